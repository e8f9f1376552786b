"""What a test will give: how far it will move the odds between explanations, and how often it has to be repeated."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from calibration.likelihood.expected import Expected
from calibration.work.threads import each

SETTLED_NATS = math.log(150.0)  # of the odds: beyond it two explanations count as told apart
MOST_REPEATS = 100
MOST_LOOKS, CLOSE = 20, 1e-3  # of a fit to a test's readings, and the share of its cost that is worth no further one
FAR_OFF = 100.0  # sd of the noise, of each reading where there is none: the rotor would not turn
PROBE = 0.05  # sd, for derivatives


def pair_weights(probabilities: Sequence[float]) -> dict[tuple[int, int], float]:
    """What each pair of explanations counts for [-], adding up to 1: a pair is worth a test if both are probable.

    `probabilities`: of the explanations, two or more; where no pair is probable all count alike [-].
    """
    pairs = list(itertools.combinations(range(len(probabilities)), 2))
    both = [probabilities[i] * probabilities[j] for i, j in pairs]
    total = sum(both)
    return {pair: one / total if total > 0.0 else 1.0 / len(both) for pair, one in zip(pairs, both, strict=True)}


def log_density(one: Expected, read: np.ndarray, repeats: int = 1) -> float:
    """Log density of a test's readings under an explanation, up to a constant, by Laplace's approximation.

    What the recording leaves open of the explanation is fitted to the readings: an effect of which hardly a size is
    known may be gone one sd away, and then reads as the model without it.

    `read`, shape (m,): the readings, in standard deviations of the noise [-].
    `repeats`: of the test, averaged: what is not known of the motor stays [-].
    """
    root = np.linalg.cholesky(one.inexact + one.own / repeats)

    def white(difference: np.ndarray) -> np.ndarray:
        found: np.ndarray = solve_triangular(root, difference, lower=True)
        return found

    at, left, m, k = one.at, one.left or np.copy, *one.slopes.shape
    straight = white(one.slopes)

    def misfit(place: np.ndarray) -> np.ndarray:
        here = one.mean + one.slopes @ place if at is None else at(place)
        return np.append(white(read - here) if np.isfinite(here).all() else np.full(m, FAR_OFF), left(place))

    def slopes(place: np.ndarray) -> np.ndarray:
        J = straight
        if at is not None:
            J = white(np.column_stack(each(partial(_slope, at, place, at(place)), np.eye(k))))
        now = left(place)
        return np.vstack([-J, np.column_stack([_slope(left, place, now, one) for one in np.eye(k)])])

    settled = -float(np.sum(np.log(np.diag(root))))
    if not k:
        return settled - 0.5 * float(np.sum(misfit(np.zeros(0)) ** 2))
    found = least_squares(misfit, np.zeros(k), slopes, ftol=CLOSE, xtol=CLOSE, gtol=CLOSE, max_nfev=MOST_LOOKS)
    cost = float(found.cost) - 0.5 * float(np.sum(left(np.zeros(k)) ** 2))
    return settled - cost - 0.5 * float(np.linalg.slogdet(found.jac.T @ found.jac)[1])


def _slope(at: Callable[[np.ndarray], np.ndarray], place: np.ndarray, now: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Derivative of the readings along a direction, shape (m,); 0 where there are none a little way on."""
    found: np.ndarray = np.nan_to_num(at(place + PROBE * along) - now) / PROBE
    return found


class Given(NamedTuple):
    """What a test will give [nats]: over the pairs together, and of each pair where one of the two is true.

    `where_true`: over the pairs together, where each of the explanations is true.
    """

    whole: float
    of_pair: dict[tuple[int, int], float]
    where_true: tuple[float, ...]


def densities(read: Sequence[Expected], repeats: int = 1) -> np.ndarray:
    """Log density of a test's readings where each explanation is true, under each, shape (n, n) [-].

    The readings are those of each explanation at its most probable point, without noise.

    `read`: what the test would read under each explanation.
    """
    return np.array([[log_density(one, true.mean, repeats) for one in read] for true in read])


def given_of(density: np.ndarray, probabilities: Sequence[float]) -> Given:
    """What a test will give.

    What its readings add to the log odds of a pair is counted for the true one. Over the pairs together it is as often
    more as less, each explanation being true as often as it is probable; of a pair it is the mean over the two.

    `density`, shape (n, n): of `densities` [-].
    `probabilities`: of the explanations, before it [-].
    """
    if not any(probabilities):
        probabilities = [1.0] * len(density)
    weights = pair_weights(probabilities)
    # by which the readings of the true one speak for it in each pair; where neither is true, for the likelier
    by = {(i, j): np.abs(density[:, i] - density[:, j]) for i, j in weights}
    for i, j in weights:
        by[i, j][[i, j]] = density[i, i] - density[i, j], density[j, j] - density[j, i]
    whole = sum(weights[pair] * by[pair] for pair in weights)
    of_pair = {pair: float(np.mean(by[pair][list(pair)])) for pair in weights}
    return Given(_median(whole, probabilities), of_pair, tuple(whole.tolist()))


def _median(values: np.ndarray, weights: Sequence[float]) -> float:
    """The value that half of the weight lies at or below."""
    order = np.argsort(values)
    summed = np.cumsum(np.asarray(weights)[order])
    return float(values[order][int(np.searchsorted(summed, 0.5 * summed[-1]))])


def repeats_needed(nats: Callable[[int], float]) -> int | None:
    """The fewest repeats after which odds of 150 to 1 are expected; None where a hundred do not bring them.

    `nats`: expected nats of a number of repeats; it never falls.
    """
    if nats(1) >= SETTLED_NATS:
        return 1
    if nats(MOST_REPEATS) < SETTLED_NATS:
        return None
    low, high = 1, MOST_REPEATS
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if nats(middle) >= SETTLED_NATS else (middle, high)
    return high
