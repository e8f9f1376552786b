"""Predictions of a set of effects as a function of its unknowns; derivatives simulate no more than they need."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calibration.likelihood.compared import Compared, Prediction
from calibration.work.threads import each

STEP = 0.02  # of a standard normal unknown, for derivatives; at most
NEAR = 1.0  # whitened size of the change that it makes
TOO_LONG = 3.0  # times NEAR; a step that changes more is taken again
LEAST_STEP = 1e-5
LEAST_FACTOR = 0.25  # a quantity that cannot be negative falls to no less than this share of itself in a step

Predicts = Callable[..., Prediction]  # of a point, and of what else `Function` takes


class Function:
    """Predictions of a point, within the effects' bounds.

    `low`, `high`, shape (m,): bounds of each unknown [-].
    `log_step`, shape (m,): change of an unknown's logarithm per unit of z; 0 where it is not log-normal [-].
    `farthest_down`, shape (m,): step that takes a log-normal unknown to `LEAST_FACTOR` of itself; minus infinity for
        others [-].
    """

    def __init__(self, comparison: Compared, names: Sequence[str]) -> None:
        self.comparison, self.problem, self.names = comparison, comparison.problem, tuple(names)
        self.k = len(self.problem.nuisances)
        unknown = self.problem.effect_unknowns(names)
        low, high = self.problem.bounds()
        self.low, self.high = np.append(low, np.zeros(len(unknown))), np.append(high, np.zeros(len(unknown)))
        for i, (name, one) in enumerate(unknown):
            parameter = self.problem.parameter(name, one.name)
            self.low[self.k + i] = one.z(max(parameter.low, 1e-12) if one.kind == "lognormal" else parameter.low)
            self.high[self.k + i] = one.z(parameter.high)
        everything = [*self.problem.nuisances, *(one for _, one in unknown)]
        self.log_step = np.array([math.log(one.b) if one.kind == "lognormal" else 0.0 for one in everything])
        falls = self.log_step > 0.0
        self.farthest_down = np.where(falls, (LEAST_FACTOR - 1.0) / np.where(falls, self.log_step, 1.0), -np.inf)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """The nearest point within the bounds [-]. `z`, shape (m,): a point [-]."""
        return np.clip(z, self.low, self.high)

    def advance(self, z: np.ndarray, move: np.ndarray) -> np.ndarray:
        """A step that is straight in the quantities themselves: of a log-normal one, z is the logarithm [-].

        `z`, `move`, shape (m,): where from, and how far [-].
        """
        found: np.ndarray = z + move
        for i in np.flatnonzero(self.log_step):
            found[i] = z[i] + math.log(max(1.0 + move[i] * self.log_step[i], LEAST_FACTOR)) / self.log_step[i]
        return found

    def straight(self, z: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """The step in the quantities themselves that leads from one point to another: the inverse of `advance` [-].

        `z`, `moved`, shape (m,): where from, and where to [-].
        """
        found: np.ndarray = moved - z
        curved = self.log_step != 0.0
        found[curved] = np.expm1(found[curved] * self.log_step[curved]) / self.log_step[curved]
        return found

    def along_valley(self, z: np.ndarray, tried: np.ndarray, here: Prediction, D: np.ndarray) -> np.ndarray:
        """A step that follows the curved valley in which a system's good fits lie [-], shape (m,).

        `z`, `tried`, shape (m,): where from, and the end of the straight step [-].
        `D`, shape (n, m): derivatives there [SI].
        """
        return self.comparison.along_valley(self, z, tried, here, D)

    def __call__(
        self,
        z: np.ndarray,
        like: Prediction | None = None,
        runs: Sequence[int] | None = None,
        *,
        smooth: bool = False,
        around: Any = None,
    ) -> Prediction:
        chosen = self.problem.chosen(self.names, z[self.k :])
        return self.problem.predict(z[: self.k], chosen, like, runs, smooth, around)

    def derivatives(
        self, z: np.ndarray, here: Prediction, D: np.ndarray, u: np.ndarray, of: Predicts | None = None
    ) -> np.ndarray:
        """Forward differences of the predictions [SI], the plateaus' from what is known of them close to the point.

        `z`, shape (m,): the point [-].
        `D`, shape (n, m): derivatives so far, for the size of the steps; 0 where nothing is known [SI].
        `u`, shape (k,): the noise, to size the steps [-].
        `of`: differentiated; this function when left out.
        """
        of = of or self
        raw, white = self.comparison.raw(here), self.comparison.whitener(here, u)
        around = self.problem.neighbourhood(z[: self.k], self.problem.chosen(self.names, z[self.k :]), here)

        def sizes(columns: np.ndarray) -> np.ndarray:
            return np.asarray(np.linalg.norm(white(np.nan_to_num(columns)), axis=0))

        def column(i: int) -> np.ndarray:
            known = self.comparison.known_derivative(i, z, raw, self.names) if i < self.k else None
            return self._difference(z, i, differentiated(i), raw, steps[i]) if known is None else known

        def differentiated(i: int) -> Callable[[np.ndarray], np.ndarray]:
            run = self.problem.run_of(i) if i < self.k else None
            if run is None:
                return lambda moved: self.comparison.raw(of(moved, around=around))
            return lambda moved: self.comparison.raw(of(moved, here, (run,)))

        steps = _steps_for(sizes(D), STEP)
        found = np.column_stack(each(column, range(z.size)))
        change = sizes(found)
        too_long = np.flatnonzero(steps * change > TOO_LONG * NEAR)
        steps = _steps_for(change, math.inf)
        if too_long.size:
            found[:, too_long] = np.column_stack(each(column, too_long.tolist()))
        return np.nan_to_num(found)

    def _difference(
        self, z: np.ndarray, i: int, of: Callable[[np.ndarray], np.ndarray], start: np.ndarray, step: float
    ) -> np.ndarray:
        """A forward difference, backward at the upper bound [SI]."""
        moved = z.copy()
        moved[i] += step if z[i] + step <= self.high[i] else -step
        change: np.ndarray = (of(moved) - start) / (moved[i] - z[i])
        return change


def _steps_for(sizes: np.ndarray, most: float) -> np.ndarray:
    """Steps that make a change of whitened size `NEAR`, shape (m,) [-]; `sizes`, shape (m,): of unit steps [-]."""
    with np.errstate(divide="ignore"):
        return np.minimum(np.maximum(NEAR / sizes, LEAST_STEP), most)
