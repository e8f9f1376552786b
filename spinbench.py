"""The command line: one function a command, each a call or two into the rooms below.

What is slow to import is imported inside the commands, so that `spinbench --help` answers at once.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from calibration.sampling import Progress
    from model.motor import Motor
    from model.reproduction import Measured

PUBLISHED_SWEEP = Path(__file__).resolve().parent / "logs" / "published_sweep"

UNUSABLE_INPUT, NOT_CONVERGED = 2, 3
# Errors that are told in words instead of with a traceback, by their class's full name (which needs no import), and
# the exit code of each. A class that is not listed counts as its nearest listed base; anything else is our own mistake.
EXIT_CODES = {
    "builtins.OSError": UNUSABLE_INPUT,
    "calibration.fit.NotConvergedError": NOT_CONVERGED,
    "calibration.peak.NoPeakError": UNUSABLE_INPUT,
    "calibration.sampling.ChainError": UNUSABLE_INPUT,
    "configs.ConfigError": UNUSABLE_INPUT,
    "model.performance.OperatingPointError": UNUSABLE_INPUT,
    "rig.recording.contents.RecordingError": UNUSABLE_INPUT,
    "model.performance.NotSettledError": NOT_CONVERGED,
}

app = typer.Typer(
    help="Bench tool for a pneumatic radial piston motor: calibrates its dynamic model and says how sure it is.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


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


def main() -> None:
    """Run the command line; a mistake of the user's is told in a line each on standard error."""
    try:
        app()
    except Exception as error:
        code = exit_code(error)
        if code is None:
            raise
        for line in _in_words(error).splitlines():
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


@app.command()
def fit(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A recording/1 folder.")],
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
) -> None:
    """Fit f_overall and what it hangs on to a recording; exit code 3 if the sampler does not converge."""
    from calibration import fit as fits
    from calibration import posterior
    from calibration.report import files, fit_page, simulation
    from calibration.sampling import Settings
    from rig.recording import read_recording

    read = read_recording(recording)
    for words in read.warnings:
        print(f"spinbench: {words}", file=sys.stderr)
    settings = Settings(seed=seed, effective_samples=effective_samples, most_steps=max_steps)
    channels = ("pressure", "speed") if speed_only else fits.ALL_CHANNELS
    changes = assignments or []
    with _sampling_progress("fit") as progress:
        found = fits.fit(read, settings, changes, channels, out / "chain" if out else None, progress)
    variants = []
    for name, changed, used in fits.variants(read, channels, compare, gauge_span_bar):
        with _sampling_progress(name) as progress:
            variants.append((name, fits.fit(changed, fits.brief(settings), changes, used, None, progress).posterior))
    data = posterior.as_json(found.posterior)
    encoded = simulation.json_bytes(data)
    if out is not None:
        files.write_files(out, {"posterior.json": encoded} | fit_page.report(found, variants))
    _deliver(encoded, fit_page.table(found), None, json_file, None)
    for words in fit_page.remarks(found):
        print(f"spinbench: {words}", file=sys.stderr)
    if out is not None:
        print(f"spinbench: the report is {out / 'report.html'}", file=sys.stderr)


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
    with contextlib.ExitStack() as shown:

        def tell(done: int, wanted: float, words: str) -> None:
            if not bar.live.is_started:  # not before sampling begins: a refusal comes without a bar
                shown.enter_context(bar)
            bar.update(task, description=f"{name}: {words}", completed=min(done, wanted), total=wanted)

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

    from calibration.report import files, reproduction
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
    from calibration.report import files

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
