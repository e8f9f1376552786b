"""Samples as a Parquet file: the table of samples.csv with types, the records in its metadata."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.runlog.reader import Run


def write(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """Write a run's samples, with its records by their names."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.Table.from_pandas(run.samples, schema=_schema(pa), preserve_index=False)
    pq.write_table(table.replace_schema_metadata({"run": run.name, **records}), file, compression="zstd")


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
