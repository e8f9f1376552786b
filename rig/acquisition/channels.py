"""The recent readings of each channel, for whoever decides on them: the sweep, the interlocks, a live view."""

from __future__ import annotations

import collections
import threading
from dataclasses import dataclass

import numpy as np

from rig.readings import NS, Quality, Reading

KEPT = 50_000  # readings of a channel


@dataclass(frozen=True)
class Window:
    """The usable readings of a channel over a span of time, oldest first.

    `time_s`, `value`, shape (n,): bench time [s], and the values in the channel's unit.
    `censored`, shape (n,): -1 and 1 for readings beyond the scale [-].
    """

    time_s: np.ndarray
    value: np.ndarray
    quality: list[Quality]
    censored: np.ndarray

    @property
    def size(self) -> int:
        """Number of readings [-]."""
        return int(self.time_s.size)


class Channels:
    """A bounded store of readings that one thread fills and others look at."""

    def __init__(self) -> None:
        self._readings: dict[str, collections.deque[Reading]] = {}
        self._lock = threading.Lock()

    def add(self, readings: tuple[Reading, ...]) -> None:
        """Keep readings, failed ones included."""
        with self._lock:
            for reading in readings:
                self._readings.setdefault(reading.name, collections.deque(maxlen=KEPT)).append(reading)

    def last(self, name: str) -> Reading | None:
        """The newest reading of a channel, failed or not; None before the first."""
        with self._lock:
            kept = self._readings.get(name)
            return kept[-1] if kept else None

    def since(self, name: str, after_ns: int) -> list[Reading]:
        """The readings of a channel, failed or not, whose replies came after a time [ns], oldest first."""
        chosen: list[Reading] = []
        with self._lock:
            for reading in reversed(self._readings.get(name, ())):
                if reading.reply_ns <= after_ns:
                    break
                chosen.append(reading)
        chosen.reverse()
        return chosen

    def window(self, name: str, start_ns: int, end_ns: int | None = None) -> Window:
        """The usable readings of a channel from a time on.

        `start_ns`, `end_ns`: bench times [ns]; to the newest when the end is left out.
        """
        chosen: list[Reading] = []
        with self._lock:
            for reading in reversed(self._readings.get(name, ())):
                if reading.time_ns < start_ns:
                    break
                if reading.usable and (end_ns is None or reading.time_ns <= end_ns):
                    chosen.append(reading)
        chosen.reverse()
        return Window(
            np.array([reading.time_ns / NS for reading in chosen]),
            np.array([reading.value for reading in chosen], dtype=np.float64),
            [reading.quality for reading in chosen],
            np.array([reading.censored for reading in chosen], dtype=np.int64),
        )
