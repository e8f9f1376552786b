"""What every compared reading happened at: speed, pressure, flow, time, direction, angle of the shaft."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Along, alike
from calibration.systems.radial_piston.predict import gauge

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

UNITS = {"speed": "rad/s", "pressure": "Pa", "flow": "m3/s", "time": "s", "direction": "1", "angle": "rad"}


def coordinates(comparison: Comparison, mode: Mode) -> dict[str, Along]:
    """Every coordinate of a recording, by name. `mode`: a model, for speed and flow: its own, which hold no noise."""
    problem, plateaus = comparison.problem, comparison.problem.blocks.plateaus
    ambient = problem.motor.si("ambient_pressure")
    runs = problem.blocks.runs
    used = comparison.used
    nothing = tuple(np.full(int(u.sum()), np.nan) for u in used)
    speed = tuple(mode.prediction.runs[i][u] for i, u in enumerate(used))
    time = tuple(run.start_s + run.time[u] for run, u in zip(runs, used, strict=True))
    line = []
    for run, u in zip(runs, used, strict=True):
        pressure = np.full(int(u.sum()), ambient)
        for span in run.valve:  # in their order in time
            full = span.pressure_pa + (ambient if run.is_gauge else 0.0)
            pressure[run.time[u] > span.start_s] = full if span.is_open else ambient
        line.append(pressure)
    angle = tuple(np.cumsum(w * np.gradient(t)) for w, t in zip(speed, time, strict=True))
    found = {
        "speed": (mode.prediction.speed, speed),
        "pressure": (gauge.absolute(plateaus.pressure, plateaus.is_gauge, ambient), tuple(line)),
        "flow": (mode.prediction.flow, nothing),
        "time": (np.full(plateaus.size, np.nan) if plateaus.untimed else plateaus.time, time),
        "direction": (plateaus.up, nothing),
        "angle": (np.full(plateaus.size, np.nan), angle),
    }
    return {name: Along(name, UNITS[name], values, of_runs) for name, (values, of_runs) in found.items()}


def same_coordinates(comparison: Comparison, mode: Mode, coordinate: str) -> tuple[str, ...]:
    """Coordinates that the plateaus of this recording cannot tell from one."""
    if comparison.problem.blocks.plateaus.size < 4 or coordinate not in UNITS:
        return ()
    # A run in time parts speed from pressure and flow.
    parted = ("angle", "speed") if comparison.problem.blocks.runs else ("angle",)
    along = {name: one.plateaus for name, one in coordinates(comparison, mode).items() if name not in parted}
    if coordinate not in along:
        return ()
    known = {name: np.nan_to_num(values) for name, values in along.items()}
    return tuple(name for name in known if name != coordinate and alike(known[coordinate], known[name]))


def samples_a_turn(comparison: Comparison, mode: Mode) -> float:
    """How many samples the runs in time take in a turn of the shaft, where they turn fastest; 0 without runs [-]."""
    few = [
        2.0 * np.pi / (float(np.nanmax(mode.prediction.runs[i][used])) * float(np.median(np.diff(run.time))))
        for i, (run, used) in enumerate(zip(comparison.problem.blocks.runs, comparison.used, strict=True))
        if np.nanmax(mode.prediction.runs[i][used]) > 0.0
    ]
    return min(few, default=0.0)
