"""What a test is expected to tell between two explanations, and how often it has to be repeated."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from calibration.likelihood.expected import Expected

SETTLED_NATS = math.log(150.0)  # of the odds: beyond it two explanations count as told apart
MOST_REPEATS = 100


def pair_weights(probabilities: Sequence[float]) -> dict[tuple[int, int], float]:
    """What each pair of explanations counts for [-], adding up to 1: a pair is worth a test if both are probable.

    Parameters
    ----------
    probabilities : sequence of float
        Of the explanations, two or more; where no pair is probable all count alike [-].
    """
    both = {
        pair: math.prod(probabilities[i] for i in pair) for pair in itertools.combinations(range(len(probabilities)), 2)
    }
    total = sum(both.values())
    return {pair: one / total if total > 0.0 else 1.0 / len(both) for pair, one in both.items()}


def expected_nats(one: Expected, other: Expected, repeats: int = 1) -> float:
    """Expected logarithm of the Bayes factor for the true explanation of two, either being true as often [nats].

    That is half the sum of the two Kullback-Leibler divergences of normal predictions. It has no upper limit; far
    beyond some 20 it says no more than certainty.

    Parameters
    ----------
    repeats : int
        Of the test, averaged: what is not known of the motor stays [-].
    """
    A, B = one.shared + one.own / repeats, other.shared + other.own / repeats
    d = one.mean - other.mean
    by_A, by_B = np.linalg.solve(A, np.column_stack([B, d])), np.linalg.solve(B, np.column_stack([A, d]))
    spread = float(np.trace(by_A[:, :-1]) + np.trace(by_B[:, :-1])) - 2.0 * d.size
    return 0.25 * (max(spread, 0.0) + float(d @ by_A[:, -1] + d @ by_B[:, -1]))


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
