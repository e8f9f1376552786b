"""The noise of the readings in the test for a mismatch: estimated beside everything that may be missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from calibration.likelihood.compared import Compared
    from calibration.likelihood.mode import Mode

PASSES = 3
LOUDNESS_PASSES = 8  # until the scales of the drawn noise stand still
CORRELATION_PASSES = 3  # of the correlations, from those of the law


class NoiseTest:
    """Estimates of the noise from differences of readings.

    `every`, shape (m, k): what the unknowns, the effects and the free forces do to the readings, standard normal
        numbers all [SI].
    `good`, shape (m,): 1, or 0 where a reading is bad [-].
    """

    def __init__(self, comparison: Compared, mode: Mode, every: np.ndarray, good: np.ndarray) -> None:
        self.comparison, self.mode, self.every, self.good = comparison, mode, every, good
        self.scales = comparison.noise.scales
        self.correlated = bool(np.any(comparison.noise.free[self.scales.stop :]))

    def of(self, difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The noise of differences that is correlated as given, its scales beside all forces [-], shape (k,).

        `difference`, shape (m,): readings less predictions [SI].
        `noise`, shape (k,): for its correlations [-].
        """
        u = self._of_declared_size(noise)
        for _ in range(PASSES):
            left = difference - self.every @ self._fit(self.every, difference, u)
            u[self.scales] += self.comparison.noise_step(left, self.mode.prediction, u, self.good)[0][self.scales]
        return u

    def of_a_draw(self, difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """A draw's noise as the search for a mode finds it; beside the forces correlations would be anyone's guess.

        `difference`, shape (m,): drawn [SI].
        `noise`, shape (k,): that it was drawn about [-].
        """
        u = noise
        if self.correlated:
            for _ in range(CORRELATION_PASSES):
                left = difference - self.mode.D @ self._fit(self.mode.D, difference, u)
                u = u + self.comparison.noise_step(left, self.mode.prediction, u, self.good, self.mode.D)[0]
        return self.of(difference, u)

    def law(self, difference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and spread of the noise that the law is drawn with [-], shape (k,) each.

        Its scales are those beside all forces, what they take up of it allowed for. A scale's law is skew: its
        logarithm's mean lies above the most probable one by the variance, as that of a chi-squared's does.

        `difference`, shape (m,): readings less predictions [SI].
        """
        u, mode = self._of_declared_size(self.mode.u), self.mode
        for _ in range(LOUDNESS_PASSES):
            left = difference - self.every @ self._fit(self.every, difference, u)
            u[self.scales] += self.comparison.noise_step(left, mode.prediction, u, self.good, self.every)[0][
                self.scales
            ]
        left = difference - self.every @ self._fit(self.every, difference, u)
        of_scales = self.comparison.noise_step(left, mode.prediction, u, self.good, self.every)[1]
        left = difference - mode.D @ mode.z
        of_correlations = self.comparison.noise_step(left, mode.prediction, mode.u, self.good, mode.D)[1]
        information = np.concatenate([np.diag(of_scales)[self.scales], np.diag(of_correlations)[self.scales.stop :]])
        spread = np.where(self.comparison.noise.free, 1.0 / np.sqrt(information), 0.0)
        u[self.scales] += spread[self.scales] ** 2
        return u, spread

    def _fit(self, columns: np.ndarray, difference: np.ndarray, u: np.ndarray) -> np.ndarray:
        white = self.comparison.whitener(self.mode.prediction, u)
        X, y = white(columns) * self.good[:, None], white(difference) * self.good
        return np.linalg.solve(X.T @ X + np.eye(X.shape[1]), X.T @ y)

    def _of_declared_size(self, u: np.ndarray) -> np.ndarray:
        """A noise with its scales as declared and its own correlations."""
        return np.where(np.arange(u.size) < self.scales.stop, 0.0, u)
