"""What a test will give: how far it will move the odds between explanations, and how often it has to be repeated."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from calibration.likelihood.expected import Expected

SETTLED_NATS = math.log(150.0)  # of the odds: beyond it two explanations count as told apart
MOST_REPEATS = 100
DRAWS = 200  # of readings, from all explanations together; each has its mirror image beside it


def pair_weights(probabilities: Sequence[float]) -> dict[tuple[int, int], float]:
    """What each pair of explanations counts for [-], adding up to 1: a pair is worth a test if both are probable.

    Parameters
    ----------
    probabilities : sequence of float
        Of the explanations, two or more; where no pair is probable all count alike [-].
    """
    pairs = list(itertools.combinations(range(len(probabilities)), 2))
    both = [probabilities[i] * probabilities[j] for i, j in pairs]
    total = sum(both)
    return {pair: one / total if total > 0.0 else 1.0 / len(both) for pair, one in zip(pairs, both, strict=True)}


def given_nats(
    read: Sequence[Expected], probabilities: Sequence[float], repeats: int = 1
) -> tuple[float, dict[tuple[int, int], float]]:
    """What a test will give, as often more as less: over the pairs together, and of each pair where one of it is true.

    Readings are drawn from the explanations, each as often as it is probable, and what they add to the log odds of a
    pair is counted for the true one. The median is taken, for a mean would be made by the rare draws of an effect whose
    size is hardly known.

    Parameters
    ----------
    read : sequence of Expected
        What the test would read under each explanation.
    probabilities : sequence of float
        Of the explanations, before it [-].
    repeats : int
        Of the test, averaged: what is not known of the motor stays [-].
    """
    K, size = len(read), read[0].mean.size
    total = sum(probabilities)
    shares = [one / total if total > 0.0 else 1.0 / K for one in probabilities]
    roots = [np.linalg.cholesky(one.shared + one.own / repeats) for one in read]
    rng = np.random.default_rng(0)
    drawn, truth = [], []
    for i, share in enumerate(shares):
        unit = rng.standard_normal((size, max(round(DRAWS * share), 1)))
        drawn.append(read[i].mean[:, None] + roots[i] @ np.hstack([unit, -unit]))
        truth += [i] * drawn[-1].shape[1]
    readings, of = np.hstack(drawn), np.array(truth)
    density = np.empty((K, of.size))
    for j in range(K):
        r = np.linalg.solve(roots[j], readings - read[j].mean[:, None])
        density[j] = -0.5 * np.sum(r * r, axis=0) - np.sum(np.log(np.diag(roots[j])))
    weights = pair_weights(probabilities)
    each = {}
    for i, j in weights:
        by = density[i] - density[j]
        each[i, j] = np.where(of == i, by, np.where(of == j, -by, np.abs(by)))
    whole = float(np.median(sum(weights[pair] * each[pair] for pair in weights)))
    return whole, {pair: float(np.median(each[pair][np.isin(of, pair)])) for pair in weights}


def repeats_needed(nats: Callable[[int], float]) -> int | None:
    """The fewest repeats after which odds of 150 to 1 are expected; None where a hundred do not bring them.

    Parameters
    ----------
    nats : callable
        Expected nats of a number of repeats; it never falls.
    """
    if nats(MOST_REPEATS) < SETTLED_NATS:
        return None
    low, high = 0, MOST_REPEATS
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if nats(middle) >= SETTLED_NATS else (middle, high)
    return high
