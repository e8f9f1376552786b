"""One run on a bench, from its start record to its end record: everything of the rig put together.

The order is that of safety: the instruments are identified before there is a run, the failsafes are set and the
watchdog watches before the regulator is first raised, and whatever happens then, the regulator is at zero before the run
is sealed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.acquisition import Acquisition, RecorderError
from rig.bench import Bench, LineTable
from rig.clock import Clock
from rig.interlock.failsafe import set_and_check
from rig.interlock.guard import Guard
from rig.interlock.limits import Limits
from rig.interlock.stop import Stop
from rig.interlock.watchdog import Plan, Watchdog
from rig.lines import Port
from rig.lines.opening import port_of
from rig.readings import NS
from rig.runlog import RunWriter
from rig.runlog.start import Circumstances, start_record
from rig.sweep.ambient import Ambient, Ask, at_end
from rig.sweep.capture import motor_of
from rig.sweep.course import Course
from rig.sweep.hooks import Hooks, Progress, Silent, guarded
from rig.sweep.plateau import Plateau
from rig.sweep.runner import Outcome, run_course

BAR = 1e5
WATCHDOG_LOG = "watchdog.jsonl"


@dataclass(frozen=True)
class Wanted:
    """What a run is to be.

    Attributes
    ----------
    kind : str
        ``sweep``, ``coast-down``, ``spin-up`` or ``zero``.
    root : Path
        Where runs are kept.
    operator : str
        Who runs the bench.
    parent : str or None
        The run that this one continues.
    wire : bool
        Whether the bytes are kept.
    progress : Progress
        Who is told.
    ask : callable or None
        Puts a prompt to the person; None when nobody is there.
    on_plateau : callable
        Called with each `Plateau`.
    """

    kind: str
    root: Path
    operator: str = ""
    parent: str | None = None
    wire: bool = True
    progress: Progress = field(default_factory=Silent)
    ask: Ask | None = None
    on_plateau: Callable[[Plateau], None] = lambda plateau: None


@dataclass(frozen=True)
class Place:
    """Where a bench is: its clock, its ports, and what a watchdog has to know of a virtual one's."""

    clock: Clock
    ports: Callable[[str, LineTable, Clock], Port]
    virtual: dict[str, Any] | None


@contextlib.contextmanager
def place_of(bench: Bench, path: Path, rate: float | None = None) -> Iterator[Place]:
    """The bench as it stands, or a virtual one that is started and ended here.

    Parameters
    ----------
    bench : Bench
        The bench.
    path : Path
        Its file.
    rate : float or None
        Seconds of a virtual bench in one of the wall [-]; the file's when left out.

    Raises
    ------
    VirtualBenchError
        When a virtual bench does not start.
    """
    if bench.file.virtual is None:
        yield Place(Clock(), port_of, None)
        return
    from rig.virtual import launch

    with launch(path, rate) as virtual:
        yield Place(virtual.clock, virtual.port_for, virtual.ports["lines"])


def run(
    bench: Bench, path: Path, place: Place, course: Course, ambient: Ambient, wanted: Wanted
) -> tuple[Path, Outcome]:
    """Go through a course and leave a sealed run.

    Parameters
    ----------
    bench : Bench
        The bench.
    path : Path
        Its file, for the watchdog.
    place : Place
        Of `place_of`.
    course : Course
        What is gone through.
    ambient : Ambient
        The room.
    wanted : Wanted
        What the run is to be.

    Returns
    -------
    folder : Path
        The run.
    outcome : Outcome
        How it ended.

    Raises
    ------
    LineError, IdentityError
        When the bench is not as its file says; there is no run then.
    SafetyError
        When a failsafe or the watchdog is missing; the run is sealed as failed.
    RecorderError
        When the run log cannot be written; the regulator is at zero.
    """
    acquisition = Acquisition(
        bench,
        place.clock,
        ports=place.ports,
        simulated=place.virtual is not None,
        ambient_bar=ambient.pressure_bar_abs,
        ambient_c=ambient.temperature_c,
    )
    acquisition.connect()
    circumstances = Circumstances(
        wanted.operator, ambient.record(), ambient.lubrication, ambient.minutes_running, wanted.parent
    )
    simulated = place.virtual is not None
    start = start_record(bench, wanted.kind, place.clock, acquisition.identities(), circumstances, simulated)  # type: ignore[arg-type]
    writer = RunWriter.create(wanted.root, start, wanted.wire)
    begin_ns = place.clock.now_ns()
    outcome = Outcome("failed", "the program ended", False, [], [])
    try:
        with _guarded_run(acquisition, writer, bench, path, place, ambient, wanted) as hooks:
            outcome = run_course(acquisition, writer, bench, course, hooks)
    except BaseException as error:
        outcome = Outcome("failed", f"{type(error).__name__}: {error}", outcome.vented, outcome.plateaus, [])
        raise
    finally:
        minutes = (place.clock.now_ns() - begin_ns) / NS / 60.0
        _seal(acquisition, writer, outcome, ambient, minutes, wanted)
    return writer.folder, outcome


@contextlib.contextmanager
def _guarded_run(
    acquisition: Acquisition,
    writer: RunWriter,
    bench: Bench,
    path: Path,
    place: Place,
    ambient: Ambient,
    wanted: Wanted,
) -> Iterator[Hooks]:
    """Polling, with the failsafes set, the watchdog watching, and the operator's stop listened to."""
    acquisition.begin(writer)
    with Stop(lambda who: wanted.progress.say(f"{who}: the line is vented and the run sealed", True)) as stop:
        watchdog = None
        if bench.file.roles.regulator is not None:
            for line in set_and_check(acquisition, bench):
                acquisition.event("failsafe", None, text=line)
            where = None if place.virtual is None else place.virtual.get(_regulator_line(bench))
            plan = Plan.of(bench, path, place.clock, writer.folder / WATCHDOG_LOG, where)
            watchdog = Watchdog.start(plan)
            acquisition.event("watchdog", None, pid=watchdog.pid)
        try:
            yield _hooks(bench, place, ambient, wanted, stop, watchdog)
        finally:
            if watchdog is not None:
                watchdog.release()


def _hooks(
    bench: Bench, place: Place, ambient: Ambient, wanted: Wanted, stop: Stop, watchdog: Watchdog | None
) -> Hooks:
    file = bench.file
    _, gauge = bench.channel("pressure")
    gauge_sd_bar = gauge.bias_sd if gauge.bias_sd is not None else 0.02
    motor = motor_of(bench, ambient)
    limit_rpm = min(file.safety.highest_speed_rpm, motor["speed_limit"].value)
    guard = Guard(motor, limit_rpm, gauge_sd_bar * BAR)
    limits = Limits(file.safety, file.roles, ambient.pressure_bar_abs, place.clock.rate)

    def trip(view: Any, now_ns: int, pressurised: bool) -> str | None:
        fault = watchdog.fault() if watchdog is not None else None
        return fault or limits.trip(view, now_ns, pressurised)

    is_gauge = file.roles.pressure.endswith("_gauge")
    return Hooks(
        guarded(guard, ambient.pressure_bar_abs, is_gauge, gauge_sd_bar),
        trip,
        lambda: stop.asked,
        wanted.progress,
        on_plateau=wanted.on_plateau,
    )


def _seal(
    acquisition: Acquisition, writer: RunWriter, outcome: Outcome, ambient: Ambient, minutes: float, wanted: Wanted
) -> None:
    """The statistics, the last readings, and the end record; the run log's own failure is told once it is closed."""
    statistics = acquisition.statistics()
    failure: RecorderError | None = None
    try:
        with contextlib.suppress(RecorderError):
            acquisition.event("statistics", None, **statistics)
        acquisition.stop()
    except RecorderError as error:
        failure = error
        outcome = Outcome("failed", str(error), outcome.vented, outcome.plateaus, outcome.left_out)
    ask = wanted.ask if outcome.outcome == "finished" else None
    at_the_end = at_end(ambient, minutes, ask).record()
    writer.end(outcome.outcome, outcome.reason, at_the_end, statistics, outcome.vented)  # type: ignore[arg-type]
    if failure is not None:
        raise failure


def _regulator_line(bench: Bench) -> str:
    return bench.file.devices[str(bench.file.roles.regulator)].line
