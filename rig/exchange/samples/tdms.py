"""Samples as a TDMS file: a group a channel, in it `value`, `time_s` and what stands beside them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from rig.exchange.samples.channels import sampled_channels
from rig.runlog.reader import Run
from rig.runlog.rows import utc_text


def write(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """Write a run's samples, with its records as properties of the file."""
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
