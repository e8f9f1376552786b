"""The most probable point of a model and its evidence, by Gauss-Newton and Laplace's approximation.

The log posterior is -1/2 sum r^2 - sum log s - 1/2 z^2 - 1/2 (u/0.3)^2: r are readings less predictions in units of
their noise, z the unknowns (standard normal a priori), u the logarithms of the noise scales of pressure, flow and speed.
Single readings that stand far out are given a wide error, as in the fit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.problem import CHANNELS, Prediction, Problem
from calibration.priors import NOISE_FACTOR
from model.effects import effects

NOISE_SD = math.log(NOISE_FACTOR)
STEP = 0.05  # of a standard normal unknown, for derivatives
BAD = 0.01
BAD_WIDTH = 10.0
LARGEST_MOVE = 3.0
MOST_PASSES = 12
SETTLED = 0.02
REST_SHARE = (
    0.2  # a coast-down is compared down to this share of its first speed: below it, trapped air swings the rotor
)


@dataclass(frozen=True)
class Whitened:
    """Readings less predictions in units of their noise.

    Attributes
    ----------
    r : ndarray, shape (n,)
        Residuals [-]; plateaus in pairs (flow, speed), then the runs' samples.
    log_scale : float
        Sum of the logarithms of what they were divided by.
    """

    r: np.ndarray
    log_scale: float


@dataclass(frozen=True)
class Mode:
    """A model at its most probable point.

    Attributes
    ----------
    names : tuple of str
        Effect ids.
    z : ndarray, shape (m,)
        Nuisances, then the effects' unknowns [-].
    u : ndarray, shape (3,)
        Logarithms of the noise scales of pressure, flow and speed [-].
    J : ndarray, shape (n, m)
        Derivatives of the whitened predictions with z [-].
    r : ndarray, shape (n,)
        Whitened residuals [-].
    covariance : ndarray, shape (m, m)
        Of z [-].
    log_evidence : float
        Natural logarithm, up to a constant that all models of a recording share.
    bad : ndarray, shape (n,)
        Probability that each residual's reading is bad [-].
    prediction : Prediction
        At the point.
    """

    names: tuple[str, ...]
    z: np.ndarray
    u: np.ndarray
    J: np.ndarray
    r: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    bad: np.ndarray
    prediction: Prediction


class Comparison:
    """Whitens readings of a problem; which of them are used is fixed once.

    Parameters
    ----------
    problem : Problem
        The recording.
    rows : ndarray of bool or None
        Plateaus that are used; all when left out.
    runs : sequence of ndarray of bool or None
        Samples of each run that are used; those before trapped air swings the rotor when left out.
    """

    def __init__(
        self, problem: Problem, rows: np.ndarray | None = None, runs: Sequence[np.ndarray] | None = None
    ) -> None:
        self.problem = problem
        plateaus = problem.blocks.plateaus
        self.rows = np.ones(plateaus.size, dtype=bool) if rows is None else rows
        self.runs = tuple(_useful(run.speed, run.from_rest) for run in problem.blocks.runs) if runs is None else runs

    @property
    def size(self) -> int:
        """Number of residuals [-]."""
        return 2 * int(self.rows.sum()) + sum(int(used.sum()) for used in self.runs)

    def white(self, predicted: Prediction, u: np.ndarray) -> Whitened:
        """Residuals at a prediction.

        Parameters
        ----------
        predicted : Prediction
            Of the problem.
        u : ndarray, shape (3,)
            Logarithms of the noise scales [-].
        """
        problem, plateaus = self.problem, self.problem.blocks.plateaus
        noise = {c: problem.noise[c] * math.exp(u[i]) for i, c in enumerate(CHANNELS)}
        var = {c: (noise[c] * plateaus.noise_scale) ** 2 + problem.resolution[c] ** 2 / 12.0 for c in CHANNELS}
        a, b = predicted.flow_slope, predicted.speed_slope
        q = var["flow"] + var["pressure"] * a * a
        n = var["speed"] + var["pressure"] * b * b
        mixed = var["pressure"] * a * b
        dq, dn = plateaus.flow - predicted.flow, plateaus.speed - predicted.speed
        has_q, has_n = np.isfinite(dq), np.isfinite(dn)
        lq = np.sqrt(q)
        rq = np.where(has_q, dq, 0.0) / lq
        share = np.where(has_q, mixed / lq, 0.0)
        ln = np.sqrt(n - share * share)
        rn = np.where(has_n, (np.where(has_n, dn, 0.0) - share * rq) / ln, 0.0)
        log_scale = float(np.sum(np.log(lq)[self.rows & has_q]) + np.sum(np.log(ln)[self.rows & has_n]))
        parts = [np.column_stack([rq, rn])[self.rows].ravel()]
        for run, speed, used in zip(problem.blocks.runs, predicted.runs, self.runs, strict=True):
            sd = math.hypot(noise["speed"] * run.noise_scale, problem.resolution["speed"] / math.sqrt(12.0))
            parts.append(((run.speed - speed) / sd)[used])
            log_scale += int(used.sum()) * math.log(sd)
        return Whitened(np.concatenate(parts), log_scale)


def find(comparison: Comparison, names: Sequence[str], start: Mode | None = None, passes: int = MOST_PASSES) -> Mode:
    """The most probable point of the base model with a set of effects.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    names : sequence of str
        Effect ids.
    start : Mode or None
        A mode of a smaller or equal set to start from.
    passes : int
        Most Gauss-Newton passes [-].
    """
    problem = comparison.problem
    k = len(problem.nuisances)
    extra = problem.effect_unknowns(names)
    z = np.zeros(k + len(extra))
    u = np.zeros(3)
    if start is not None:
        z[:k], u = start.z[:k], start.u.copy()
        held = {
            (name, unknown.name): start.z[k + i]
            for i, (name, unknown) in enumerate(problem.effect_unknowns(start.names))
        }
        for i, (name, unknown) in enumerate(extra):
            z[k + i] = held.get((name, unknown.name), 0.0)
    for i, (name, unknown) in enumerate(extra):
        first = effects()[name].amplitude
        if unknown.name == first.name and z[k + i] == 0.0 and first.low == 0.0:
            z[k + i] = 0.3  # at an amplitude of 0 nothing can be said of its shape
    f = _Function(comparison, names)
    white, predicted = f(z, u)
    J = f.jacobian(z, u, white.r)
    for _ in range(passes):
        weight, bad = _weights(white.r, comparison)
        A = (J * weight[:, None]).T @ J + np.eye(z.size)
        move = np.linalg.solve(A, (J * weight[:, None]).T @ white.r - z)
        move *= min(1.0, LARGEST_MOVE / max(np.max(np.abs(move)), 1e-12))
        z_new, u_new, white_new, predicted_new = _line_search(f, comparison, z, u, move, white)
        moved = np.max(np.abs(z_new - z))
        z, u, white, predicted = z_new, u_new, white_new, predicted_new
        J = f.jacobian(z, u, white.r)
        if moved < SETTLED:
            break
    weight, bad = _weights(white.r, comparison)
    A = (J * weight[:, None]).T @ J + np.eye(z.size)
    covariance = np.linalg.inv(A)
    log_evidence = -_cost(white, z, u, comparison) - 0.5 * float(np.linalg.slogdet(A)[1])
    log_evidence += _folding(problem, names, z, covariance)
    return Mode(tuple(names), z, u, J, white.r, covariance, log_evidence, bad, predicted)


class _Function:
    """Whitened residuals of a point, within the effects' bounds."""

    def __init__(self, comparison: Comparison, names: Sequence[str]) -> None:
        self.comparison, self.problem, self.names = comparison, comparison.problem, tuple(names)
        self.k = len(self.problem.nuisances)
        unknown = self.problem.effect_unknowns(names)
        self.low = np.full(self.k + len(unknown), -6.0)
        self.high = np.full(self.k + len(unknown), 6.0)
        for i, (name, one) in enumerate(unknown):
            parameter = next(p for p in effects()[name].parameters if p.name == one.name)
            self.low[self.k + i] = one.z(max(parameter.low, 1e-12) if one.kind == "lognormal" else parameter.low)
            self.high[self.k + i] = one.z(parameter.high)

    def clip(self, z: np.ndarray) -> np.ndarray:
        return np.clip(z, self.low, self.high)

    def __call__(self, z: np.ndarray, u: np.ndarray) -> tuple[Whitened, Prediction]:
        predicted = self.problem.predict(z[: self.k], self.problem.chosen(self.names, z[self.k :]))
        return self.comparison.white(predicted, u), predicted

    def jacobian(self, z: np.ndarray, u: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Forward differences of the predictions; the whitening's own change with z is left aside."""
        J = np.empty((r.size, z.size))
        for i in range(z.size):
            step = STEP if z[i] + STEP <= self.high[i] else -STEP
            moved = z.copy()
            moved[i] += step
            J[:, i] = -(self(moved, u)[0].r - r) / step
        return np.nan_to_num(J)


def _line_search(
    f: _Function, comparison: Comparison, z: np.ndarray, u: np.ndarray, move: np.ndarray, white: Whitened
) -> tuple[np.ndarray, np.ndarray, Whitened, Prediction]:
    before = _cost(white, z, u, comparison)
    for share in (1.0, 0.5, 0.25, 0.1, 0.03):
        tried = f.clip(z + share * move)
        found, predicted = f(tried, u)
        if np.all(np.isfinite(found.r)) and _cost(found, tried, u, comparison) <= before + 1e-9:
            u_new = _noise(comparison, predicted, u)
            return tried, u_new, comparison.white(predicted, u_new), predicted
    _, predicted = f(z, u)
    u_new = _noise(comparison, predicted, u)
    return z, u_new, comparison.white(predicted, u_new), predicted


def _noise(comparison: Comparison, predicted: Prediction, u: np.ndarray) -> np.ndarray:
    """The noise scales that suit a prediction best, one after the other on a grid that narrows."""
    best = u.copy()
    nothing = np.zeros(0)
    for _ in range(2):
        for i in range(3):
            span = 0.6
            for _ in range(4):
                tried = best[i] + span * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
                costs = []
                for value in tried:
                    v = best.copy()
                    v[i] = value
                    costs.append(_cost(comparison.white(predicted, v), nothing, v, comparison))
                best[i] = tried[int(np.argmin(costs))]
                span *= 0.4
    return best


def _cost(white: Whitened, z: np.ndarray, u: np.ndarray, comparison: Comparison) -> float:
    """Minus the log posterior, up to a constant."""
    good = -0.5 * white.r**2 + math.log(1.0 - BAD)
    wide = -0.5 * (white.r / BAD_WIDTH) ** 2 + math.log(BAD / BAD_WIDTH)
    fit = np.logaddexp(good, wide) if comparison.size >= 6 else good
    return float(-np.sum(fit) + white.log_scale + 0.5 * np.sum(z * z) + 0.5 * np.sum((u / NOISE_SD) ** 2))


def _weights(r: np.ndarray, comparison: Comparison) -> tuple[np.ndarray, np.ndarray]:
    """Weight of each residual in a least-squares step, and the probability that its reading is bad."""
    if comparison.size < 6:
        return np.ones_like(r), np.zeros_like(r)
    odds = BAD / BAD_WIDTH / (1.0 - BAD) * np.exp(np.minimum(0.5 * r**2 * (1.0 - BAD_WIDTH**-2), 700.0))
    bad = odds / (1.0 + odds)
    return 1.0 - bad + bad * BAD_WIDTH**-2, bad


def _folding(problem: Problem, names: Sequence[str], z: np.ndarray, covariance: np.ndarray) -> float:
    """What bounds at 0 do to the evidence: the prior's half that is allowed counts twice, the posterior's cut is lost."""
    from scipy.special import log_ndtr

    k = len(problem.nuisances)
    total = 0.0
    for i, (name, unknown) in enumerate(problem.effect_unknowns(names)):
        amplitude = effects()[name].amplitude
        if unknown.name == amplitude.name and amplitude.low == 0.0 and unknown.kind == "normal":
            total += math.log(2.0) + float(log_ndtr(z[k + i] / math.sqrt(covariance[k + i, k + i])))
    return total


def _useful(speed: np.ndarray, from_rest: bool) -> np.ndarray:
    """Samples of a run that are compared: all of a spin-up, and a coast-down until it is nearly over."""
    used = np.isfinite(speed)
    if from_rest:
        return used
    slow = np.flatnonzero(speed < REST_SHARE * np.nanmean(speed[:5]))
    if slow.size:
        used[slow[0] :] = False
    return used
