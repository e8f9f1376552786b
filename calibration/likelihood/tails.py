"""The prior of an effect's size has longer tails than the standard normal one that a search works with.

Of what is missing in a model nobody knows the size beforehand, only the order of it: a few times the scale of
`model.effects.EffectParameter` is nothing unheard of, but costs z^2/2 under a normal law, which hands the evidence of a
large effect to a wrong one that happens to be small in its own units. A size is the hyperbolic sine of a standard
normal number (Johnson's S_U law): as dense at 0 as the normal law, and log-normal far out. A search has the normal law,
so that it stays a least-squares problem; here its marginals are weighed anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from calibration.likelihood.compared import Problem

POINTS = 2001
REACH = 8.0  # sds of what the readings say
FARTHEST = 12.0  # of asinh(z), where the readings say nothing


@dataclass(frozen=True)
class Marginal:
    """Of one size, under the prior with the longer tails.

    Attributes
    ----------
    z, sd : float
        Mean and spread, in the scale of the size [-].
    """

    log_gain: float
    z: float
    sd: float


def log_ratio(z: np.ndarray) -> np.ndarray:
    """Logarithm of the density of a size over that of the normal law, [-], same shape as ``z``."""
    ratio: np.ndarray = 0.5 * (z * z - np.arcsinh(z) ** 2 - np.log1p(z * z))
    return ratio


def share(low: float, high: float) -> float:
    """Share of the prior between bounds [-]."""
    return float(ndtr(math.asinh(high)) - ndtr(math.asinh(low)))


def reweighed(z: float, sd: float, low: float, high: float) -> Marginal:
    """A marginal that was found with the normal prior, with the longer tails."""
    told = 1.0 / (sd * sd) - 1.0  # precision of what the readings say without the prior
    there, width = (z / (sd * sd) / told, told**-0.5) if told > 1e-9 else (0.0, math.inf)
    near = min(max(there, low), high)
    start = math.asinh(max(low, near - REACH * width, -math.sinh(FARTHEST)))
    end = math.asinh(min(high, near + REACH * width, math.sinh(FARTHEST)))
    t = np.linspace(start, end, POINTS)
    x = np.sinh(t)
    found = -0.5 * ((x - z) / sd) ** 2 + np.log(np.cosh(t))
    after = found + log_ratio(x)
    top = float(np.max(after))
    weight, before = np.exp(after - top), np.exp(found - top)
    total = float(np.sum(weight))
    mean = float(np.sum(weight * x)) / total
    spread = math.sqrt(float(np.sum(weight * (x - mean) ** 2)) / total)
    return Marginal(math.log(total / float(np.sum(before))), mean, spread)


def marginals(
    problem: Problem, names: Sequence[str], z: np.ndarray, covariance: np.ndarray
) -> dict[tuple[str, str], Marginal]:
    """The sizes of a set's effects, by effect and parameter; figures of a shape are none.

    Parameters
    ----------
    z : ndarray, shape (m,)
        The most probable point, with normal priors [-].
    covariance : ndarray, shape (m, m)
        There [-].
    """
    k = len(problem.nuisances)
    found = {}
    for i, (name, unknown) in enumerate(problem.effect_unknowns(names), start=k):
        parameter = problem.parameter(name, unknown.name)
        if parameter.shape:
            continue
        low, high = unknown.z(parameter.low), unknown.z(parameter.high)
        one = reweighed(float(z[i]), math.sqrt(float(covariance[i, i])), low, high)
        allowed = share(low, high) / (0.5 if low == 0.0 else 1.0)  # that a half counts twice is said in `mode.folding`
        found[name, unknown.name] = Marginal(one.log_gain - math.log(allowed), one.z, one.sd)
    return found
