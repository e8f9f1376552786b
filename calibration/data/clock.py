"""When each row was read: on the recording's clock, or not known."""

from __future__ import annotations

from collections.abc import Iterable

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


def untimed_row(rows: Iterable[tuple[RecordingFile, int]]) -> str:
    """The first of some rows without a time, as ``file, row``; empty where each has one."""
    for file, number in rows:
        if not np.isfinite(times_of(file)[number - 1]):
            return f"{file.file}, row {number}"
    return ""
