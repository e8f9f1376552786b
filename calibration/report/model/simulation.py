"""What `spinbench simulate` and `spinbench sensitivity` show: simulation/1 for programs, tables and plots for eyes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.report import style
from model import layout as at
from model.motor import Motor, name_with_unit
from model.operation.performance import OperatingPoint
from model.operation.sensitivity import Sensitivity
from model.solvers.transient import Transient

if TYPE_CHECKING:
    from rich.table import Table

FORMAT = "simulation/1"
SENSITIVITY_FORMAT = "sensitivity/1"
RUN_ROWS = 12  # of a run in time that are shown

# Rows of the table of one point: words, key, unit, digits after the point; a row without a key is a heading.
POINT_ROWS: tuple[tuple[str, str, str, int], ...] = (
    ("speed", "speed_rpm", "rpm", 2),
    ("speed ripple, peak to peak", "speed_ripple_rpm", "rpm", 2),
    ("flow at the inlet", "flow_l_min", "L/min", 2),
    ("gas torque", "gas_torque_nm", "N m", 4),
    ("roller friction", "roller_torque_nm", "N m", 4),
    ("f_overall friction", "f_overall_torque_nm", "N m", 4),
    ("Power", "", "", 0),
    ("isentropic, from the line to the ambient", "isentropic_power_w", "W", 2),
    ("- pressure drop at the inlet", "inlet_drop_loss_w", "W", 2),
    ("- pressure drop at the outlet", "outlet_drop_loss_w", "W", 2),
    ("- blow-down, filling and heat", "blow_down_loss_w", "W", 2),
    ("= work of the gas", "gas_work_w", "W", 2),
    ("+ what the torque reading adds", "torque_reading_surplus_w", "W", 2),
    ("= indicated, in the torque reading", "indicated_power_w", "W", 2),
    ("- roller friction", "roller_loss_w", "W", 2),
    ("- f_overall friction (the rest: no load)", "f_overall_loss_w", "W", 2),
    ("Indicated isentropic efficiency", "", "", 0),
    ("in the torque reading", "isentropic_efficiency", "1", 4),
    ("of the gas's work (virtual work)", "isentropic_efficiency_virtual_work", "1", 4),
)
SWEEP_COLUMNS = (
    ("pressure", "pressure_bar_abs", "bar", 3),
    ("speed", "speed_rpm", "rpm", 2),
    ("flow", "flow_l_min", "L/min", 2),
    ("gas torque", "gas_torque_nm", "N m", 4),
    ("indicated", "indicated_power_w", "W", 2),
    ("efficiency", "isentropic_efficiency", "1", 3),
)


def points_data(motor: Motor, points: Sequence[OperatingPoint]) -> dict[str, Any]:
    """simulation/1 of one operating point, or of a sweep with its points in ``points``."""
    head = _head(motor)
    return head | asdict(points[0]) if len(points) == 1 else head | {"points": [asdict(point) for point in points]}


def transient_data(motor: Motor, kind: str, pressure_bar: float, run: Transient) -> dict[str, Any]:
    """simulation/1 of a run in time: arrays by time.

    `pressure_bar`: absolute inlet pressure while the supply is open [bar].
    """
    return _head(motor) | {
        "transient": kind,
        "pressure_bar_abs": pressure_bar,
        "time_s": run.time_s.round(9).tolist(),
        "speed_rpm": (run.speed_rad_s * at.RPM).tolist(),
        "mean_speed_rpm": (run.mean_speed_rad_s() * at.RPM).tolist(),
        "angle_rad": run.angle_rad.tolist(),
        "inlet_kg": run.inlet_kg.tolist(),
        "outlet_kg": run.outlet_kg.tolist(),
    }


def sensitivity_data(motor: Motor, pressures_bar: Sequence[float], ranking: Sequence[Sensitivity]) -> dict[str, Any]:
    """sensitivity/1: the ranking, a list by pressure in every effect; null where the motor would stall."""
    rows = [
        {key: _plain(value) if isinstance(value, np.ndarray) else value for key, value in vars(one).items()}
        for one in ranking
    ]
    return _head(motor) | {
        "format": SENSITIVITY_FORMAT,
        "pressure_bar_abs": list(pressures_bar),
        "ranking": rows,
    }


def point_table(point: OperatingPoint) -> Table:
    """The table of one operating point."""
    title = f"{point.pressure_bar_abs:g} bar abs, no load, torque reading {point.torque_reading}"
    table = _table(title, ("", "left"), ("", "right"), ("", "left"))
    for words, key, unit, digits in POINT_ROWS:
        if key:
            table.add_row(words, _shown(getattr(point, key), digits), "" if unit == "1" else unit)
        else:
            table.add_row(f"[bold]{words}[/]", "", "")
    return table


def sweep_table(points: Sequence[OperatingPoint]) -> Table:
    """The table of a sweep."""
    table = _table(
        "no load", *((style.label(name, unit).replace(" (", "\n("), "right") for name, _, unit, _ in SWEEP_COLUMNS)
    )
    for point in points:
        table.add_row(*(_shown(getattr(point, key), digits) for _, key, _, digits in SWEEP_COLUMNS))
    return table


def transient_table(run: Transient) -> Table:
    """Some rows of a run in time, equally spaced."""
    table = _table("", ("time (s)", "right"), ("speed (rpm)", "right"), ("turns", "right"))
    for i in np.unique(np.linspace(0, run.time_s.size - 1, RUN_ROWS).astype(int)):
        turns = (run.angle_rad[i] - run.angle_rad[0]) / (2.0 * np.pi)
        table.add_row(f"{run.time_s[i]:.3f}", f"{run.speed_rad_s[i] * at.RPM:.2f}", f"{turns:.3f}")
    return table


def sensitivity_table(pressure_bar: float, ranking: Sequence[Sensitivity], index: int) -> Table:
    """The ranking at one pressure."""
    right = ("value", "rpm\n/ 1 %", "L/min\n/ 1 %", "prior\nsd", "rpm\n/ sd", "L/min\n/ sd")
    table = _table(f"{pressure_bar:g} bar abs", ("parameter", "left"), *((name, "right") for name in right))
    for one in ranking:
        by_prior = (one.speed_rpm_per_prior_sd, one.flow_l_min_per_prior_sd)
        table.add_row(
            name_with_unit(one.name),
            f"{one.value:g}",
            _signed(one.speed_rpm_per_percent[index]),
            _signed(one.flow_l_min_per_percent[index]),
            one.prior_step,
            *("" if effect is None else _signed(effect[index]) for effect in by_prior),
        )
    return table


def remarks(points: Sequence[OperatingPoint], limit_rpm: float) -> list[str]:
    """What a person should know of the points beyond their figures. `limit_rpm`: the manufacturer's limit [rpm]."""
    stalled = [f"{point.pressure_bar_abs:g}" for point in points if point.state == "stalled"]
    fast = [f"{point.pressure_bar_abs:g}" for point in points if point.speed_rpm > limit_rpm]
    found = [f"the motor stalls at {_some(stalled)} bar: its friction holds it (speed 0)"] if stalled else []
    return found + ([f"warning: above the manufacturer's {limit_rpm:g} rpm at {_some(fast)} bar"] if fast else [])


def transient_remarks(run: Transient, limit_rpm: float) -> list[str]:
    """What a person should know of a run beyond its figures. `limit_rpm`: the manufacturer's limit [rpm]."""
    fastest = float(run.speed_rad_s.max()) * at.RPM
    if fastest == 0.0:
        return ["the motor does not start: friction holds it at its starting angle"]
    return [f"warning: {fastest:.0f} rpm is above the manufacturer's {limit_rpm:g} rpm"] if fastest > limit_rpm else []


def _head(motor: Motor) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "motor": motor.name,
        "parameters": {name_with_unit(name): motor[name].value for name in type(motor.parameters).model_fields},
        "readings": motor.readings.model_dump(),
    }


def _table(title: str, *columns: tuple[str, Any]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(
        title=title or None,
        title_justify="left",
        box=box.SIMPLE_HEAD,
        show_header=bool(columns[0][0]),
        show_edge=False,
        padding=(0, 1, 0, 0),
    )
    for name, justify in columns:
        table.add_column(name, justify=justify, no_wrap=True)
    return table


def _some(words: list[str], most: int = 5) -> str:
    """A list in words, its middle left out when it is long."""
    return ", ".join(words) if len(words) <= most else f"{words[0]} to {words[-1]}"


def _shown(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _signed(value: float) -> str:
    return "stalls" if np.isnan(value) else f"{value:+.2f}" if abs(value) >= 0.005 else "0.00"


def _plain(values: np.ndarray) -> list[float | None]:
    return [None if np.isnan(value) else float(value) for value in values]
