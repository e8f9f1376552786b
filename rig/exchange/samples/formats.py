"""The formats of a run's samples; each takes the run, its records by their names, and the file to make."""

from __future__ import annotations

import datetime
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rig.exchange.samples.channels import SampledChannel, sampled_channels
from rig.runlog.reader import Run
from rig.runlog.rows import utc_text

ENTRY = "run"  # of an HDF5 file


def write_parquet(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """A Parquet file: the table of samples.csv with types, the records in its metadata."""
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


def write_hdf5(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """An HDF5 file in the manner of NeXus: one entry, and in it a log (NXlog) a channel, with the records as text."""
    import h5py

    start = utc_text(run.start.clock.utc_start_ns)
    # In memory first: on a full disk the library can take the process down.
    with h5py.File(file.name, "w", driver="core", backing_store=False) as out:
        out.attrs["default"] = ENTRY
        entry = out.create_group(ENTRY, track_order=True)
        entry.attrs["NX_class"] = "NXentry"
        _text(entry, "title", run.start.title or run.name)
        _text(entry, "run", run.name)
        _text(entry, "start_time", start)
        for name, data in records.items():
            _text(entry, name, data.decode("utf-8"))
        for channel in sampled_channels(run):
            _log(entry, channel, start)
        out.flush()
        file.write_bytes(out.id.get_file_image())


def _log(entry: Any, channel: SampledChannel, start: str) -> None:
    import h5py

    log = entry.create_group(channel.name)
    log.attrs["NX_class"] = "NXlog"
    log.create_dataset("value", data=channel.value, compression="gzip").attrs["units"] = channel.unit
    time = log.create_dataset("time", data=channel.time_s, compression="gzip")
    time.attrs["units"], time.attrs["start"] = "s", start
    for name, values in channel.beside.items():
        kind = h5py.string_dtype("utf-8", values.dtype.itemsize) if values.dtype.kind == "S" else values.dtype
        log.create_dataset(name, data=values.astype(kind), compression="gzip")


def _text(group: Any, name: str, text: str) -> None:
    group.create_dataset(name, data=text)


def write_tdms(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """A TDMS file: a group a channel, in it `value`, `time_s` and what stands beside; the records as properties."""
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    said = {name: data.decode("utf-8") for name, data in records.items()}
    root = RootObject({"name": run.name, "start_time": utc_text(run.start.clock.utc_start_ns), **said})
    with TdmsWriter(file) as out:
        out.write_segment([root])
        for channel in sampled_channels(run):
            columns = [
                ChannelObject(channel.name, "value", channel.value, {"unit_string": channel.unit}),
                ChannelObject(channel.name, "time_s", channel.time_s, {"unit_string": "s"}),
            ]
            for name, values in channel.beside.items():
                cells = [cell.decode("utf-8") for cell in values.tolist()] if values.dtype.kind == "S" else values
                columns.append(ChannelObject(channel.name, name, cells))
            out.write_segment([GroupObject(channel.name), *columns])


def write_mdf(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """An MDF 4 file: a channel group a channel, over its own times, with the records as attachments.

    A sample without a value is invalid.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the package has to say while it is imported
        from asammdf import MDF
    with MDF(version="4.10") as out:
        out.start_time = datetime.datetime.fromisoformat(utc_text(run.start.clock.utc_start_ns))
        for channel in sampled_channels(run):
            out.append(_signals(channel), acq_name=channel.name, comment=channel.name, common_timebase=True)
        for name, data in records.items():
            out.attach(data, file_name=name, mime="application/json", compression=False)
        out.save(file)


def _signals(channel: SampledChannel) -> list[Any]:
    """The channel under its own name; what stands beside it has that name in front."""
    from asammdf import Signal

    missing = np.isnan(channel.value)
    found = [Signal(channel.value, channel.time_s, unit=channel.unit, name=channel.name, invalidation_bits=missing)]
    for name, values in channel.beside.items():
        said = f"{channel.name}.{name}"
        encoding = "utf-8" if values.dtype.kind == "S" else None
        found.append(Signal(values, channel.time_s, name=said, encoding=encoding))
    return found
