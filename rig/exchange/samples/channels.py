"""The samples of a run by channel, as the formats for channels have them.

Beside each value stand its quality, whether it is off the scale, its times and the words of the instrument.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rig.recording.mistakes import shown
from rig.runlog.folder import RunError
from rig.runlog.reader import Run

# Columns of `Run.samples` beside the value, and what they are kept as; text where there is nothing.
BESIDE = {
    "n": "i8",
    "exchange": "i8",
    "quality": "",
    "censored": "i1",
    "time_ns": "i8",
    "request_ns": "i8",
    "reply_ns": "i8",
    "retries": "i4",
    "utc": "",
    "raw": "",
    "detail": "",
}


@dataclass(frozen=True)
class SampledChannel:
    """One channel's samples.

    `name`: `device.channel`.
    `value`: in `unit`; NaN where there is none.
    `time_s`: of each sample [s], from the run's start.
    `beside`: the columns of `BESIDE`: numbers, or text in UTF-8.
    """

    name: str
    unit: str
    value: NDArray[np.float64]
    time_s: NDArray[np.float64]
    beside: dict[str, NDArray[np.generic]]


def sampled_channels(run: Run) -> Iterator[SampledChannel]:
    """The channels of a run, each with its samples in the order of the log.

    Raises RunError when a channel has several units: a channel of these formats has one.
    """
    for (device, channel), rows in run.samples.groupby(["device", "channel"], sort=False, dropna=False):
        name, units = f"{device}.{channel}", [unit for unit in rows["unit"].unique() if unit]
        if len(units) > 1:
            raise RunError(
                f"{run.folder}: {name} has several units ({', '.join(map(shown, units))}); export it as Parquet, or as "
                "a recording"
            )
        beside: dict[str, NDArray[np.generic]] = {
            key: rows[key].to_numpy(dtype=kind) if kind else encoded(rows[key]) for key, kind in BESIDE.items()
        }
        value, time_s = rows["value"].to_numpy(dtype=np.float64), rows["time_s"].to_numpy(dtype=np.float64)
        yield SampledChannel(name, units[0] if units else "", value, time_s, beside)


def encoded(cells: Iterable[object]) -> NDArray[np.bytes_]:
    """Text as UTF-8, of one width."""
    return np.array([str(cell).encode("utf-8") for cell in cells], dtype=np.bytes_)
