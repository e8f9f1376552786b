"""The model alone: `simulate`, `sensitivity` and `reproduce`."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench.api.simulating import DURATION_S, LONGEST_S, SHORTEST_S, motor_of
from spinbench.cli.options import JsonOption, MotorOption, SetOption, out_folder
from spinbench.cli.show import check_places, deliver, remark
from spinbench.progress import waiting

if TYPE_CHECKING:
    from model.motor import Motor

POINTS = 9
SOLVING = "solving; after an installation the solvers are compiled first, which takes half a minute"


class TransientKind(StrEnum):
    """Runs in time."""

    SPIN_UP = "spin-up"
    COAST_DOWN = "coast-down"


def simulate(
    pressure_bar_abs: Annotated[float, typer.Option(help="Absolute inlet pressure, in bar.")],
    to: Annotated[float | None, typer.Option("--to", help="Sweep up to this absolute pressure, in bar.")] = None,
    points: Annotated[
        int | None, typer.Option(min=2, max=10_001, help=f"Points of the sweep; {POINTS} if left out.")
    ] = None,
    transient: Annotated[TransientKind | None, typer.Option(help="A run in time instead of the steady state.")] = None,
    duration_s: Annotated[
        float | None,
        typer.Option(
            min=SHORTEST_S, max=LONGEST_S, help=f"Length of the run in time, in seconds; {DURATION_S} if left out."
        ),
    ] = None,
    assignments: SetOption = None,
    motor: MotorOption = "ptm3600",
    json_file: JsonOption = None,
    out: Annotated[Path | None, out_folder("Write simulation.png and .json there.")] = None,
) -> None:
    """Simulate the motor: an operating point, a sweep of the pressure, a spin-up or a coast-down."""
    if transient is not None and to is not None:
        raise typer.BadParameter("a run in time has one pressure: leave out --to or --transient")
    if points is not None and to is None:
        raise typer.BadParameter("--points are those of a sweep: say --to which pressure, or leave it out")
    if duration_s is not None and transient is None:
        raise typer.BadParameter("--duration-s is that of a run in time: say --transient, or leave it out")
    check_places(out, json_file)
    chosen = motor_of(motor, assignments or [])
    if transient is not None:
        _simulate_transient(chosen, transient, pressure_bar_abs, duration_s or DURATION_S, json_file, out)
    else:
        _simulate_points(chosen, pressure_bar_abs, to, points or POINTS, json_file, out)


def _simulate_points(
    motor: Motor, start_bar: float, end_bar: float | None, count: int, json_file: Path | None, out: Path | None
) -> None:
    import numpy as np

    from calibration.report.model import simulation, simulation_figures
    from model.operation.performance import BAR, check_pressures, operating_points
    from rig.recording import files

    check_pressures(motor, [bar * BAR for bar in (start_bar, end_bar) if bar is not None])
    pressures = [start_bar] if end_bar is None else np.linspace(start_bar, end_bar, count).round(9).tolist()
    with waiting(SOLVING):
        found = operating_points(motor, [bar * BAR for bar in pressures])
    limit = motor["speed_limit"].value
    table = simulation.point_table(found[0]) if end_bar is None else simulation.sweep_table(found)
    data = files.json_bytes(simulation.points_data(motor, found))
    if out is not None:
        of_one = end_bar is None
        plot = simulation_figures.power_plot(found[0]) if of_one else simulation_figures.sweep_plot(found, limit)
        files.write_files(out, {"simulation.json": data, "simulation.png": plot})
    deliver(data, [table], json_file)
    remark(*simulation.remarks(found, limit))


def _simulate_transient(
    motor: Motor, kind: TransientKind, bar: float, duration_s: float, json_file: Path | None, out: Path | None
) -> None:
    from calibration.report.model import simulation, simulation_figures
    from model.operation.performance import BAR
    from model.operation.runs import coast_down, spin_up
    from rig.recording import files

    with waiting(SOLVING):
        run = (spin_up if kind is TransientKind.SPIN_UP else coast_down)(motor, bar * BAR, duration_s)
    data = files.json_bytes(simulation.transient_data(motor, kind.value, bar, run))
    if out is not None:
        plot = simulation_figures.transient_plot(run)
        files.write_files(out, {"simulation.json": data, "simulation.png": plot})
    deliver(data, [simulation.transient_table(run)], json_file)
    remark(*simulation.transient_remarks(run, motor["speed_limit"].value))


def sensitivity(
    pressure_bar_abs: Annotated[
        list[float], typer.Option(help="Absolute inlet pressure, in bar; several may be given.")
    ],
    assignments: SetOption = None,
    motor: MotorOption = "ptm3600",
    json_file: JsonOption = None,
) -> None:
    """Rank the parameters by what they do to speed and flow: per 1 %, and per standard deviation of their prior."""
    from calibration.report.model import simulation
    from model.operation.performance import BAR
    from model.operation.sensitivity import sensitivities
    from rig.recording import files

    check_places(None, json_file)
    chosen = motor_of(motor, assignments or [])
    with waiting(SOLVING):
        ranking = sensitivities(chosen, [bar * BAR for bar in pressure_bar_abs])
    tables = [simulation.sensitivity_table(bar, ranking, i) for i, bar in enumerate(pressure_bar_abs)]
    deliver(files.json_bytes(simulation.sensitivity_data(chosen, pressure_bar_abs, ranking)), tables, json_file)


def reproduce(
    out: Annotated[Path, out_folder("Where the figures and tables go.")],
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Where the page goes; reproduce.md beside the figures if left out."),
    ] = None,
) -> None:
    """Compute the article's figures and results anew, and set them beside the published ones."""
    from calibration.report.model import reproduction
    from model.article.reproduction import reproduce as compute
    from model.motor import read_motor
    from rig.recording import files
    from spinbench.published import measured

    check_places(out, page)
    motor = read_motor("ptm3600")
    with waiting(SOLVING):
        found = compute(motor, measured())
    place = page or out / reproduction.PAGE
    figures = Path(os.path.relpath(out.resolve(), place.resolve().parent)).as_posix()
    text = reproduction.page(found, "" if figures == "." else figures)
    files.write_files(out, reproduction.report(found, motor["port_lap"].value))
    files.write_file(place, text)
    print(f"{place}: the article's results beside ours; figures, tables and JSON in {out}")
