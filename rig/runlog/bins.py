"""A series in bounded memory: the lowest and highest value of each stretch of time, on scales that double."""

from __future__ import annotations

from collections import deque

FINEST_S = 0.05
BINS = 800  # kept of each scale
SCALES = 20  # the coarsest spans 240 days

Bin = tuple[float, float, float]  # when it begins [s], lowest, highest


class Bins:
    """Bins of one channel. Times may only grow; what comes late is counted to the bin that is open."""

    def __init__(self) -> None:
        self._closed: list[deque[Bin]] = [deque(maxlen=BINS) for _ in range(SCALES)]
        self._open: list[Bin | None] = [None] * SCALES
        self.first_s: float | None = None

    def add(self, time_s: float, value: float) -> None:
        """Take a reading."""
        if self.first_s is None:
            self.first_s = time_s
        self._merge(0, (time_s, value, value))

    def _merge(self, scale: int, new: Bin) -> None:
        width = FINEST_S * 2.0**scale
        start = new[0] // width * width
        held = self._open[scale]
        if held is None or start > held[0]:
            if held is not None:
                self._closed[scale].append(held)
                if scale + 1 < SCALES:
                    self._merge(scale + 1, held)
            self._open[scale] = (start, new[1], new[2])
        else:
            self._open[scale] = (held[0], min(held[1], new[1]), max(held[2], new[2]))

    def last(self, from_s: float, until_s: float, most: int = BINS) -> list[Bin]:
        """The bins from a time to another, no more than `most`, on the finest scale that does."""
        span = max(until_s - from_s, FINEST_S)
        scale = next((k for k in range(SCALES - 1) if FINEST_S * 2.0**k * (most - 1) >= span), SCALES - 1)
        bins = [*self._closed[scale]]
        for k in range(scale, -1, -1):  # what is not in a closed bin of this scale yet
            part = self._open[k]
            if part is not None:
                bins.append(part)
        return [one for one in bins if from_s - FINEST_S * 2.0**scale < one[0] <= until_s]
