"""Where something may be missing: a torque, a flow or an instrument's error along one coordinate, as columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Along, Balance, Pieces
from calibration.systems.radial_piston.places.coordinates import coordinates, same_coordinates
from calibration.systems.radial_piston.places.forces import TorqueAnswer, torque_column
from calibration.systems.radial_piston.predict.kinds import RUN

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

FEWEST = 4  # values that a coordinate must take
GAUGE_PA = 3e4  # a gauge's error is sized in shares of this
METER = 0.1  # ... a tachometer's, of the middle speed


def balances(comparison: Comparison, mode: Mode) -> list[Balance]:
    """Torque and flow along speed, time and pressure, and each instrument's error along its own reading.

    Along pressure only where the recording could tell it from speed: plateaus do, or a run in time.
    """
    at = coordinates(comparison, mode)
    plateaus = comparison.problem.blocks.plateaus
    parted = "speed" not in same_coordinates(comparison, mode, "pressure")
    answer = TorqueAnswer(comparison, torque_column(comparison, mode))
    has_flow = bool(np.isfinite(plateaus.flow).any())
    middle = float(np.nanmedian(np.abs(plateaus.flow))) if has_flow else 0.0
    found = []
    for name in ("speed", "time", "pressure"):
        along = at[name]
        if name != "pressure" or parted or comparison.problem.blocks.runs:
            found.append(Balance("speed", "torque", along, 1.0, along.everything, _torque(along, answer)))
        if has_flow and (name != "pressure" or parted):
            found.append(Balance("flow", "mass", along, middle, along.plateaus, _flow(along, comparison)))
    gauge, meter, tachometer = at["pressure"], at["flow"], at["speed"]
    found.append(Balance("pressure", "sensor", gauge, GAUGE_PA, gauge.plateaus, _gauge(gauge, comparison, mode)))
    if has_flow:
        found.append(Balance("flow", "sensor", meter, middle, meter.plateaus, _flow(meter, comparison)))
    values = tachometer.everything
    size = METER * float(np.median(values)) if values.size else 0.0
    found.append(Balance("speed", "sensor", tachometer, size, values, _tachometer(tachometer, comparison)))
    return [one for one in found if _spread(one.values)]


def _spread(values: np.ndarray) -> bool:
    known = values[np.isfinite(values)]
    return bool(known.size >= FEWEST and np.ptp(known) > 0.0)


def _torque(along: Along, answer: TorqueAnswer) -> Callable[[Pieces], np.ndarray]:
    return lambda pieces: answer(pieces(along.plateaus), [pieces(one) for one in along.runs])


def _flow(along: Along, comparison: Comparison) -> Callable[[Pieces], np.ndarray]:
    """Of a flow that the model lacks, or an error of its meter: both are added to what is read."""

    def columns(pieces: Pieces) -> np.ndarray:
        shares = pieces(along.plateaus)
        out = np.zeros((comparison.read.size, shares.shape[1]))
        out[: comparison.n] = shares
        return out

    return columns


def _gauge(along: Along, comparison: Comparison, mode: Mode) -> Callable[[Pieces], np.ndarray]:
    """Of a gauge that reads high: the line is lower than it says, at the plateaus and in the supply of a run."""
    n, problem = comparison.n, comparison.problem
    ambient = problem.motor.si("ambient_pressure")

    def columns(pieces: Pieces) -> np.ndarray:
        shares = pieces(along.plateaus)
        out = np.zeros((comparison.read.size, shares.shape[1]))
        out[:n] = -shares * mode.prediction.flow_slope[:, None]
        out[n : 2 * n] = -shares * mode.prediction.speed_slope[:, None]
        for run in problem.blocks.runs:
            i = next(i for i, one in enumerate(problem.nuisances) if one.name == f"{run.file}.supply")
            opened = [one.pressure_pa + (ambient if run.is_gauge else 0.0) for one in run.valve if one.is_open]
            if opened:
                moved = np.where(comparison.kind >= RUN, mode.D[:, i], 0.0) / problem.nuisances[i].b
                out += moved[:, None] * pieces(np.array([np.mean(opened)]))
        return out

    return columns


def _tachometer(along: Along, comparison: Comparison) -> Callable[[Pieces], np.ndarray]:
    n = comparison.n

    def columns(pieces: Pieces) -> np.ndarray:
        shares = pieces(along.plateaus)
        out = np.zeros((comparison.read.size, shares.shape[1]))
        out[n : 2 * n] = shares
        for i, one in enumerate(along.runs):
            out[comparison.kind == RUN + i] = pieces(one)
        return out

    return columns
