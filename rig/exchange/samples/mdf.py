"""Samples as an MDF 4 file: a channel group a channel, over its own times; a sample without a value is invalid."""

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


def write(run: Run, records: Mapping[str, bytes], file: Path) -> None:
    """Write a run's samples, with its records as attachments."""
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
