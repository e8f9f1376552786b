"""The operator's stop: Ctrl-C once vents and seals the run, twice ends it now. SIGTERM and SIGHUP count as once.

The handlers only count: whoever runs the sweep looks at `Stop.asked` and does the venting, in its own thread and with
its own time-outs. Nothing here takes a lock that the interrupted thread might hold.
"""

from __future__ import annotations

import collections
import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

POLITE = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))

CLOSED = "the terminal was closed"


class Stop:
    """Counts requests to stop while it is entered.

    `on_first`: called once, with who asked (``Ctrl-C``, ``SIGTERM``, ...), in the thread that asked, a signal's being
        the main one. It must be short and must not raise.
    `by`: who asked first; empty while nobody has.
    """

    def __init__(self, on_first: Callable[[str], None] | None = None) -> None:
        self._on_first = on_first
        self._asks: collections.deque[str] = collections.deque()  # appending is atomic, in a signal handler too
        self._polite: collections.deque[str] = collections.deque()
        self._first = threading.Lock()  # only ever tried, never waited for
        self._before: dict[int, Any] = {}
        self.by = ""
        self._interrupts = False

    @contextlib.contextmanager
    def interrupting(self) -> Iterator[None]:
        """While entered a signal raises KeyboardInterrupt too: for a question to a person that may be left open."""
        self._interrupts = True
        try:
            yield
        finally:
            self._interrupts = False

    @property
    def asked(self) -> int:
        """0: go on; 1: vent and seal the run; 2 or more: now [-]."""
        return max(len(self._asks), min(1, len(self._polite)))

    def ask(self, who: str = "operator") -> None:
        """Ask as Ctrl-C does; twice means now."""
        self._asks.append(who)
        self._tell(who)

    def __enter__(self) -> Stop:
        """Install the handlers, in the main thread; elsewhere the system does not allow it, and only `ask` counts."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, *POLITE):
                self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        """Put the handlers back that were there."""
        for number, handler in self._before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGINT:
            self.ask("Ctrl-C")
        else:
            who = CLOSED if number == getattr(signal, "SIGHUP", None) else signal.Signals(number).name
            self._polite.append(who)
            self._tell(who)
        if self._interrupts:
            raise KeyboardInterrupt

    def _tell(self, who: str) -> None:
        if self._first.acquire(blocking=False):
            self.by = who
            if self._on_first is not None:
                self._on_first(who)
