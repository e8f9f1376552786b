"""Runs that are planned one after the other: each begins when the one before has ended well, and not otherwise."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from rig.bench.bench import Bench
from spinbench.console.access import RefusedError
from spinbench.console.planned import MOST_ROWS, Planned, of_table, planned_of
from spinbench.console.sweeps import Sweeps


class Queue:
    """The list, and whether it goes on by itself. Its methods may be called from several threads.

    `keep`: is given the list when it has changed.
    """

    def __init__(self, bench: Bench, sweeps: Sweeps, held: list[Any], keep: Callable[[list[Any]], None]) -> None:
        self._bench, self._sweeps, self._keep = bench, sweeps, keep
        self._lock = threading.RLock()
        self._waiting: list[tuple[int, Planned]] = []
        self._numbered = 0
        self._answers: dict[str, str] = {}
        self._inertia: float | None = None  # of the flywheel that is on the shaft
        self.going, self.said = False, ""
        for one in held[:MOST_ROWS]:
            try:
                self._add(planned_of(one if isinstance(one, dict) else {}, bench))
            except RefusedError as error:  # of another bench, or another version
                self.said = f"a run that was kept from before is left out: {error}"

    def change(self, do: str, asked: Mapping[str, Any]) -> None:
        """What a window asks for. `do`: ``add``, ``load``, ``clone``, ``remove``, ``up``, ``down``, ``hold``."""
        with self._lock:
            if do == "add":
                entry = asked.get("planned")
                self._add(planned_of(entry if isinstance(entry, dict) else {}, self._bench))
            elif do == "load":
                self._add(*of_table(str(asked.get("text", "")), self._bench))
            elif do == "hold":
                self.hold("A person holds it.")
            else:
                self._move(do, asked.get("n"))
            self._keep([asdict(planned) for _, planned in self._waiting])

    def _add(self, *new: Planned) -> None:
        if len(self._waiting) + len(new) > MOST_ROWS:
            raise RefusedError(409, f"the queue holds at most {MOST_ROWS} runs")
        for planned in new:
            self._numbered += 1
            self._waiting.append((self._numbered, planned))

    def _move(self, do: str, n: Any) -> None:
        at = next((i for i, (number, _) in enumerate(self._waiting) if number == n), None)
        if at is None:
            raise RefusedError(409, "that run is no longer in the queue")
        entry = self._waiting[at]
        if do == "clone":
            self._add(entry[1])
            self._waiting.insert(at + 1, self._waiting.pop())
        elif do == "remove":
            del self._waiting[at]
        elif do in ("up", "down"):
            del self._waiting[at]
            self._waiting.insert(max(at - 1, 0) if do == "up" else at + 1, entry)
        else:
            raise RefusedError(400, f"the queue cannot '{do[:20]}'")

    def start(self, answers: dict[str, str], expected: Any) -> None:
        """Start the first one; the others follow.

        `expected`: the numbers of the runs that the window showed; another list is refused.
        """
        with self._lock:
            if not self._waiting:
                raise RefusedError(409, "the queue is empty")
            if expected != [number for number, _ in self._waiting]:
                raise RefusedError(409, "the queue has changed since it was shown: look at it and start it again")
            self._answers = answers
            self._inertia = self._waiting[0][1].added_inertia_kg_m2
            self._next()
            self.going, self.said = True, ""

    def hold(self, why: str) -> None:
        """No further run begins by itself."""
        with self._lock:
            if self.going:
                self.going, self.said = False, f"The queue is held. {why}"

    def follow(self) -> None:
        """Begin the next one where the one before has ended well; hold where it has not."""
        with self._lock:
            if not self.going or self._sweeps.running:
                return
            if why := self._sweeps.why_not_well():
                self.hold(f"{why} Find the cause, then start the queue again.")
            elif not self._waiting:
                self.going, self.said = False, "The queue is done."
            elif self._waiting[0][1].added_inertia_kg_m2 != self._inertia:
                self.hold("The next run wants another flywheel: change it, then start the queue again.")
            else:
                try:
                    if self._answers.get("minutes_running", "").strip():
                        self._answers["minutes_running"] = f"{self._sweeps.minutes_running():.1f}"
                    self._next()
                except RefusedError as error:
                    self.hold(f"The next run was refused: {error}.")

    def _next(self) -> None:
        planned = self._waiting[0][1]
        self._sweeps.start(planned, self._answers)
        del self._waiting[0]
        self._keep([asdict(one) for _, one in self._waiting])

    def told(self) -> dict[str, Any]:
        """For the page."""
        with self._lock:
            waiting = [{"n": number, **planned.told(self._bench)} for number, planned in self._waiting]
            return {"waiting": waiting, "going": self.going, "said": self.said}
