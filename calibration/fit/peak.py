"""The posterior's peak and its curvature there: where the walkers start, and the first guess of their spread."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

BatchLogProb = Callable[[np.ndarray], np.ndarray]
STEP = 1e-3  # of the gradient, in prior standard deviations
CURVATURE_STEP = 0.05
WIDER = 1.2  # than the curvature says: posteriors have shoulders
NARROW = 0.35  # prior standard deviations: a direction that the recording fixes this well may be a curved ridge
MOST_NARROW = 4


class NoPeakError(ArithmeticError):
    """Nothing in the prior explains the recording."""


def find_peak(log_prob: BatchLogProb, candidates: np.ndarray) -> np.ndarray:
    """The highest point found from the best of some candidates.

    `log_prob`: log posterior of points of shape (n, n_dimensions), returning shape (n,) [-].
    `candidates`, shape (n, n_dimensions): draws from the prior [-].
    Returns the peak [-]. Raises NoPeakError when no candidate has a finite probability.
    """
    values = log_prob(candidates)
    if not np.isfinite(values).any():
        raise NoPeakError("no point of the prior explains the recording; are motor and recording of one rig?")
    return _climb(log_prob, candidates[int(np.argmax(values))])


def _climb(log_prob: BatchLogProb, start: np.ndarray) -> np.ndarray:
    n = start.size
    steps = STEP * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)])

    def value_and_gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
        with np.errstate(over="ignore"):  # a step of the search may go far beyond the prior
            values = -log_prob(x + steps)
        values = np.where(np.isfinite(values), values, 1e10)
        return float(values[0]), (values[1 : n + 1] - values[n + 1 :]) / (2.0 * STEP)

    result = minimize(value_and_gradient, start, jac=True, method="L-BFGS-B", options={"maxiter": 200})
    return np.asarray(result.x)


def spread_at(log_prob: BatchLogProb, peak: np.ndarray) -> np.ndarray:
    """Covariance of the normal distribution with the peak's curvature, shape (n, n) [-].

    `peak`, shape (n,): the peak [-].
    """
    n = peak.size
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    eye = CURVATURE_STEP * np.eye(n)
    points = [peak + si * eye[i] + sj * eye[j] for i, j in pairs for si in (1, -1) for sj in (1, -1)]
    values = log_prob(np.array(points)).reshape(len(pairs), 4)
    values = np.where(np.isfinite(values), values, float(log_prob(peak[None, :])[0]) - 10.0)
    curvature = np.zeros((n, n))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, values, strict=True):
        curvature[i, j] = curvature[j, i] = -(pp - pm - mp + mm) / (4.0 * CURVATURE_STEP**2)
    eigenvalues, vectors = np.linalg.eigh(curvature)
    # The prior alone has curvature 1; less than that is the step's error or a second peak.
    return (vectors / np.maximum(eigenvalues, 0.5)) @ vectors.T


def scatter(
    log_prob: BatchLogProb, peak: np.ndarray, covariance: np.ndarray, rng: np.random.Generator, n: int
) -> np.ndarray:
    """Points scattered like the posterior where it is wide, and moved onto its ridge where it is narrow.

    Along each of the narrowest directions in turn a parabola through three values finds the ridge, and the point is set
    at random about it with the parabola's own width.

    `peak`, `covariance`, shape (n_dimensions,) and (n_dimensions, n_dimensions): of `find_peak` and `spread_at` [-].
    Returns the points [-].
    """
    eigenvalues, vectors = np.linalg.eigh(covariance)
    widths = np.sqrt(eigenvalues)
    points = peak + (WIDER * widths * rng.standard_normal((n, peak.size))) @ vectors.T
    for k in np.flatnonzero(widths < NARROW)[:MOST_NARROW]:
        step = 2.0 * widths[k] * vectors[:, k]
        below, here, above = (log_prob(points + s * step) for s in (-1.0, 0.0, 1.0))
        with np.errstate(invalid="ignore", divide="ignore"):
            bend = 2.0 * here - below - above
            top = np.where(bend > 0.1, 0.5 * (above - below) / bend, np.sign(above - below))
            width = np.where(bend > 0.1, 1.0 / np.sqrt(bend), 0.5)
        moved = np.clip(np.nan_to_num(top), -20.0, 20.0) + np.nan_to_num(width) * rng.standard_normal(n)
        points = points + moved[:, None] * step
    return points
