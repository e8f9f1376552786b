"""The arithmetic of the guard: friction from log speeds, given everything else, and quantiles of what it says next.

Without load, the speed is the torque over f, so a log speed is log torque less log f, plus a discrepancy that is alike
at like pressures, plus noise: linear and Gaussian in log f. What is not linear (a shift of the pressure, the stall, the
ports) is drawn from its prior, many times; each draw gets its own belief of log f, and a weight by how well it explains
the points. Pure functions of arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri


@dataclass(frozen=True)
class Discrepancy:
    """How far the model may be off in log speed, as a stationary process that forgets with distance."""

    sd: float
    length: float

    def covariance(self, here: np.ndarray, there: np.ndarray) -> np.ndarray:
        """Covariance between places.

        `here`, `there`, shapes (n,) and (m,): places [-].
        Returns ndarray, shape (n, m).
        """
        distance = np.abs(here[:, None] - there[None, :])
        return self.sd**2 * np.exp(-distance / self.length)


@dataclass(frozen=True)
class LogPrior:
    """What is known of log f before: normal between bounds; flat where the standard deviation is infinite."""

    mean: float
    sd: float
    low: float
    high: float

    def quantiles(self, probability: np.ndarray) -> np.ndarray:
        """Quantiles."""
        if np.isinf(self.sd):
            return self.low + probability * (self.high - self.low)
        return _truncated(np.full_like(probability, self.mean), self.sd, self.low, self.high, probability)


@dataclass(frozen=True)
class Belief:
    """What each draw holds of log f after the points.

    `mean`, `sd`, shape (n_draws,): of log f [-].
    `log_weight`, shape (n_draws,): how well the draw explains the points, up to a constant [-].
    `residual`, shape (n_draws, n_points): log speed less log torque [-].
    `inverse`, shape (n_draws, n_points, n_points): of the covariance of discrepancy and noise [-].
    """

    mean: np.ndarray
    sd: np.ndarray
    log_weight: np.ndarray
    residual: np.ndarray
    inverse: np.ndarray


def update(residual: np.ndarray, noise_sd: np.ndarray, shared: np.ndarray, prior: LogPrior) -> Belief:
    """The belief of each draw after the points.

    `residual`, shape (n_draws, n_points): log speed measured less log torque of the draw [-].
    `noise_sd`, shape (n_draws, n_points): independent errors of the log speed [-].
    `shared`, shape (n_points, n_points): covariance of the discrepancy [-].
    """
    n = residual.shape[1]
    covariance = shared + np.eye(n) * (noise_sd**2)[:, None, :]
    inverse = np.linalg.inv(covariance)
    ones = inverse.sum(axis=2)
    precision, weighed = ones.sum(axis=1), -np.einsum("ki,ki->k", ones, residual)
    spread = np.einsum("ki,kij,kj->k", residual, inverse, residual)
    if np.isfinite(prior.sd):
        precision, weighed = precision + prior.sd**-2, weighed + prior.mean / prior.sd**2
        spread += (prior.mean / prior.sd) ** 2
    mean, sd = weighed / precision, precision**-0.5
    inside = _log_between((prior.low - mean) / sd, (prior.high - mean) / sd)
    log_weight = -0.5 * (spread - precision * mean**2) - 0.5 * np.linalg.slogdet(covariance)[1] + np.log(sd) + inside
    return Belief(mean, sd, log_weight, residual, inverse)


def draw(belief: Belief, prior: LogPrior, probability: np.ndarray) -> np.ndarray:
    """A value of log f for each draw, shape (n_draws,).

    `probability`, shape (n_draws,): where in its belief each takes the value [-].
    """
    return _truncated(belief.mean, belief.sd, prior.low, prior.high, probability)


def discrepancy_at(
    belief: Belief, log_f: np.ndarray, towards: np.ndarray, discrepancy: Discrepancy
) -> tuple[np.ndarray, np.ndarray]:
    """The discrepancy at a place, given each draw's log f and the points.

    `log_f`, shape (n_draws,): of `draw` [-].
    `towards`, shape (n_points,): covariance between the points' places and this one [-].
    Returns `mean, sd`, shape (n_draws,): of the log speed's discrepancy [-].
    """
    weights = belief.inverse @ towards
    mean = np.einsum("ki,ki->k", weights, belief.residual + log_f[:, None])
    return mean, np.sqrt(np.maximum(discrepancy.sd**2 - weights @ towards, 0.0))


def normalised(log_weight: np.ndarray) -> np.ndarray:
    """Weights whose sum is 1, shape (n_draws,). `log_weight`, shape (n_draws,): up to a constant [-]."""
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum()


def quantile(
    speeds: np.ndarray, weights: np.ndarray, log_mean: np.ndarray, log_sd: np.ndarray, probability: float
) -> float:
    """Quantile of a mixture: each speed times a lognormal factor of its own.

    `speeds`, shape (n_draws,): zeros stay zero [own unit].
    `weights`, shape (n_draws,): how likely each is; their sum is 1 [-].
    `log_mean`, `log_sd`, shape (n_draws,): of each factor's logarithm [-].
    """
    turning = speeds > 0.0
    standing = float(np.sum(weights[~turning]))
    if standing >= probability or not turning.any():
        return 0.0
    centre, spread = np.log(speeds[turning]) + log_mean[turning], np.maximum(log_sd[turning], 1e-6)
    low, high = float(np.min(centre - 6.0 * spread)), float(np.max(centre + 6.0 * spread))
    for _ in range(50):
        middle = 0.5 * (low + high)
        below = standing + float(weights[turning] @ ndtr((middle - centre) / spread))
        low, high = (middle, high) if below < probability else (low, middle)
    return float(np.exp(high))


def _truncated(
    mean: np.ndarray, sd: np.ndarray | float, low: float, high: float, probability: np.ndarray
) -> np.ndarray:
    """Quantiles of normals cut off at the bounds; the nearer bound where nearly all of one lies outside."""
    below, above = ndtr((low - mean) / sd), ndtr((high - mean) / sd)
    value = mean + sd * ndtri(np.clip(below + probability * (above - below), 1e-12, 1.0 - 1e-12))
    return np.asarray(np.clip(value, low, high))


def _log_between(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Logarithm of a standard normal's probability between two values."""
    swap = low > 0.0
    near, far = np.where(swap, -high, low), np.where(swap, -low, high)
    upper = log_ndtr(far)
    return np.asarray(upper + np.log1p(-np.exp(np.minimum(log_ndtr(near) - upper, -1e-12))))
