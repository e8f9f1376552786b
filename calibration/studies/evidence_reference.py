"""The integral of a density by sampling: nested sampling, and importance sampling.

Both begin from where the density was found to be. Nested sampling goes down from a wide law q about that place by the
ratio density / q: the integral of that over q is the evidence whatever q is, so nothing is approximated by it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp, stdtrit
from scipy.stats import multivariate_t

ROUND_DRAWS = 500  # of finding where a posterior is
FEWEST_ROUNDS, MOST_ROUNDS = 4, 10
TEMPERED, ENOUGH = 4.0, 15.0  # effective draws per unknown: that a round is to have, and that end the search
DEGREES = 8.0  # of freedom of all laws drawn from, whose tails are wider than the posterior's
WIDTH, IMPORTANCE_WIDTH = 1.25, 1.15  # of them, in sds of the posterior
NOWHERE = -1e100  # log density where there is none; sampling needs a number
LIVE, SLICES, LEFT = 80, 2, 0.3  # live points, slices a step, nats that live points may still add when a run ends
_T_CONSTANT = float(gammaln(0.5 * (DEGREES + 1.0)) - gammaln(0.5 * DEGREES) - 0.5 * math.log(math.pi * DEGREES))

Density = Callable[[np.ndarray], float]


@dataclass(frozen=True)
class Found:
    """An evidence by sampling. `mean`, `covariance`, shape (d,), (d, d): of the posterior's coordinates v [-]."""

    log_evidence: float
    error: float
    calls: int
    effective: float
    mean: np.ndarray
    covariance: np.ndarray


def adapted(density: Density, width: np.ndarray, seed: Sequence[int]) -> Found:
    """Where a posterior is and how wide: rounds of importance sampling, each from what those before have found.

    All draws count, each against the mixture of all laws drawn from (Cornuet et al. 2012). While few draws carry all
    the weight, the weights are raised to a power below 1.

    `width`, shape (d,): scale of the first round in each coordinate [-].
    """
    rng = np.random.default_rng(seed)
    d = width.size
    mean, covariance = np.zeros(d), np.diag(width**2)
    v, at_v, laws = np.empty((0, d)), np.empty(0), []
    for i in range(MOST_ROUNDS):
        laws.append(multivariate_t(mean, IMPORTANCE_WIDTH**2 * covariance, DEGREES))
        new = np.asarray(laws[-1].rvs(ROUND_DRAWS, random_state=rng))
        v, at_v = np.vstack([v, new]), np.append(at_v, [density(one) for one in new])
        drawn_from = logsumexp([law.logpdf(v) for law in laws], axis=0) - math.log(len(laws))
        log_weight = at_v - drawn_from
        mean, covariance = _moments(v, _tempered(log_weight, TEMPERED * d))
        covariance += 1e-6 * np.diag(width**2)
        if i + 1 >= FEWEST_ROUNDS and _effective(np.exp(log_weight - log_weight.max())) >= ENOUGH * d:
            break
    log_evidence = float(logsumexp(log_weight)) - math.log(log_weight.size)
    weight = np.exp(log_weight - log_evidence)
    error = float(np.std(weight) / math.sqrt(weight.size))
    return Found(log_evidence, error, v.shape[0], _effective(weight), mean, covariance)


def _tempered(log_weight: np.ndarray, effective: float) -> np.ndarray:
    """Weights to the highest power of at most 1 at which that many draws count."""
    power = 1.0
    while True:
        weight: np.ndarray = np.exp(power * (log_weight - log_weight.max()))
        if _effective(weight) >= effective or power < 1e-3:
            return weight
        power *= 0.8


def nested(density: Density, mean: np.ndarray, covariance: np.ndarray, seed: Sequence[int], live: int = LIVE) -> Found:
    """The evidence by nested sampling, with dynesty's slices along random directions.

    It starts from q: Student's t laws, independent along the axes of the given covariance and wider than it.

    `mean`, `covariance`, shape (d,), (d, d): of q [-].
    """
    import dynesty

    root = WIDTH * np.linalg.cholesky(covariance)
    volume = float(np.sum(np.log(np.diag(root))))

    def over_q(x: np.ndarray) -> float:
        at_x = density(mean + root @ x)
        if at_x <= NOWHERE:
            return NOWHERE * (1.0 + float(x @ x))
        return at_x + volume - float(np.sum(_log_student(x)))

    sampler = dynesty.NestedSampler(
        over_q,
        lambda cube: stdtrit(DEGREES, cube),
        mean.size,
        nlive=live,
        bound="single",
        sample="rslice",
        slices=SLICES,
        rstate=np.random.default_rng(seed),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sampler.run_nested(dlogz=LEFT, print_progress=False)
    found = sampler.results
    weight = np.exp(found.logwt - found.logz[-1])
    mean, covariance = _moments(mean + found.samples @ root.T, weight)
    calls = int(np.sum(found.ncall))
    return Found(
        float(found.logz[-1]),
        math.sqrt(float(found.information[-1]) / live),
        calls,
        _effective(weight),
        mean,
        covariance,
    )


def _log_student(x: np.ndarray) -> np.ndarray:
    return _T_CONSTANT - 0.5 * (DEGREES + 1.0) * np.log1p(x * x / DEGREES)


def importance(density: Density, mean: np.ndarray, covariance: np.ndarray, seed: Sequence[int], draws: int) -> Found:
    """The evidence by importance sampling from a Student's t law.

    `mean`, `covariance`, shape (d,), (d, d): about which and how widely to draw [-].
    """
    shape = IMPORTANCE_WIDTH**2 * (covariance + 1e-9 * np.eye(mean.size))
    law = multivariate_t(mean, shape, DEGREES, seed=np.random.default_rng(seed))
    v = law.rvs(draws)
    log_weight = np.array([density(one) for one in v]) - law.logpdf(v)
    log_evidence = float(logsumexp(log_weight)) - math.log(draws)
    weight = np.exp(log_weight - log_evidence)
    mean, covariance = _moments(v, weight)
    error = float(np.std(weight) / math.sqrt(draws))
    return Found(log_evidence, error, draws, _effective(weight), mean, covariance)


def _moments(v: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    share = weight / weight.sum()
    mean = share @ v
    return mean, (share[:, None] * (v - mean)).T @ (v - mean)


def _effective(weight: np.ndarray) -> float:
    return float(np.sum(weight) ** 2 / np.sum(weight**2))
