"""Whether a reading has settled: its slope over a window is small, known to be small, and it does not scatter.

The slope comes from a straight line through the window. Its standard error is that of independent residuals times the
root of their integrated autocorrelation time, since a bench's readings follow each other more slowly than they are
taken (`rig.plateaus.series`). A slope within the limit counts only when its upper 95 % bound is within twice the limit:
a window that is too short or too noisy to tell a drift from none has shown nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rig.bench.checks import FILLED, LEAST_READINGS
from rig.plateaus.series import line_through

BOUND = 2.0  # standard errors
KNOWN_WITHIN = 2.0  # limits


@dataclass(frozen=True)
class Settled:
    """The verdict on one window.

    `slope`, `slope_se`: of the line through the readings, and its standard error [own unit/s]; NaN with too few
        readings.
    `scatter`: standard deviation of the residuals [own unit]; NaN likewise.
    `why`: the reason when it has not; empty when it has.
    """

    settled: bool
    slope: float = math.nan
    slope_se: float = math.nan
    scatter: float = math.nan
    why: str = ""


def settled(
    time_s: np.ndarray, value: np.ndarray, window_s: float, slope_limit: float, scatter_limit: float | None = None
) -> Settled:
    """Judge the readings of one channel.

    `time_s`, `value`, shape (n,): times [s] and values [own unit], oldest first.
    `window_s`: length that the readings should cover [s]; older ones are not looked at.
    `slope_limit`: largest slope of a settled reading [own unit/s].
    `scatter_limit`: largest standard deviation of the residuals [own unit]; not judged when left out.
    Returns the verdict, with the reason when it is no.
    """
    if time_s.size:
        recent = time_s > time_s[-1] - window_s
        time_s, value = time_s[recent], value[recent]
    if time_s.size < LEAST_READINGS:
        readings = f"{time_s.size} reading{'s' * (time_s.size != 1)}"
        return Settled(False, why=f"{readings} in the window; {LEAST_READINGS} are needed")
    covered_s = float(time_s[-1] - time_s[0])
    if covered_s < FILLED * window_s:
        return Settled(False, why=f"the readings cover {covered_s:.3g} s of the window's {window_s:g} s")
    slope, slope_se, scatter = line_through(time_s, value)
    why = _why_not(slope, slope_se, slope_limit)
    if not why and scatter_limit is not None and scatter > scatter_limit:
        why = f"scatters by {scatter:.3g}, more than {scatter_limit:g}"
    return Settled(not why, slope, slope_se, scatter, why)


def _why_not(slope: float, slope_se: float, limit: float) -> str:
    size, bound = abs(slope), abs(slope) + BOUND * slope_se
    if size > limit and size - BOUND * slope_se > 0.0:
        return f"changes by {slope:+.3g} per second, more than {limit:g}"
    if size > limit or bound > KNOWN_WITHIN * limit:
        return f"too noisy to tell: the slope may be as large as {bound:.3g} per second, the limit is {limit:g}"
    return ""
