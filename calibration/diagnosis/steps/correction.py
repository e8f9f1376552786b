"""A smooth torque or flow that closes a balance, along one coordinate: a Gaussian process in the linear problem.

It stands for what is missing where no effect has a name for it, so that predictions can be made. Every nuisance is free
beside it: what f_overall or an instrument's error can take up, it does not have to. Its length and its size are not
chosen but weighed, by their evidence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import logsumexp, softmax

from calibration.diagnosis.steps.confirm import HeldOut, Predicted, fit_on, predict_held, summed_up
from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import Linearized, freed, linearize
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Balance

KNOTS = 31  # places at which the curve is known; straight between them
LENGTHS = (0.05, 0.1, 0.2, 0.4, 0.8)  # of the kernel, in shares of the coordinate's span
SIZES = (0.03, 0.1, 0.3)  # sd, in units of a balance's own scale
STEP = 1e-3  # of a standard normal unknown, for a derivative
ROOT3 = math.sqrt(3.0)
Key = tuple[str, str, str, str]
SURE, LARGE = 1.0, 0.5  # sds from 0, and share of its largest value, where a curve stands out


@dataclass(frozen=True)
class Correction:
    """A smooth torque or flow along one coordinate.

    `at`, shape (k,): where it is known [own unit].
    `mean`, `sd`, shape (k,): the curve: a torque that brakes [N m], a flow beyond the model's [m3/s], or an
        instrument's error [SI].
    `gain`: log evidence over no correction, lengths and sizes averaged over [-].
    `column`, shape (m,): what its mean does to the readings [SI].
    `z`, `z_sd`, shape (n,): the nuisances beside it, and their sd [-].
    `size`: the sd that its prior has, sizes weighed by their evidence [as the curve].
    """

    channel: str
    balance: str
    coordinate: str
    unit: str
    at: np.ndarray
    mean: np.ndarray
    sd: np.ndarray
    gain: float
    column: np.ndarray
    z: np.ndarray
    z_sd: np.ndarray
    size: float


def nuisances_beside(comparison: Compared, mode: Mode, found: Sequence[Correction]) -> tuple[np.ndarray, np.ndarray]:
    """The nuisances and their sd when something is missing and nobody knows what [-], each shape (n,).

    A torque of unknown form may have a part in proportion to speed, as large as the process is believed to be: no
    recording tells that from viscous friction. The spread of f_overall holds it.

    `found`: those of all coordinates; they are averaged over by their evidence.
    """
    weight = softmax([one.gain for one in found])
    means, sds = np.array([one.z for one in found]), np.array([one.z_sd for one in found])
    mean: np.ndarray = weight @ means
    variance = weight @ (sds**2 + means**2) - mean**2
    place = comparison.problem.place(comparison.problem.friction)
    speed = comparison.places.ordinary_speed(mode)
    if place is not None and speed > 0.0:
        f_overall, at_z = comparison.problem.nuisances[place], mean[place]
        slope = float(f_overall.value(at_z + STEP) - f_overall.value(at_z)) / STEP
        hidden = np.array([one.size / (speed * slope) if one.balance == "torque" else 0.0 for one in found])
        variance[place] += weight @ hidden**2
    return mean, np.sqrt(np.maximum(variance, 0.0))


def corrections(comparison: Compared, mode: Mode, u: np.ndarray, meters: bool = False) -> list[Correction]:
    """The smooth torques and flows along each coordinate, one at a time, that of most evidence first.

    `u`, shape (k,): the noise that the detection found [-].
    `meters`: whether the instruments' errors, each along its own range, are given too [Pa], [m3/s] or [rad/s].
    """
    problem = linearize(comparison, mode, u)
    every = np.ones(comparison.read.size, dtype=bool)
    listed = processes(problem) if meters else _of_balances(problem)
    found = [_smoothed(_Fitted(problem, one, every)) for one in listed]
    return sorted(found, key=lambda one: -one.gain)


def hold_out(comparison: Compared, mode: Mode, u: np.ndarray) -> HeldOut | None:
    """Whether a smooth correction predicts readings that it has not seen; None where nothing can be corrected.

    `u`, shape (k,): the noise that the detection found [-].
    """
    problem = linearize(comparison, mode, u)
    listed = _of_balances(problem)
    if not listed:
        return None
    every = np.ones(comparison.read.size, dtype=bool)
    best = _best(problem, listed, every).process
    folds, same, gains = comparison.folds()[0], 0, []
    errors: dict[str, list[np.ndarray]] = {"before": [], "after": []}
    for held in folds:
        chosen = _best(problem, listed, ~held)
        same += chosen.process is best
        density, error = chosen.predict(held)
        z, A, _ = fit_on(comparison, problem.mode, ~held)
        density0, error0 = predict_held(comparison, problem.mode, z, A, held)
        gains.append(density - density0)
        errors["before"].append(error0)
        errors["after"].append(error)
    return summed_up(comparison, folds, int(same), gains, errors, Predicted.BY_CORRECTION)


@dataclass(frozen=True)
class Process:
    """A Gaussian process before the readings are looked at.

    `knots`, shape (k,): where it is known [own unit].
    `hats`, `white`, shape (m, k): what each knot does to the readings [SI], and the same whitened [-].
    """

    of: Balance
    knots: np.ndarray
    hats: np.ndarray
    white: np.ndarray

    @property
    def key(self) -> Key:
        """Channel, balance, coordinate and recording."""
        return self.of.channel, self.of.balance, self.of.along.name, self.of.recording


class _Fitted:
    """A process with the nuisances on some of the readings."""

    def __init__(self, problem: Linearized, process: Process, used: np.ndarray) -> None:
        self.problem, self.process = problem, process
        X = np.column_stack([problem.J, process.white, problem.y])[used]
        self.gram = X.T @ X
        self.priors = [_root(process.knots, a, b * process.of.scale) for a in LENGTHS for b in SIZES]
        self.fits = [self._fit(root) for root in self.priors]
        evidence = np.array([evidence for _, _, evidence in self.fits])
        k = problem.J.shape[1]
        A, b = self.gram[:k, :k] + np.eye(k), self.gram[:k, -1]
        nothing = 0.5 * float(b @ np.linalg.solve(A, b)) - 0.5 * float(np.linalg.slogdet(A)[1])
        self.gain = float(logsumexp(evidence) - math.log(evidence.size)) - nothing
        self.weights = softmax(evidence)

    def _fit(self, root: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Most probable unknowns, nuisances first, then the knots; their covariance; the evidence."""
        k = self.problem.J.shape[1]
        turn = np.eye(self.gram.shape[0] - 1)
        turn[k:, k:] = root
        A = turn.T @ self.gram[:-1, :-1] @ turn + np.eye(turn.shape[0])
        b = turn.T @ self.gram[:-1, -1]
        C = np.linalg.inv(A)
        evidence = 0.5 * float(b @ C @ b) - 0.5 * float(np.linalg.slogdet(A)[1])
        return turn @ (C @ b), turn @ C @ turn.T, evidence

    def predict(self, held: np.ndarray) -> tuple[float, np.ndarray]:
        """Log density of held-out readings, and their errors [SI]."""
        problem, mode = self.problem, self.problem.mode
        comparison, good = problem.comparison, held & (problem.good > 0.0)
        X, y = np.column_stack([problem.J, self.process.white])[good], problem.y[good]
        densities, mean = [], np.zeros(X.shape[1])
        for (z, covariance, _), weight in zip(self.fits, self.weights, strict=True):
            C, r = np.eye(y.size) + X @ covariance @ X.T, y - X @ z
            densities.append(-0.5 * float(r @ np.linalg.solve(C, r)) - 0.5 * float(np.linalg.slogdet(C)[1]))
            mean += weight * z
        density = float(logsumexp(densities, b=self.weights)) - float(np.sum(np.log(problem.white.scale[good])))
        k = problem.J.shape[1]
        error = comparison.read - comparison.raw(mode.prediction) + mode.D @ (mode.z - mean[:k])
        return density, np.nan_to_num(error - self.process.hats @ mean[k:])[held]


def evidence(problem: Linearized, process: Process, beside: np.ndarray | None = None) -> float:
    """Log evidence of a process over none, lengths and sizes averaged over [-].

    `beside`, shape (m, k): whitened columns of something that is free in any case [-].
    """
    every = np.ones(problem.y.size, dtype=bool)
    if beside is not None:
        problem = replace(problem, J=np.hstack([problem.J, freed(beside)]))
    return _Fitted(problem, process, every).gain


def stands_out(problem: Linearized, process: Process) -> tuple[float, float] | None:
    """Where a process is hardly 0, and large [own unit of its coordinate]; None where that is nowhere."""
    curve = _smoothed(_Fitted(problem, process, np.ones(problem.y.size, dtype=bool)))
    size = np.abs(curve.mean)
    out = np.flatnonzero((size > SURE * curve.sd) & (size >= LARGE * size.max()))
    if not out.size:
        return None
    near = float(curve.at[1] - curve.at[0])  # an edge is known to a knot
    low, high = float(curve.at[out[0]]) - near, float(curve.at[out[-1]]) + near
    return max(low, float(curve.at[0])), min(high, float(curve.at[-1]))


def _best(problem: Linearized, listed: Sequence[Process], used: np.ndarray) -> _Fitted:
    return max((_Fitted(problem, one, used) for one in listed), key=lambda fitted: fitted.gain)


def _smoothed(fitted: _Fitted) -> Correction:
    """The curve, averaged over lengths and sizes; its spread holds what these leave open."""
    one, k = fitted.process, fitted.problem.J.shape[1]
    means = np.array([z for z, _, _ in fitted.fits])
    variances = np.array([np.diag(covariance) for _, covariance, _ in fitted.fits])
    mean = fitted.weights @ means
    sd = np.sqrt(np.maximum(fitted.weights @ (variances + means**2) - mean**2, 0.0))
    along = one.of.along
    return Correction(
        one.of.channel,
        one.of.balance,
        along.name,
        along.unit,
        one.knots,
        mean[k:],
        sd[k:],
        fitted.gain,
        one.hats @ mean[k:],
        mean[:k],
        sd[:k],
        one.of.scale * math.sqrt(float(fitted.weights @ np.tile(np.square(SIZES), len(LENGTHS)))),
    )


def processes(problem: Linearized) -> list[Process]:
    """A smooth process for all that may be off."""
    found = []
    for one in problem.comparison.places.balances(problem.mode):
        knots = np.linspace(float(np.nanmin(one.values)), float(np.nanmax(one.values)), KNOTS)
        hats = one.columns(partial(_between, knots))
        found.append(Process(one, knots, hats, problem.columns(hats)))
    return found


def _of_balances(problem: Linearized) -> list[Process]:
    """Those of torque and flow: what predicts, where an instrument's error would only explain."""
    return [one for one in processes(problem) if one.of.balance != "sensor"]


def _between(knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Shares of the knots about each value, shape (n, k); none where there is no value."""
    apart = np.abs(np.nan_to_num(x, nan=np.inf)[:, None] - knots) / (knots[1] - knots[0])
    return np.maximum(0.0, 1.0 - apart)


def _root(knots: np.ndarray, length: float, size: float) -> np.ndarray:
    """Lower root of a Matern kernel of order 3/2: once smooth, so that it can follow an edge."""
    apart = ROOT3 * np.abs(knots[:, None] - knots) / (length * np.ptp(knots))
    kernel = size**2 * (1.0 + apart) * np.exp(-apart)
    return np.linalg.cholesky(kernel + 1e-9 * size**2 * np.eye(knots.size))
