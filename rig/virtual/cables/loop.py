"""One thread for everything: bytes that come, and actions at times of the bench's clock."""

from __future__ import annotations

import heapq
import itertools
import selectors
from collections.abc import Callable
from typing import Any

from rig.clock import Clock
from rig.readings import NS

MOST_WAIT_S = 0.2  # of the wall


class Loop:
    """Calls what is due and what has bytes, until it is stopped."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.stopped = False
        self._due: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._files = selectors.SelectSelector()  # its time-out is finer than a millisecond

    def at(self, time_ns: int, action: Callable[[], None]) -> None:
        """Call something at a time. `time_ns`: time of the bench; at once when past [ns]."""
        heapq.heappush(self._due, (time_ns, next(self._order), action))

    def after(self, span_s: float, action: Callable[[], None]) -> None:
        """Call something after a span of the bench's time. `span_s`: how long [s]."""
        self.at(self.clock.now_ns() + int(span_s * NS), action)

    def every(self, real_s: float, action: Callable[[], None]) -> None:
        """Call something again and again. `real_s`: how often, on the wall's clock [s]."""

        def again() -> None:
            action()
            self.after(real_s * self.clock.rate, again)

        self.after(0.0, again)

    def watch(self, file: Any, action: Callable[[], None]) -> None:
        """Call something whenever a file has bytes; a socket that listens, a caller."""
        self._files.register(file, selectors.EVENT_READ, action)

    def forget(self, file: Any) -> None:
        """Watch a file no more."""
        self._files.unregister(file)

    def run(self) -> None:
        """Work until `stop`."""
        while not self.stopped:
            wait_s = MOST_WAIT_S
            if self._due:
                wait_s = min(wait_s, self.clock.real_s((self._due[0][0] - self.clock.now_ns()) / NS))
            for key, _ in self._files.select(max(0.0, wait_s)):
                if key.fileobj in self._files.get_map():  # an action before may have closed it
                    key.data()
            now_ns = self.clock.now_ns()
            while self._due and self._due[0][0] <= now_ns:
                heapq.heappop(self._due)[2]()

    def stop(self) -> None:
        """End `run` after the present action."""
        self.stopped = True
