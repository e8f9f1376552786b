"""Step 2: whether anything is missing. Its p-value is uniform where nothing is.

The statistic is the smallest tail probability over the projected signatures of all effects (one-sided where an effect
cannot be negative) and over the free-form forces. The noise scales are estimated beside all of these, so that a misfit
does not pass for noise; its correlations are those that suit the base model. The law under the null is drawn:
nuisances, noise, its scales and its correlations anew each time, in the model made linear at its most probable point.
The scales drawn are as probable as what all forces leave over makes them, by the restricted likelihood: drawn anew from
their prior they make the law that of recordings louder than this one, and the test too careful. What the test takes
from a recording it takes from each draw. So a loudness that is not believable is a mismatch of its own: something that
no force is fine enough to follow. So is a nuisance pulled farther than its prior believes: what can take up a whole
misfit leaves nothing to see. The rarest share of the law is taken as exponential; what lies beyond all draws is marked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, log_ndtr, ndtr

from calibration.diagnosis.linear_model.forces import Force
from calibration.diagnosis.linear_model.signatures import Signature, project
from calibration.likelihood.linear import Comparison
from calibration.likelihood.linearized import FREE, GOOD
from calibration.likelihood.mode import Mode
from calibration.likelihood.noise import NOISE_SD, SCALES, SPREAD, too_loud

DRAWS = 200
TAIL = 0.15  # share of the draws that the exponential tail is fitted to
MISMATCH_P = 0.01  # below it something is missing
PASSES = 3
LOUDNESS_PASSES = 8  # until the scales of the drawn noise stand still
CORRELATION_PASSES = 3  # of the correlations, from those of the law


@dataclass(frozen=True)
class Detection:
    """Whether anything is missing.

    Attributes
    ----------
    u : ndarray, shape (5,)
        The noise, its scales with all forces taken out [-].
    pulled : str
        The nuisance that is pulled farther than can be believed; empty where none is.
    """

    p_value: float
    extrapolated: bool
    statistic: float
    u: np.ndarray
    scores: np.ndarray
    force_log_p: np.ndarray
    force_scores: list[np.ndarray]
    pulled: str = ""


def detect(
    comparison: Comparison,
    mode: Mode,
    found: Sequence[Signature],
    free: Sequence[Force],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Detection:
    """Test a mode."""
    difference = np.nan_to_num(comparison.read - comparison.raw(mode.prediction) + mode.D @ mode.z)
    test = _Test(comparison, mode, found, free)
    real = test(difference, mode.u)
    noise, spread = test.noise(difference)
    null = np.empty(draws)
    for i in range(draws):
        u = noise + spread * rng.standard_normal(noise.size)
        drawn = _draw(comparison, mode, u, rng)
        null[i] = test(drawn, test.correlations(drawn, noise)).statistic
    p, beyond = rarity(real.statistic, null)
    # Beside the forces, or where they take nothing up: either way that noise is not believable.
    if (loud := too_loud(np.maximum(real.u, mode.u))) is not None:
        believed = SCALES.stop * float(ndtr(-math.log(loud[1]) / NOISE_SD))
        p, beyond = min(p, believed), beyond or believed < p
    name, believed = _pull(comparison, mode)
    if pulled := name if believed < MISMATCH_P else "":
        p, beyond = min(p, believed), beyond or believed < p
    return replace(real, p_value=max(p, 1e-300), extrapolated=beyond, pulled=pulled)


def rarity(statistic: float, null: np.ndarray) -> tuple[float, bool]:
    """How often chance gives a statistic as large [-], and whether that lies beyond the draws of its law.

    Parameters
    ----------
    null : ndarray, shape (n,)
        Draws of it where nothing is missing [-].
    """
    null = np.sort(null)
    above = int(np.sum(null >= statistic))
    cut = null[int((1.0 - TAIL) * null.size)]
    if statistic <= cut:
        return (above + 0.5) / (null.size + 1.0), False
    scale = max(float(np.mean(null[null > cut] - cut)), 0.5)
    return TAIL * math.exp(-(statistic - cut) / scale), above == 0


def _pull(comparison: Comparison, mode: Mode) -> tuple[str, float]:
    """The nuisance farthest from its prior's middle, and a bound on how often one of them is as far [-].

    When a valve was moved, and what its line then did, are each run's own: however odd, they are no physics left out.
    """
    shared = np.array([comparison.problem.run_of(i) is None for i in range(len(comparison.problem.nuisances))])
    z = np.where(shared, np.abs(mode.z[: shared.size]), 0.0)
    farthest = int(np.argmax(z))
    return comparison.problem.nuisances[farthest].name, float(min(1.0, z.size * 2.0 * ndtr(-z[farthest])))


class _Test:
    def __init__(
        self,
        comparison: Comparison,
        mode: Mode,
        found: Sequence[Signature],
        free: Sequence[Force],
    ) -> None:
        self.comparison, self.mode = comparison, mode
        good = mode.bad < GOOD
        self.good = good.astype(float)
        self.S = np.column_stack([s.column for s in found]) if found else np.zeros((good.size, 0))
        self.one_sided = np.array([s.one_sided for s in found], dtype=bool)
        self.free = [f.columns for f in free]
        F = np.column_stack(self.free) if free else np.zeros((good.size, 0))
        white = comparison.whitener(mode.prediction, mode.u)
        size = np.maximum(np.linalg.norm(white(F), axis=0), 1e-12)
        self.all = np.column_stack([mode.D, self.S, F * (FREE / size)])
        keep = np.any(self.all != 0.0, axis=0)
        self.all = self.all[:, keep]
        self.correlated = bool(np.any(comparison.noise.free[SCALES.stop :]))

    def _fit(self, columns: np.ndarray, difference: np.ndarray, u: np.ndarray) -> np.ndarray:
        white = self.comparison.whitener(self.mode.prediction, u)
        X, y = white(columns) * self.good[:, None], white(difference) * self.good
        return np.linalg.solve(X.T @ X + np.eye(X.shape[1]), X.T @ y)

    def correlations(self, difference: np.ndarray, u: np.ndarray) -> np.ndarray:
        """A draw's noise as the search for a mode finds it; beside the forces correlations would be anyone's guess."""
        if not self.correlated:
            return u
        for _ in range(CORRELATION_PASSES):
            left = difference - self.mode.D @ self._fit(self.mode.D, difference, u)
            u = u + self.comparison.noise_step(left, self.mode.prediction, u, self.good, self.mode.D)[0]
        return u

    def noise(self, difference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and spread of the noise that the law is drawn with [-], shape (5,) each.

        Its scales are those beside all forces, what they take up of it allowed for. A scale's law is skew: its
        logarithm's mean lies above the most probable one by the variance, as that of a chi-squared's does.
        """
        u, mode = _of_declared_size(self.mode.u), self.mode
        for _ in range(LOUDNESS_PASSES):
            left = difference - self.all @ self._fit(self.all, difference, u)
            u[SCALES] += self.comparison.noise_step(left, mode.prediction, u, self.good, self.all)[0][SCALES]
        left = difference - self.all @ self._fit(self.all, difference, u)
        of_scales = self.comparison.noise_step(left, mode.prediction, u, self.good, self.all)[1]
        left = difference - mode.D @ mode.z
        of_correlations = self.comparison.noise_step(left, mode.prediction, mode.u, self.good, mode.D)[1]
        information = np.concatenate([np.diag(of_scales)[SCALES], np.diag(of_correlations)[SCALES.stop :]])
        spread = np.where(self.comparison.noise.free, 1.0 / np.sqrt(information), 0.0)
        u[SCALES] += spread[SCALES] ** 2
        return u, spread

    def __call__(self, difference: np.ndarray, noise: np.ndarray) -> Detection:
        """What the test makes of differences whose noise is correlated as given; its scales are estimated."""
        comparison, mode = self.comparison, self.mode
        u = _of_declared_size(noise)
        good = self.good
        for _ in range(PASSES):
            left = difference - self.all @ self._fit(self.all, difference, u)
            u[SCALES] += comparison.noise_step(left, mode.prediction, u, good)[0][SCALES]
        white = comparison.whitener(mode.prediction, u)
        J, y = white(mode.D) * good[:, None], white(difference) * good
        r = project(J, y)
        log_p = [0.0]
        scores = np.zeros(self.S.shape[1])
        if self.S.shape[1]:
            G = white(self.S) * good[:, None]
            size = np.sqrt(np.maximum(np.einsum("ij,ij->j", G, project(J, G)), 1e-12))
            seen = size > 1e-3 * np.maximum(np.linalg.norm(G, axis=0), 1e-9)
            scores = np.where(seen, G.T @ r / size, 0.0)
            tail = np.where(self.one_sided, log_ndtr(-scores), math.log(2.0) + log_ndtr(-np.abs(scores)))
            log_p.append(float(np.min(tail)))
        force_log_p, force_scores = [], []
        for columns in self.free:
            B = white(columns) * good[:, None]
            P = B.T @ project(J, B)
            b = B.T @ r
            value, vector = np.linalg.eigh(P)
            use = value > 1e-6 * max(value[-1], 1e-12)
            Q = float(np.sum((vector[:, use].T @ b) ** 2 / value[use]))
            force_log_p.append(log_tail(Q, int(use.sum())))
            force_scores.append(b / np.sqrt(np.maximum(np.diag(P), 1e-12)))
        log_p += force_log_p
        return Detection(1.0, False, -min(log_p), u, scores, np.array(force_log_p), force_scores)


def _of_declared_size(u: np.ndarray) -> np.ndarray:
    """A noise with its scales as declared and its own correlations."""
    return np.where(np.arange(SPREAD.size) < SCALES.stop, 0.0, u)


def log_tail(Q: float, k: int) -> float:
    """Natural logarithm of how often k squares of standard normal numbers add up to more.

    Parameters
    ----------
    k : int
        How many; none add up to nothing [-].
    """
    tail = float(chdtrc(k, Q)) if k else 1.0
    return math.log(tail) if tail > 0.0 else -0.5 * Q


def _draw(comparison: Comparison, mode: Mode, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Differences of readings that the model itself would give [SI]."""
    problem = comparison.problem
    n, end = comparison.n, comparison.end
    out = mode.D @ rng.standard_normal(mode.z.size)
    pressure, flow, speed = comparison.noise.draw_plateaus(u, rng)
    pressure += problem.resolution["pressure"] * (rng.random(n) - 0.5)
    out[:n] += mode.prediction.flow_slope * pressure + flow + problem.resolution["flow"] * (rng.random(n) - 0.5)
    out[n : 2 * n] += mode.prediction.speed_slope * pressure + speed
    out[2 * n : end] += comparison.noise.draw_samples(u, rng)
    out[n:end] += problem.resolution["speed"] * (rng.random(end - n) - 0.5)
    out[end:] += comparison.noise.beside * rng.standard_normal(out.size - end)
    sd = comparison.angle_sd
    angle = sd * rng.standard_normal(end - 2 * n)
    first = np.flatnonzero(comparison.noise.first)
    before = np.roll(angle, 1)
    before[first] = sd[first] * rng.standard_normal(first.size)
    out[2 * n : end] += (angle - before) / comparison.step
    return np.where(comparison.known, out, 0.0)
