"""The posterior of a model of a sweep, as a diagnosis has it, in coordinates in which it can be sampled.

It is exp(-`minus_log_posterior`) over every unknown, the noise scales among them, within the effects' bounds, with the
longer tails that the prior of an effect's size has (`calibration.likelihood.tails`). The
coordinates v are about a mode: its covariance makes them of about unit size, and f_overall follows the curved valley of
equal speed, a shear whose volume is 1.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, minus_log_posterior
from calibration.likelihood.tails import log_ratio
from calibration.studies.evidence_reference import NOWHERE
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Prediction, Problem
from rig.recording import Recording

NOISE_STEP = 0.02  # of a noise scale's logarithm, for second derivatives
TANGENT_STEP = 0.02  # of a standard normal unknown
VALLEY_ROWS = 3  # plateaus by which f_overall is set
WIDTH, VALLEY_WIDTH = 1.0, 3.0  # to begin with, in sds of the mode's covariance: of any unknown, and across the valley


class Target:
    """The posterior of a model in coordinates about its mode.

    `size`: number of coordinates: the unknowns, then the noise scales [-].
    `width`, shape (size,): about which to look for the posterior, in each [-].
    `noise_log_volume`: what Laplace's approximation over the noise scales adds to a log evidence that holds them fixed
        [-]; None where the mode is no maximum in them.
    """

    def __init__(self, comparison: Comparison, mode: Mode) -> None:
        self.comparison, self.mode = comparison, mode
        self._f = Function(comparison, mode.names)
        members = comparison.problem.effect_unknowns(mode.names)
        self._sizes = np.array([one.kind == "normal" for _, one in members], dtype=bool)  # the rest is of the shape
        self._valley, self._sweep = _Valley(comparison, mode), _Sweep(comparison, mode, self._f)
        m, s = mode.z.size, self._valley.place
        self._order = np.array([*(i for i in range(m) if i != s), s])
        self._root = np.linalg.cholesky(mode.covariance[np.ix_(self._order, self._order)])
        noise = self._noise_hessian()
        value, vector = np.linalg.eigh(noise)
        self.noise_log_volume = None
        if np.all(value > 0.0):
            self.noise_log_volume = 0.5 * (value.size * math.log(2.0 * math.pi) - float(np.sum(np.log(value))))
        self._noise_root = vector / np.sqrt(np.maximum(value, 1.0))
        self.size = m + mode.u.size
        self.width = np.full(self.size, WIDTH)
        self.width[m - 1] = VALLEY_WIDTH
        self.calls = 0
        low, high = self._f.low[self._f.k :], self._f.high[self._f.k :]
        low, high = (np.where(self._sizes, np.arcsinh(x), x) for x in (low, high))
        allowed = np.sum(np.log(ndtr(high) - ndtr(low)))  # the effects' priors are cut at their bounds
        self._constant = -0.5 * m * math.log(2.0 * math.pi) - float(allowed)
        self._constant += float(np.sum(np.log(np.diag(self._root)))) + float(np.linalg.slogdet(self._noise_root)[1])

    def __call__(self, v: np.ndarray) -> float:
        """Log of likelihood times prior per unit of v; `NOWHERE` where there is no such model [-].

        `v`, shape (size,): coordinates [-].
        """
        z = self._unknowns(v)
        if z is None:
            return NOWHERE
        self.calls += 1
        return self._constant - self._cost(self._sweep(z), z, self.mode.u + self._noise_root @ v[z.size :])

    def _unknowns(self, v: np.ndarray) -> np.ndarray | None:
        """z at a place; None outside the bounds."""
        z = self.mode.z.copy()
        z[self._order] += self._root @ v[: z.size]
        inside = (z >= self._f.low - 1e-12) & (z <= self._f.high + 1e-12)
        inside[self._valley.place] = True
        if not inside.all():
            return None
        z[self._valley.place] += self._valley(z)
        return z if abs(z[self._valley.place]) <= self._f.high[self._valley.place] else None

    def _cost(self, predicted: Prediction, z: np.ndarray, u: np.ndarray) -> float:
        raw, comparison = self.comparison.raw(predicted), self.comparison
        if not np.all(np.isfinite(raw[comparison.known])):
            return -NOWHERE
        white = comparison.whitener(predicted, u)
        longer = float(np.sum(log_ratio(z[self._f.k :][self._sizes])))
        return minus_log_posterior(white(comparison.read - raw), white.log_scale, z, u, comparison) - longer

    def _noise_hessian(self) -> np.ndarray:
        """Second derivatives of the cost with the noise scales, by differences."""
        mode, n = self.mode, self.mode.u.size
        step = NOISE_STEP * np.eye(n)
        found = np.empty((n, n))
        for i in range(n):
            for j in range(n):
                around = [(a * b, a * step[i] + b * step[j]) for a in (1, -1) for b in (1, -1)]
                costs = [sign * self._cost(mode.prediction, mode.z, mode.u + by) for sign, by in around]
                found[i, j] = sum(costs) / (4.0 * NOISE_STEP**2)
        return found


class _Sweep:
    """Predictions of a sweep that goes through each level once for all its visits, where time makes no difference."""

    def __init__(self, comparison: Comparison, mode: Mode, f: Function) -> None:
        self._f, self._names = f, mode.names
        plateaus = comparison.problem.blocks.plateaus
        _, first, self._visit = np.unique(plateaus.pressure, return_index=True, return_inverse=True)
        moved = f.clip(np.where(np.arange(mode.z.size) < f.k, mode.z, mode.z + 0.5))
        there = f(moved)
        same = all(np.array_equal(x, x[first][self._visit]) for x in (there.flow, there.speed, there.speed_slope))
        self._once = Problem(part_of(comparison.problem.recording, first)) if same else None

    def __call__(self, z: np.ndarray) -> Prediction:
        if self._once is None:
            return self._f(z)
        found = self._once.predict(z[: self._f.k], self._once.chosen(self._names, z[self._f.k :]))
        at = self._visit
        flow, speed, a, b = (x[at] for x in (found.flow, found.speed, found.flow_slope, found.speed_slope))
        return replace(found, flow=flow, speed=speed, flow_slope=a, speed_slope=b)


class _Valley:
    """How far f_overall has to move off a straight line for the speed to stay, as a function of all other unknowns.

    A few plateaus are enough: whatever the function, the shear by it has volume 1.
    """

    def __init__(self, comparison: Comparison, mode: Mode) -> None:
        problem, n = comparison.problem, comparison.n
        self.place = next(i for i, unknown in enumerate(problem.nuisances) if unknown.name == "f_overall")
        self._friction, self._mode, self._k = problem.nuisances[self.place], mode, len(problem.nuisances)
        rows = np.flatnonzero(comparison.known[n : 2 * n] & (mode.prediction.speed > 0.0))
        rows = rows[np.argsort(problem.blocks.plateaus.pressure[rows], kind="stable")]
        rows = np.sort(rows[np.linspace(rows.size // 4, rows.size - 1, VALLEY_ROWS).astype(int)])
        self._few = Problem(part_of(problem.recording, rows))
        self._weight = mode.J[n : 2 * n, self.place][rows] ** 2
        self._reference = self._speeds(mode.z)
        self._tangent = np.zeros(mode.z.size)
        high = Function(comparison, mode.names).high
        for i in range(mode.z.size):
            if i != self.place:
                moved = mode.z.copy()
                moved[i] += TANGENT_STEP if moved[i] + TANGENT_STEP <= high[i] else -TANGENT_STEP
                self._tangent[i] = self._to_valley(moved) / (moved[i] - mode.z[i])

    def __call__(self, z: np.ndarray) -> float:
        move = z - self._mode.z
        move[self.place] = 0.0
        return self._to_valley(z) - float(self._tangent @ move)

    def _to_valley(self, z: np.ndarray) -> float:
        """From the mode's f_overall to that at which the speeds are about the mode's, whatever f_overall is in z."""
        z = z.copy()
        start = z[self.place] = self._mode.z[self.place]
        speed = self._speeds(z)
        turns = np.isfinite(speed) & (speed > 0.0)
        if not turns.any():
            return 0.0
        gain = np.average(np.log(speed[turns] / self._reference[turns]), weights=self._weight[turns])
        found = self._friction.z(float(self._friction.value(start)) * math.exp(float(gain)))
        return float(found - start) if np.isfinite(found) else 0.0

    def _speeds(self, z: np.ndarray) -> np.ndarray:
        return self._few.predict(z[: self._k], self._few.chosen(self._mode.names, z[self._k :])).speed


def part_of(recording: Recording, rows: np.ndarray) -> Recording:
    """A recording of one sweep with some of its rows. `rows`, shape (n,): which [-]."""
    file = recording.files[0]
    columns = {
        name: replace(one, values=one.values[rows], censor=one.censor[rows]) for name, one in file.columns.items()
    }
    direction = None if file.direction is None else file.direction[rows]
    return replace(recording, files=(replace(file, rows=rows.size, columns=columns, direction=direction),))
