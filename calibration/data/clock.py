"""When each row was read: on the recording's clock, or not known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from model.effects.effect import Effect
from rig.recording import RecordingFile


def times_of(file: RecordingFile) -> np.ndarray:
    """Time of each row of a file on the recording's clock [s], shape (n,); nan where none was taken."""
    stamps = file.columns.get("time_s")
    return np.full(file.rows, np.nan) if stamps is None else file.start_s + stamps.values


def needs_clock(effect: Effect) -> bool:
    """Whether steady rows show an effect only where it is known when each was read."""
    return not effect.transient_only and any(parameter.unit == "s" for parameter in effect.parameters)


def times_of_rows(rows: Sequence[tuple[RecordingFile, int]]) -> tuple[np.ndarray, str]:
    """When some rows were read [s], shape (n,), and the first without a time, as ``file, row``: then 0 throughout.

    `rows`: file, and number of the row from 1.
    """
    clocks = {file.file: times_of(file) for file, _ in rows}
    time = np.array([clocks[file.file][number - 1] for file, number in rows])
    without = np.flatnonzero(~np.isfinite(time))
    if not without.size:
        return time, ""
    file, number = rows[int(without[0])]
    return np.zeros(len(rows)), f"{file.file}, row {number}"
