"""Where something may be missing: a torque, a flow or an instrument's error along one coordinate, as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.linear_model.coordinates import Along, coordinates, same_coordinates
from calibration.diagnosis.linear_model.forces import TorqueAnswer, torque_column
from calibration.likelihood.linear import RUN, Comparison
from calibration.likelihood.mode import Mode

FEWEST = 4  # values that a coordinate must take
GAUGE_PA = 3e4  # a gauge's error is sized in shares of this
METER = 0.1  # ... a tachometer's, of the middle speed

Pieces = Callable[[np.ndarray], np.ndarray]  # shares of k pieces at n values, shape (n, k)


@dataclass(frozen=True)
class Balance:
    """What may be off, and along what.

    Attributes
    ----------
    scale : float
        What its sizes are shares of [N m], [m3/s], [Pa] or [rad/s].
    values : ndarray
        Of the coordinate, where it would show [own unit].
    columns : callable
        From pieces of the coordinate to changes of the readings by 1 of each piece, shape (m, k) [SI].
    """

    channel: str
    balance: str
    along: Along
    scale: float
    values: np.ndarray
    columns: Callable[[Pieces], np.ndarray]


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
