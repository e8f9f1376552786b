"""The noise of a recording's readings: how large it is, and how much of it stays from one reading to the next.

Five numbers u set it, standard normal a priori once divided by `SPREAD`: the logarithms of the noise scales of
pressure, flow and speed, and the inverse hyperbolic tangents of two correlations, of a plateau with the one before it
in its file and of a sample of a run in time with the one before. A correlation falls as a power of the rows in between.
The gauge's noise moves flow and speed of a plateau together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtrs

from calibration.likelihood import compared
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.unknowns.priors import CHANNELS, NOISE_SD, Unknown, noise_scale
from configs.compiled import njit

CORRELATION_SD = 0.7  # of the inverse hyperbolic tangent: two in three lie within 0.6; of even correlations it is 0.9
SPREAD = np.array([NOISE_SD, NOISE_SD, NOISE_SD, CORRELATION_SD, CORRELATION_SD])
SCALES, ROWS, SAMPLES = slice(0, 3), 3, 4  # places in u
LOUDEST = 4.0  # prior sds of a noise's scale, a factor of 3.3; what needs more is no explanation
FEWEST = 16  # pairs of neighbours: fewer cannot tell a correlation from a misfit, and none is taken to be
LARGEST_STEP = 0.5
PROBE = 1e-3  # in u, for the curvature of what the samples say
LEAST_CURVATURE = 0.1  # of a sample's information

Slopes = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Whitener:
    """The map from differences of readings to standard normal numbers.

    `plateaus`, shape (2 n, 2 n): Cholesky factor of the covariance of the plateaus' flows, then speeds [SI].
    `follow`, shape (k,): what each sample of the runs takes over from the one before [-].
    `band`, shape (3, k): Cholesky factor of what is left of the samples then, in lower banded form [SI].
    `beside`, shape (v,): sd of what is read beside plateaus and runs: the gauge vented, the flow meter while the rotor
        stands [SI].
    `known`, shape (m,): entries that there are.
    """

    plateaus: np.ndarray
    follow: np.ndarray
    band: np.ndarray
    beside: np.ndarray
    known: np.ndarray

    def __call__(self, difference: np.ndarray) -> np.ndarray:
        """Whitened differences. `difference`, shape (m,) or (m, k): differences of readings [SI]."""
        rows = (slice(None), None) if difference.ndim > 1 else (slice(None),)
        given = np.where(self.known[rows], difference, 0.0)
        out = np.empty_like(given)
        first, end = len(self.plateaus), given.shape[0] - self.beside.size
        if first:
            solved, _ = dtrtrs(self.plateaus, given[:first], lower=True)
            out[:first] = solved.reshape(given[:first].shape)
        if end > first:
            out[first:end] = _forward(self.follow, self.band, given[first:end])
        out[end:] = given[end:] / self.beside[rows]
        return out

    @property
    def scale(self) -> np.ndarray:
        """sd of each reading given those before it [SI], shape (m,); 1 where there is none."""
        return np.concatenate([np.diag(self.plateaus), self.band[0], self.beside])

    @property
    def log_scale(self) -> float:
        """Sum of the logarithms of the sds, without those beside plateaus and runs, which are declared [-]."""
        return float(np.log(np.diag(self.plateaus)).sum() + np.log(self.band[0]).sum())


class Noise(compared.Noise):
    """The noise of a recording as a function of u.

    `known`, shape (m,): readings that there are: plateaus' flows, their speeds, samples, readings beside them.
    `step`, shape (k,): time over which each sample is a mean [s].
    `apart`, shape (k,): samples that do not begin where the one before ends.
    `free`, shape (5,): places of u that the recording can speak of; the correlations are 0 where it is too short.
    `spread`, shape (5,): standard deviations of u's prior [-].
    `scales`: places of the scales in u.
    """

    spread, scales = SPREAD, SCALES

    def __init__(
        self, problem: Problem, known: np.ndarray, sizes: tuple[int, ...], step: np.ndarray, apart: np.ndarray
    ) -> None:
        plateaus = problem.blocks.plateaus
        self.known, self.n, self.step = known, plateaus.size, step
        self.declared = np.array([problem.noise[c] for c in CHANNELS])
        self.rounding = np.array([problem.resolution[c] for c in CHANNELS]) ** 2 / 12.0
        lines = [run.line.sd for run in problem.blocks.runs]
        self.beside = np.concatenate([problem.blocks.vented.sd, problem.blocks.standing.sd, *lines])
        self.row_scale, self.parted = plateaus.noise_scale, np.zeros(self.n, dtype=bool)
        files = np.array([list(dict.fromkeys(plateaus.file)).index(file) for file in plateaus.file], dtype=int)
        between = np.abs(plateaus.row[:, None] - plateaus.row[None, :])
        self.apart = np.where(files[:, None] == files[None, :], between, -1)
        self.steps = np.arange(int(self.apart.max(initial=0)) + 1)
        self._last_alike: tuple[float, np.ndarray] | None = None
        enough = (int(np.sum(self.apart == 1)) // 2 >= FEWEST, step.size >= FEWEST)
        self.free = np.array([True, True, True, *enough])
        scales = [run.noise_scale[run.used] for run in problem.blocks.runs]
        self.sample_scale = np.concatenate(scales or [np.zeros(0)])
        self.first = apart.copy()
        if step.size:
            self.first[np.cumsum([0, *sizes[:-1]])] = True

    def scale_unknowns(self) -> list[Unknown]:
        """What the first numbers of u stand for: u is the prior's sd times the standard normal number of each."""
        why = "a declared noise figure is uncertain by a factor 1.35"
        return [noise_scale(channel, why) for channel in CHANNELS]

    def too_loud(self, u: np.ndarray) -> tuple[str, float] | None:
        """The loudest channel and its noise in declared ones [-], where that is not believable; None where it is.

        `u`, shape (5,): the noise [-].
        """
        i = int(np.argmax(u[SCALES]))
        return (CHANNELS[i], math.exp(u[i])) if u[i] > LOUDEST * NOISE_SD else None

    def leave_alone(self, rows: np.ndarray, in_one: np.ndarray) -> None:
        """Take the noise of some plateaus for their own: of a misread row its neighbours know nothing.

        `rows`, shape (n,): the plateaus.
        `in_one`, shape (n,): those of which one reading is misread: of it the other knows nothing either.
        """
        self.parted = self.parted | in_one
        apart = (rows[:, None] | rows) & ~np.eye(self.n, dtype=bool)
        self.apart = np.where(apart, -1, self.apart)
        self._last_alike = None

    def whitener(self, u: np.ndarray, slopes: Slopes, angle: np.ndarray) -> Whitener:
        """The map to standard normal numbers.

        `u`, shape (5,): the noise [-].
        `slopes`, shape (n,): of flow and speed with pressure, at the plateaus [SI].
        `angle`, shape (k,): to what the shaft's angle is known at each sample [rad].
        """
        alike, factor, rest = self._plateaus(u, slopes, self.known)
        root = np.linalg.cholesky(alike * (factor @ factor.T) + rest)
        return Whitener(root, *self._samples(u, angle), self.beside, self.known)

    def step_of(
        self,
        difference: np.ndarray,
        u: np.ndarray,
        slopes: Slopes,
        angle: np.ndarray,
        weight: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """One scoring step of u for given differences, and the information that there is of u [-].

        `difference`, shape (m,): readings less predictions [SI].
        `u`, shape (5,): where to step from [-].
        `slopes`, shape (n,): of flow and speed with pressure, at the plateaus [SI].
        `angle`, shape (k,): to what the shaft's angle is known at each sample [rad].
        `weight`, shape (m,): of each entry, below 1 where a reading is bad [-].
        `columns`, shape (m, l): derivatives with unknowns, standard normal a priori, to which the differences were
            fitted; what that fit took up of the plateaus' noise is allowed for [SI].
        Returns `step`: to add to u [-]; `information`: with the prior's; of what the samples say of a correlation that
        is not stepped, nothing [-].
        """

        def scored(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            slope, information = -at / SPREAD**2, np.diag(SPREAD**-2.0)
            for add in (
                self._of_plateaus(difference, at, slopes, angle, weight > 0.5, columns),
                self._of_samples(difference, at, angle, weight, correlated),
            ):
                slope, information = slope + add[0], information + add[1]
            step = np.zeros(at.size)
            places = np.flatnonzero(self.free) if correlated else np.arange(SCALES.stop)
            found = np.linalg.solve(information[np.ix_(places, places)], slope[places])
            step[places] = np.clip(found, -LARGEST_STEP, LARGEST_STEP)
            step[SAMPLES] = max(step[SAMPLES], -at[SAMPLES])  # what neighbours take back is in the angle's part
            return step, information

        if u[2] < 0.0 and self.step.size:
            # Samples are no quieter than declared: what they say of louder noise is seen from there alone.
            declared = u.copy()
            declared[2] = PROBE
            step, information = scored(declared)
            if step[2] > 0.0:
                return step + declared - u, information
        return scored(u)

    def draw_plateaus(self, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the plateaus' pressures, flows and speeds, rounding apart [SI], shape (3, n).

        `u`, shape (5,): the noise [-].
        """
        factor = np.linalg.cholesky(self._alike(u)) if self.n else np.zeros((0, 0))
        sd = self.declared * np.exp(u[SCALES])
        return sd[:, None] * self.row_scale * (rng.standard_normal((3, self.n)) @ factor.T)

    def draw_samples(self, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the samples of the runs, pulses and rounding apart [SI], shape (k,).

        `u`, shape (5,): the noise [-].
        """
        rho, drawn = math.tanh(u[SAMPLES]), rng.standard_normal(self.step.size)
        new = math.sqrt(1.0 - rho * rho)
        for i in np.flatnonzero(~self.first):
            drawn[i] = rho * drawn[i - 1] + new * drawn[i]
        return self._of_samples_sd(u) * drawn

    def _of_samples_sd(self, u: np.ndarray) -> np.ndarray:
        """Noise of the samples [SI], shape (k,): at least what is declared.

        Little scatter from one to the next says nothing of what they have in common.
        """
        return self.declared[2] * math.exp(max(u[2], 0.0)) * self.sample_scale

    def _alike(self, u: np.ndarray) -> np.ndarray:
        """Correlation of the plateaus' noise, shape (n, n); the last one is kept, as most steps are of scales."""
        kept = self._last_alike
        if kept is None or kept[0] != u[ROWS]:
            kept = float(u[ROWS]), self._by_steps(np.power(math.tanh(u[ROWS]), self.steps))
            self._last_alike = kept
        return kept[1]

    def _by_steps(self, values: np.ndarray) -> np.ndarray:
        """What hangs on the rows in between alone, for each pair of plateaus, shape (n, n); 0 where none are."""
        return np.append(values, 0.0)[self.apart]

    def _plateaus(self, u: np.ndarray, slopes: Slopes, known: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What makes the plateaus' covariance: the correlation of rows, shape (2 n, 2 n); what one sd of the noise of
        pressure, flow and speed does, shape (2 n, 3); what comes on top, row by row, shape (2 n, 2 n)."""
        n, (a, b) = self.n, slopes
        known = known[: 2 * n]
        factor = np.zeros((2 * n, 3))
        factor[:n, 0], factor[n:, 0], factor[:n, 1], factor[n:, 2] = a, b, 1.0, 1.0
        factor *= self.declared * np.exp(u[SCALES])
        factor *= (known * np.concatenate([self.row_scale, self.row_scale]))[:, None]
        p, q, w = self.rounding
        rest = np.diag(np.where(known, np.concatenate([q + p * a * a, w + p * b * b]), 1.0))
        rows = np.arange(n)
        together = known[:n] & known[n:] & ~self.parted
        rest[rows, n + rows] = rest[n + rows, rows] = np.where(together, p * a * b, 0.0)
        alike, parted = np.tile(self._alike(u), (2, 2)), np.flatnonzero(self.parted)
        alike[parted, n + parted] = alike[n + parted, parted] = 0.0
        return alike, factor, rest

    def _of_plateaus(
        self,
        difference: np.ndarray,
        u: np.ndarray,
        slopes: Slopes,
        angle: np.ndarray,
        good: np.ndarray,
        columns: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slope of the plateaus' log likelihood with u, and their expected information (Fisher scoring)."""
        m, known = 2 * self.n, self.known & good
        slope, information = np.zeros(u.size), np.zeros((u.size, u.size))
        if not m:
            return slope, information
        alike, factor, rest = self._plateaus(u, slopes, known)
        whole = factor @ factor.T
        inverse = np.linalg.inv(alike * whole + rest)
        y = inverse @ np.where(known[:m], difference[:m], 0.0)
        if columns is not None:  # restricted likelihood: less what the fit took up
            behind = Whitener(np.zeros((0, 0)), *self._samples(u, angle), self.beside, self.known[m:])
            X = behind(columns[m:])
            Y = np.where(known[:m, None], columns[:m], 0.0)
            W = inverse @ Y
            inverse = inverse - W @ np.linalg.solve(X.T @ X + Y.T @ W + np.eye(X.shape[1]), W.T)
        rho, before = math.tanh(u[ROWS]), np.maximum(self.steps - 1, 0)
        grows = self._by_steps(self.steps * np.power(rho, before) * (1.0 - rho * rho))
        parts = factor.T
        change = np.empty((4, m, m))
        change[:3] = 2.0 * alike * (parts[:, :, None] * parts[:, None, :])
        change[3] = np.tile(grows, (2, 2)) * whole
        product = inverse @ change
        flat, turned = product.reshape(4, -1), product.transpose(0, 2, 1).reshape(4, -1)
        slope[:4] = 0.5 * (change @ y @ y - np.trace(product, axis1=1, axis2=2))
        information[:4, :4] = 0.5 * (flat @ turned.T)
        return slope, information

    def _samples(self, u: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What each sample of the runs takes over from the one before, and the factor of the rest, in banded form."""
        if not self.step.size:
            return np.zeros(0), np.zeros((3, 0))
        share = np.where(self.first, 0.0, math.tanh(u[SAMPLES]))
        follow, band = _factored(self._of_samples_sd(u), share, self.step, self.first, angle, self.rounding[2])
        if not np.isfinite(band[0]).all():
            raise np.linalg.LinAlgError("the samples' covariance is not positive definite")
        return follow, band

    def _of_samples(
        self, difference: np.ndarray, u: np.ndarray, angle: np.ndarray, weight: np.ndarray, correlated: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """Slope of the samples' log likelihood with their scale, and correlation if that is stepped, and its curvature.

        By differences.
        """
        slope, information = np.zeros(u.size), np.zeros((u.size, u.size))
        k = self.step.size
        if not k:
            return slope, information
        mine = slice(2 * self.n, 2 * self.n + k)
        w, given = weight[mine], difference[mine]

        def log_likelihood(scale: float, correlation: float) -> float:
            moved = u.copy()
            moved[2] += scale * PROBE
            moved[SAMPLES] += correlation * PROBE
            follow, band = self._samples(moved, angle)
            r = _forward(follow, band, given)
            return -float(np.sum(w * (0.5 * r * r + np.log(band[0]))))

        here = log_likelihood(0, 0)
        least = LEAST_CURVATURE * float(w.sum())
        ways = [(2, (1, 0))] if u[2] >= 0.0 else []
        ways += [(SAMPLES, (0, 1))] if correlated else []
        for place, (scale, correlation) in ways:
            right, left = log_likelihood(scale, correlation), log_likelihood(-scale, -correlation)
            slope[place] = (right - left) / (2.0 * PROBE)
            information[place, place] = max((2.0 * here - right - left) / PROBE**2, least)
        return slope, information


@njit(error_model="numpy", cache=True, nogil=True)
def _factored(
    sd: np.ndarray, share: np.ndarray, step: np.ndarray, first: np.ndarray, angle: np.ndarray, rounding: float
) -> tuple[np.ndarray, np.ndarray]:
    """What samples take over from those before, shape (k,), and the Cholesky factor of the rest, shape (3, k).

    Rounding, and the angle that a sample shares with the next, are a band, which following the noise widens by one.

    `sd`, shape (k,): of the noise of each [SI].
    `share`, shape (k,): of it that stays from the one before [-].
    `step`, `first`, `angle`: as in `Noise`.
    `rounding`: variance [SI].
    """
    k = sd.size
    follow, shared, own, band = np.zeros(k), np.zeros(k), np.empty(k), np.zeros((3, k))
    for i in range(k):  # those at i - 1 of the first are the last's: there the shares are 0
        now, last = angle[i] / step[i], angle[i if first[i] else i - 1] / step[i]
        own[i] = rounding + now * now + last * last
        if not first[i]:
            shared[i] = -angle[i - 1] * angle[i - 1] / (step[i] * step[i - 1])
        follow[i] = share[i] * sd[i] / max(sd[i - 1], 1e-30)
    for i in range(k):
        band[0, i] = sd[i] * sd[i] * (1.0 - share[i] * share[i]) + own[i]
        band[0, i] += follow[i] * follow[i] * own[i - 1] - 2.0 * follow[i] * shared[i]
        if i + 1 < k:
            band[1, i] = shared[i + 1] - follow[i + 1] * own[i] + follow[i + 1] * follow[i] * shared[i]
        if i + 2 < k:
            band[2, i] = -follow[i + 2] * shared[i + 1]
    for i in range(k):
        for back in range(1, min(i, 2) + 1):
            before = band[back, i - back]
            band[0, i] -= before * before
            if back == 1:
                band[1, i] -= band[2, i - 1] * before
        band[0, i] = np.sqrt(band[0, i])
        band[1, i] /= band[0, i]
        band[2, i] /= band[0, i]
    return follow, band


@njit(cache=True, nogil=True)
def _solved(follow: np.ndarray, band: np.ndarray, given: np.ndarray) -> np.ndarray:
    out = np.empty_like(given)
    for i in range(given.shape[0]):
        for c in range(given.shape[1]):
            left = given[i, c]
            if i > 0:
                left -= follow[i] * given[i - 1, c] + band[1, i - 1] * out[i - 1, c]
            if i > 1:
                left -= band[2, i - 2] * out[i - 2, c]
            out[i, c] = left / band[0, i]
    return out


def _forward(follow: np.ndarray, band: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Samples less what they take over from those before, through a factor in banded form."""
    columns = np.ascontiguousarray(given).reshape(given.shape[0], -1)
    return np.asarray(_solved(follow, band, columns)).reshape(given.shape)
