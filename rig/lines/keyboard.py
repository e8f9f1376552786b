"""A person at a terminal, as a port: prompts go out, typed lines come in. A pipe does as well as a terminal.

Who talks with the person (`by_hand.manual`) sorts commands from entries first, and lays an entry in with `feed`: the
next question and answer on the line are that entry, with the times at which it was asked for and typed. So the log
holds what an instrument's would, and a replay reads it in the same way.
"""

from __future__ import annotations

import os
import select
import sys
from collections import deque

from rig.clock import Clock
from rig.lines.port import LostError
from rig.readings import NS

MOST_BYTES = 4096  # of one read


class KeyboardPort:
    """Standard input and output, or any two file descriptors.

    `incoming`, `outgoing`: file descriptors; those of standard input and output when left out.
    """

    def __init__(self, clock: Clock, incoming: int | None = None, outgoing: int | None = None) -> None:
        self.clock = clock
        self._given = incoming, outgoing
        self._incoming = self._outgoing = -1
        self._fed: deque[tuple[int, int, bytes]] = deque()
        self._is_open = self._at_end = False

    def open(self) -> None:
        """Find the descriptors; fails when the program has no standard input."""
        incoming, outgoing = self._given
        try:
            self._incoming = sys.stdin.fileno() if incoming is None else incoming
            self._outgoing = sys.stdout.fileno() if outgoing is None else outgoing
        except (AttributeError, OSError, ValueError):
            raise LostError("keyboard: this program has no standard input; run it in a terminal") from None
        self._is_open = True

    def close(self) -> None:
        """Forget the descriptors; they stay open, since they are not ours."""
        self._is_open = False

    def feed(self, data: bytes, asked_ns: int, typed_ns: int) -> None:
        """Lay in what was typed: the next question asks for it, but shows nothing, and the next read gives it."""
        self._fed.append((asked_ns, typed_ns, data))

    def write(self, data: bytes) -> int:
        """Show text, and return when [ns]."""
        self._check()
        if self._fed:
            return self._fed[0][0]
        time_ns = self.clock.now_ns()
        try:
            if self._given[1] is None:
                sys.stdout.flush()  # what was printed before comes before
            while data:
                data = data[os.write(self._outgoing, data) :]
        except OSError as error:
            raise LostError(f"keyboard: the terminal is gone ({error.strerror})") from None
        return time_ns

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """Wait for what is typed; a terminal gives whole lines."""
        self._check()
        if self._fed:
            _, typed_ns, data = self._fed.popleft()
            return typed_ns, data
        if self._at_end:
            raise LostError("keyboard: the input has ended")
        wait_s = max(0.0, self.clock.real_s((until_ns - self.clock.now_ns()) / NS))
        try:
            ready = select.select([self._incoming], [], [], wait_s)[0]
            data = os.read(self._incoming, MOST_BYTES) if ready else b""
        except OSError as error:  # a terminal that was closed
            self._at_end = True
            raise LostError(f"keyboard: the terminal is gone ({error.strerror})") from None
        if ready and not data:
            self._at_end = True
            raise LostError("keyboard: the input has ended")
        return self.clock.now_ns(), data

    def _check(self) -> None:
        if not self._is_open:
            raise LostError("keyboard: not open")
