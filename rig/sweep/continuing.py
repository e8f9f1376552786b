"""What a sweep that was broken off has taken already, and those that it had itself continued."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.bench.bench import Bench
from rig.plateaus.plan import Step
from rig.plateaus.plateau import Mean, Plateau
from rig.readings import NS
from rig.recording.mistakes import shown
from rig.runlog import Run, RunError, columns_of, read_run
from rig.runlog.folder import START
from rig.runlog.phases import captures
from rig.runlog.plateaus import PlateauRow
from rig.sweep.judge import AT_REST_RPM
from rig.sweep.orders import FAILED

MOST_PARENTS = 100


@dataclass(frozen=True)
class Taken:
    """What there is already.

    `plateaus`: all that count, oldest first, those that had not settled too: what the guard learns from.
    """

    steps: tuple[Step, ...] = ()
    captures: frozenset[str] = frozenset()
    plateaus: tuple[Plateau, ...] = ()


def taken(run: Run, bench: Bench, logs: Path, motor_serial: str | None = None) -> Taken:
    """What a run, and the runs that it continues, have taken.

    `motor_serial`: of the motor that is on the bench; the bench file's when left out.
    Raises RunError when one is of another bench, motor or sweep, or of no sweep at all.
    """
    steps: list[Step] = []
    kinds: set[str] = set()
    plateaus: list[Plateau] = []
    for at in _back_from(run, logs):
        _check(at, bench)
        refuse_another_motor(at, bench, motor_serial)
        steps += [
            Step(plateau.level_bar_abs, plateau.direction, plateau.repeat)
            for plateau in _believed(at)
            if plateau.settled and plateau.level_bar_abs is not None
        ]
        plateaus = [*_plateaus(at), *plateaus]
        kinds |= {phase.kind for phase in captures(at)[0] if not phase.cut_short}
    return Taken(tuple(steps), frozenset(kinds), tuple(plateaus))


def plateaus_before(run: Run, bench: Bench, logs: Path) -> tuple[Plateau, ...]:
    """Plateaus of a run and of those that it followed, oldest first, as far as they are of this bench and there."""
    found: list[Plateau] = []
    with contextlib.suppress(RunError):  # one that is gone says no more
        for at in _back_from(run, logs):
            found = [*(_plateaus(at) if at.start.bench == bench.name else []), *found]
    return tuple(found)


def _back_from(run: Run, logs: Path) -> Iterator[Run]:
    """A run, and one after the other those that it followed."""
    seen: set[str] = set()
    at: Run | None = run
    while at is not None and at.name not in seen and len(seen) < MOST_PARENTS:
        yield at
        seen.add(at.name)
        at = _parent_of(at, logs)


def _parent_of(run: Run, logs: Path) -> Run | None:
    """The run that a run followed; by its whole name, for another's may begin with it."""
    name = run.start.goes_on_from
    if not name:
        return None
    if Path(name).name != name or not (logs / name / START).is_file():
        raise RunError(
            f"{run.name} goes on from '{shown(name, 100)}', which is not in {logs}; put it there, or start anew"
        )
    return read_run(logs / name)


def refuse_another_motor(run: Run, bench: Bench, motor_serial: str | None = None) -> None:
    """Refuse to take a run after one of another motor.

    `motor_serial`: of the motor that is on the bench; the bench file's when left out.
    Raises RunError when the motors, or the serial numbers of both, differ.
    """
    serial = bench.file.motor_serial if motor_serial is None else motor_serial
    motors = [(run.start.motor, run.start.motor_serial), (bench.motor, serial)]
    named = all(number for _, number in motors)
    theirs, ours = (f"the motor {_name_of(motor)}{f' no. {number}' * named}" for motor, number in motors)
    if theirs != ours:
        raise RunError(f"{run.name} is of {shown(theirs, 200)}, not of {shown(ours, 200)}, which is on the bench now")


def refuse_another_seal(run: str | None, before: str | None, now: str) -> None:
    """Refuse to go on with a run on a bench that conceals something else.

    `before`, `now`: the seals of both; empty where nothing is concealed, None where the run does not say.
    """
    if before is None or before == now:
        return
    if not before:
        raise RunError(f"{run} is of a bench that conceals nothing; leave --conceal out")
    raise RunError(f"{run} is of a bench that conceals something; name the folder of its seal with --conceal")


def _name_of(motor: str | dict[str, Any]) -> str:
    return motor if isinstance(motor, str) else str(motor.get("name"))


def _believed(run: Run) -> Sequence[PlateauRow]:
    """A run's plateaus; of one that failed without the last, where the tachometer shows no rotor turning, or hangs."""
    if run.end is None or run.end.outcome != FAILED:
        return run.plateaus
    column = columns_of(run.start.roles)["speed"]
    speeds = [None if (mean := row.means.get(column)) is None else mean.mean for row in run.plateaus]
    count = len(speeds)
    while count and abs(speeds[count - 1] or 0.0) < AT_REST_RPM:
        count -= 1
    while count > 1 and speeds[count - 1] == speeds[count - 2]:
        count -= 1
    return run.plateaus[:count]


def _plateaus(run: Run) -> list[Plateau]:
    """A run's plateaus as the sweep has them."""
    columns = columns_of(run.start.roles)
    found = []
    for row in _believed(run):
        means = {
            role: Mean(mean.mean, mean.se, mean.n, mean.n_eff or 0.0, mean.censored)
            for role, column in columns.items()
            if (mean := row.means.get(column)) is not None
        }
        step = Step(row.level_bar_abs or 0.0, row.direction, row.repeat)
        times = (round(row.start_s * NS), round(row.end_s * NS))
        found.append(Plateau(row.n, step, *times, row.settled, means, row.note))
    return found


def _check(run: Run, bench: Bench) -> None:
    if run.start.kind not in ("sweep", "manual"):
        raise RunError(f"{run.name} is a run of kind '{run.start.kind}'; only a sweep is continued")
    if run.start.bench != bench.name:
        raise RunError(f"{run.name} is of the bench '{run.start.bench}', not of '{bench.name}'")
    now = bench.file.sweep.model_dump()
    changed = [key for key in ("levels_bar_abs", "order", "repeats", "seed") if run.start.sweep.get(key) != now[key]]
    if changed:
        raise RunError(f"{run.name} is of another sweep: {', '.join(changed)} differ from the bench file's; start anew")
