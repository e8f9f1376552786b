"""How long each step of a diagnosis takes, and the telling of each step as it begins."""

from __future__ import annotations

import time
from collections.abc import Callable

Tell = Callable[[str], None]


class StepClock:
    """Called with the name of a step when it begins, and with an empty one after the last.

    `tell`: as given; what it is told besides is no step of its own.
    `seconds`: of each step that has ended; of one that came again, together [s].
    """

    def __init__(self, tell: Tell) -> None:
        self.seconds: dict[str, float] = {}
        self.tell = tell
        self._step, self._began = "", time.monotonic()

    def __call__(self, step: str) -> None:
        now = time.monotonic()
        if self._step:
            self.seconds[self._step] = round(self.seconds.get(self._step, 0.0) + now - self._began, 3)
        self._step, self._began = step, now
        if step:
            self.tell(step)
