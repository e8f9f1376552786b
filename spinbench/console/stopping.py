"""STOP: the process that writes a run is told, as `kill -TERM` does, and its own log says whether it was done.

docs/safety.md, the operator's stop: it vents the line and seals the run. Nothing here touches an instrument.
"""

from __future__ import annotations

import functools
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.runlog import RunError
from rig.runlog.folder import END, START, is_locked, writer_of
from rig.runlog.listing import age_of
from rig.runlog.reader import read_start
from rig.runlog.tail import SET_POINT, STATE, Tail
from spinbench.console.words import CLOSE_SUPPLY, is_imported

CONFIRMED_WITHIN_S = 5.0  # of the wall; then NOT DELIVERED is shown, and put right if the order comes later
MEASURED = ("sweep", "coast-down", "spin-up", "zero", "plateaus", "manual")  # kinds that have a bench
ENDING = ("vent", "aborted", "failed", "done")  # states: in a capture zero is ordered too, and the run goes on
_age_of = functools.cache(age_of)  # they are looked for twice a second


def being_written(logs: Path) -> list[Path]:
    """The runs on a bench that a program writes now, oldest first."""
    open_ones = [one for one in newest_first(logs) if not (one / END).exists() and is_locked(one)]
    return [one for one in reversed(open_ones) if _is_of_a_bench(one)]


def runs_of_benches(logs: Path) -> Iterator[Path]:
    """The runs that were taken on a bench, newest first: no imports. One that cannot be read counts."""
    for one in newest_first(logs):
        try:
            is_of_a_bench = _is_of_a_bench(one)
        except RunError:
            is_of_a_bench = True
        if is_of_a_bench:
            yield one


def newest_first(logs: Path) -> list[Path]:
    """The runs of a folder by when they began, whatever they were called since."""
    if not logs.is_dir():
        return []
    found = (one for one in logs.iterdir() if (one / START).is_file() and not one.is_symlink())
    return sorted(found, key=_age_of, reverse=True)


@functools.cache
def _is_of_a_bench(folder: Path) -> bool:
    start = read_start(folder)
    return start.kind in MEASURED and not is_imported(start)


def ask_to_stop(pid: int | None) -> str:
    """Tell a process to vent and seal; why it could not be told, empty when it was."""
    if pid is None:
        return "the program that writes the run is not known"
    try:
        os.kill(pid, signal.SIGTERM)
    except ProcessLookupError:
        return f"its program, process {pid}, has ended"
    except PermissionError:
        return f"its program, process {pid}, belongs to another user"
    return ""


@dataclass
class Stopping:
    """One press of STOP on one run.

    `after`: the newest event of the run when it was pressed [-].
    `by_hand`: whether a person has the valve, and no regulator.
    `pressed_s`: the same on the monotonic clock, which nobody sets back [s].
    `delivered_s`: how long after STOP the regulator was ordered to zero [s].
    """

    run: Path
    by: str
    at: float
    after: int
    refused: str = ""
    by_hand: bool = False
    delivered_s: float | None = None
    ended: bool = False
    vented: bool = False
    pressed_s: float = field(default_factory=time.monotonic)

    @classmethod
    def of(cls, run: Path, by: str) -> Stopping:
        """Press it. The log is read to its end first: what comes later is the answer."""
        tail = _followed(run)
        at = time.time()
        by_hand = tail.start.roles.get("regulator") is None
        return cls(run, by, at, tail.last_event, ask_to_stop(writer_of(run)), by_hand)

    @property
    def delivered(self) -> bool:
        """Whether the log says that it was done."""
        return self.delivered_s is not None or self.ended

    def look(self, tail: Tail) -> None:
        """See whether the run's log has the answer."""
        order = tail.latest.get(SET_POINT)
        state = tail.latest.get(STATE)
        is_ending = state is not None and state.details.get("state") in ENDING
        is_zero = order is not None and order.n > self.after and order.details.get("bar_abs") is None and is_ending
        if self.delivered_s is None and is_zero and order is not None:
            clock = tail.start.clock
            self.delivered_s = max(clock.utc_start_ns / 1e9 + order.time_s / clock.rate - self.at, 0.0)
        self.ended = tail.end is not None
        self.vented = tail.end is not None and tail.end.vented is True

    def told(self) -> dict[str, Any]:
        """For the page: ``asked``, ``DELIVERED`` or ``NOT DELIVERED``, and what to do."""
        name = self.run.name
        if self.delivered:
            line = "The line is vented." if self.vented else "The line is being vented: watch the gauge."
            if self.ended and not self.vented:
                line = f"The line is NOT known to be without pressure. {CLOSE_SUPPLY}"
            order = "The run has ended."
            if self.delivered_s is not None:
                order = f"The regulator was ordered to zero {self.delivered_s:.1f} s after STOP."
            text = f"{order} {line}"
            return {"word": "DELIVERED", "text": text, "run": name, "by": self.by}
        waited = time.monotonic() - self.pressed_s
        if self.refused or waited > CONFIRMED_WITHIN_S:
            silent = f"its log has no order to vent for {waited:.0f} s"
            why = self.refused or ("A person has this bench's valve" if self.by_hand else silent)
            return {"word": "NOT DELIVERED", "text": f"{why}. {CLOSE_SUPPLY}", "run": name, "by": self.by}
        return {"word": "asked", "text": "The order is on its way.", "run": name, "by": self.by}


def nothing_to_stop(logs: Path) -> dict[str, Any]:
    """What STOP says where no run is being written."""
    text = f"No run is being written in {logs}. If there is pressure: {CLOSE_SUPPLY[:1].lower()}{CLOSE_SUPPLY[1:]}"
    return {"word": "NOT DELIVERED", "text": text, "run": "", "by": ""}


def _followed(run: Path) -> Tail:
    """The run's events so far; its samples are left aside."""
    tail = Tail(run)
    tail.advance(blocks=0)
    return tail
