"""A port that plays back what crossed the wire, with the times it was there."""

from __future__ import annotations

from collections import deque

from rig.lines.port import LostError
from rig.readings import Event


class ReplayPort:
    """Plays back the events of one exchange after the other.

    A driver that asks what it asked then gets what came then. One that was mended may ask or wait otherwise: what was
    received is given until the next question, and silence after that.
    """

    def __init__(self) -> None:
        self._events: deque[Event] = deque()
        self._last_ns = 0
        self.differences: list[str] = []  # where the bytes asked are not those that were asked

    def load(self, events: tuple[Event, ...]) -> None:
        """Lay in the events of the next exchange; what is left of the last one is dropped."""
        self._events = deque(events)
        if events:
            self._last_ns = events[0].time_ns

    def open(self) -> None:
        """Open; fails as it failed then."""
        self._fail_if_lost()

    def close(self) -> None:
        """Close."""

    def write(self, data: bytes) -> int:
        """Compare with what was sent, and return the time at which it was [ns]."""
        while self._events and self._events[0].kind in ("rx", "silence"):
            self._events.popleft()
        self._fail_if_lost()
        if not self._events:
            self.differences.append(f"sends {data[:32].hex(' ')} where nothing was sent")
            return self._last_ns
        sent = self._events.popleft()
        self._last_ns = sent.time_ns
        if sent.data != data:
            self.differences.append(f"sends {data[:32].hex(' ')} where {sent.data[:32].hex(' ')} was sent")
        return sent.time_ns

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """What came next then. `until_ns`: not used: the wait ended as it ended then [ns]."""
        self._fail_if_lost()
        if not self._events or self._events[0].kind == "tx":
            return max(self._last_ns, until_ns), b""
        event = self._events.popleft()
        self._last_ns = event.time_ns
        return event.time_ns, event.data

    def _fail_if_lost(self) -> None:
        if self._events and self._events[0].kind == "lost":
            raise LostError(self._events.popleft().data.decode(errors="replace"))
