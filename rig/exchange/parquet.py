"""A sealed run as one Parquet file, for those who analyse it elsewhere."""

from __future__ import annotations

import contextlib
import os
import uuid
from pathlib import Path
from typing import Any

from rig.runlog.folder import END, MAX_RECORD_BYTES, START, RunError, read_bytes
from rig.runlog.reader import BEING_WRITTEN, Run


def export_parquet(run: Run, file: Path) -> None:
    """Write the samples of a run as a Parquet file, with its start and end records in the file's metadata.

    Raises
    ------
    RunError
        When the run has no end record, the file exists, or pyarrow is not installed.
    """
    file = Path(file)
    if run.end is None:
        what = "is being written" if run.state == BEING_WRITTEN else "was killed: `spinbench runs repair` seals it"
        raise RunError(f"{run.folder}: only a sealed run becomes a Parquet file, and this one {what}")
    if os.path.lexists(file):
        raise RunError(f"{file}: exists already; nothing is overwritten, give a name that is free")
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise RunError(
            'a Parquet file needs the package pyarrow; install it with `pip install "spinbench[formats]"`'
        ) from None
    beside = file.with_name(f".{file.name}.{uuid.uuid4().hex}.writing")
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        table = pa.Table.from_pandas(run.samples, schema=_schema(pa), preserve_index=False)
        records = {name: read_bytes(run.folder / name, MAX_RECORD_BYTES) for name in (START, END)}
        pq.write_table(table.replace_schema_metadata({"run": run.name, **records}), beside, compression="zstd")
        beside.rename(file)
    except OSError as error:
        raise RunError(
            f"{file}: cannot be written ({error.strerror or error}); check the place and the space"
        ) from None
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def _schema(pa: Any) -> Any:
    """The columns and their types; words that repeat are kept once."""
    word = pa.dictionary(pa.int32(), pa.string())
    return pa.schema(
        [
            ("n", pa.int64()),
            ("exchange", pa.int64()),
            ("device", word),
            ("channel", word),
            ("value", pa.float64()),
            ("unit", word),
            ("quality", word),
            ("censored", pa.int8()),
            ("time_ns", pa.int64()),
            ("time_s", pa.float64()),
            ("request_ns", pa.int64()),
            ("reply_ns", pa.int64()),
            ("utc", pa.string()),
            ("retries", pa.int32()),
            ("raw", pa.string()),
            ("detail", pa.string()),
        ]
    )
