"""The most probable point of a model and its evidence, by Gauss-Newton and Laplace's approximation.

The log posterior is -1/2 sum r^2 - sum log s - 1/2 z^2 - 1/2 (u/0.3)^2: r are readings less predictions in
units of their noise, z the unknowns (standard normal a priori), u the logarithms of the noise scales of
pressure, flow and speed. Single readings that stand far out are given a wide error, as in the fit. Steps
that do not lower the cost are shortened.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_ndtr

from calibration.diagnosis.function import Function
from calibration.diagnosis.linear import BLUR, NOISE_SD, RUN, Comparison
from calibration.diagnosis.problem import Prediction, Problem
from model.effects import effects
from model.layout import PULSE

BAD = 0.01
BAD_WIDTH = 10.0
LARGEST_MOVE = 6.0
MOST_PASSES = 30
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried in turn until one lowers the cost
SETTLED = 0.01  # squared length of a move, in posterior sds, below which a search ends
CLOSE = 100.0  # squared length of a move below which derivatives are taken along the axes of the posterior
ROUGHLY = 1.0  # share of the swing of the pulses that is left to chance while a search is on its way
ANGLES = 16  # starting angles tried within a pulse


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
    D : ndarray, shape (n, m)
        Derivatives of the predictions with z [SI].
    J : ndarray, shape (n, m)
        The same, whitened [-].
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
    D: np.ndarray
    J: np.ndarray
    r: np.ndarray
    covariance: np.ndarray
    log_evidence: float
    bad: np.ndarray
    prediction: Prediction


def find(
    comparison: Comparison,
    names: Sequence[str],
    start: Mode | None = None,
    passes: int = MOST_PASSES,
    first: dict[tuple[str, str], float] | None = None,
) -> Mode:
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
    first : dict or None
        Starting values of effects' unknowns by (effect, parameter) [-].
    """
    problem = comparison.problem
    k = len(problem.nuisances)
    extra = problem.effect_unknowns(names)
    z, u = np.zeros(k + len(extra)), np.zeros(3)
    f = Function(comparison, names)
    D = np.zeros((comparison.read.size, z.size))
    if start is not None:
        z[:k], u = start.z[:k], np.clip(start.u, -0.3, 0.3)
        D[:, :k] = start.D[:, :k]
        kept = {(e, x.name): start.z[k + i] for i, (e, x) in enumerate(problem.effect_unknowns(start.names))}
    else:
        kept = {}
    kept |= first or {}
    for i, (name, unknown) in enumerate(extra):
        z[k + i] = kept.get((name, unknown.name), 0.0)
        amplitude = effects()[name].amplitude
        if unknown.name == amplitude.name and len(effects()[name].parameters) > 1 and abs(z[k + i]) < 0.05:
            z[k + i] = 0.1  # at an amplitude of 0 nothing can be said of its shape
    z = f.clip(z)
    predicted = f(z)
    rough = bool(problem.blocks.runs)  # the phase of the pulses makes the surface rough
    near, axes = False, np.eye(z.size)
    comparison.blur = ROUGHLY if rough else BLUR
    for _ in range(passes):
        D = f.along(z, predicted, axes, D) if near else f.derivatives(z, predicted, D, u)
        white = comparison.whitener(predicted, u)
        r, J = white(comparison.read - comparison.raw(predicted)), white(D)
        weight, _ = _weights(r, comparison)
        A = (J * weight[:, None]).T @ J + np.eye(z.size)
        moved, predicted = _step(f, comparison, z, u, A, (J * weight[:, None]).T @ r - z, predicted, D)
        far = float((moved - z) @ A @ (moved - z))
        z, u = moved, _noise(comparison, predicted, u)
        if far < SETTLED and near == rough:
            if comparison.blur == BLUR:
                break
            comparison.blur = BLUR
            z = _turned(f, comparison, z, u, predicted)
            predicted = f(z)
        near = rough and (near or far < CLOSE)
        if near:
            size, turn = np.linalg.eigh(A)
            axes = turn / np.sqrt(size)
    comparison.blur = BLUR
    return close(comparison, names, z, u, D, predicted)


def close(
    comparison: Comparison, names: Sequence[str], z: np.ndarray, u: np.ndarray, D: np.ndarray, predicted: Prediction
) -> Mode:
    """A mode of what a search found: its covariance and its evidence.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    names : sequence of str
        Effect ids.
    z, u : ndarray
        The point [-].
    D : ndarray
        Derivatives there [SI].
    predicted : Prediction
        The prediction there.
    """
    white = comparison.whitener(predicted, u)
    r, J = white(comparison.read - comparison.raw(predicted)), white(D)
    weight, bad = _weights(r, comparison)
    A = (J * weight[:, None]).T @ J + np.eye(z.size)
    covariance = np.linalg.inv(A)
    log_evidence = -_cost(r, white.log_scale, z, u, comparison) - 0.5 * float(np.linalg.slogdet(A)[1])
    log_evidence += folding(comparison.problem, names, z, covariance)
    return Mode(tuple(names), z, u, D, J, r, covariance, log_evidence, bad, predicted)


def set_angles(comparison: Comparison, mode: Mode) -> Mode:
    """Give each run in time the starting angle, of a few within a pulse, that suits it best at a point.

    Parameters
    ----------
    comparison : Comparison
        The recording; its problem's angles and its ripple are changed.
    mode : Mode
        The point.

    Returns
    -------
    Mode
        The point with the angles' deviations set to 0: a start for `find`.
    """
    problem = comparison.problem
    k = len(problem.nuisances)
    z = mode.z.copy()
    z[[i for i, u in enumerate(problem.nuisances) if u.name.endswith(".angle")]] = 0.0
    chosen = problem.chosen(mode.names, mode.z[k:])
    for i, run in enumerate(problem.blocks.runs):
        comparison.swing[comparison.kind[2 * comparison.n : comparison.end] == RUN + i] = problem.swing(z[:k], i)[
            run.used
        ]
        best = (math.inf, 0.0)
        for angle in np.arange(ANGLES) * PULSE / ANGLES:
            problem.start_angle[run.file] = float(angle)
            predicted = problem.predict(z[:k], chosen, mode.prediction, [i])
            r = comparison.whitener(predicted, np.zeros(3))(comparison.read - comparison.raw(predicted))
            best = min(best, (float(np.sum(r[comparison.kind == RUN + i] ** 2)), float(angle)))
        problem.start_angle[run.file] = best[1]
    return replace(mode, z=z)


def _bounded(A: np.ndarray, b: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The step of a quadratic within bounds: what would leave them is held there and the rest is solved again."""
    free = np.ones(b.size, dtype=bool)
    move = np.zeros(b.size)
    for _ in range(b.size):
        move[free] = np.linalg.solve(A[np.ix_(free, free)], (b - A @ np.where(free, 0.0, move))[free])
        out = free & ((move < low) | (move > high))
        if not out.any():
            break
        move[out] = np.clip(move[out], low[out], high[out])
        free &= ~out
    return move


def _turned(f: Function, comparison: Comparison, z: np.ndarray, u: np.ndarray, here: Prediction) -> np.ndarray:
    """A point with the starting angle of each run in time at the best of a few within a pulse [-]."""
    z = z.copy()
    names = [unknown.name for unknown in comparison.problem.nuisances]
    for i, run in enumerate(comparison.problem.blocks.runs):
        place = names.index(f"{run.file}.angle")
        best = (math.inf, float(z[place]))
        edge = math.sqrt(3.0)  # half a pulse: an angle one pulse on is the same angle
        within = (float(z[place]) + edge) % (2.0 * edge) - edge
        for angle in [float(z[place]), within, *np.linspace(-edge, edge, ANGLES)]:
            z[place] = angle
            there = f(z, here, (i,))
            white = comparison.whitener(there, u)
            r = white(comparison.read - comparison.raw(there))
            best = min(best, (_cost(r, white.log_scale, z, u, comparison), float(angle)))
        z[place] = best[1]
    return z


def _step(
    f: Function,
    comparison: Comparison,
    z: np.ndarray,
    u: np.ndarray,
    A: np.ndarray,
    downhill: np.ndarray,
    predicted: Prediction,
    D: np.ndarray,
) -> tuple[np.ndarray, Prediction]:
    """The largest share of a step that lowers the cost, and the prediction there; where there is none, no step."""

    def cost(at_z: np.ndarray, there: Prediction) -> float:
        white = comparison.whitener(there, u)
        return _cost(white(comparison.read - comparison.raw(there)), white.log_scale, at_z, u, comparison)

    before = cost(z, predicted)
    whole = _bounded(A, downhill, f.low - z, f.high - z)
    for share in SHARES:
        move = share * whole
        move *= min(1.0, LARGEST_MOVE / max(float(np.max(np.abs(move))), 1e-12))
        tried = f.along_valley(z, f.clip(f.advance(z, move)), predicted, D)
        found = f(tried)
        if np.all(np.isfinite(comparison.raw(found)[comparison.known])) and cost(tried, found) <= before + 1e-6:
            return tried, found
    return z, predicted


def _noise(comparison: Comparison, predicted: Prediction, u: np.ndarray) -> np.ndarray:
    """The noise scales that suit a prediction best."""
    difference = comparison.read - comparison.raw(predicted)
    for _ in range(4):
        weight, _ = _weights(comparison.whitener(predicted, u)(difference), comparison)
        u = comparison.noise_step(difference, predicted, u, weight)
    return u


def _cost(r: np.ndarray, log_scale: float, z: np.ndarray, u: np.ndarray, comparison: Comparison) -> float:
    """Minus the log posterior, up to a constant."""
    good = -0.5 * r**2 + math.log(1.0 - BAD)
    wide = -0.5 * (r / BAD_WIDTH) ** 2 + math.log(BAD / BAD_WIDTH)
    fit = np.logaddexp(good, wide) if comparison.size >= 6 else good
    fit[comparison.end :] = good[comparison.end :]  # a mean of many readings is not one bad reading
    return float(-np.sum(fit) + log_scale + 0.5 * np.sum(z * z) + 0.5 * np.sum((u / NOISE_SD) ** 2))


def _weights(r: np.ndarray, comparison: Comparison) -> tuple[np.ndarray, np.ndarray]:
    """Weight of each residual in a least-squares step, and the probability that its reading is bad."""
    if comparison.size < 6:
        return np.ones_like(r), np.zeros_like(r)
    odds = BAD / BAD_WIDTH / (1.0 - BAD) * np.exp(np.minimum(0.5 * r**2 * (1.0 - BAD_WIDTH**-2), 700.0))
    bad = odds / (1.0 + odds)
    bad[comparison.end :] = 0.0
    return 1.0 - bad + bad * BAD_WIDTH**-2, bad


def folding(problem: Problem, names: Sequence[str], z: np.ndarray, covariance: np.ndarray) -> float:
    """What bounds at 0 do to the evidence: the prior's half that is allowed counts twice, the posterior's cut is lost.

    Parameters
    ----------
    problem : Problem
        For the unknowns.
    names : sequence of str
        Effect ids.
    z : ndarray
        The point [-].
    covariance : ndarray
        There [-].
    """
    k = len(problem.nuisances)
    total = 0.0
    for i, (name, unknown) in enumerate(problem.effect_unknowns(names)):
        amplitude = effects()[name].amplitude
        if unknown.name == amplitude.name and amplitude.low == 0.0 and unknown.kind == "normal":
            total += math.log(2.0) + float(log_ndtr(z[k + i] / math.sqrt(covariance[k + i, k + i])))
    return total
