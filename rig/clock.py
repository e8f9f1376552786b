"""The bench's clock: monotonic, tied to UTC once, and on a virtual bench faster than the wall's."""

from __future__ import annotations

import time


class Clock:
    """A monotonic clock that runs at `rate` times real time.

    `rate`: seconds of the bench in one second of the wall [-]; 1 with hardware.
    `start_ns`: real monotonic time at which the bench's clock reads 0 [ns]; now, when left out. Two processes that
        share it and the rate (on Linux the monotonic clock is the machine's) share the bench's time.
    """

    def __init__(self, rate: float = 1.0, start_ns: int | None = None) -> None:
        if not 0.01 <= rate <= 1000.0:
            raise ValueError(f"the clock's rate is {rate:g}; it lies between 0.01 and 1000")
        self.rate = rate
        self.start_ns = time.monotonic_ns() if start_ns is None else start_ns
        self.utc_start_ns = time.time_ns() - (time.monotonic_ns() - self.start_ns)

    def now_ns(self) -> int:
        """Time of the bench [ns], 0 at the start."""
        return self.at_ns(time.monotonic_ns())

    def at_ns(self, real_ns: int) -> int:
        """The bench's time at a real monotonic time. `real_ns`: of `time.monotonic_ns` [ns]."""
        passed = real_ns - self.start_ns
        return passed if self.rate == 1.0 else int(passed * self.rate)

    def real_s(self, bench_s: float) -> float:
        """Real seconds that a span of the bench's time takes [s]. `bench_s`: span on the bench [s]."""
        return bench_s / self.rate

    def sleep(self, bench_s: float) -> None:
        """Wait for a span of the bench's time. `bench_s`: how long [s]; nothing happens when not positive."""
        if bench_s > 0.0:
            time.sleep(self.real_s(bench_s))
