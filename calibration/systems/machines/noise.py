"""The noise of a machine's readings: how large it is, and how alike neighbours are, array by array.

u holds the logarithm of each array's scale on its declared noise (log-normal 0.3 a priori), then the inverse hyperbolic
tangent of the correlation of its neighbours, 0 where they do not follow each other in time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.likelihood import compared
from calibration.systems.machines.readings import Readings
from calibration.unknowns.priors import NOISE_SD

EVEN_SD = 0.9  # of the inverse hyperbolic tangent of a correlation that is as likely as any other
CORRELATIONS = np.linspace(-0.6, 0.95, 32)
NEWTON, CLOSE, LARGEST = 30, 1e-9, 0.5  # steps towards a scale; how short the last is, and the longest
LEAST_SQUARE = 1e-12


def uncorrelated(white: np.ndarray, rho: float) -> np.ndarray:
    """Take the correlation of neighbours out of whitened residuals [-].

    `white`, shape (n,) or (n, k): residuals in units of their noise [-].
    """
    if not rho:
        return white
    return np.concatenate([white[:1], (white[1:] - rho * white[:-1]) / math.sqrt(1.0 - rho * rho)])


@dataclass(frozen=True)
class Whitener:
    """The map from differences of readings to standard normal numbers, array by array.

    `u`, shape (2 l,): the noise of the l arrays [-].
    """

    readings: Sequence[Readings]
    u: np.ndarray

    def __call__(self, difference: np.ndarray) -> np.ndarray:
        """Whitened differences. `difference`, shape (m,) or (m, k): differences of readings [SI]."""
        parts = np.split(difference, ends(self.readings)[:-1])
        return np.concatenate([self.of_array(i, part) for i, part in enumerate(parts)])

    def of_array(self, i: int, difference: np.ndarray) -> np.ndarray:
        """Whitened differences of one array [-], shape (n,) or (n, k).

        `difference`, shape (n,) or (n, k): differences of its readings [SI].
        """
        white = self.readings[i].white(difference) * math.exp(-self.u[i])
        return uncorrelated(white, self._rho(i))

    @property
    def scale(self) -> np.ndarray:
        """sd of each reading given those before it [SI], shape (m,)."""
        found = []
        for i, one in enumerate(self.readings):
            sd = one.sd if one.whitener is None else 1.0 / np.diag(one.whitener)
            left = np.where(np.arange(sd.size) > 0, math.sqrt(1.0 - self._rho(i) ** 2), 1.0)
            found.append(sd * left * math.exp(self.u[i]))
        return np.concatenate(found)

    @property
    def log_scale(self) -> float:
        """Sum of the logarithms of the sds, as far as they hang on the noise [-]."""
        total = 0.0
        for i, one in enumerate(self.readings):
            n = one.value.size
            total += n * float(self.u[i]) + 0.5 * max(n - 1, 0) * math.log(1.0 - self._rho(i) ** 2)
        return total

    def _rho(self, i: int) -> float:
        return math.tanh(float(self.u[len(self.readings) + i]))


class Noise(compared.Noise):
    """The noise of a recording as a function of u.

    `spread`, shape (2 l,): standard deviations of u's prior [-].
    `scales`: places of the scales in u.
    """

    def __init__(self, readings: Sequence[Readings]) -> None:
        self.readings, count = readings, len(readings)
        self.spread = np.repeat([NOISE_SD, EVEN_SD], count)
        self.scales = slice(0, count)
        self.free = np.array([True] * count + [one.serial for one in readings], dtype=bool)

    def told(self, u: np.ndarray) -> list[dict[str, Any]]:
        """The noise of each array, with its label. `u`, shape (2 l,): the noise [-]."""
        count = len(self.readings)
        return [
            {"readings": one.label, "scale": math.exp(u[i]), "correlation": math.tanh(u[count + i])}
            for i, one in enumerate(self.readings)
            if one.value.size
        ]

    def step_of(
        self,
        difference: np.ndarray,
        u: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The step to the noise that suits differences best, and the information that there is of it [-].

        `difference`, shape (m,): readings less predictions [SI].
        `u`, shape (2 l,): where to step from [-].
        `columns`, shape (m, k): derivatives with unknowns, standard normal a priori, that the prediction was fitted
            with: what they took up of the noise is allowed for [SI].
        `correlated`: whether correlations are set too.
        Returns `step`: to add to u [-]; `information`: with the prior's [-].
        """
        count, found = len(self.readings), u.copy()
        taken = np.zeros(count) if columns is None else self._taken_up(columns, u)
        information = self.spread**-2.0
        for i, (one, part) in enumerate(zip(self.readings, self.split(difference), strict=True)):
            white, best = one.white(part), math.inf
            n = white.size
            free = max(n - taken[i], 0.0)
            now = math.tanh(float(u[count + i]))
            for rho in CORRELATIONS if one.serial and correlated else (now,):
                square = float(np.sum(uncorrelated(white, float(rho)) ** 2))
                scale = _scale(square, free)
                cost = 0.5 * square * math.exp(-2.0 * scale) + free * scale + 0.5 * (scale / NOISE_SD) ** 2
                cost += 0.5 * max(n - 1, 0) * math.log(1.0 - rho * rho) + 0.5 * (math.atanh(rho) / EVEN_SD) ** 2
                if cost < best:
                    best, found[i], found[count + i] = cost, scale, math.atanh(rho)
            information[i] += 2.0 * free
            information[count + i] += n * (1.0 - math.tanh(float(found[count + i])) ** 2) if one.serial else 0.0
        return found - u, np.diag(information)

    def draw(self, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the readings [SI], shape (m,). `u`, shape (2 l,): the noise [-]."""
        drawn, count = [], len(self.readings)
        for i, one in enumerate(self.readings):
            rho, noise = math.tanh(float(u[count + i])), rng.standard_normal(one.value.size)
            if rho:
                new = math.sqrt(1.0 - rho * rho)
                for k in range(1, noise.size):
                    noise[k] = rho * noise[k - 1] + new * noise[k]
            noise = one.sd * noise if one.whitener is None else np.linalg.solve(one.whitener, noise)
            drawn.append(noise * math.exp(u[i]))
        return np.concatenate(drawn)

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        """A vector, or rows of a matrix, array by array. `values`, shape (m,) or (m, k): in any unit."""
        return np.split(values, ends(self.readings)[:-1])

    def _taken_up(self, columns: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Readings of each array that unknowns took up [-], shape (l,)."""
        white = Whitener(self.readings, u)
        parts = [white.of_array(i, part) for i, part in enumerate(self.split(columns))]
        A = np.eye(columns.shape[1]) + sum(part.T @ part for part in parts)
        inverse = np.linalg.inv(A)
        return np.array([float(np.sum((part @ inverse) * part)) for part in parts])


def ends(readings: Sequence[Readings]) -> np.ndarray:
    """Where each array ends in the vector of all [-]."""
    return np.cumsum([one.value.size for one in readings])


def _scale(square: float, free: float) -> float:
    """The logarithm of the most probable scale of so many readings with a sum of squares, by Newton's method."""
    u = 0.5 * math.log(max(square / max(free, 1.0), LEAST_SQUARE))
    for _ in range(NEWTON):
        slope = free - square * math.exp(-2.0 * u) + u / NOISE_SD**2
        step = slope / (2.0 * square * math.exp(-2.0 * u) + NOISE_SD**-2)
        u -= min(max(step, -LARGEST), LARGEST)
        if abs(step) < CLOSE:
            break
    return u
