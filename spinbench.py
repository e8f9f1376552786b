"""The command line: one function a command, each a call or two into the rooms below.

What is slow to import is imported inside the commands, so that `spinbench --help` answers at once.
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from calibration.challenge.opening import Scored
    from calibration.fit.sampling import Progress
    from model.motor import Motor
    from model.reproduction import Measured
    from rig.bench.bench import Bench
    from rig.recording import Recording
    from rig.run.running import Wanted
    from rig.runlog import Run
    from rig.sweep.ambient import Ambient, Given
    from rig.sweep.course import Course

Command = Callable[..., None]

PUBLISHED_SWEEP = Path(__file__).resolve().parent / "logs" / "published_sweep"

LOGS = Path("logs")  # of the folder that the program is started in: runs are data, not part of the program

# Its matrices are small: threads that share one of them cost more than they save. Set before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

UNUSABLE_INPUT, NOT_CONVERGED, RUN_FAILED, MODEL_DOES_NOT_FIT = 2, 3, 4, 5
INTERRUPTED = 130  # as a shell has it for what Ctrl-C ends
# Errors that are told in words instead of with a traceback, by their class's full name (which needs no import), and
# the exit code of each. A class that is not listed counts as its nearest listed base; anything else is our own mistake.
EXIT_CODES = {
    "builtins.OSError": UNUSABLE_INPUT,
    "calibration.challenge.layout.ChallengeError": UNUSABLE_INPUT,
    "calibration.fit.fit.NotConvergedError": NOT_CONVERGED,
    "calibration.fit.peak.NoPeakError": UNUSABLE_INPUT,
    "calibration.fit.sampling.ChainError": UNUSABLE_INPUT,
    "calibration.systems.radial_piston.with_effects.EffectsError": UNUSABLE_INPUT,
    "configs.ConfigError": UNUSABLE_INPUT,
    "model.performance.OperatingPointError": UNUSABLE_INPUT,
    "rig.acquisition.recorder.RecorderError": RUN_FAILED,
    "rig.bench.instrument.IdentityError": UNUSABLE_INPUT,
    "rig.bench.instrument.InstrumentError": UNUSABLE_INPUT,
    "rig.interlock.SafetyError": UNUSABLE_INPUT,
    "rig.lines.port.LineError": UNUSABLE_INPUT,
    "rig.recording.contents.RecordingError": UNUSABLE_INPUT,
    "rig.runlog.folder.RunError": UNUSABLE_INPUT,
    "rig.sweep.ambient.AmbientError": UNUSABLE_INPUT,
    "rig.sweep.plan.SweepError": UNUSABLE_INPUT,
    "rig.virtual.launch.VirtualBenchError": UNUSABLE_INPUT,
    "model.performance.NotSettledError": NOT_CONVERGED,
}

app = typer.Typer(
    help="Bench tool for a pneumatic radial piston motor: calibrates its dynamic model and says how sure it is.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


runs_app = typer.Typer(
    help="The runs that were logged: list, show, verify, repair, export, import.", no_args_is_help=True
)
app.add_typer(runs_app, name="runs")

challenge_app = typer.Typer(
    help="Sealed blind campaigns: make recordings, run the diagnosis, score it, show the ledger.", no_args_is_help=True
)
app.add_typer(challenge_app, name="challenge")

many_app = typer.Typer(
    help="Many recordings at once, a fleet or a year of runs: one table, as CSV and Parquet.", no_args_is_help=True
)
app.add_typer(many_app, name="many")


class TransientKind(StrEnum):
    """Runs in time."""

    SPIN_UP = "spin-up"
    COAST_DOWN = "coast-down"


MotorOption = Annotated[str, typer.Option("--motor", metavar="NAME|FILE", help="A motor in configs/motors, or a file.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Change a parameter or a reading; may be given several times."),
]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - for standard output.")
]


BenchArgument = Annotated[
    Path, typer.Argument(metavar="BENCH", help="A bench file, or the name of one in configs/benches.")
]
RunArgument = Annotated[str, typer.Argument(metavar="RUN", help="A run's folder, name, or its beginning; 'last'.")]
LogsOption = Annotated[Path, typer.Option("--logs", metavar="DIR", help="Where runs are kept.")]
RateOption = Annotated[
    float | None,
    typer.Option(min=0.1, max=50.0, help="Of a virtual bench: its seconds in one of the wall; the file's if left out."),
]


WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes of this machine; as many as it has cores if left out.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="A Dask scheduler, whose workers are used instead."),
]
CampaignArgument = Annotated[Path, typer.Argument(metavar="DIR", help="The campaign's folder.")]
BookOption = Annotated[
    Path | None, typer.Option("--ledger", metavar="FILE", help="The ledger; that of this repository if left out.")
]
PageOption = Annotated[
    Path | None, typer.Option("--page", metavar="DIR", help="Write the result page with its figures and tables.")
]
KeyOption = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", help="The seal's key; beside the seal if left out.")
]
SealOption = Annotated[
    Path | None,
    typer.Option(
        "--conceal", metavar="SEAL", help="Of a virtual bench: what is concealed is drawn, and sealed in this folder."
    ),
]
ConcealSeedOption = Annotated[
    int | None, typer.Option("--conceal-seed", min=0, help="Of what is concealed; drawn itself if left out.")
]
OnlyOption = Annotated[
    str, typer.Option("--only", metavar="ID", help="Conceal this effect, or something of this category, such as none.")
]
SealKeyOption = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", help="The seal's key; in your state folder if left out.")
]
ManyArgument = Annotated[
    list[Path], typer.Argument(metavar="DIR...", help="Recordings or runs, or folders that hold them.")
]
TableOption = Annotated[
    Path, typer.Option("-o", "--out", metavar="DIR", help="Gets the table; started again, it goes on.")
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed; the same seed gives the same result to the bit.")]


class CaptureKind(StrEnum):
    """Single runs in time, and the vented zero."""

    COAST_DOWN = "coast-down"
    SPIN_UP = "spin-up"
    ZERO = "zero"


def main() -> None:
    """Run the command line; a mistake of the user's is told in a line each on standard error."""
    try:
        app()
    except Exception as error:
        code = exit_code(error)
        if code is None:
            raise
        for line in (*_in_words(error).splitlines(), *getattr(error, "__notes__", ())):
            print(f"spinbench: {line}", file=sys.stderr)
        sys.exit(code)


def exit_code(error: Exception) -> int | None:
    """The exit code of an error that is told in words; None for one that deserves its traceback."""
    names = (f"{base.__module__}.{base.__qualname__}" for base in type(error).__mro__)
    return next((EXIT_CODES[name] for name in names if name in EXIT_CODES), None)


def _in_words(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"spinbench {version('spinbench')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and exit.", is_eager=True, callback=_show_version)
    ] = False,
) -> None:
    """Options of the bare command; --version has done its work before this is called."""


@app.command()
def simulate(
    pressure_bar_abs: Annotated[float, typer.Option(help="Inlet pressure, absolute [bar].")],
    to: Annotated[float | None, typer.Option("--to", help="Sweep up to this pressure, absolute [bar].")] = None,
    points: Annotated[int, typer.Option(min=2, max=10_001, help="Points of the sweep.")] = 9,
    transient: Annotated[TransientKind | None, typer.Option(help="A run in time instead of the steady state.")] = None,
    duration_s: Annotated[float, typer.Option(min=0.001, max=60.0, help="Length of the run in time [s].")] = 0.6,
    assignments: SetOption = None,
    motor: MotorOption = "ptm3600",
    json_file: JsonOption = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", help="Write simulation.png and .json there.")
    ] = None,
) -> None:
    """Simulate the motor: an operating point, a sweep of the pressure, a spin-up or a coast-down."""
    if transient is not None and to is not None:
        raise typer.BadParameter("a run in time has one pressure: leave out --to or --transient")
    chosen = _motor(motor, assignments)
    if transient is not None:
        _simulate_transient(chosen, transient, pressure_bar_abs, duration_s, json_file, out)
    else:
        _simulate_points(chosen, pressure_bar_abs, to, points, json_file, out)


def _simulate_points(
    motor: Motor, start_bar: float, end_bar: float | None, count: int, json_file: Path | None, out: Path | None
) -> None:
    import numpy as np

    from calibration.report import simulation, simulation_figures
    from model.performance import BAR, check_pressures, operating_points

    check_pressures(motor, [bar * BAR for bar in (start_bar, end_bar) if bar is not None])
    pressures = [start_bar] if end_bar is None else np.linspace(start_bar, end_bar, count).round(9).tolist()
    found = operating_points(motor, [bar * BAR for bar in pressures])
    limit = motor["speed_limit"].value
    table = simulation.point_table(found[0]) if end_bar is None else simulation.sweep_table(found)
    plot = None
    if out is not None:
        plot = (
            simulation_figures.power_plot(found[0]) if end_bar is None else simulation_figures.sweep_plot(found, limit)
        )
    _deliver(simulation.json_bytes(simulation.points_data(motor, found)), table, plot, json_file, out)
    for words in simulation.remarks(found, limit):
        print(f"spinbench: {words}", file=sys.stderr)


def _simulate_transient(
    motor: Motor, kind: TransientKind, bar: float, duration_s: float, json_file: Path | None, out: Path | None
) -> None:
    from calibration.report import simulation, simulation_figures
    from model.performance import BAR
    from model.runs import coast_down, spin_up

    run = (spin_up if kind is TransientKind.SPIN_UP else coast_down)(motor, bar * BAR, duration_s)
    data = simulation.json_bytes(simulation.transient_data(motor, kind.value, bar, run))
    plot = simulation_figures.transient_plot(run) if out is not None else None
    _deliver(data, simulation.transient_table(run), plot, json_file, out)
    for words in simulation.transient_remarks(run, motor["speed_limit"].value):
        print(f"spinbench: {words}", file=sys.stderr)


@app.command()
def sensitivity(
    pressure_bar_abs: Annotated[
        list[float], typer.Option(help="Inlet pressure, absolute [bar]; several may be given.")
    ],
    assignments: SetOption = None,
    motor: MotorOption = "ptm3600",
    json_file: JsonOption = None,
) -> None:
    """Rank the parameters by what they do to speed and flow: per 1 %, and per standard deviation of their prior."""
    from calibration.report import simulation
    from model.performance import BAR
    from model.sensitivity import sensitivities

    chosen = _motor(motor, assignments)
    ranking = sensitivities(chosen, [bar * BAR for bar in pressure_bar_abs])
    tables = [simulation.sensitivity_table(bar, ranking, i) for i, bar in enumerate(pressure_bar_abs)]
    data = simulation.json_bytes(simulation.sensitivity_data(chosen, pressure_bar_abs, ranking))
    _deliver(data, tables, None, json_file, None)


def _kept_when_interrupted(kept: Callable[[Path | None], str]) -> Callable[[Command], Command]:
    """Ctrl-C in a command ends it with exit code 130, in words: what is kept of it, by its folder of results."""

    def around(command: Command) -> Command:
        @functools.wraps(command)
        def told(**given: Any) -> None:
            try:
                command(**given)
            except KeyboardInterrupt:
                print(f"spinbench: interrupted; {kept(given['out'])}", file=sys.stderr)
                raise typer.Exit(INTERRUPTED) from None

        return told

    return around


def _kept_of_a_fit(out: Path | None) -> str:
    if out is None:
        return "nothing is kept; with -o DIR the chain is kept as it grows, and the same command goes on from it"
    if not any((out / "chain").glob("*")):
        return "nothing was drawn yet; the same command begins again"
    return f"what was drawn is kept in {out / 'chain'}; the same command goes on from there"


def _kept_of_a_diagnosis(out: Path | None) -> str:
    return "nothing is kept of an unfinished diagnosis; the same command begins again"


@app.command()
@_kept_when_interrupted(_kept_of_a_fit)
def fit(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording/1 folder, or a run as RUN elsewhere.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Report, posterior and chain; a killed fit goes on."),
    ] = None,
    json_file: JsonOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same result to the bit.")] = 1,
    effective_samples: Annotated[
        int, typer.Option(min=200, max=1_000_000, help="Least effective sample size of every unknown.")
    ] = 10_000,
    max_steps: Annotated[int, typer.Option(min=50, max=1_000_000, help="Budget of each ensemble.")] = 12_000,
    assignments: SetOption = None,
    speed_only: Annotated[bool, typer.Option("--speed-only", help="Leave the flow channel out.")] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Fit again without the flow, to show what f_overall hangs on.")
    ] = False,
    gauge_span_bar: Annotated[
        float | None,
        typer.Option(metavar="BAR", help="Full scale of the gauge: fit again for accuracy classes 0.6, 1.0, 1.6, 2.5."),
    ] = None,
    effects: Annotated[
        str, typer.Option(metavar="ID,ID", help="Effects that the model holds too; their sizes become unknowns.")
    ] = "",
    logs: LogsOption = LOGS,
) -> None:
    """Fit f_overall and what it hangs on to a recording; exit code 3 if the sampler does not converge, 5 if the model
    does not explain the readings.
    """
    import dataclasses

    from calibration import fit_quality
    from calibration.fit import fit as fits
    from calibration.fit.sampling import Settings
    from calibration.report import fit_page, fit_words, simulation
    from calibration.systems.radial_piston import with_effects
    from calibration.work import files

    _check_places(out, json_file)
    read = _recording(_folder(recording, logs))
    for words in read.warnings:
        print(f"spinbench: {words}", file=sys.stderr)
    settings = Settings(seed=seed, effective_samples=effective_samples, most_steps=max_steps)
    channels = ("pressure", "speed") if speed_only else fits.ALL_CHANNELS
    changes = assignments or []
    held = [name.strip() for name in effects.split(",") if name.strip()]
    planned = fits.variants(read, channels, compare, gauge_span_bar)
    with _testing() as tell:
        quality = fit_quality.judge(read, seed, changes, channels, held, tell)
    try:
        with _sampling_progress("fit") as progress:
            found = fits.fit(read, settings, changes, channels, out / "chain" if out else None, progress, held)
    except fits.NotConvergedError as error:
        if not quality.model_fits:
            error.add_note(f"nor does the model explain the readings: {quality.why}")
        raise
    found = dataclasses.replace(found, quality=quality)
    encoded = simulation.json_bytes(fit_quality.as_json(found))
    if out is not None and planned:  # one of them may not converge
        files.write_files(out, {"posterior.json": encoded})
    variants = []
    for name, changed, used in planned:
        with _sampling_progress(name) as progress:
            still = with_effects.seen(held, used)
            again = fits.fit(changed, fits.brief(settings), changes, used, None, progress, still)
            variants.append((name, again.posterior))
    if out is not None:
        files.write_files(out, {"posterior.json": encoded} | fit_page.report(found, variants))
    for words in fit_words.headline(found):
        print(words, file=sys.stderr)
    _deliver(encoded, fit_page.table(found), None, json_file, None)
    for words in fit_page.remarks(found):
        print(f"spinbench: {words}", file=sys.stderr)
    if out is not None:
        print(f"spinbench: the report is {out / 'report.html'}", file=sys.stderr)
    if not quality.model_fits:
        raise typer.Exit(MODEL_DOES_NOT_FIT)


@app.command()
@_kept_when_interrupted(_kept_of_a_diagnosis)
def diagnose(
    recording: Annotated[
        list[Path],
        typer.Argument(metavar="RECORDING...", help="Recording/1 folders, or runs as RUN elsewhere; several as one."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Write report.html, .png and diagnosis.json there."),
    ] = None,
    json_file: JsonOption = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed; the same seed gives the same result to the bit.")] = 1,
    hold_out: Annotated[
        Path | None,
        typer.Option("--hold-out", metavar="DIR", help="A run that nothing sees before it is predicted, as the proof."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=64,
            help="Processes, of no influence on the result; when left out two, if there are as many cores.",
        ),
    ] = None,
    logs: LogsOption = LOGS,
) -> None:
    """Say whether the model explains a recording and, if not, which physics is missing; 0 whatever the verdict."""
    from calibration.data.joined import together
    from calibration.diagnosis.diagnose import diagnose as look
    from calibration.diagnosis.document import as_json
    from calibration.diagnosis.other_rigs.problem import OF_KIND
    from calibration.report import diagnosis_page, diagnosis_sets, diagnosis_table, diagnosis_words, simulation
    from calibration.work import files

    _check_places(out, json_file)
    parts = [_recording(_folder(named, logs)) for named in recording]
    unseen = None if hold_out is None else _recording(_folder(hold_out, logs))
    _refuse_twice(parts, unseen)
    for words in (words for part in (*parts, unseen) if part is not None for words in part.warnings):
        print(f"spinbench: {words}", file=sys.stderr)
    read = together(parts)
    if not isinstance(read.motor, str) and read.motor.get("kind") in OF_KIND:
        _diagnose_rig(read, out, json_file, seed, unseen)
        return
    with _diagnosing() as tell:
        diagnosis = look(read, seed, tell, unseen, workers or min(2, os.cpu_count() or 1))
        found = as_json(diagnosis)
        data = simulation.json_bytes(found)
        if out is not None:
            tell("report")
            files.write_files(out, {diagnosis_page.JSON: data} | diagnosis_page.report(diagnosis, found))
    _deliver(data, diagnosis_table.table(found), None, json_file, None)
    print(diagnosis_words.sentence(found), file=sys.stderr)
    _warn_of_rows(found)
    if blind := diagnosis_sets.blind_in_words(diagnosis):
        print(blind, file=sys.stderr)
    _tell_if_not_predicted(unseen, found)
    print(f"spinbench: {diagnosis_words.steps_in_words(diagnosis.seconds)}", file=sys.stderr)
    if out is not None:
        print(f"spinbench: the report is {out / 'report.html'}", file=sys.stderr)


def _diagnose_rig(
    read: Recording, out: Path | None, json_file: Path | None, seed: int, unseen: Recording | None
) -> None:
    """The diagnosis of a rig that is not this motor."""
    from calibration.diagnosis.other_rigs import as_json, look, words
    from calibration.report import diagnosis_words, simulation
    from calibration.report import rigs_page as page
    from calibration.work import files

    with _diagnosing() as tell:
        diagnosis = look(read, seed, tell, unseen)
        found = as_json(diagnosis)
        data = simulation.json_bytes(found)
        if out is not None:
            tell("report")
            files.write_files(out, {"diagnosis.json": data} | page.report(diagnosis, found))
    _deliver(data, words.table(found), None, json_file, None)
    print(words.sentence(found), file=sys.stderr)
    _warn_of_rows(found)
    _tell_if_not_predicted(unseen, found)
    print(f"spinbench: {diagnosis_words.steps_in_words(diagnosis.seconds)}", file=sys.stderr)
    if out is not None:
        print(f"spinbench: the report is {out / 'report.html'}", file=sys.stderr)


def _refuse_twice(parts: Sequence[Recording], unseen: Recording | None) -> None:
    """Refuse readings that are given twice, whatever their path: they would count twice, or be predicted once seen."""
    from rig.recording import RecordingError

    def is_same(one: Recording, other: Recording) -> bool:
        return one.folder.resolve() == other.folder.resolve() or (one.sha256 != "" and one.sha256 == other.sha256)

    for i, one in enumerate(parts):
        if unseen is not None and is_same(one, unseen):
            also = "" if one.folder == unseen.folder else f", as {one.folder}"
            raise RecordingError(
                f"{unseen.folder} is to be held out and diagnosed{also}: name a run that is not among the others"
            )
        for other in parts[:i]:
            if is_same(one, other):
                these = one.folder if one.folder == other.folder else f"{one.folder}, which is {other.folder} or a copy"
                raise RecordingError(
                    f"a recording is given twice: {these}; its readings would count twice, so name it once"
                )


def _warn_of_rows(found: Mapping[str, Any]) -> None:
    """Say on standard error of which files less than nine tenths of the rows were used, and which rows were not."""
    from calibration.data.runs_in_time import few_used

    for words in few_used(found.get("files", [])):
        print(f"spinbench: {words}", file=sys.stderr)


def _tell_if_not_predicted(unseen: Recording | None, found: Mapping[str, Any]) -> None:
    """Say on standard error that a run was held out for nothing."""
    from calibration.report.diagnosis_words import is_unseen

    held_out = found["improvement"]["held_out"]
    if unseen is not None and not (held_out and is_unseen(held_out)):
        why = "there is no set of effects to do it with"
        print(f"spinbench: {unseen.folder} was not predicted: {why}", file=sys.stderr)


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
def _diagnosing() -> Iterator[Callable[[str], None]]:
    """A bar on standard error that names the step; it is gone once there is a result or a refusal."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    done = 0.0
    columns = (TextColumn("diagnosis"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    console = Console(stderr=True)
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=100)

        def tell(step: str) -> None:
            nonlocal done
            begins = [percent for name, percent in DIAGNOSIS_STEPS.items() if step.startswith(name)]
            following = next((percent for percent in DIAGNOSIS_STEPS.values() if percent > done), 98)
            done = max(done, begins[0]) if begins else done + 0.1 * (following - done)
            bar.update(task, description=step, completed=done)

        yield tell


@contextlib.contextmanager
def _testing() -> Iterator[Callable[[str], None]]:
    """A line on standard error while the model of a fit is tested; it is gone once there is an answer."""
    from rich.console import Console

    words = "does the model explain the readings?"
    with Console(stderr=True).status(words) as line:
        yield lambda step: line.update(f"{words} {step}")


@contextlib.contextmanager
def _sampling_progress(name: str) -> Iterator[Progress]:
    """A bar on standard error: effective samples drawn of those wanted, with the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.0f}/{task.total:.0f} effective samples"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    bar = Bar(*columns, console=Console(stderr=True))
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


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where the figures and tables go.")],
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Where the page goes; reproduce.md beside the figures if left out."),
    ] = None,
) -> None:
    """Compute the article's figures and results anew, and set them beside the published ones."""
    import os

    from calibration.report import reproduction
    from calibration.work import files
    from model.motor import read_motor
    from model.reproduction import reproduce as compute

    motor = read_motor("ptm3600")
    found = compute(motor, _published_sweep())
    place = page or out / reproduction.PAGE
    figures = Path(os.path.relpath(out.resolve(), place.resolve().parent)).as_posix()
    text = reproduction.page(found, "" if figures == "." else figures)
    files.write_files(out, reproduction.report(found, motor["port_lap"].value))
    files.write_file(place, text)
    print(f"{place}: the article's results beside ours; figures, tables and JSON in {out}")


@app.command()
def sweep(
    bench: BenchArgument,
    logs: LogsOption = LOGS,
    operator: Annotated[str, typer.Option(help="Who runs the bench.")] = "",
    rate: RateOption = None,
    ambient_pressure_bar_abs: Annotated[float | None, typer.Option(help="Of the room [bar].")] = None,
    ambient_temperature_c: Annotated[float | None, typer.Option(help="Of the room [degC].")] = None,
    relative_humidity: Annotated[float | None, typer.Option(help="Of the room, 0 to 1.")] = None,
    lubrication: Annotated[str | None, typer.Option(help="Oil, and when it was last given.")] = None,
    minutes_running: Annotated[float | None, typer.Option(help="How long the motor has run today [min].")] = None,
    resume: Annotated[
        str | None, typer.Option("--continue", metavar="RUN", help="A new run that takes the levels this one did not.")
    ] = None,
    wire: Annotated[bool, typer.Option("--wire/--no-wire", help="Keep the bytes, so that it can be replayed.")] = True,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Hold the plateaus against the model while it runs, and warn.")
    ] = True,
    conceal: SealOption = None,
    conceal_seed: ConcealSeedOption = None,
    only: OnlyOption = "",
    key: SealKeyOption = None,
) -> None:
    """Run the no-load pressure sweep; exit code 4 when it was stopped or failed. The run is kept either way."""
    from rig.run.running import Wanted
    from rig.sweep.ambient import Given
    from rig.sweep.continuing import Taken, taken

    given = Given(ambient_pressure_bar_abs, ambient_temperature_c, relative_humidity, lubrication, minutes_running)
    parent = _run(resume, logs) if resume else None

    def course(read: Bench, ambient: Ambient) -> tuple[Course, list[str]]:
        from rig.sweep.planning import sweep_course

        have = taken(parent, read, logs) if parent else Taken()
        return sweep_course(read, ambient, have.steps, have.captures, have.plateaus)

    server = _server(conceal, conceal_seed, only, key)
    wanted = Wanted("sweep", logs, operator, parent.name if parent else None, wire, rate, server)
    _take(bench, given, course, wanted, check)


@app.command()
def capture(
    bench: BenchArgument,
    kind: Annotated[CaptureKind, typer.Option(help="What is taken.")],
    level_bar_abs: Annotated[
        float | None, typer.Option(help="Pressure, absolute [bar]; the bench file's if left out.")
    ] = None,
    logs: LogsOption = LOGS,
    operator: Annotated[str, typer.Option(help="Who runs the bench.")] = "",
    rate: RateOption = None,
    ambient_pressure_bar_abs: Annotated[float | None, typer.Option(help="Of the room [bar].")] = None,
    ambient_temperature_c: Annotated[float | None, typer.Option(help="Of the room [degC].")] = None,
    relative_humidity: Annotated[float | None, typer.Option(help="Of the room, 0 to 1.")] = None,
    lubrication: Annotated[str | None, typer.Option(help="Oil, and when it was last given.")] = None,
    minutes_running: Annotated[float | None, typer.Option(help="How long the motor has run today [min].")] = None,
    conceal: SealOption = None,
    conceal_seed: ConcealSeedOption = None,
    only: OnlyOption = "",
    key: SealKeyOption = None,
) -> None:
    """Take a coast-down, a spin-up or a vented zero at the highest rate; refused where the bench cannot resolve it."""
    from rig.run.running import Wanted
    from rig.sweep.ambient import Given

    given = Given(ambient_pressure_bar_abs, ambient_temperature_c, relative_humidity, lubrication, minutes_running)

    def course(read: Bench, ambient: Ambient) -> tuple[Course, list[str]]:
        from rig.sweep.planning import capture_course

        return capture_course(read, ambient, kind.value, level_bar_abs), []

    server = _server(conceal, conceal_seed, only, key)
    _take(bench, given, course, Wanted(kind.value, logs, operator, rate=rate, server=server))


def _server(conceal: Path | None, seed: int | None, only: str, key: Path | None) -> tuple[str, ...] | None:
    """The process that serves a bench which conceals something; None for one that does not."""
    if conceal is None:
        if seed is not None or only or key is not None:
            raise typer.BadParameter("--conceal-seed, --only and --key belong to --conceal SEAL")
        return None
    from calibration.challenge.concealed_bench import command

    return command(conceal.resolve(), None if key is None else key.resolve(), seed, only)


def _take(
    path: Path,
    given: Given,
    course: Callable[[Bench, Ambient], tuple[Course, list[str]]],
    wanted: Wanted,
    check: bool = False,
) -> None:
    """A run, under a bar where a regulator makes it; what came of it in a line."""
    from dataclasses import replace
    from functools import partial

    from calibration.live_checks import Beside
    from rig.bench.bench import bench_path, read_bench
    from rig.run.running import UNVENTED, take
    from rig.run.terminal import Terminal, somebody_is_there

    place = bench_path(path)
    bench = read_bench(place)
    if wanted.server is not None and bench.file.virtual is None:
        raise typer.BadParameter(f"{place} is no virtual bench: there is nothing behind it to conceal anything in")
    say: Callable[[str], None] = _say_beside
    with contextlib.ExitStack() as shown:
        if bench.file.roles.regulator is not None:
            terminal = shown.enter_context(Terminal(f"{wanted.kind} on {bench.name}"))
            wanted = replace(wanted, progress=terminal, ask=terminal.ask if somebody_is_there() else None)
            say = partial(terminal.say, warning=True)
        if check:
            wanted = replace(wanted, beside=lambda folder, note: Beside(folder, _so_far, note, say))
        folder, outcome = take(place, given, course, wanted)
    print(f"{folder}: {outcome.outcome}{f', {outcome.reason}' if outcome.reason else ''}")
    if not outcome.vented:
        print(f"spinbench: {UNVENTED}", file=sys.stderr)
    if outcome.outcome != "finished":
        if wanted.kind == "sweep":
            print(f"go on with: {_continuing(path, folder, wanted, given, check)}")
        raise typer.Exit(RUN_FAILED)


def _continuing(path: Path, folder: Path, wanted: Wanted, given: Given, check: bool) -> str:
    """The command that goes on where a sweep ended, with the options of that sweep."""
    import shlex

    from rig.sweep.ambient import OPTIONS

    words = ["spinbench", "sweep", str(path), "--continue", folder.name]
    words += ["--logs", str(wanted.root)] if wanted.root != LOGS else []
    words += ["--operator", wanted.operator] if wanted.operator else []
    words += [f"--rate={wanted.rate:g}"] if wanted.rate is not None else []
    stays = {name: value for name, value in vars(given).items() if value is not None and name != "minutes_running"}
    words += [f"{OPTIONS[name]}={value}" for name, value in stays.items()]
    words += [] if wanted.wire else ["--no-wire"]
    words += [] if check else ["--no-check"]
    return shlex.join(words)


def _say_beside(text: str) -> None:
    """Tell a person who may be typing."""
    print(f"\nspinbench: {text}", file=sys.stderr)


def _so_far(folder: Path) -> Recording:
    """The plateaus of a run that is being written; the check beside a sweep calls it in its own process."""
    from dataclasses import replace

    from rig.exchange.export import recording_of
    from rig.runlog import read_run

    return recording_of(replace(read_run(folder), state="so far")).recording  # an export is of what has ended


@app.command()
def sheet(
    bench: BenchArgument,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="Print a sheet: .html for paper, .csv to fill in."),
    ] = None,
    entered: Annotated[
        Path | None, typer.Option("--enter", metavar="FILE", help="A filled-in .csv sheet becomes a run.")
    ] = None,
    logs: LogsOption = LOGS,
    operator: Annotated[str, typer.Option(help="Who read the instruments.")] = "",
    ambient_pressure_bar_abs: Annotated[float | None, typer.Option(help="Of the room [bar].")] = None,
    ambient_temperature_c: Annotated[float | None, typer.Option(help="Of the room [degC].")] = None,
    relative_humidity: Annotated[float | None, typer.Option(help="Of the room, 0 to 1.")] = None,
    lubrication: Annotated[str | None, typer.Option(help="Oil, and when it was last given.")] = None,
    minutes_running: Annotated[float | None, typer.Option(help="How long the motor had run that day [min].")] = None,
) -> None:
    """A sheet for a bench that a person reads: to be printed, or entered once it is filled in."""
    from calibration.work import files
    from rig.bench.bench import bench_path, read_bench
    from rig.by_hand import sheet as sheets
    from rig.run.terminal import ask, somebody_is_there
    from rig.sweep.ambient import Given, at_start

    if (out is None) == (entered is None):
        raise typer.BadParameter("give either -o, to print a sheet, or --enter, to enter one")
    read = read_bench(bench_path(bench))
    if out is not None:
        if out.suffix not in (".html", ".csv"):
            raise typer.BadParameter(f"{out}: a sheet is .html, to be printed, or .csv, to be filled in")
        if out.exists():
            raise typer.BadParameter(f"{out} exists already, and may be filled in; give a name that is free")
        text = sheets.print_sheet(read) if out.suffix == ".csv" else sheets.print_page(read)
        files.write_file(out, text.encode())
        print(out)
        return
    if entered is not None:
        from rig.by_hand.sheet_entry import SheetError
        from rig.run.running import enter

        given = Given(ambient_pressure_bar_abs, ambient_temperature_c, relative_humidity, lubrication, minutes_running)
        room = at_start(read, given, ask if somebody_is_there() else None)
        try:
            text = entered.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            raise SheetError(f"{entered}: not UTF-8 text; save it as UTF-8") from None
        try:
            print(enter(read, text, room, logs, operator))
        except SheetError as error:
            raise SheetError("\n".join(f"{entered}: {line}" for line in str(error).splitlines())) from None


@app.command()
def doctor(
    bench: BenchArgument,
    scan: Annotated[
        bool, typer.Option("--scan", help="Try Modbus addresses 1 to 16 where a device is silent.")
    ] = False,
) -> None:
    """Examine a bench: ports, identities, rates, and known culprits with their cure; exit code 2 on a fault."""
    from rich.console import Console

    from rig.bench.bench import bench_path, read_bench
    from rig.doctor import Level, examine, table
    from rig.run.running import place_of

    place = bench_path(bench)
    read = read_bench(place)
    with place_of(read, place, 1.0) as there:
        console = Console(stderr=True)
        with console.status(f"examining {read.name}"):
            findings = examine(read, there.ports, there.clock, scan_units=range(1, 17) if scan else ())
    Console(width=None if sys.stdout.isatty() else 140).print(table(findings))
    if any(finding.level is Level.FAULT for finding in findings):
        raise typer.Exit(UNUSABLE_INPUT)


@app.command()
def virtual(
    bench: BenchArgument,
    state: Annotated[
        Path, typer.Option("--state", metavar="DIR", help="Where ports.json and the links to the ptys go.")
    ],
    rate: RateOption = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of noise, errors and faults; the file's if left out.")
    ] = None,
    conceal: SealOption = None,
    conceal_seed: ConcealSeedOption = None,
    only: OnlyOption = "",
    key: SealKeyOption = None,
) -> None:
    """Serve a virtual bench until Ctrl-C, for another program; a sweep on a virtual bench starts its own."""
    from rig.bench.bench import bench_path
    from rig.virtual.serve import serve

    _server(conceal, conceal_seed, only, key)
    state.mkdir(parents=True, exist_ok=True)

    def ready() -> None:
        print(f"serving {bench} until Ctrl-C; {state / 'ports.json'} tells the ports", file=sys.stderr, flush=True)

    if conceal is None:
        serve(bench_path(bench), state, rate, None, seed, ready=ready)
        return
    from calibration.challenge.concealed_bench import serve_concealed

    serve_concealed(bench_path(bench), state, conceal, key, conceal_seed, only, rate, None, seed, ready=ready)


@app.command()
def reveal(
    seal: Annotated[Path, typer.Argument(metavar="SEAL", help="The folder that --conceal named.")],
    diagnosis: Annotated[
        Path | None, typer.Option("--diagnosis", metavar="FILE", help="What `diagnose --json` wrote, to be scored.")
    ] = None,
    key: SealKeyOption = None,
    json_file: JsonOption = None,
) -> None:
    """Open the seal of a concealed bench: what was concealed, and what a diagnosis of it is worth."""
    from calibration.challenge import revealing
    from calibration.report import simulation
    from calibration.work import files

    _check_places(None, json_file)
    found = None if diagnosis is None else revealing.read_diagnosis(diagnosis)
    contents = revealing.reveal(seal, key)
    scored = None if found is None else revealing.score(contents, found)
    data = simulation.json_bytes({"format": "reveal/1", **contents, "score": scored})
    if json_file is not None and str(json_file) == "-":
        sys.stdout.write(data.decode())
        return
    if json_file is not None:
        files.write_file(json_file, data)
    for words in (*revealing.in_words(contents), *([] if scored is None else revealing.score_in_words(scored))):
        print(words)


@app.command()
def replay(
    run: RunArgument,
    logs: LogsOption = LOGS,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="As slowly as it was; else as fast as it goes.")
    ] = False,
    mended: Annotated[
        list[str] | None,
        typer.Option(metavar="INSTRUMENT", help="Take today's file of this instrument instead of the run's own."),
    ] = None,
    save: Annotated[bool, typer.Option("--save", help="Keep the new samples as a run that names this one.")] = False,
    with_model: Annotated[
        bool, typer.Option("--with-model", help="Drive the model with the recorded pressure.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", help="Where the comparison with the model goes.")
    ] = None,
) -> None:
    """Play a run's bytes back through the drivers; exit code 4 unless every sample comes again, bit for bit."""
    from configs import FOLDER
    from rig.replay.replaying import bench_of_run, mended_bench
    from rig.replay.replaying import replay as play
    from rig.replay.saving import retake_plateaus, writer_for

    read = _run(run, logs)
    bench = mended_bench(read, mended, FOLDER / "instruments") if mended else bench_of_run(read)
    with contextlib.ExitStack() as kept:
        writer = kept.enter_context(writer_for(read, bench, logs)) if save else None
        try:
            with _counting(f"replay of {read.name}", read.exchange_count) as tell:
                found = play(read, bench, writer, real_time, lambda done, exchange: tell(done))
        except Exception as error:
            if writer is not None:
                writer.end("failed", f"replay of {read.name}: {error}")
            raise
        if writer is not None:
            retake_plateaus(read, writer)
            writer.end("finished", f"replay of {read.name}")
            print(f"{writer.folder}: the new samples")
    verdict = "the same, bit for bit" if found.same else f"{found.different} differ"
    print(f"{read.name}: {found.exchanges} exchanges, {found.samples} samples of {found.logged}: {verdict}")
    for words in (*found.asked, *found.differences):
        print(f"spinbench: {words}", file=sys.stderr)
    if found.tail and read.state == "killed":
        print(f"spinbench: {found.tail} more rows than the log: it was killed between its files", file=sys.stderr)
    if with_model:
        _against_model(read, out)
    if not found.same and not mended:
        raise typer.Exit(RUN_FAILED)


def _against_model(run: Run, out: Path | None) -> None:
    """Measured against simulated speed and flow in time."""
    from calibration.report import replay_comparison
    from calibration.work import files
    from model.motor import read_motor
    from model.replayed import drive, in_room
    from rig.replay.channels import STEP_S, channels_of

    measured = channels_of(run)
    room = run.start.ambient
    motor = in_room(read_motor(str(run.start.motor)), room.pressure_bar_abs, room.temperature_c, room.relative_humidity)
    with _counting("model", 1) as tell:
        simulated = drive(motor, measured.pressure_time_s, measured.pressure_pa, STEP_S)
        tell(1)
    compared = replay_comparison.compare(measured, simulated)
    if out is not None:
        files.write_files(out, replay_comparison.report(run.name, measured, simulated, compared))
        print(f"spinbench: the comparison is {out / 'replay.png'}, its figures replay.csv", file=sys.stderr)
    _print(replay_comparison.table(compared))


@runs_app.command("list")
def list_all(logs: LogsOption = LOGS) -> None:
    """List the runs."""
    from rich.markup import escape
    from rich.table import Table

    from rig.runlog.listing import list_runs

    found = list_runs(logs)
    if not found:
        print(f"no runs in {logs}", file=sys.stderr)
        return
    table = Table("run", "kind", "bench", "started (UTC)", "outcome", "rows", "plateaus")
    for row in found:
        bench = f"{row.bench} (virtual)" if row.simulated else row.bench
        cells = (row.name, row.kind, bench, row.utc_start, row.outcome, str(row.rows), str(row.plateaus))
        table.add_row(*map(escape, cells))
    _print(table)


@runs_app.command()
def show(run: RunArgument, logs: LogsOption = LOGS) -> None:
    """Show a run: its start, its plateaus, what went wrong, its end."""
    from rig.runlog.listing import summary

    print(summary(_run(run, logs)))


@runs_app.command()
def verify(run: RunArgument, logs: LogsOption = LOGS) -> None:
    """Compare a run with its hashes and counts; exit code 4 when something is not as it was sealed."""
    from rig.runlog import verify as check
    from rig.runlog.listing import find_run

    folder = find_run(run, logs)
    findings = check(folder)
    for words in findings or ["as it was sealed"]:
        print(f"{folder}: {words}")
    if findings:
        raise typer.Exit(RUN_FAILED)


@runs_app.command()
def repair(run: RunArgument, logs: LogsOption = LOGS) -> None:
    """Seal a run that was killed; nothing but a torn last line is dropped, and it is said which."""
    from rig.runlog import repair as mend
    from rig.runlog.listing import find_run

    folder = find_run(run, logs)
    for words in mend(folder):
        print(f"{folder}: {words}")


@runs_app.command()
def export(
    run: RunArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR|FILE", help="A folder to make, or a .parquet file.")],
    logs: LogsOption = LOGS,
    unsettled: Annotated[bool, typer.Option("--unsettled", help="Plateaus that had not settled too.")] = False,
) -> None:
    """Export a run as a recording/1 folder, or its samples as Parquet."""
    from rig.exchange.export import export_recording
    from rig.exchange.parquet import export_parquet

    read = _run(run, logs)
    if out.suffix == ".parquet":
        export_parquet(read, out)
    else:
        for words in export_recording(read, out, unsettled).notes:
            print(f"spinbench: {words}", file=sys.stderr)
    print(out)


@runs_app.command("import")
def import_data(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="CSV or TDMS files.")],
    mapping: Annotated[Path, typer.Option("--mapping", metavar="FILE", help="What their columns are, units and all.")],
    logs: LogsOption = LOGS,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", help="A recording to make of it, in place of a run.")
    ] = None,
) -> None:
    """Import data taken elsewhere, as a run; of a rig that is not this motor, as a recording."""
    from rig.exchange.importing import import_files
    from rig.exchange.mapping import read_mapping

    read = read_mapping(mapping)
    if not isinstance(read.file.motor, str) and out is None:
        raise typer.BadParameter(f"{mapping} is of another rig: name the recording to make with -o")
    print(import_files(files, read, logs if out is None else out, as_recording=out is not None))


@challenge_app.command("make")
def challenge_make(
    out: CampaignArgument,
    cases: Annotated[int, typer.Option(min=1, max=100_000, help="Recordings.")] = 200,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Of all truths, and sealed with them; drawn if left out.")
    ] = None,
    family: Annotated[str, typer.Option(help="Family of draws: proof, or that of development.")] = "proof",
    only: Annotated[str, typer.Option(metavar="CATEGORY", help="Cases of one category alone, such as none.")] = "",
    key: KeyOption = None,
    workers: WorkersOption = None,
) -> None:
    """Draw truths, seal them, and make their recordings by the second rig; goes on where it was interrupted."""
    from calibration.challenge.campaign import make

    with _bars() as begin:
        made = make(out, cases, seed, family, only, key=key, workers=_workers(workers), tell=begin("recordings"))
    print(f"{out}: {made.cases} recordings; committed to truths with SHA-256 {made.truth_sha256}")


@challenge_app.command("run")
def challenge_run(out: CampaignArgument, workers: WorkersOption = None, scheduler: SchedulerOption = None) -> None:
    """Diagnose every recording of a campaign, its seal untouched; goes on where it was interrupted."""
    from calibration.challenge.running import VERDICTS, run

    with _bars() as begin:
        ran = run(out, _workers(workers), scheduler, begin("verdicts"))
    for result in [one for one in ran.results if one.error][:10]:
        print(f"spinbench: {result.name}: {result.error}", file=sys.stderr)
    failed = sum(bool(one.error) for one in ran.results)
    hours = sum(one.seconds for one in ran.results) / 3600.0
    print(f"{out / VERDICTS}: {len(ran.results)} verdicts, {failed} failed, {hours:.2f} core-hours; {ran.sha256}")


@challenge_app.command("score")
def challenge_score(
    campaigns: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Campaigns; several are counted together.")],
    key: KeyOption = None,
    follow_ups: Annotated[
        bool,
        typer.Option("--follow-ups", help="Simulate the test recommended for confounded verdicts; diagnose again."),
    ] = False,
    oracle: Annotated[
        bool, typer.Option("--oracle", help="Compute the held-out gain of the true set, where the diagnosis offers it.")
    ] = False,
    page: PageOption = None,
    keep: Annotated[
        Path | None,
        typer.Option("--keep", metavar="DIR", help="Keep each campaign, now open, as a file for `challenge pool`."),
    ] = None,
    book: BookOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json_file: JsonOption = None,
) -> None:
    """Open the seal, count hits, misses, refusals and false alarms, and enter the campaign into the ledger."""
    from calibration.challenge import keeping, opening
    from calibration.work import files

    _check_places(page, json_file)
    _check_places(keep, None)
    place = _ledger(book)
    settings = opening.Settings(key, follow_ups, oracle, _workers(workers), scheduler)
    with _bars() as begin:
        scored = opening.score(campaigns, place, settings, begin)
    if keep is not None:
        files.write_files(keep, keeping.files(scored))
    _tell_of_scores(scored, place, page, json_file)
    for problem in scored.problems[:10]:
        print(f"spinbench: {problem}", file=sys.stderr)
    for entry, added in zip(scored.entries, scored.added, strict=True):
        words = "entered into" if added else "already in"
        print(f"spinbench: {entry['campaign']} {words} {place}", file=sys.stderr)


@challenge_app.command("pool")
def challenge_pool(
    kept: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Campaigns that `challenge score --keep` kept.")
    ],
    same_code: Annotated[
        bool, typer.Option("--same-code", help="Refuse campaigns that were run or scored with other code than this.")
    ] = False,
    page: PageOption = None,
    book: BookOption = None,
    json_file: JsonOption = None,
) -> None:
    """Count scored campaigns of one code together, each held against the ledger; nothing is run."""
    from calibration.challenge import keeping

    _check_places(page, json_file)
    place = _ledger(book)
    scored = keeping.read(kept, place)
    if same_code:
        keeping.hold_against_this_code(scored)
    _tell_of_scores(scored, place, page, json_file)


def _tell_of_scores(scored: Scored, book: Path, page: Path | None, json_file: Path | None) -> None:
    from calibration.challenge import ledger, tables
    from calibration.challenge import page as pages
    from calibration.report import simulation
    from calibration.work import files

    if page is not None:
        files.write_files(page, pages.files(scored, ledger.read_ledger(book)))
        print(f"spinbench: the page is {page / pages.PAGE}", file=sys.stderr)
    grids = [tables.goals(scored.summary), tables.outcomes(scored.summary), tables.by_signal(scored.summary)]
    _deliver(simulation.json_bytes(scored.summary), [tables.as_rich(grid) for grid in grids], None, json_file, None)


@challenge_app.command("ledger")
def challenge_ledger(book: BookOption = None) -> None:
    """Verify the chain of the ledger, and show every campaign that was ever scored; exit code 2 if it is broken."""
    from calibration.challenge import ledger, page, tables
    from calibration.challenge.layout import ChallengeError

    if book is not None and not book.exists():
        raise ChallengeError(f"{book}: there is no ledger; give the file that `challenge score --ledger` wrote")
    place = _ledger(book)
    lines = ledger.read_ledger(place)
    _print(tables.as_rich(page.ledger_grid(lines)))
    print(f"{place}: {len(lines)} lines, the chain holds")


@many_app.command("diagnose")
def many_diagnose(
    recordings: ManyArgument,
    out: TableOption,
    seed: SeedOption = 1,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Diagnose many recordings into one table; exit code 2 when some could not be."""
    from calibration import fleet

    found = fleet.recordings_in(recordings, _is_recording)
    with _bars() as begin:
        rows = fleet.diagnose_all(found, _recording, seed, out, _workers(workers), scheduler, begin("diagnoses"))
    shown = [(str(row["recording"]), row["verdict"], " + ".join(row["effects"] or [])) for row in rows]
    _tell_of_many(("recording", "verdict", "effects"), shown, rows, out / fleet.CSV)


@many_app.command("fit")
def many_fit(
    recordings: ManyArgument,
    out: TableOption,
    seed: SeedOption = 1,
    effective_samples: Annotated[
        int, typer.Option(min=200, max=1_000_000, help="Least effective sample size of every unknown.")
    ] = 2000,
    max_steps: Annotated[int, typer.Option(min=50, max=1_000_000, help="Budget of each ensemble.")] = 12_000,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Fit many recordings into one table, which says where the model does not fit; exit code 2 when some failed."""
    from calibration import fleet
    from calibration.fit.sampling import Settings

    found = fleet.recordings_in(recordings, _is_recording)
    settings = Settings(seed=seed, effective_samples=effective_samples, most_steps=max_steps)
    with _bars() as begin:
        rows = fleet.fit_all(found, _recording, settings, out, _workers(workers), scheduler, begin("fits"))
    figures = [(row.get("f_overall_mean"), row.get("f_overall_sd")) for row in rows]
    fits_well = {True: "yes", False: "no: do not rely on it", None: ""}
    shown = [
        (str(row["recording"]), "failed" if mean is None else f"{mean:.4f} +- {sd:.4f}", fits_well[row["model_fits"]])
        for row, (mean, sd) in zip(rows, figures, strict=True)
    ]
    _tell_of_many(("recording", "f_overall, N m s", "the model fits"), shown, rows, out / fleet.CSV)


def _tell_of_many(
    header: tuple[str, ...], shown: Sequence[tuple[str, ...]], rows: list[dict[str, Any]], place: Path
) -> None:
    """The table on the terminal, what failed on standard error."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(*header)
    for cells in shown:
        table.add_row(*(escape(cell) for cell in cells))
    _print(table)
    print(place)
    failed = [row for row in rows if row["error"]]
    for row in failed:
        print(f"spinbench: {row['recording']}: {row['error']}", file=sys.stderr)
    if failed:
        raise typer.Exit(UNUSABLE_INPUT)


def _ledger(book: Path | None) -> Path:
    from calibration.challenge.ledger import LEDGER

    return Path(__file__).resolve().parent / LEDGER if book is None else book


def _workers(asked: int | None) -> int:
    import os

    return asked or os.cpu_count() or 1


def _is_recording(folder: Path) -> bool:
    from rig.runlog.folder import START

    return (folder / "recording.toml").is_file() or (folder / START).is_file()


def _run(name: str, logs: Path) -> Run:
    """A run, by what the person typed."""
    from rig.runlog import read_run
    from rig.runlog.listing import find_run

    return read_run(find_run(name, logs))


def _check_places(out: Path | None, json_file: Path | None) -> None:
    """Whether results could be written, before the work that they come of."""
    from calibration.work import files

    files.check_places(out, None if json_file is None or str(json_file) == "-" else json_file)


def _folder(named: Path, logs: Path) -> Path:
    """A recording's folder; what is no path that exists may be a run, by its name, the beginning of one, or `last`."""
    from rig.recording import RecordingError
    from rig.runlog.folder import RunError
    from rig.runlog.listing import find_run

    if named.exists() or len(named.parts) != 1:
        return named
    try:
        return find_run(named, logs)
    except RunError as error:
        raise RecordingError(f"there is no folder '{named}', and {error}") from error


def _recording(path: Path) -> Recording:
    """A recording: a recording/1 folder, or what a run's plateaus and captures amount to."""
    from rig.recording import read_recording
    from rig.runlog.folder import START

    if not (path / START).exists():
        return read_recording(path)
    from rig.exchange.export import recording_of
    from rig.runlog import read_run

    exported = recording_of(read_run(path))
    for words in exported.notes:
        print(f"spinbench: {words}", file=sys.stderr)
    return exported.recording


@contextlib.contextmanager
def _counting(name: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on standard error, for what can be counted."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True)) as bar:
        task = bar.add_task(escape(name), total=max(total, 1))
        yield lambda done: bar.update(task, completed=done)


@contextlib.contextmanager
def _bars() -> Iterator[Callable[[str], Callable[[int, int, str], None]]]:
    """Bars on standard error, one a step, with the time left, for items that take seconds to minutes each."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    left = (TextColumn("left"), TimeRemainingColumn())
    with Bar(*columns, *left, console=Console(stderr=True), speed_estimate_period=3600.0) as bar:

        def begin(step: str) -> Callable[[int, int, str], None]:
            task = bar.add_task(step, total=None)
            return lambda done, total, last: bar.update(task, completed=done, total=total)

        yield begin


def _print(table: object) -> None:
    from rich.console import Console

    Console(width=None if sys.stdout.isatty() else 140).print(table)


def _motor(name: str, assignments: list[str] | None) -> Motor:
    """The motor that the options name, with what --set changes."""
    from model.motor import read_motor, set_values

    is_file = name.endswith(".toml") or "/" in name or "\\" in name
    return set_values(read_motor(Path(name) if is_file else name), assignments or [])


def _published_sweep() -> Measured:
    """Table 3 as the shipped recording has it, in the model's units."""
    from model.performance import BAR
    from model.reproduction import Measured
    from rig.recording import read_recording

    columns = read_recording(PUBLISHED_SWEEP).files[0].columns
    return Measured(columns["pressure_bar_abs"].values * BAR, columns["speed_rpm"].values, columns["flow_l_min"].values)


def _deliver(data: bytes, table: object, plot: bytes | None, json_file: Path | None, out: Path | None) -> None:
    """JSON where it was asked for, files in the folder, and the table unless standard output is taken."""
    from calibration.work import files

    if out is not None:
        contents = {"simulation.json": data} | ({"simulation.png": plot} if plot is not None else {})
        files.write_files(out, contents)
    if json_file is not None and str(json_file) == "-":
        sys.stdout.write(data.decode())
        return
    if json_file is not None:
        files.write_file(json_file, data)
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else 120)  # in a pipe no column is cut
    for one in table if isinstance(table, list) else [table]:
        console.print(one)


if __name__ == "__main__":
    main()
