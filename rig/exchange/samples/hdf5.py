"""Samples as an HDF5 file in the manner of NeXus: one entry, and in it a log (NXlog) a channel."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.exchange.samples.channels import SampledChannel, sampled_channels
from rig.runlog.reader import Run
from rig.runlog.rows import utc_text

ENTRY = "run"


def write(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """Write a run's samples, with its records as text."""
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
