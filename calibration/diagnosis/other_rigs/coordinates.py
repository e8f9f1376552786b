"""What a search of another rig's model moves, and what a point of it means."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.other_rigs.noise import Noise, whitened
from calibration.diagnosis.other_rigs.problem import RigProblem
from model.effects import effects

FIRST_Z = 0.3  # at an amplitude of 0 nothing can be said of a shape


@dataclass(frozen=True)
class Estimate:
    """Mean, standard deviation and unit of an unknown."""

    mean: float
    sd: float
    unit: str


class Coordinates:
    """What a search moves: flat unknowns over their size, then standard normal numbers."""

    def __init__(self, problem: RigProblem, names: Sequence[str]) -> None:
        self.problem, self.flats = problem, problem.flats
        self.of_effects = problem.effect_unknowns(names)
        self.unknowns = [*problem.unknowns, *(unknown for _, unknown, _, _ in self.of_effects)]
        self.n_flat, k = len(self.flats), len(problem.unknowns)
        self.low = np.array([*(flat.low / flat.size for flat in self.flats), *([-8.0] * len(self.unknowns))])
        self.high = np.full(self.low.size, 8.0)
        self.high[: self.n_flat] = np.inf
        self.x = np.array([*(flat.start / flat.size for flat in self.flats), *([0.0] * len(self.unknowns))])
        self.labels = [*(flat.name for flat in self.flats), *(unknown.name for unknown in problem.unknowns)]
        self.folded = []
        for i, (name, unknown, low, high) in enumerate(self.of_effects, start=self.n_flat + k):
            amplitude = effects()[name].amplitude
            self.low[i], self.high[i] = unknown.z(low), unknown.z(high)
            if unknown.name == amplitude.name and amplitude.low == 0.0:
                self.folded.append(i)
                self.x[i] = FIRST_Z
            self.labels.append(f"{name}.{unknown.name}")
        for i, unknown in enumerate(problem.unknowns, start=self.n_flat):
            if unknown.name in ("viscous_friction", "displacement"):
                self.low[i] = max(self.low[i], unknown.z(1e-9 * unknown.a))
        self.x = np.clip(self.x, self.low + 1e-6, self.high - 1e-6)

    def values(self, x: np.ndarray) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Unknowns by name, and the effects' parameters [SI].

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        """
        values = {flat.name: float(x[i] * flat.size) for i, flat in enumerate(self.flats)}
        chosen: dict[str, dict[str, float]] = {}
        k = len(self.problem.unknowns)
        for i, unknown in enumerate(self.problem.unknowns, start=self.n_flat):
            values[unknown.name] = float(unknown.value(np.asarray(x[i])))
        for i, (name, unknown, _, _) in enumerate(self.of_effects, start=self.n_flat + k):
            chosen.setdefault(name, {})[unknown.name] = float(unknown.value(np.asarray(x[i])))
        return values, chosen

    def begun(self, estimates: Mapping[str, Estimate]) -> np.ndarray:
        """A start at another fit's estimates, where it has them [-]."""
        x = self.x.copy()
        for i, label in enumerate(self.labels):
            if label in estimates:
                mean = estimates[label].mean
                x[i] = mean / self.flats[i].size if i < self.n_flat else self.unknowns[i - self.n_flat].z(mean)
        return np.clip(x, self.low + 1e-6, self.high - 1e-6)

    def residuals(self, x: np.ndarray) -> list[np.ndarray]:
        """Readings less predictions [SI].

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        """
        values, chosen = self.values(x)
        predicted = self.problem.predict(values, chosen)
        return [one.value - p for one, p in zip(self.problem.readings, predicted, strict=True)]

    def whole(self, x: np.ndarray, noise: Noise) -> np.ndarray:
        """Whitened residuals and, behind them, the standard normal unknowns: half its square is the cost.

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        """
        return np.concatenate([*whitened(self.problem.readings, self.residuals(x), noise), x[self.n_flat :]])

    def estimates(self, x: np.ndarray, covariance: np.ndarray) -> dict[str, Estimate]:
        """Each unknown in its own unit.

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        covariance : ndarray, shape (m, m)
            Of it [-].
        """
        found = {}
        for i, label in enumerate(self.labels):
            sd = math.sqrt(max(covariance[i, i], 0.0))
            if i < self.n_flat:
                flat = self.flats[i]
                found[label] = Estimate(float(x[i] * flat.size), sd * flat.size, flat.unit)
            else:
                unknown = self.unknowns[i - self.n_flat]
                value = float(unknown.value(np.asarray(x[i])))
                spread = unknown.b * sd if unknown.kind == "normal" else value * math.log(unknown.b) * sd
                found[label] = Estimate(value, spread, unknown.unit)
        return found
