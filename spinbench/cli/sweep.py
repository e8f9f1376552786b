"""`sweep` and `capture`: a run on a bench, real or virtual."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench import readings
from spinbench.cli import options
from spinbench.cli.concealing import server_of
from spinbench.cli.errors import RUN_FAILED
from spinbench.cli.show import remark
from spinbench.progress import waiting

if TYPE_CHECKING:
    from rig.bench.bench import Bench
    from rig.run.running import Wanted
    from rig.runlog import Run
    from rig.sweep.ambient import Ambient, Given
    from rig.sweep.course import Course


PLATEAUS = 10  # of a capture of plateaus, where nobody says how many
PAGE_NICE = 10  # another run may have begun meanwhile


class CaptureKind(StrEnum):
    """Single runs in time, the vented zero, and plateaus at one level."""

    COAST_DOWN = "coast-down"
    SPIN_UP = "spin-up"
    ZERO = "zero"
    PLATEAUS = "plateaus"


def sweep(
    bench: options.BenchArgument,
    logs: options.LogsOption = options.LOGS,
    operator: options.OperatorOption = "",
    motor_serial: options.MotorSerialOption = None,
    note: options.NoteOption = "",
    rate: options.RateOption = None,
    ambient_pressure_bar_abs: options.RoomPressureOption = None,
    ambient_temperature_c: options.RoomTemperatureOption = None,
    relative_humidity: options.HumidityOption = None,
    lubrication: options.LubricationOption = None,
    minutes_running: options.MinutesRunningOption = None,
    resume: Annotated[
        str | None,
        typer.Option("--continue", metavar="RUN", help="Make a new run of the levels that this one did not take."),
    ] = None,
    wire: Annotated[bool, typer.Option("--wire/--no-wire", help="Keep the bytes, so that it can be replayed.")] = True,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Hold the plateaus against the model while it runs, and warn.")
    ] = True,
    page: Annotated[
        bool, typer.Option("--page/--no-page", help="Write the run's page, report.html, into its folder at the end.")
    ] = True,
    conceal: options.SealOption = None,
    conceal_seed: options.ConcealSeedOption = None,
    only: options.OnlyOption = "",
    key: options.SealKeyOption = None,
) -> None:
    """Run the no-load pressure sweep; exit code 4 when it was stopped or failed. The run is kept either way."""
    _load(bench)
    from rig.run.running import Wanted
    from rig.sweep.ambient import Given

    given = Given(ambient_pressure_bar_abs, ambient_temperature_c, relative_humidity, lubrication, minutes_running)
    parent = _among("--continue", resume, logs) if resume else None
    course = partial(_what_is_missing, parent, logs, motor_serial)
    server = server_of(conceal, conceal_seed, only, key)
    by = (operator, motor_serial, note, *_before(parent))
    _take(bench, given, course, Wanted("sweep", logs, *by, wire, rate, server), check, page, (conceal, key))


def capture(
    bench: options.BenchArgument,
    kind: Annotated[CaptureKind, typer.Option(help="What to take.")],
    level_bar_abs: Annotated[
        float | None, typer.Option(help="Absolute pressure, in bar; the bench file's if left out. A zero has none.")
    ] = None,
    plateaus: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="How many plateaus, with --kind plateaus; 10 if left out."),
    ] = None,
    added_inertia_kg_m2: Annotated[
        float | None, typer.Option(help="Inertia of a flywheel on the shaft, in kg m2; the bench file's if left out.")
    ] = None,
    after: options.AfterOption = None,
    logs: options.LogsOption = options.LOGS,
    operator: options.OperatorOption = "",
    motor_serial: options.MotorSerialOption = None,
    note: options.NoteOption = "",
    rate: options.RateOption = None,
    ambient_pressure_bar_abs: options.RoomPressureOption = None,
    ambient_temperature_c: options.RoomTemperatureOption = None,
    relative_humidity: options.HumidityOption = None,
    lubrication: options.LubricationOption = None,
    minutes_running: options.MinutesRunningOption = None,
    conceal: options.SealOption = None,
    conceal_seed: options.ConcealSeedOption = None,
    only: options.OnlyOption = "",
    key: options.SealKeyOption = None,
) -> None:
    """Take one thing alone: a coast-down, a spin-up, plateaus at one level or a vented zero.

    A run in time is taken at the highest rate, and refused where the bench cannot resolve it.
    """
    _load(bench)
    from rig.run.running import Wanted
    from rig.sweep.ambient import Given

    _refuse_what_it_has_not(kind, level_bar_abs, plateaus)
    parent = None if after is None else _among("--after", after, logs)
    given = Given(ambient_pressure_bar_abs, ambient_temperature_c, relative_humidity, lubrication, minutes_running)

    times = PLATEAUS if plateaus is None else plateaus
    course = partial(_one_capture, kind.value, level_bar_abs, times, parent, logs, motor_serial)
    server = server_of(conceal, conceal_seed, only, key)
    by = (operator, motor_serial, note, *_before(parent))
    _take(bench, given, course, Wanted(kind.value, logs, *by, True, rate, server, added_inertia_kg_m2))


def _refuse_what_it_has_not(kind: CaptureKind, level_bar_abs: float | None, plateaus: int | None) -> None:
    if plateaus is not None and kind is not CaptureKind.PLATEAUS:
        raise typer.BadParameter(f"--plateaus belongs to --kind plateaus; a {kind.value} has none")
    if level_bar_abs is not None and kind is CaptureKind.ZERO:
        raise typer.BadParameter("--level-bar-abs: a zero is taken with the line vented, at no level; leave it out")


def _one_capture(
    kind: str,
    level_bar_abs: float | None,
    times: int,
    parent: Run | None,
    logs: Path,
    motor_serial: str | None,
    bench: Bench,
    ambient: Ambient,
) -> tuple[Course, list[str]]:
    """A capture, after the run before where there is one."""
    from rig.sweep.continuing import plateaus_before, refuse_another_motor
    from rig.sweep.planning import capture_course

    if parent is not None:
        refuse_another_motor(parent, bench, motor_serial)
    known = () if parent is None else plateaus_before(parent, bench, logs)
    return replace(capture_course(bench, ambient, kind, level_bar_abs, times), known=known), []


def _what_is_missing(
    parent: Run | None, logs: Path, motor_serial: str | None, bench: Bench, ambient: Ambient
) -> tuple[Course, list[str]]:
    """A sweep of what the run before did not take."""
    from rig.sweep.continuing import Taken, taken
    from rig.sweep.planning import sweep_course

    have = taken(parent, bench, logs, motor_serial) if parent else Taken()
    return sweep_course(bench, ambient, have.steps, have.captures, have.plateaus)


def _load(bench: Path) -> None:
    """Import what takes seconds on a busy machine, with words on the screen."""
    with waiting(f"reading {bench}"):
        import rig.run.running  # noqa: F401


def _before(parent: Run | None) -> tuple[str | None, str | None]:
    """The name of the run before, and its seal where it says one."""
    if parent is None:
        return None, None
    return parent.name, parent.start.seal if "seal" in parent.start.model_fields_set else None


def _among(option: str, name: str, logs: Path) -> Run:
    """The run that another one goes on from; it is kept beside it, so that it is found again."""
    found = readings.run_named(name, logs)
    if found.folder.resolve().parent != logs.resolve():
        raise typer.BadParameter(f"{option} {name}: it is not in {logs}, where this run is kept; say --logs")
    return found


def _take(
    path: Path,
    given: Given,
    course: Callable[[Bench, Ambient], tuple[Course, list[str]]],
    wanted: Wanted,
    check: bool = False,
    page: bool = False,
    concealed: tuple[Path | None, Path | None] = (None, None),
) -> None:
    """A run, under a bar where a regulator makes it; what came of it in a line."""
    from calibration.live_checks import Beside
    from rig.bench.bench import bench_path, read_bench
    from rig.run.running import UNVENTED, take
    from rig.run.terminal import Terminal, somebody_is_there
    from rig.runlog.schema import ended
    from rig.sweep.judge import unusable

    place = bench_path(path)
    bench = read_bench(place)
    if wanted.server is not None and bench.file.virtual is None:
        raise typer.BadParameter(f"{place} is no virtual bench: there is nothing behind it to conceal anything in")
    say: Callable[[str], None] = _say_beside
    with contextlib.ExitStack() as shown:
        if bench.file.roles.regulator is not None:
            terminal = shown.enter_context(Terminal(f"{wanted.kind} on {bench.name}"))
            asks = terminal.ask if somebody_is_there() else None
            wanted = replace(wanted, progress=terminal, waiting=waiting, ask=asks)
            say = partial(terminal.say, warning=True)
        if check:
            wanted = replace(wanted, beside=lambda folder, note: Beside(folder, readings.so_far, note, say))
        folder, outcome = take(place, given, course, wanted)
    print(f"{folder}: {ended(outcome.outcome, outcome.stopped_by, outcome.reason)}")
    if not outcome.vented:
        remark(UNVENTED)
    if outcome.outcome == "failed" or unusable(outcome.plateaus):
        _remark_on_rate(bench, wanted)
    if page:
        _write_page(folder)
    if outcome.outcome != "finished":
        if wanted.kind == "sweep":
            print(f"go on with: {_continuing(path, folder, wanted, given, (check, page), concealed)}")
        raise typer.Exit(RUN_FAILED)


def _remark_on_rate(bench: Bench, wanted: Wanted) -> None:
    rate = wanted.rate or (bench.file.virtual.rate if bench.file.virtual is not None else 1.0)
    if rate > 1.0:
        remark(f"a virtual bench at {rate:g} times real time needs a machine that has time for it: try a lower --rate")


def _write_page(folder: Path) -> None:
    """The run's page; the run is sealed and stays as it is, whatever becomes of it."""
    from spinbench import run_page

    os.nice(PAGE_NICE)
    try:
        with waiting("the run's page is made; Ctrl-C leaves it out"):
            where = run_page.write(folder)
    except KeyboardInterrupt:
        remark("the run's page was left out; the run is kept")
    except Exception as error:  # the run is there and sealed: its end is not this page's
        remark(f"the run's page could not be made ({type(error).__name__}: {error}); the run is kept")
    else:
        remark(f"the run's page is {where}")


def _continuing(
    path: Path,
    folder: Path,
    wanted: Wanted,
    given: Given,
    switches: tuple[bool, bool],
    concealed: tuple[Path | None, Path | None],
) -> str:
    """The command that goes on where a sweep ended, with the options of that sweep.

    `switches`: whether it is checked, and whether it has a page; `concealed`: seal and key.
    """
    from rig.sweep.ambient import OPTIONS

    words = ["spinbench", "sweep", str(path), "--continue", folder.name]
    words += ["--logs", str(wanted.root)] if wanted.root != options.LOGS else []
    words += ["--operator", wanted.operator] if wanted.operator else []
    words += [f"--motor-serial={wanted.motor_serial}"] if wanted.motor_serial is not None else []
    words += [f"--note={wanted.note}"] if wanted.note else []
    words += [f"--rate={wanted.rate:g}"] if wanted.rate is not None else []
    stays = {name: value for name, value in vars(given).items() if value is not None and name != "minutes_running"}
    words += [f"{OPTIONS[name]}={value}" for name, value in stays.items()]
    for name, place in zip(("--conceal", "--key"), concealed, strict=True):
        words += [name, str(place)] if place is not None else []
    given_away = zip(("--no-wire", "--no-check", "--no-page"), (wanted.wire, *switches), strict=True)
    words += [name for name, is_on in given_away if not is_on]
    return shlex.join(words)


def _say_beside(text: str) -> None:
    """Tell a person who may be typing."""
    print(f"\nspinbench: {text}", file=sys.stderr)
