"""Predictions of a set of effects as a function of its unknowns; derivatives simulate no more than they need."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.diagnosis.linear import Comparison
from calibration.diagnosis.problem import SI_OF, Prediction
from model.effects import effects

STEP = 0.02  # of a standard normal unknown, for derivatives
FAINT = 1.0  # a column whose whitened norm is below this is not taken anew: one sd of it cannot be seen


class Function:
    """Predictions of a point, within the effects' bounds.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    names : sequence of str
        Effect ids.
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

    def clip(self, z: np.ndarray) -> np.ndarray:
        """The nearest point within the bounds [-].

        Parameters
        ----------
        z : ndarray, shape (m,)
            A point [-].
        """
        return np.clip(z, self.low, self.high)

    def __call__(self, z: np.ndarray, like: Prediction | None = None, runs: Sequence[int] | None = None) -> Prediction:
        chosen = self.problem.chosen(self.names, z[self.k :])
        return self.problem.predict(z[: self.k], chosen, like, runs)

    def derivatives(
        self, z: np.ndarray, here: Prediction, D: np.ndarray, only: Sequence[int] | None, u: np.ndarray
    ) -> np.ndarray:
        """Forward differences of the predictions [SI]; what acts on few parts is taken of these alone.

        Parameters
        ----------
        z : ndarray, shape (m,)
            The point [-].
        here : Prediction
            At it.
        D : ndarray, shape (n, m)
            Derivatives so far [SI].
        only : sequence of int or None
            Columns to take anew; all when left out [-].
        u : ndarray, shape (3,)
            Noise scales, to tell faint columns [-].
        """
        out = D.copy()
        raw = self.comparison.raw(here)
        white = self.comparison.whitener(here, u)
        drives = self._drives(z, here)
        for i in range(z.size) if only is None else only:
            if i < self.k and np.any(out[:, i]) and np.linalg.norm(white(out[:, i])) < FAINT:
                continue
            step = STEP if z[i] + STEP <= self.high[i] else -STEP
            moved = z.copy()
            moved[i] += step
            name = self.problem.nuisances[i].name if i < self.k else ""
            if name in ("pressure_offset", "pressure_scale"):
                there = self(moved, here, ())
                column = (self.comparison.raw(there) - raw) / step
                self._through_supply(column, drives, name, i)
            elif name.endswith((".supply", ".angle")):
                run = [r.file for r in self.problem.blocks.runs].index(name.rpartition(".")[0])
                if name.endswith(".supply"):
                    column = np.zeros(raw.size)
                    column[self.comparison.kind == 2 + run] = drives[run] * self.problem.nuisances[i].b
                else:
                    column = (self.comparison.raw(self(moved, here, (run,))) - raw) / step
            elif name.startswith(("flow_", "speed_")):
                column = self._instrument(i, name, raw, z)
            else:
                column = (self.comparison.raw(self(moved)) - raw) / step
            out[:, i] = np.nan_to_num(column)
        return out

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
            column[self.comparison.kind == 2 + j] = drives[j] * per_z

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
