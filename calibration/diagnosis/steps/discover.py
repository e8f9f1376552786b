"""What a mismatch that no listed effect explains looks like: a torque or a flow as a sum of few terms.

Sparse regression in the model made linear, every nuisance free: terms are added one by one while each pays its price,
and a term already in is chosen anew once there is another. What is found on the whole recording must be found again in
most of many recordings drawn from it, with replacement, block by block (stability selection).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import Linearized, linearize
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Form

MOST_TERMS = 2
DRAWS = 100
STABLE = 0.8  # share of the drawn recordings in which a term must be found again
TIED = 1.0  # nats: terms of one form closer than this are the same to a drawn recording
UNITS = {"torque": "N m", "mass": "m3/s"}


@dataclass(frozen=True)
class Term:
    """A torque or a flow found from the data.

    `gain`: log evidence over the base model, in the linear model, prices paid [-].
    `column`: what it does to the readings [SI].
    `stability`: of each term of the sum, the share of the recordings drawn from this one in which it was found again
        [-].
    """

    balance: str
    expression: str
    unit: str
    gain: float
    column: np.ndarray
    stability: tuple[float, ...] = ()


def discover(
    comparison: Compared, mode: Mode, u: np.ndarray, rng: np.random.Generator, balance: str = "torque"
) -> Term | None:
    """The few terms that explain a mismatch of a balance best; None where none is stable.

    `u`, shape (k,): the noise that the detection found [-].
    """
    listed = [one for one in comparison.places.forms(mode) if one.balance == balance]
    if not listed:
        return None
    regression = _Regression(linearize(comparison, mode, u), listed)
    kept = _stable(regression, rng)
    ids = [i for i, _ in kept]
    gain = regression.gain(ids) - regression.price * len(ids) if ids else 0.0
    if gain <= 0.0:
        return None
    text, column = regression.told(ids)
    return Term(balance, text, UNITS[balance], gain, column, tuple(share for _, share in kept))


def _stable(regression: _Regression, rng: np.random.Generator) -> list[tuple[int, float]]:
    """Terms that the whole recording asks for and that are stable, with how often they were found again."""
    draws = [regression.draw(rng) for _ in range(DRAWS)]
    kept: list[tuple[int, float]] = []
    for most in range(MOST_TERMS, 0, -1):  # where not all of a pair are stable, one alone may be
        wanted, again = _again(regression, draws, most)
        kept = again or kept
        if again and len(again) == len(wanted):
            break
    return kept


def _again(
    regression: _Regression, draws: Sequence[tuple[np.ndarray, np.ndarray]], most: int
) -> tuple[list[int], list[tuple[int, float]]]:
    """Terms chosen on the whole recording, and those of them that the draws choose again, with how often."""
    listed = regression.listed
    drawn = [(one, regression.chosen(one, most)) for one in draws]

    def share(i: int) -> float:
        return float(np.mean([regression.has(i, ids, one) for one, ids in drawn]))

    wanted = regression.chosen(regression.whole, most)
    if any(listed[a].is_like(listed[b]) for a, b in combinations(wanted, 2)):
        return wanted, []  # two steps side by side are a step with a soft edge: one term says it
    return wanted, [(i, share(i)) for i in wanted if share(i) >= STABLE]


class _Regression:
    """The linear problem with all terms of a balance, as Gram matrices by block."""

    def __init__(self, problem: Linearized, listed: Sequence[Form]) -> None:
        self.listed, self.price = listed, math.log(len(listed))
        G = problem.columns(np.hstack([one.columns for one in listed]))
        ends = np.cumsum([0, *(one.columns.shape[1] for one in listed)])
        self.of = [np.arange(ends[i], ends[i + 1]) for i in range(len(listed))]
        self.k = problem.J.shape[1]
        X = np.column_stack([problem.J, G, problem.y])
        always, blocks = problem.comparison.drawn_together()
        self.grams = [X[rows].T @ X[rows] for rows in blocks]
        self.fixed = X[always].T @ X[always]
        self.whole = self._projected(np.ones(len(blocks)))

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """A recording of as many blocks, drawn with replacement: what `chosen` takes."""
        count = len(self.grams)
        return self._projected(np.bincount(rng.integers(0, count, count), minlength=count).astype(float))

    def _projected(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Precision of the terms' coefficients, nuisances projected out, and its product with the best coefficients."""
        K = self.fixed + sum(w * gram for w, gram in zip(weight, self.grams, strict=True) if w)
        k = self.k
        left = np.linalg.solve(K[:k, :k] + np.eye(k), K[:k, k:])
        rest = K[k:, k:] - K[k:, :k] @ left
        P = rest[:-1, :-1] + np.eye(rest.shape[0] - 1)
        return P, rest[:-1, -1]

    def chosen(self, drawn: tuple[np.ndarray, np.ndarray], most: int = MOST_TERMS) -> list[int]:
        """Terms that pay their price, at most two, the first chosen anew beside the second."""
        first, gain = self._best(drawn, [])
        if gain <= self.price:
            return []
        if most < 2 or len(self.listed) < 2:
            return [first]
        second, both = self._best(drawn, [first])
        if both <= gain + self.price:
            return [first]
        for _ in range(2):
            first, both = self._best(drawn, [second])
            second, both = self._best(drawn, [first])
        return [first, second]

    def has(self, i: int, ids: Sequence[int], drawn: tuple[np.ndarray, np.ndarray]) -> bool:
        """Whether a term is among those chosen of a draw, or one of its form that the draw cannot tell from it.

        Where the draw lacks the level between two thresholds, they do the same.
        """
        mine = self.listed[i]
        for place, j in enumerate(ids):
            if mine.is_like(self.listed[j]):
                return True
            if mine.kind == self.listed[j].kind and i not in ids:
                other = [*ids[:place], i, *ids[place + 1 :]]
                if self.gain(other, drawn) > self.gain(ids, drawn) - TIED:
                    return True
        return False

    def _best(self, drawn: tuple[np.ndarray, np.ndarray], beside: list[int]) -> tuple[int, float]:
        gains = [self.gain([*beside, i], drawn) if i not in beside else -np.inf for i in range(len(self.listed))]
        best = int(np.argmax(gains))
        return best, float(gains[best])

    def gain(self, ids: Sequence[int], drawn: tuple[np.ndarray, np.ndarray] | None = None) -> float:
        """Log evidence of some terms over none."""
        P, b = self.whole if drawn is None else drawn
        at = np.concatenate([self.of[i] for i in ids])
        block, right = P[np.ix_(at, at)], b[at]
        return float(0.5 * right @ np.linalg.solve(block, right) - 0.5 * np.linalg.slogdet(block)[1])

    def told(self, ids: Sequence[int]) -> tuple[str, np.ndarray]:
        """Terms as text, with what they do to the readings [SI]."""
        P, b = self.whole
        at = np.concatenate([self.of[i] for i in ids])
        fit = np.linalg.solve(P[np.ix_(at, at)], b[at])
        parts, column, used = [], np.zeros(self.listed[ids[0]].columns.shape[0]), 0
        for i in ids:
            one, count = self.listed[i], self.of[i].size
            mine = fit[used : used + count]
            used += count
            # Of a harmonic, each run has a cosine and a sine: the amplitude is theirs together, over the runs.
            size = float(mine[0]) if count == 1 else math.sqrt(2.0 * float(np.mean(mine**2)))
            parts.append(one.text.format(a=f"{size * one.size * one.unit:.3g}"))
            column = column + one.columns @ mine
        return " + ".join(parts), column
