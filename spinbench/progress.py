"""What a person sees of a command that takes its time, on standard error."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.fit.sampling import Progress

# Percent done when each step of a diagnosis begins, by its first words; what is told in between goes on from there.
DIAGNOSIS_STEPS = {
    "base": 0,
    "detect": 8,
    "look farther": 10,
    "name": 12,
    "test": 80,
    "confirm": 88,
    "locate": 92,
    "look for a law": 93,
    "next test": 94,
    "weigh": 96,
}


@contextlib.contextmanager
def counting(name: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar for what can be counted."""
    from rich.markup import escape

    from rig.progress import bar_of

    with bar_of() as bar:
        task = bar.add_task(escape(name), total=max(total, 1))
        yield lambda done: bar.update(task, completed=done)


@contextlib.contextmanager
def bars() -> Iterator[Callable[[str], Callable[[int, int, str], None]]]:
    """Bars, one a step, with the time left, for items that take seconds to minutes each."""
    from rig.progress import TASK, Bar, Count, Elapsed, Left, bar_of

    with bar_of(TASK, Bar, Count, Elapsed, "left", Left, pace_s=3600.0) as bar:

        def begin(step: str) -> Callable[[int, int, str], None]:
            task = bar.add_task(step, total=None)
            return lambda done, total, last: bar.update(task, completed=done, total=total)

        yield begin


@contextlib.contextmanager
def diagnosing(what: str = "diagnosis") -> Iterator[Callable[[str], None]]:
    """A bar that names the step; it is gone once there is a result or a refusal."""
    from rig.progress import TASK, Bar, Elapsed, bar_of

    done = 0.0
    with bar_of(what, Bar, Elapsed, TASK, passing=True, seen_by_a_person=True) as bar:
        task = bar.add_task("", total=100)

        def tell(step: str) -> None:
            nonlocal done
            begins = [percent for name, percent in DIAGNOSIS_STEPS.items() if step.startswith(name)]
            following = next((percent for percent in DIAGNOSIS_STEPS.values() if percent > done), 98)
            done = max(done, begins[0]) if begins else done + 0.1 * (following - done)
            bar.update(task, description=step, completed=done)

        yield tell


@contextlib.contextmanager
def sampling(name: str) -> Iterator[Progress]:
    """A bar: effective samples drawn of those wanted, with the time left."""
    from rig.progress import DONE, TASK, Bar, Elapsed, Left, bar_of

    bar = bar_of(TASK, Bar, f"{DONE} effective samples", Elapsed, "left", Left)
    task = bar.add_task(name, total=1.0)
    most = 0.0
    with contextlib.ExitStack() as shown:

        def tell(done: int, wanted: float, words: str) -> None:
            nonlocal most
            if not bar.live.is_started:  # not before sampling begins: a refusal comes without a bar
                shown.enter_context(bar)
            most = max(most, min(done, wanted))  # an estimate may fall again; a bar does not run backwards
            bar.update(task, description=f"{name}: {words}", completed=most, total=wanted)

        yield tell


@contextlib.contextmanager
def waiting(words: str) -> Iterator[Callable[[str], None]]:
    """A line while something is found out, to which a step may be added; it is gone once there is an answer."""
    from rich.console import Console

    with Console(stderr=True).status(words) as line:
        yield lambda step: line.update(f"{words} {step}")
