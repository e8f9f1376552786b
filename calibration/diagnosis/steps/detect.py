"""Whether anything is missing. Its p-value is uniform where nothing is.

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

from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import FREE, GOOD
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Force
from calibration.likelihood.signatures import Signature, project
from calibration.unknowns.priors import NOISE_SD

DRAWS = 200
TAIL = 0.15  # share of the draws that the exponential tail is fitted to
MISMATCH_P = 0.01  # below it something is missing


@dataclass(frozen=True)
class Detection:
    """Whether anything is missing.

    `u`, shape (k,): the noise, its scales with all forces taken out [-].
    `pulled`: the nuisance that is pulled farther than can be believed; empty where none is.
    `gain`: what the forces together take off the sum of squares, where what is left is weighed by it; else 0 [-].
    """

    p_value: float
    extrapolated: bool
    statistic: float
    u: np.ndarray
    scores: np.ndarray
    force_log_p: np.ndarray
    force_scores: list[np.ndarray]
    pulled: str = ""
    gain: float = 0.0


def detect(
    comparison: Compared,
    mode: Mode,
    found: Sequence[Signature],
    free: Sequence[Force],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Detection:
    """Test a mode."""
    difference = np.nan_to_num(comparison.read - comparison.raw(mode.prediction) + mode.D @ mode.z)
    test = _Test(comparison, mode, found, free)
    real = test(difference, test.noise.of(difference, mode.u))
    if comparison.rig:
        real = replace(real, gain=test.gain(difference, real.u))
    noise, spread = test.noise.law(difference)
    null = np.empty(draws)
    for i in range(draws):
        u = noise + spread * rng.standard_normal(noise.size)
        drawn = test.drawn(u, rng)
        null[i] = test(drawn, test.noise.of_a_draw(drawn, noise)).statistic
    p, beyond = rarity(real.statistic, null)
    # Beside the forces, or where they take nothing up: either way that noise is not believable.
    if (loud := comparison.noise.too_loud(np.maximum(real.u, mode.u))) is not None:
        believed = comparison.noise.scales.stop * float(ndtr(-math.log(loud[1]) / NOISE_SD))
        p, beyond = min(p, believed), beyond or believed < p
    name, believed = _pull(comparison, mode)
    if pulled := name if believed < MISMATCH_P else "":
        p, beyond = min(p, believed), beyond or believed < p
    return replace(real, p_value=max(p, 1e-300), extrapolated=beyond, pulled=pulled)


def rarity(statistic: float, null: np.ndarray) -> tuple[float, bool]:
    """How often chance gives a statistic as large [-], and whether that lies beyond the draws of its law.

    `null`, shape (n,): draws of it where nothing is missing [-].
    """
    null = np.sort(null)
    above = int(np.sum(null >= statistic))
    cut = null[int((1.0 - TAIL) * null.size)]
    if statistic <= cut:
        return (above + 0.5) / (null.size + 1.0), False
    scale = max(float(np.mean(null[null > cut] - cut)), 0.5)
    return TAIL * math.exp(-(statistic - cut) / scale), above == 0


def _pull(comparison: Compared, mode: Mode) -> tuple[str, float]:
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
        comparison: Compared,
        mode: Mode,
        found: Sequence[Signature],
        free: Sequence[Force],
    ) -> None:
        self.comparison, self.mode = comparison, mode
        self.free_z = comparison.free_in_test(mode)
        self.D = mode.D * self.free_z
        good = mode.bad < GOOD
        self.good = good.astype(float)
        self.S = np.column_stack([s.column for s in found]) if found else np.zeros((good.size, 0))
        self.one_sided = np.array([s.one_sided for s in found], dtype=bool)
        self.free = [f.columns for f in free]
        F = np.column_stack(self.free) if free else np.zeros((good.size, 0))
        white = comparison.whitener(mode.prediction, mode.u)
        size = np.maximum(np.linalg.norm(white(F), axis=0), 1e-12)
        self.all = np.column_stack([self.D, self.S, F * (FREE / size)])
        keep = np.any(self.all != 0.0, axis=0)
        self.all = self.all[:, keep]
        self.noise = comparison.noise_test(mode, self.all, self.good)

    def __call__(self, difference: np.ndarray, u: np.ndarray) -> Detection:
        """What the test makes of differences with a noise."""
        comparison, mode, good = self.comparison, self.mode, self.good
        white = comparison.whitener(mode.prediction, u)
        J, y = white(self.D) * good[:, None], white(difference) * good
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
            force_log_p.append(log_tail(*_quadratic(P, b)))
            force_scores.append(b / np.sqrt(np.maximum(np.diag(P), 1e-12)))
        log_p += force_log_p
        return Detection(1.0, False, -min(log_p), u, scores, np.array(force_log_p), force_scores)

    def drawn(self, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Differences of readings that the mode itself would give [SI]; nothing of what the test leaves free."""
        z = rng.standard_normal(self.mode.z.size)
        moved = self.mode.D @ np.where(self.free_z > 1.0, 0.0, z)
        found: np.ndarray = moved + self.comparison.drawn_noise(self.mode.prediction, u, rng)
        return np.where(self.comparison.known, found, 0.0)

    def gain(self, difference: np.ndarray, u: np.ndarray) -> float:
        """What the forces together take off the sum of squares [-]."""
        white = self.comparison.whitener(self.mode.prediction, u)
        J, y = white(self.D) * self.good[:, None], white(difference) * self.good
        B = white(np.column_stack(self.free)) * self.good[:, None] if self.free else np.zeros((y.size, 0))
        B = B / np.maximum(np.linalg.norm(B, axis=0), 1e-12)
        return _quadratic(B.T @ project(J, B), B.T @ project(J, y))[0] if B.size else 0.0


def _quadratic(P: np.ndarray, b: np.ndarray) -> tuple[float, int]:
    """What directions with a precision take off the sum of squares, and how many of them there are [-]."""
    value, vector = np.linalg.eigh(P)
    use = value > 1e-6 * max(value[-1], 1e-12)
    return float(np.sum((vector[:, use].T @ b) ** 2 / value[use])), int(use.sum())


def log_tail(Q: float, k: int) -> float:
    """Natural logarithm of how often k squares of standard normal numbers add up to more.

    `k`: how many; none add up to nothing [-].
    """
    tail = float(chdtrc(k, Q)) if k else 1.0
    return math.log(tail) if tail > 0.0 else -0.5 * Q
