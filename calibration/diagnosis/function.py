"""Predictions of a set of effects as a function of its unknowns; derivatives simulate no more than they need."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

from calibration.diagnosis.linear import RUN, Comparison
from calibration.diagnosis.problem import SI_OF, Prediction
from model.effects import effects

STEP = 0.02  # of a standard normal unknown, for derivatives; at most
FAR = 20.0  # whitened size of the change that it makes: over more than a pulse, whose phase says nothing yet
NEAR = 1.0  # ... where there are no pulses
LEAST_STEP = 1e-5
LEAST_FACTOR = 0.25  # a quantity that cannot be negative falls to no less than this share of itself in a step
THREADS = 2


class Function:
    """Predictions of a point, within the effects' bounds.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    names : sequence of str
        Effect ids.

    Attributes
    ----------
    low, high : ndarray, shape (m,)
        Bounds of each unknown [-].
    log_step : ndarray, shape (m,)
        Change of an unknown's logarithm per unit of z; 0 where it is not log-normal [-].
    """

    def __init__(self, comparison: Comparison, names: Sequence[str]) -> None:
        self.comparison, self.problem, self.names = comparison, comparison.problem, tuple(names)
        self.k = len(self.problem.nuisances)
        unknown = self.problem.effect_unknowns(names)
        self.low = np.full(self.k + len(unknown), -9.0)
        self.high = np.full(self.k + len(unknown), 9.0)
        for i, (name, one) in enumerate(unknown):
            parameter = next(p for p in effects()[name].parameters if p.name == one.name)
            self.low[self.k + i] = one.z(max(parameter.low, 1e-12) if one.kind == "lognormal" else parameter.low)
            self.high[self.k + i] = one.z(parameter.high)
        everything = [*self.problem.nuisances, *(one for _, one in unknown)]
        self.log_step = np.array([math.log(one.b) if one.kind == "lognormal" else 0.0 for one in everything])

    def clip(self, z: np.ndarray) -> np.ndarray:
        """The nearest point within the bounds [-].

        Parameters
        ----------
        z : ndarray, shape (m,)
            A point [-].
        """
        return np.clip(z, self.low, self.high)

    def advance(self, z: np.ndarray, move: np.ndarray) -> np.ndarray:
        """A step that is straight in the quantities themselves: of a log-normal one, z is the logarithm [-].

        Parameters
        ----------
        z, move : ndarray, shape (m,)
            Where from, and how far [-].
        """
        found: np.ndarray = z + move
        for i in np.flatnonzero(self.log_step):
            found[i] = z[i] + math.log(max(1.0 + move[i] * self.log_step[i], LEAST_FACTOR)) / self.log_step[i]
        return found

    def along_valley(self, z: np.ndarray, tried: np.ndarray, here: Prediction, D: np.ndarray) -> np.ndarray:
        """A step with f_overall set anew, so that the plateaus' speeds do on average what was to be expected of it.

        What a sweep says of f_overall is a hundred times sharper than what it says of port lap or roller friction
        alone: the good fits lie along a curved valley, which a straight step leaves. The inertia goes with f_overall,
        for their ratio is what a coast-down shows.

        Parameters
        ----------
        z, tried : ndarray, shape (m,)
            Where from, and the end of the straight step [-].
        here : Prediction
            At the start.
        D : ndarray, shape (n, m)
            Derivatives there [SI].
        """
        n, names = self.comparison.n, [u.name for u in self.problem.nuisances]
        speeds = slice(n, 2 * n)
        known = self.comparison.known[speeds]
        if not known.any() or "f_overall" not in names:
            return tried
        f, J = names.index("f_overall"), names.index("inertia")
        friction, inertia = self.problem.nuisances[f], self.problem.nuisances[J]
        g = np.where(known, D[speeds, f], 0.0)
        if not np.any(g):
            return tried
        expected = (here.speed + D[speeds] @ (tried - z))[known]
        found = tried.copy()
        for _ in range(2):
            missing = expected - self(found, here, ()).speed[known]
            before = float(friction.value(found[f]))
            found[f] += float(np.clip(g[known] @ missing / (g @ g), -0.05, 0.05))
            share = float(friction.value(found[f])) / before
            found[J] = float(inertia.z(float(inertia.value(found[J])) * share))
        return self.clip(found) if np.all(np.isfinite(found)) else tried

    def __call__(self, z: np.ndarray, like: Prediction | None = None, runs: Sequence[int] | None = None) -> Prediction:
        chosen = self.problem.chosen(self.names, z[self.k :])
        return self.problem.predict(z[: self.k], chosen, like, runs)

    def derivatives(self, z: np.ndarray, here: Prediction, D: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Forward differences of the predictions [SI]; what acts on few parts is taken of these alone.

        Parameters
        ----------
        z : ndarray, shape (m,)
            The point [-].
        here : Prediction
            At it.
        D : ndarray, shape (n, m)
            Derivatives so far, for the size of the steps; 0 where nothing is known [SI].
        u : ndarray, shape (3,)
            Noise scales, to size the steps [-].
        """
        raw, white = self.comparison.raw(here), self.comparison.whitener(here, u)
        far = FAR if self.problem.blocks.runs else NEAR
        drives = self._drives(z, here)

        def column(i: int) -> np.ndarray:
            name = self.problem.nuisances[i].name if i < self.k else ""
            if name in ("pressure_offset", "pressure_scale"):
                found = self._difference(z, i, here, raw, STEP, ())
                self._through_supply(found, drives, name, i)
                return found
            if name.endswith(".supply"):
                run = self._run_of(name)
                found = np.zeros(raw.size)
                found[self.comparison.kind == RUN + run] = drives[run] * self.problem.nuisances[i].b
                return found
            if name.endswith(".angle"):
                return self._difference(z, i, here, raw, STEP, (self._run_of(name),))
            if name.startswith(("flow_", "speed_")):
                return self._instrument(i, name, raw, z)
            size = float(np.linalg.norm(white(D[:, i])))
            step = STEP if size == 0.0 else min(STEP, max(far / size, LEAST_STEP))
            found = self._difference(z, i, here, raw, step)
            size = float(np.linalg.norm(white(np.nan_to_num(found))))
            if step * size > 3.0 * far:
                found = self._difference(z, i, here, raw, max(far / size, LEAST_STEP))
            return found

        return self._columns(column, z.size)

    def along(self, z: np.ndarray, here: Prediction, axes: np.ndarray, D: np.ndarray) -> np.ndarray:
        """Differences of the predictions along given axes, as derivatives with z [SI].

        Where two unknowns nearly make up for each other, derivatives with each alone are two large numbers whose
        difference, all that tells them apart, is lost in the phase of the pulses. Along the axes of the posterior,
        one sd each, it is not.

        Parameters
        ----------
        z : ndarray, shape (m,)
            The point [-].
        here : Prediction
            At it.
        axes : ndarray, shape (m, m)
            Steps, a column each [-].
        D : ndarray, shape (n, m)
            Derivatives so far [SI].
        """
        raw = self.comparison.raw(here)

        def column(i: int) -> np.ndarray:
            moved = self.advance(z, axes[:, i])
            sign = 1.0 if np.all((moved >= self.low) & (moved <= self.high)) else -1.0
            straight = np.clip(self.advance(z, sign * axes[:, i]), -9.0, 9.0)
            end = self.along_valley(z, straight, here, D)
            change = self.comparison.raw(self(end)) - raw
            found: np.ndarray = sign * (np.nan_to_num(change) - D @ (end - straight))
            return found

        found: np.ndarray = np.linalg.solve(axes.T, self._columns(column, z.size).T).T
        return found

    def _columns(self, column: Callable[[int], np.ndarray], count: int) -> np.ndarray:
        each = _threads().map(column, range(count)) if self.problem.blocks.runs else map(column, range(count))
        return np.nan_to_num(np.column_stack(list(each)))

    def _run_of(self, name: str) -> int:
        return [run.file for run in self.problem.blocks.runs].index(name.rpartition(".")[0])

    def _difference(
        self,
        z: np.ndarray,
        i: int,
        here: Prediction,
        raw: np.ndarray,
        step: float,
        runs: Sequence[int] | None = None,
    ) -> np.ndarray:
        """A forward difference, backward at the upper bound [SI]."""
        moved = z.copy()
        moved[i] += step if z[i] + step <= self.high[i] else -step
        there = self(moved) if runs is None else self(moved, here, runs)
        change: np.ndarray = self.comparison.raw(there) - raw
        return change / (moved[i] - z[i])

    def _drives(self, z: np.ndarray, here: Prediction) -> list[np.ndarray]:
        """What each run's samples do per Pa that the gauge's readings are taken off."""
        found = []
        for j, run in enumerate(self.problem.blocks.runs):
            i = next(i for i, u in enumerate(self.problem.nuisances) if u.name == f"{run.file}.supply")
            moved = z.copy()
            moved[i] += 0.2
            there = self(moved, here, (j,))
            used = self.comparison.used[j]
            found.append((there.runs[j] - here.runs[j])[used] / (0.2 * self.problem.nuisances[i].b))
        return found

    def _through_supply(self, column: np.ndarray, drives: list[np.ndarray], name: str, i: int) -> None:
        """A gauge's error acts on a run through its supply alone."""
        for j, run in enumerate(self.problem.blocks.runs):
            size = max((s.pressure_pa for s in run.supply if s.is_open), default=0.0)
            per_z = self.problem.nuisances[i].b * (SI_OF["pressure"] if name == "pressure_offset" else size)
            column[self.comparison.kind == RUN + j] = drives[j] * per_z

    def _instrument(self, i: int, name: str, raw: np.ndarray, z: np.ndarray) -> np.ndarray:
        """An offset or a scale of flow or speed needs no simulation."""
        channel, _, error = name.partition("_")
        mine = self.comparison.kind == 0 if channel == "flow" else self.comparison.kind > 0
        unknown = self.problem.nuisances[i]
        if error == "offset":
            return np.where(mine, unknown.b * SI_OF[channel], 0.0)
        scale = 1.0 + unknown.b * z[i]
        offset = next(
            (
                u.b * z[j] * SI_OF[channel]
                for j, u in enumerate(self.problem.nuisances)
                if u.name == f"{channel}_offset"
            ),
            0.0,
        )
        return np.where(mine, (raw - offset) / scale * unknown.b, 0.0)


@cache
def _threads() -> ThreadPoolExecutor:
    """Two threads: the compiled integrator runs without the interpreter's lock."""
    return ThreadPoolExecutor(THREADS)
