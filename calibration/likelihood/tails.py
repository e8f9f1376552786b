"""The prior of an effect's size has longer tails than the standard normal one that a search works with.

Of what is missing in a model nobody knows the size beforehand, only the order of it: a few times the scale of
`model.effects.EffectParameter` is nothing unheard of, but costs z^2/2 under a normal law, which hands the evidence of a
large effect to a wrong one that happens to be small in its own units. A size is the hyperbolic sine of a standard
normal number (Johnson's S_U law): as dense at 0 as the normal law, and log-normal far out. A search has the normal law,
so that it stays a least-squares problem; here what it found of the sizes is weighed anew, all of a set together: two
that stand in for each other are not both as large as either could be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calibration.likelihood.compared import Problem

POINTS = 201
DRAWS = 256  # of the sizes before the last
WIDE = 4.0  # prior sds of what is drawn for those after it
REACH = 8.0  # sds of what the readings say
FARTHEST = 12.0  # of asinh(z), where the readings say nothing


@dataclass(frozen=True)
class Reweighed:
    """Sizes under the prior with the longer tails, within their bounds.

    `log_gain`: of the evidence, over that with normal priors without bounds.
    `z`, `sd`, shape (n,): mean and spread, in the scale of each size [-].
    """

    log_gain: float
    z: np.ndarray
    sd: np.ndarray


def log_ratio(z: np.ndarray) -> np.ndarray:
    """Logarithm of the density of a size over that of the normal law, [-], same shape as ``z``."""
    ratio: np.ndarray = 0.5 * (z * z - np.arcsinh(z) ** 2 - np.log1p(z * z))
    return ratio


def share(low: float, high: float) -> float:
    """Share of the prior between bounds [-]."""
    return float(ndtr(math.asinh(high)) - ndtr(math.asinh(low)))


def reweighed(z: np.ndarray, covariance: np.ndarray, low: np.ndarray, high: np.ndarray) -> Reweighed:
    """Sizes that were found with the normal prior, with the longer tails and the bounds.

    Importance sampling, one size after the other: each is drawn from its law given those before it, as if those after
    it were hardly known beforehand. The last is summed over.

    `z`, shape (n,): the most probable point [-].
    `covariance`, shape (n, n): there [-].
    `low`, `high`, shape (n,): bounds [-].
    """
    n = z.size
    if not n:
        return Reweighed(0.0, z, z)
    told = np.linalg.inv(covariance)
    wide = np.linalg.inv(told - (1.0 - WIDE**-2) * np.eye(n))
    middle = wide @ told @ z
    uniform = _spread_evenly(n - 1)
    x = np.empty((uniform.shape[0], n))
    log_weight = np.full(
        x.shape[0], -sum(math.log(share(*one)) for one in zip(low.tolist(), high.tolist(), strict=True))
    )
    for i in range(n - 1):
        drawn_from = _given(i, x, middle, wide)
        grid, mass, log_total = _law(*drawn_from, WIDE, low[i], high[i])
        below = np.cumsum(mass, axis=1) - 0.5 * mass
        x[:, i] = [np.interp(u, *one) for u, *one in zip(uniform[:, i], below, grid, strict=True)]
        log_weight += _log_density(x[:, i], *_given(i, x, z, covariance), 1.0)
        log_weight -= _log_density(x[:, i], *drawn_from, WIDE) - log_total
    grid, mass, log_total = _law(*_given(n - 1, x, z, covariance), 1.0, low[-1], high[-1])
    log_weight += log_total
    x[:, -1] = (mass * grid).sum(axis=1)
    within = np.zeros_like(x)
    within[:, -1] = (mass * (grid - x[:, -1:]) ** 2).sum(axis=1)
    weight = np.exp(log_weight - np.max(log_weight))
    log_gain = float(np.max(log_weight)) + math.log(float(np.mean(weight)))
    weight /= weight.sum()
    mean = weight @ x
    return Reweighed(log_gain, mean, np.sqrt(weight @ ((x - mean) ** 2 + within)))


def _spread_evenly(n: int) -> np.ndarray:
    """Points that fill a unit cube of n dimensions evenly, shape (draws, n); one where it has none [-].

    Source: M. Roberts, The unreasonable effectiveness of quasirandom sequences (2018): the golden ratio's kin.
    """
    ratio = 2.0
    for _ in range(40):
        ratio = (1.0 + ratio) ** (1.0 / (n + 1.0))
    return (0.5 + np.arange(DRAWS if n else 1)[:, None] * ratio ** -np.arange(1.0, n + 1.0)) % 1.0


def _given(i: int, x: np.ndarray, z: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, float]:
    """Mean, shape (draws,), and variance of one size given those before it, of a normal law (z, covariance) [-]."""
    slope = np.linalg.solve(covariance[:i, :i], covariance[:i, i])
    return z[i] + (x[:, :i] - z[:i]) @ slope, float(covariance[i, i] - covariance[:i, i] @ slope)


def _log_density(x: np.ndarray, middle: np.ndarray, variance: float, prior_sd: float) -> np.ndarray:
    """Of asinh(x), where x is normal (middle, variance) with a normal prior and now has the longer tails [-]."""
    off = (x - middle) ** 2 / variance + math.log(2.0 * math.pi * variance)
    log_density: np.ndarray = 0.5 * ((x / prior_sd) ** 2 - np.arcsinh(x) ** 2 - off)
    return log_density


def _law(
    middle: np.ndarray, variance: float, prior_sd: float, low: float, high: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of one size, a grid in its bounds, the mass about each point, shape (draws, POINTS), and the log of all [-].

    `middle`, shape (draws,): with a normal prior, as `variance` [-].
    """
    told = 1.0 / variance - prior_sd**-2  # precision of what the readings say without the prior
    there, width = (middle / variance / told, told**-0.5) if told > 1e-9 else (np.zeros_like(middle), math.inf)
    near, farthest = np.clip(there, low, high), math.sinh(FARTHEST)
    start = np.arcsinh(np.maximum(near - REACH * width, max(low, -farthest)))
    end = np.arcsinh(np.minimum(near + REACH * width, min(high, farthest)))
    x = np.sinh(np.linspace(start, end, POINTS, axis=1))
    log_density = _log_density(x, middle[:, None], variance, prior_sd)
    top = np.max(log_density, axis=1)
    mass = np.exp(log_density - top[:, None])
    mass[:, [0, -1]] *= 0.5
    total = mass.sum(axis=1)
    return x, mass / total[:, None], top + np.log(total * (end - start) / (POINTS - 1))


def reweighed_sizes(
    problem: Problem, names: Sequence[str], z: np.ndarray, covariance: np.ndarray
) -> tuple[list[tuple[str, str]], Reweighed]:
    """The sizes of a set's effects, by effect and parameter; figures of a shape are none.

    `z`, shape (m,): the most probable point, with normal priors [-].
    `covariance`, shape (m, m): there [-].
    """
    members, places, bounds = [], [], []
    for i, (name, unknown) in enumerate(problem.effect_unknowns(names), start=len(problem.nuisances)):
        parameter = problem.parameter(name, unknown.name)
        if not parameter.shape:
            members.append((name, unknown.name))
            places.append(i)
            bounds.append([unknown.z(parameter.low), unknown.z(parameter.high)])
    low, high = np.array(bounds).reshape(-1, 2).T
    return members, reweighed(z[places], covariance[np.ix_(places, places)], low, high)
