"""Predictions of a set of effects as a function of its unknowns; derivatives simulate no more than they need."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from calibration.likelihood.linear import FLOW, RUN, STANDING, Comparison
from calibration.systems.radial_piston import wheel
from calibration.systems.radial_piston.in_time import follows_angle
from calibration.systems.radial_piston.problem import SI_OF, Prediction
from calibration.systems.radial_piston.supply import ways_of
from calibration.work.threads import each
from model.effects import effects
from model.effects.neighbourhood import Neighbourhood

STEP = 0.02  # of a standard normal unknown, for derivatives; at most
NEAR = 1.0  # whitened size of the change that it makes
LEAST_STEP = 1e-5
STRAIGHT = 0.002  # of f_overall's prior sd: after so small a correction a second is far below what a sweep can tell
LEAST_FACTOR = 0.25  # a quantity that cannot be negative falls to no less than this share of itself in a step


Predicts = Callable[..., Prediction]  # of a point, and of what else `Function` takes


class Function:
    """Predictions of a point, within the effects' bounds.

    Attributes
    ----------
    low, high : ndarray, shape (m,)
        Bounds of each unknown [-].
    angles : dict
        Places of the angles by which the shaft is turned on, where an effect follows it, and the runs that they belong
        to [-].
    lines : list of tuple
        Of each change of a run's line: the run, and the places of its moment and of its time constant [-].
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
        names = [nuisance.name for nuisance in self.problem.nuisances]
        runs = self.problem.blocks.runs
        self.lines = [
            (i, names.index(f"{run.file}.{way}_late"), names.index(f"{run.file}.{way}_time"))
            for i, run in enumerate(runs)
            for way in ways_of(run)
        ]
        self._follows = follows_angle(self.names)
        turns = {names.index(f"{run.file}.turn"): i for i, run in enumerate(runs) if f"{run.file}.turn" in names}
        self.angles = turns if self._follows else {}
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

    def straight(self, z: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """The step in the quantities themselves that leads from one point to another: the inverse of `advance` [-].

        Parameters
        ----------
        z, moved : ndarray, shape (m,)
            Where from, and where to [-].
        """
        found: np.ndarray = moved - z
        curved = self.log_step != 0.0
        found[curved] = np.expm1(found[curved] * self.log_step[curved]) / self.log_step[curved]
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
        expected = (here.speed + D[speeds] @ self.straight(z, tried))[known]
        found = tried.copy()
        for _ in range(2):
            missing = expected - self(found, here, ()).speed[known]
            before = float(friction.value(found[f]))
            by = float(np.clip(g[known] @ missing / (g @ g), -0.05, 0.05))
            found[f] += by
            share = float(friction.value(found[f])) / before
            found[J] = float(inertia.z(float(inertia.value(found[J])) * share))
            if abs(by) < STRAIGHT:
                break
        return self.clip(found) if np.all(np.isfinite(found)) else tried

    def __call__(
        self,
        z: np.ndarray,
        like: Prediction | None = None,
        runs: Sequence[int] | None = None,
        *,
        smooth: bool = False,
        around: Neighbourhood | None = None,
    ) -> Prediction:
        chosen = self.problem.chosen(self.names, z[self.k :])
        return self.problem.predict(z[: self.k], chosen, like, runs, smooth, around)

    def derivatives(
        self, z: np.ndarray, here: Prediction, D: np.ndarray, u: np.ndarray, of: Predicts | None = None
    ) -> np.ndarray:
        """Forward differences of the predictions [SI], the plateaus' from what is known of them close to the point.

        Parameters
        ----------
        z : ndarray, shape (m,)
            The point [-].
        D : ndarray, shape (n, m)
            Derivatives so far, for the size of the steps; 0 where nothing is known [SI].
        u : ndarray, shape (5,)
            The noise, to size the steps [-].
        of : callable or None
            Differentiated; this function when left out.
        """
        of = of or self
        raw, white = self.comparison.raw(here), self.comparison.whitener(here, u)
        around = self.problem.neighbourhood(z[: self.k], self.problem.chosen(self.names, z[self.k :]), here)

        def column(i: int) -> np.ndarray:
            name = self.problem.nuisances[i].name if i < self.k else ""
            if name.startswith(("flow_", "speed_")):
                return self._instrument(i, name, raw, z)
            if name.endswith(".turn") and not self._follows:
                return np.zeros_like(raw)
            run = self.problem.run_of(i) if i < self.k else None
            if run is not None and ".wheel_" in name:
                return self._wheel(i, run, name)

            def differentiated(moved: np.ndarray) -> np.ndarray:
                if run is None:
                    return self.comparison.raw(of(moved, around=around))
                return self.comparison.raw(of(moved, here, (run,)))

            size = float(np.linalg.norm(white(D[:, i])))
            step = STEP if size == 0.0 else min(STEP, max(NEAR / size, LEAST_STEP))
            found = self._difference(z, i, differentiated, raw, step)
            size = float(np.linalg.norm(white(np.nan_to_num(found))))
            if step * size > 3.0 * NEAR:
                found = self._difference(z, i, differentiated, raw, max(NEAR / size, LEAST_STEP))
            return found

        return np.nan_to_num(np.column_stack(each(column, range(z.size))))

    def _difference(
        self, z: np.ndarray, i: int, of: Callable[[np.ndarray], np.ndarray], start: np.ndarray, step: float
    ) -> np.ndarray:
        """A forward difference, backward at the upper bound [SI]."""
        moved = z.copy()
        moved[i] += step if z[i] + step <= self.high[i] else -step
        change: np.ndarray = (of(moved) - start) / (moved[i] - z[i])
        return change

    def _wheel(self, i: int, run: int, name: str) -> np.ndarray:
        """A wheel's teeth need no simulation."""
        found = np.zeros_like(self.comparison.read)
        used = self.problem.blocks.runs[run].used
        column = wheel.seen(self.problem.blocks.runs[run], name.rpartition(".")[2])[used]
        found[self.comparison.kind == RUN + run] = column * self.problem.nuisances[i].b
        return found

    def _instrument(self, i: int, name: str, raw: np.ndarray, z: np.ndarray) -> np.ndarray:
        """An offset or a scale of flow or speed needs no simulation."""
        channel, _, error = name.partition("_")
        mine = np.isin(self.comparison.kind, (FLOW, STANDING)) if channel == "flow" else self.comparison.kind > FLOW
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
