"""Means and slopes of readings that follow each other, with errors that allow for their correlation.

Readings that follow each other closely are not independent: the error of their mean is s sqrt(tau/n), with tau the
integrated autocorrelation time in readings, 1 + 2 (rho_1 + rho_2 + ...). Two estimates are made and the larger is
taken: the sum, cut at the first lag that is at least 5 tau (A. Sokal, Monte Carlo Methods in Statistical Mechanics,
1996), and (1 + rho_1)/(1 - rho_1), that of a first-order lag, which a plateau of few readings shows far better.
Autocorrelations about the sample's own mean come out too low, by about tau/n and (1 + 3 rho_1)/n (F. Marriott and
J. Pope, Biometrika 41, 1954), and so does the variance; all are put right to first order. docs/sweep.md says how often
such an error holds.
"""

from __future__ import annotations

import math

import numpy as np

SOKAL_WINDOW = 5.0
HIGHEST_RHO = 0.98
MOST_CORRELATED = 0.5  # tau is never taken for more than this share of the readings
LEAST_FOR_TIME = 4  # readings from which an autocorrelation can be estimated at all


def integrated_time(value: np.ndarray) -> float:
    """Integrated autocorrelation time of equally spaced readings, in readings, at least 1 [-]."""
    n = value.size
    centred = value - value.mean()
    power = float(centred @ centred)
    if n < LEAST_FOR_TIME or power <= 0.0:
        return 1.0
    rho = np.correlate(centred, centred, "full")[n - 1 :] / power
    corrected = rho + (1.0 - rho) * min(_summed(rho) / n, MOST_CORRELATED)
    tau = max(_summed(corrected), _of_first_order(float(rho[1]), n))
    return min(tau, max(1.0, MOST_CORRELATED * n))


def _of_first_order(rho: float, n: int) -> float:
    rho = min(max(rho + (1.0 + 3.0 * max(rho, 0.0)) / n, 0.0), HIGHEST_RHO)
    return (1.0 + rho) / (1.0 - rho)


def _summed(rho: np.ndarray) -> float:
    tau = 1.0
    for lag in range(1, rho.size):
        tau += 2.0 * float(rho[lag])
        if lag >= SOKAL_WINDOW * tau:
            break
    return max(tau, 1.0)


def standard_error(value: np.ndarray) -> tuple[float | None, float]:
    """Standard error of the mean of equally spaced readings, and the effective number of readings.

    Returns `se`: [own unit]; None from fewer than two readings; `n_eff`: [-].
    """
    n = int(value.size)
    if n < 2:
        return None, float(n)
    tau = integrated_time(value)
    biased = float(np.var(value))
    return math.sqrt(biased * tau / (n - tau)), n / tau


def line_through(time_s: np.ndarray, value: np.ndarray) -> tuple[float, float, float]:
    """Slope of the straight line through readings, its standard error, and the scatter about it.

    `time_s`, `value`, shape (n,): times [s] and values [own unit], at least three.
    Returns `slope, slope_se`: [own unit/s]; the error allows for correlated residuals; `scatter`: standard deviation of
    the residuals [own unit].
    """
    centred = time_s - time_s.mean()
    spread = float(centred @ centred)
    slope = float(centred @ value) / spread
    residual = value - value.mean() - slope * centred
    scatter = math.sqrt(float(residual @ residual) / (residual.size - 2))
    return slope, scatter * math.sqrt(integrated_time(residual) / spread), scatter
