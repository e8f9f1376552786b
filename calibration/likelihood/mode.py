"""A model at its most probable point, and its evidence by Laplace's approximation.

The log posterior is -1/2 sum r^2 - sum log s - 1/2 z^2 - 1/2 (u/spread)^2: r are readings less predictions in units of
their noise, z the unknowns (standard normal a priori), u the noise (`Compared.noise`). Single readings that
stand far out are given a wide error, Cauchy's: a slip of the eye or a lost digit may be of any size, and a normal
error, however wide, would make its size an argument for louder noise. The evidence has the longer tails of the effects'
sizes (`calibration.likelihood.tails`); the point and its covariance are those of the normal prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.likelihood.bad_reading import BAD, BAD_WIDTH, bad_weight, log_bad
from calibration.likelihood.compared import Compared, Prediction
from calibration.likelihood.function import Function
from calibration.likelihood.tails import reweighed_sizes

# More of a channel are no single misreadings: this many, or as many as five if they are a fifth at most, or this share.
SINGLE, FEW, FEW_SHARE, SHARE = 3, 5, 0.2, 0.1
ALIKE = math.log(BAD_WIDTH / BAD)  # nats that a reading bad by itself costs: one shift of all may be so much worse
NOISE_STEPS, STANDS = 4, 1e-3  # at most; prior sds of the noise, of which a smaller step is the last


@dataclass(frozen=True)
class Mode:
    """A model at its most probable point.

    `z`, shape (m,): nuisances, then the effects' unknowns [-].
    `u`, shape (k,): the noise [-].
    `D`, shape (n, m): derivatives of the predictions with z [SI].
    `J`, shape (n, m): the same, whitened [-].
    `r`, shape (n,): whitened residuals [-].
    `covariance`, shape (m, m): of z [-].
    `log_evidence`: natural logarithm, up to a constant that all models of a recording share.
    `bad`, shape (n,): probability that each residual's reading is bad [-].
    """

    names: tuple[str, ...]
    z: np.ndarray
    u: np.ndarray
    D: np.ndarray
    J: np.ndarray
    r: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    bad: np.ndarray
    prediction: Prediction


def starting_at(f: Function, z: np.ndarray, u: np.ndarray) -> Mode:
    """A point for a search to start from: a mode without derivatives, residuals or evidence.

    `z`, shape (m,): nuisances, then the effects' unknowns [-].
    `u`, shape (k,): the noise [-].
    """
    nothing = np.zeros(f.comparison.read.size)
    D = np.zeros((nothing.size, z.size))
    return Mode(f.names, z, u, D, D, nothing, np.eye(z.size), 0.0, nothing, f(z))


def close(
    comparison: Compared, names: Sequence[str], z: np.ndarray, u: np.ndarray, D: np.ndarray, predicted: Prediction
) -> Mode:
    """A mode of what a search found: its covariance and its evidence. `D`: derivatives there [SI]."""
    white = comparison.whitener(predicted, u)
    r, J = white(comparison.read - comparison.raw(predicted)), white(D)
    weight, bad = robust_weights(r, comparison, found=True)
    A = (J * weight[:, None]).T @ J + np.eye(z.size)
    covariance = np.linalg.inv(A)
    log_evidence = -minus_log_posterior(r, white.log_scale, z, u, comparison, found=True) - 0.5 * float(
        np.linalg.slogdet(A)[1]
    )
    log_evidence += reweighed_sizes(comparison.problem, names, z, covariance)[1].log_gain
    return Mode(tuple(names), z, u, D, J, r, covariance, log_evidence, bad, predicted)


def suiting_noise(
    comparison: Compared, predicted: Prediction, u: np.ndarray, D: np.ndarray, correlated: bool, found: bool = False
) -> np.ndarray:
    """The noise that suits a prediction best [-], shape (k,).

    `u`, shape (k,): where to start from [-].
    `D`, shape (n, m): derivatives of the prediction with the unknowns, for what these took up of the noise [SI].
    `correlated`: whether the correlations are set too: near a good fit only; far from it they would pass a misfit for
        noise.
    `found`: whether it is the end of a search, as in `robust_weights`.
    """
    difference = comparison.read - comparison.raw(predicted)
    for _ in range(NOISE_STEPS):
        weight, _ = robust_weights(comparison.whitener(predicted, u)(difference), comparison, found)
        step = comparison.noise_step(difference, predicted, u, weight, D, correlated)[0]
        u = u + step
        if np.all(np.abs(step) < STANDS * comparison.noise.spread):
            break
    return u


def minus_log_posterior(
    r: np.ndarray, log_scale: float, z: np.ndarray, u: np.ndarray, comparison: Compared, found: bool = False
) -> float:
    """Minus the log posterior, up to a constant [-]. `r`, shape (n,): whitened residuals [-]."""
    good = -0.5 * r**2 + math.log(1.0 - BAD)
    _, bad = robust_weights(r, comparison, found)
    fit = np.where(bad > 0.0, np.logaddexp(good, log_bad(r)), good)
    return float(-np.sum(fit) + log_scale + 0.5 * np.sum(z * z) + 0.5 * np.sum((u / comparison.noise.spread) ** 2))


def cost_at(comparison: Compared, z: np.ndarray, u: np.ndarray, predicted: Prediction, found: bool = False) -> float:
    """The cost of a point with a noise: minus the log posterior, up to a constant [-].

    `z`, shape (m,): the point [-].
    `u`, shape (k,): the noise [-].
    """
    white = comparison.whitener(predicted, u)
    r = white(comparison.read - comparison.raw(predicted))
    return minus_log_posterior(r, white.log_scale, z, u, comparison, found)


def cost_of(comparison: Compared, mode: Mode) -> float:
    """Minus the log posterior at a mode's point, up to a constant, with noise that is not correlated [-].

    That is how a search goes until its end: a correlation that passes a misfit for noise would make others hopeless.
    """
    u, scales = np.zeros_like(mode.u), comparison.noise.scales
    u[scales] = mode.u[scales]
    u = suiting_noise(comparison, mode.prediction, u, mode.D, False)
    white = comparison.whitener(mode.prediction, u)
    r = white(comparison.read - comparison.raw(mode.prediction))
    return minus_log_posterior(r, white.log_scale, mode.z, u, comparison, found=True)


def robust_weights(r: np.ndarray, comparison: Compared, found: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Weight of each residual in a least-squares step, and the probability that its reading is bad [-].

    Bad readings are single ones: where many of a channel stand out, or all of a pressure level by the same each time it
    was visited, it is the model that is off, and they count. Of a level that is told at the end of a search alone: on
    the way two misread rows may look alike, in a noise that they make seem loud.

    `r`, shape (n,): whitened residuals [-].
    """
    if comparison.size < 6 or comparison.trusting:
        return np.ones_like(r), np.zeros_like(r)
    odds = np.exp(np.minimum(log_bad(r) + 0.5 * r**2, 700.0)) / (1.0 - BAD)
    bad = odds / (1.0 + odds)
    bad[comparison.end :] = 0.0  # a mean of many readings is not one bad reading
    for mine in comparison.of_a_kind:
        if np.count_nonzero(bad[mine] > 0.5) > max(SINGLE, min(FEW, FEW_SHARE * mine.size), SHARE * mine.size):
            bad[mine] = 0.0
    if found and np.any(bad > 0.5):
        for mine in comparison.again:
            apart = 0.5 * float(np.sum((r[mine] - np.mean(r[mine])) ** 2)) if np.all(bad[mine] > 0.5) else math.inf
            if apart < (mine.size - 1) * ALIKE:
                bad[mine] = 0.0
    return 1.0 - bad + bad * bad_weight(r), bad
