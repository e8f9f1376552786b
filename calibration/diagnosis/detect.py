"""Step 1: whether anything is missing. Its p-value is uniform where nothing is.

The statistic is the smallest tail probability over the projected signatures of all effects (one-sided where an effect
cannot be negative) and over the free-form forces. The noise scales are estimated beside all of these, so that a misfit
does not pass for noise. Its law under the null is drawn: nuisances, noise and noise scales anew each time, in the model
made linear at its most probable point. Beyond the draws the tail is exponential, and marked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, log_ndtr

from calibration.diagnosis.linear import NOISE_SD, Comparison
from calibration.diagnosis.mode import Mode
from calibration.diagnosis.problem import CHANNELS
from calibration.diagnosis.signatures import Force, Signature, project

DRAWS = 200
TAIL = 0.15  # share of the draws that the exponential tail is fitted to
PASSES = 3
BAD_ROW = 0.5  # readings that are more probably bad than this are left aside


@dataclass(frozen=True)
class Detection:
    """Whether anything is missing.

    Attributes
    ----------
    p_value : float
        Uniform under the null [-].
    extrapolated : bool
        Whether it lies beyond the draws.
    statistic : float
        -ln of the smallest tail probability [-].
    u : ndarray, shape (3,)
        Logarithms of the noise scales, all forces taken out [-].
    scores : ndarray
        Of each signature [-].
    force_log_p : ndarray
        Natural logarithm of each force's own tail probability [-].
    force_scores : list of ndarray
        Of each force's pieces [-].
    """

    p_value: float
    extrapolated: bool
    statistic: float
    u: np.ndarray
    scores: np.ndarray
    force_log_p: np.ndarray
    force_scores: list[np.ndarray]


def detect(
    comparison: Comparison,
    mode: Mode,
    found: Sequence[Signature],
    free: Sequence[Force],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Detection:
    """Test a mode.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The model at its most probable point.
    found : sequence of Signature
        Of the effects that it does not hold.
    free : sequence of Force
        Free-form forces.
    rng : numpy.random.Generator
        For the draws.
    draws : int
        Of the null law [-].
    """
    test = _Test(comparison, mode, found, free)
    difference = comparison.read - comparison.raw(mode.prediction) + mode.D @ mode.z
    real = test(np.nan_to_num(difference))
    null = np.sort([test(_draw(comparison, mode, rng)).statistic for _ in range(draws)])
    above = int(np.sum(null >= real.statistic))
    p, beyond = (above + 0.5) / (draws + 1.0), False
    cut = null[int((1.0 - TAIL) * draws)]
    if real.statistic > cut:
        scale = max(float(np.mean(null[null > cut] - cut)), 0.5)
        p, beyond = TAIL * math.exp(-(real.statistic - cut) / scale), above == 0
    return Detection(max(p, 1e-300), beyond, real.statistic, real.u, real.scores, real.force_log_p, real.force_scores)


class _Test:
    def __init__(self, comparison: Comparison, mode: Mode, found: Sequence[Signature], free: Sequence[Force]) -> None:
        self.comparison, self.mode = comparison, mode
        good = mode.bad < BAD_ROW
        self.good = good.astype(float)
        self.S = np.column_stack([s.column for s in found]) if found else np.zeros((good.size, 0))
        self.one_sided = np.array([s.one_sided for s in found], dtype=bool)
        self.free = [f.columns for f in free]
        F = np.column_stack(self.free) if free else np.zeros((good.size, 0))
        white = comparison.whitener(mode.prediction, mode.u)
        size = np.maximum(np.linalg.norm(white(F), axis=0), 1e-12)
        self.all = np.column_stack([mode.D, self.S, F * (20.0 / size)])
        keep = np.any(self.all != 0.0, axis=0)
        self.all = self.all[:, keep]

    def __call__(self, difference: np.ndarray) -> Detection:
        comparison, mode = self.comparison, self.mode
        u = np.zeros(3)
        good = self.good
        for _ in range(PASSES):
            white = comparison.whitener(mode.prediction, u)
            X, y = white(self.all) * good[:, None], white(difference) * good
            fit = np.linalg.solve(X.T @ X + np.eye(X.shape[1]), X.T @ y)
            u = comparison.noise_step(difference - self.all @ fit, mode.prediction, u, good)
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
            force_log_p.append(_log_tail(Q, int(use.sum())))
            force_scores.append(b / np.sqrt(np.maximum(np.diag(P), 1e-12)))
        log_p += force_log_p
        return Detection(1.0, False, -min(log_p), u, scores, np.array(force_log_p), force_scores)


def _log_tail(Q: float, k: int) -> float:
    tail = float(chdtrc(k, Q)) if k else 1.0
    return math.log(tail) if tail > 0.0 else -0.5 * Q


def _draw(comparison: Comparison, mode: Mode, rng: np.random.Generator) -> np.ndarray:
    """Differences of readings that the model itself would give [SI]."""
    problem, plateaus = comparison.problem, comparison.problem.blocks.plateaus
    u = NOISE_SD * rng.standard_normal(3)
    noise = {c: problem.noise[c] * math.exp(u[i]) for i, c in enumerate(CHANNELS)}
    n = comparison.n
    out = mode.D @ rng.standard_normal(mode.z.size)
    pressure = noise["pressure"] * plateaus.noise_scale * rng.standard_normal(n)
    pressure += problem.resolution["pressure"] * (rng.random(n) - 0.5)
    out[:n] += mode.prediction.flow_slope * pressure + noise["flow"] * plateaus.noise_scale * rng.standard_normal(n)
    out[n : 2 * n] += mode.prediction.speed_slope * pressure
    out[n : 2 * n] += noise["speed"] * plateaus.noise_scale * rng.standard_normal(n)
    out[:n] += problem.resolution["flow"] * (rng.random(n) - 0.5)
    end = comparison.end
    out[n:end] += problem.resolution["speed"] * (rng.random(end - n) - 0.5)
    scale = np.repeat([run.noise_scale for run in problem.blocks.runs], comparison.sizes)
    out[2 * n : end] += noise["speed"] * scale * rng.standard_normal(end - 2 * n)
    out[end:] += problem.blocks.vented.sd * rng.standard_normal(out.size - end)
    swing = comparison.angle_sd
    angle = swing * rng.standard_normal(end - 2 * n)
    first = np.cumsum([0, *comparison.sizes[:-1]])[: len(comparison.sizes)]
    before = np.roll(angle, 1)
    before[first] = swing[first] * rng.standard_normal(first.size)
    out[2 * n : end] += (angle - before) / comparison.step
    return np.where(comparison.known, out, 0.0)
