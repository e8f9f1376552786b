"""From a bench file to what a run goes through."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from rig.bench.bench import Bench
from rig.plateaus.plan import DOWN, UP, Step, SweepError, plan
from rig.plateaus.plateau import Plateau
from rig.sweep import capture
from rig.sweep.ambient import Ambient
from rig.sweep.capturing import CaptureTask
from rig.sweep.course import Course


def sweep_course(
    bench: Bench,
    ambient: Ambient,
    finished: Collection[Step] = (),
    captured: Collection[str] = (),
    known: Sequence[Plateau] = (),
) -> tuple[Course, list[str]]:
    """What a sweep goes through.

    Returns `course`: plateaus, then captures; `remarks`: captures that are left out because the bench cannot resolve
    them, and why. Raises SweepError when a level is above the bench's limit or below the room's pressure, or nothing is
    left to be done.
    """
    table = bench.file.sweep
    check_levels(bench, ambient, [*table.levels_bar_abs, *filter(None, [table.capture_level_bar_abs])])
    steps = plan(table.levels_bar_abs, table.order, table.repeats, table.seed, finished)
    wanted = [kind for kind in table.captures if kind not in captured]
    if finished and not steps and not wanted:
        raise SweepError("the run to be continued has taken everything; there is nothing left to do")
    captures, remarks = [], []
    for kind in wanted:
        try:
            captures.append(capture.capture_task(bench, ambient, kind))
        except capture.CaptureError as error:
            remarks.append(str(error))
    return replace(_course(bench, ambient, steps, captures, ("start", "end")), known=tuple(known)), remarks


def capture_course(
    bench: Bench, ambient: Ambient, kind: str, level_bar_abs: float | None = None, plateaus: int = 10
) -> Course:
    """What a capture goes through: a single run in time, plateaus at one level, or the vented zero.

    `level_bar_abs`: absolute pressure [bar]; the bench file's capture level, or its highest level, when left out.
    `plateaus`: how often the level is read, where plateaus are asked for [-].
    Raises CaptureError when the bench cannot resolve it.
    """
    if kind not in capture.CAPTURE_KINDS:
        raise capture.CaptureError(f"no capture is called '{kind:.40}'; known are {', '.join(capture.CAPTURE_KINDS)}")
    if kind == "zero":
        return _course(bench, ambient, [], [], ("start",))
    level = capture.level_of(bench) if level_bar_abs is None else level_bar_abs
    check_levels(bench, ambient, [level])
    if kind == "plateaus":
        # A low level starts no rotor: it is approached from above, with the rotor turning.
        higher = capture.level_of(bench)
        first = [Step(higher, UP, 1)] if level < higher else []
        steps = first + [Step(level, DOWN if first else UP, repeat) for repeat in range(1, plateaus + 1)]
        return _course(bench, ambient, steps, [], ("start", "end"))
    return _course(bench, ambient, [], [capture.capture_task(bench, ambient, kind, level)], ("start", "end"))


def check_levels(bench: Bench, ambient: Ambient, levels_bar_abs: Collection[float]) -> None:
    """Refuse levels that are none.

    Raises SweepError: above the limit, beyond the regulator's span, or not above the room's pressure.
    """
    is_split = len(levels_bar_abs) > 1 and all(float(level).is_integer() for level in levels_bar_abs)
    hint = "; were 1.25 and the like written with a comma? A comma parts two levels: write a point" * is_split
    highest = bench.file.safety.highest_pressure_bar_abs
    reach = _reach(bench, ambient)
    for level in levels_bar_abs:
        if level > reach:
            raise SweepError(
                f"level {level:g} bar abs is beyond the regulator's span, which ends at {reach:g} bar abs{hint}"
            )
        if level > highest:
            raise SweepError(f"level {level:g} bar abs is above safety.highest_pressure_bar_abs, {highest:g} bar{hint}")
        if level <= ambient.pressure_bar_abs:
            raise SweepError(
                f"level {level:g} bar abs is not above the room's {ambient.pressure_bar_abs:g} bar; levels are "
                f"absolute, not gauge{hint}"
            )


def _reach(bench: Bench, ambient: Ambient) -> float:
    """The highest absolute pressure that the regulator can be ordered [bar]; no limit by hand."""
    device = bench.file.roles.regulator
    if device is None:
        return float("inf")
    driver = bench.regulator(device)
    return driver.highest + (ambient.pressure_bar_abs if driver.unit == "bar gauge" else 0.0)


def _course(
    bench: Bench, ambient: Ambient, steps: list[Step], captures: list[CaptureTask], zeros: tuple[str, ...]
) -> Course:
    file = bench.file
    roles = tuple(role for role in ("pressure", "flow", "speed", "temperature") if getattr(file.roles, role))
    channels = tuple(f"{device}.{channel}" for device in file.devices for channel in bench.build(device).channels)
    by_hand = file.roles.regulator is None
    return Course(steps, captures, file.sweep, ambient.pressure_bar_abs, roles, channels, by_hand, zeros)
