"""The noise of a machine's readings in the test for a mismatch, by restricted likelihood.

The noise of foreign data is neither as large as declared nor white. So scale and correlation of each array are
estimated beside the unknowns and the strongest directions of everything that may be missing, that a misfit may not pass
for noise; the law is drawn with the noise that was found, and for each draw it is estimated anew.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.systems.machines.noise import CORRELATIONS, ends, uncorrelated
from calibration.systems.machines.readings import Readings
from calibration.unknowns.priors import NOISE_SD

SHARE, SERIAL_SHARE = 4, 10  # readings for each direction that the noise is estimated beside; in time more are needed
SMALL = 1e-9


class NoiseTest:
    """Estimates of the noise from differences of readings.

    `every`, shape (m, k): what the unknowns, the effects and the free forces do to the readings, those of the mode
        first [SI].
    """

    def __init__(self, readings: Sequence[Readings], mode: Mode, every: np.ndarray) -> None:
        self.readings = readings
        self._ends = ends(readings)[:-1]
        own = np.any(mode.D != 0.0, axis=0)
        parts = np.split(every, self._ends)
        k = int(own.sum())  # columns of nothing but zeros were left out of what may be missing
        self._arrays = [_Array(one, one.white(part), k) for one, part in zip(readings, parts, strict=True)]

    def of(self, difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The noise of differences, beside everything that may be missing [-], shape (2 l,).

        `difference`, shape (m,): readings less predictions [SI].
        `noise`, shape (2 l,): not looked at.
        """
        parts = np.split(difference, self._ends)
        both = [
            array.noise(one.white(part)) for one, array, part in zip(self.readings, self._arrays, parts, strict=True)
        ]
        return np.array([*(scale for scale, _ in both), *(rho for _, rho in both)])

    def of_a_draw(self, difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The noise of drawn differences, found as that of the readings is [-], shape (2 l,).

        `difference`, shape (m,): drawn [SI].
        `noise`, shape (2 l,): not looked at.
        """
        return self.of(difference, noise)

    def law(self, difference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The noise that the law is drawn with [-], and that it has no spread, shape (2 l,) each.

        `difference`, shape (m,): readings less predictions [SI].
        """
        u = self.of(difference, difference)
        return u, np.zeros(u.size)


class _Array:
    """One array of readings, and the directions beside which its noise is estimated.

    `every`, shape (n, k): in units of the declared noise [-].
    `own`: the first so many columns are the mode's: all their directions count.
    """

    def __init__(self, readings: Readings, every: np.ndarray, own: int) -> None:
        n = every.shape[0]
        if not n:
            return
        self.rhos = CORRELATIONS if readings.serial else np.zeros(1)
        basis = _span(every[:, :own], np.zeros((n, 0)), n)
        room = max(n // (SERIAL_SHARE if readings.serial else SHARE) - basis.shape[1], 0)
        basis = np.column_stack([basis, _span(every[:, own:], basis, room)])
        self.free = max(n - basis.shape[1], 1)
        self.Q, self.cost = [], []
        for rho in self.rhos:
            Q, R = np.linalg.qr(uncorrelated(basis, float(rho)))
            self.Q.append(Q)
            log_det = float(np.sum(np.log(np.maximum(np.abs(np.diag(R)), 1e-300))))
            self.cost.append(0.5 * max(n - 1, 0) * math.log(1.0 - rho * rho) + log_det)

    def noise(self, white: np.ndarray) -> tuple[float, float]:
        """Logarithm of the scale, and the inverse hyperbolic tangent of the correlation [-].

        `white`, shape (n,): differences in units of the declared noise [-].
        """
        if not white.size:
            return 0.0, 0.0
        best, found = math.inf, (0.0, 0.0)
        for k, rho in enumerate(self.rhos):
            one = uncorrelated(white, float(rho))
            rest = float(one @ one) - float(np.sum((self.Q[k].T @ one) ** 2))
            u = 0.5 * math.log(max(rest, SMALL) / self.free)
            cost = self.free * u + self.cost[k]
            if cost < best:
                best = cost
                found = (u * 2.0 * self.free / (2.0 * self.free + NOISE_SD**-2), math.atanh(float(rho)))
        return found


def _span(columns: np.ndarray, beside: np.ndarray, most: int) -> np.ndarray:
    """Orthonormal directions of some columns that others do not have, the strongest first."""
    rest = columns - beside @ (beside.T @ columns)
    rest = rest - beside @ (beside.T @ rest)
    norm = np.linalg.norm(rest, axis=0)
    keep = norm > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), SMALL)
    if not keep.any() or most <= 0:
        return np.zeros((columns.shape[0], 0))
    U, s, _ = np.linalg.svd(rest[:, keep] / norm[keep], full_matrices=False)
    return np.asarray(U[:, : min(most, int(np.sum(s > 1e-5 * s[0])))])
