"""Something that is otherwise from one moment on: a torque, or what an instrument reads."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Along, StepsInTime
from calibration.systems.radial_piston.places.coordinates import coordinates
from calibration.systems.radial_piston.places.forces import TorqueAnswer, torque_column
from calibration.systems.radial_piston.places.terms import LARGEST_N_M

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

LARGEST_SHARE = 0.05  # sd of the prior of an instrument's step, of its reading
FEWEST = 3  # plateaus on either side of a moment: fewer are misread rows
MOMENTS = 60  # most tried


def steps_in_time(comparison: Comparison, mode: Mode) -> StepsInTime | None:
    """The steps that a recording could show; None where it has no clock for one."""
    time = coordinates(comparison, mode)["time"]
    moments = np.zeros(0) if comparison.problem.blocks.plateaus.untimed else _moments(time)
    if not moments.size:
        return None
    columns = functools.partial(_columns, time=time, moments=moments)
    return StepsInTime(moments, float(time.everything.max()), _first_after(comparison, time, moments), columns)


def _first_after(comparison: Comparison, time: Along, moments: np.ndarray) -> np.ndarray:
    """Readings of the first plateau after each moment, shape (m, moments)."""
    n = comparison.n
    found = np.zeros((comparison.read.size, moments.size), dtype=bool)
    for k, moment in enumerate(moments):
        after = np.where(time.plateaus > moment, time.plateaus, np.inf)
        if np.isfinite(after).any():
            row = int(np.argmin(after))
            found[[row, n + row], k] = True
    return found


def _moments(time: Along) -> np.ndarray:
    """Moments between neighbouring plateaus and runs, with plateaus enough before and after."""
    plateaus = np.sort(time.plateaus[np.isfinite(time.plateaus)])
    starts = [float(run[np.isfinite(run)][0]) for run in time.runs if np.isfinite(run).any()]
    known = np.unique([*plateaus, *starts])
    between = 0.5 * (known[1:] + known[:-1])
    if plateaus.size < 2 * FEWEST:
        return np.zeros(0)
    inside = between[(between > plateaus[FEWEST - 1]) & (between < plateaus[-FEWEST])]
    return inside[np.unique(np.linspace(0, inside.size - 1, min(MOMENTS, inside.size)).astype(int))]


def _columns(comparison: Comparison, mode: Mode, time: Along, moments: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    """What one sd of each kind of step at each moment does to the readings [SI], shape (m, moments)."""
    n, end, size = comparison.n, comparison.end, comparison.read.size
    predicted, plateaus = mode.prediction, comparison.problem.blocks.plateaus
    steady = (time.plateaus[:, None] > moments).astype(float)
    runs = [(run[:, None] > moments).astype(float) for run in time.runs]
    answer = TorqueAnswer(comparison, torque_column(comparison, mode))
    torque = answer(steady * LARGEST_N_M, [one * LARGEST_N_M for one in runs])
    speed, flow, pressure = (np.zeros((size, moments.size)) for _ in range(3))
    speed[n : 2 * n] = steady * predicted.speed[:, None]
    turning = [predicted.runs[i][used] for i, used in enumerate(comparison.used)]
    if turning:
        speed[2 * n : end] = np.vstack(runs) * np.concatenate(turning)[:, None]
    flow[:n] = steady * predicted.flow[:, None]
    for rows, slope in ((slice(0, n), predicted.flow_slope), (slice(n, 2 * n), predicted.speed_slope)):
        pressure[rows] = steady * (slope * plateaus.pressure)[:, None]
    return {
        ("speed", "torque"): np.nan_to_num(torque),
        ("speed", "sensor"): LARGEST_SHARE * np.nan_to_num(speed),
        ("flow", "sensor"): LARGEST_SHARE * np.nan_to_num(flow),
        ("pressure", "sensor"): LARGEST_SHARE * np.nan_to_num(pressure),
    }
