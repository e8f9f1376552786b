"""The log posterior of what recordings share, with what is each run's own integrated out.

A run in time has some twenty unknowns of its own: the course of its line, how the rotor broke away, where the shaft
stood. Each of several recordings has its room and its instruments' errors. All these enter in first order about the
most probable point, so they are integrated out in closed form (Laplace's approximation); the motor, the effects and the
noise scales are sampled, and of a single recording its room and its instruments' errors too. How alike the noise of
neighbours is stays as it suits the most probable point. The likelihood is that of a diagnosis,
`calibration.likelihood.mode`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, minus_log_posterior, robust_weights
from calibration.likelihood.tails import log_ratio
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.several.comparison import Several
from calibration.systems.several.problem import SeveralProblem
from calibration.unknowns.effects import in_a_fit
from calibration.unknowns.priors import Unknown, factors_at, values_of
from calibration.work.threads import each


@dataclass(frozen=True)
class Point:
    """The posterior at a point.

    `log_prob`: up to a constant [-].
    `z`, shape (m,): everything of the recordings, what is a run's own at its most probable value [-].
    `raw`, shape (n,): the readings expected there [SI].
    `prediction`: the same, what is a run's own as at the mode.
    `root`, shape (k, k): of the covariance of what is the runs' own: root times its transpose [-].
    `bad`, shape (n,): probability that each reading is bad [-].
    """

    log_prob: float
    z: np.ndarray
    u: np.ndarray
    raw: np.ndarray
    prediction: Any
    root: np.ndarray
    bad: np.ndarray


class Integrated:
    """Log posterior of points that hold what is sampled.

    `mode`: the most probable point, about which what is a run's own enters in first order.
    `unknowns`: what is sampled: of the recordings first, then the scales of their noise.
    `shared`, `own`: places in the mode's z of what is sampled, and of what is integrated out.
    `told`: places in ``own`` of what is a recording's and no run's; `of_recordings` says what they are.
    `spread`, shape (k,): the prior's sd of the logarithm of each noise scale [-].
    `scales_of`: which of them each recording has.
    `low`, `high`, shape (n_unknowns,): bounds [-].
    `off`, shape (own.size,): how far from the mode the derivatives put the most probable point of what is integrated
        out: at a kink they know one side. Taken off everywhere, so that the mode stays where it was found [-].
    """

    def __init__(self, comparison: Comparison | Several, mode: Mode) -> None:
        self.comparison, self.mode = comparison, mode
        self.f = Function(comparison, mode.names)
        problem, noise = comparison.problem, comparison.noise
        of_effects = problem.effect_unknowns(mode.names)
        everything = [
            *problem.nuisances,
            *(in_a_fit(name, one) for name, one in of_effects),
        ]
        is_of_run = np.array([i < self.f.k and problem.run_of(i) is not None for i in range(len(everything))])
        is_own = is_of_run.copy()
        if isinstance(problem, SeveralProblem):
            is_own[: self.f.k] = [not problem.is_of_the_motor(i) for i in range(self.f.k)]
        self.shared, self.own = np.flatnonzero(~is_own), np.flatnonzero(is_own)
        self.told = np.flatnonzero(~is_of_run[self.own])
        self.of_recordings = [everything[i] for i in self.own[self.told]]
        scales = noise.scale_unknowns()
        self.spread: np.ndarray = noise.spread[noise.scales]
        recordings = len(comparison.parts) if isinstance(comparison, Several) else 1
        self.scales_of = np.array_split(np.arange(self.spread.size), recordings)
        self.unknowns: list[Unknown] = [*(everything[i] for i in self.shared), *scales]
        self.low = np.append(self.f.low[self.shared], np.full(len(scales), -np.inf))
        self.high = np.append(self.f.high[self.shared], np.full(len(scales), np.inf))
        sizes = [i for i, (name, one) in enumerate(of_effects, self.f.k) if not problem.parameter(name, one.name).shape]
        self._sizes = np.array(sizes, dtype=int)
        self.D = mode.D[:, self.own]
        self.weight = robust_weights(mode.r, comparison, found=True)[0]
        self.raw = comparison.raw(mode.prediction)
        white = comparison.whitener(mode.prediction, mode.u)
        J = white(self.D)
        weighed = J * self.weight[:, None]
        slope = weighed.T @ white(comparison.read - self.raw) - mode.z[self.own]
        self.off: np.ndarray = np.linalg.solve(weighed.T @ J + np.eye(self.own.size), slope)

    def values(self, z: np.ndarray) -> np.ndarray:
        """Physical values of the unknowns, shape (n, n_unknowns), each in its own unit; ``z`` likewise [-]."""
        return values_of(self.unknowns, z)

    def factors(self, z: np.ndarray) -> np.ndarray:
        """What one unit of each coordinate multiplies its unknown by, near a point; `priors.factors_at`."""
        return factors_at(self.unknowns, z)

    def centre(self) -> np.ndarray:
        """The most probable point [-], shape (n_unknowns,)."""
        return np.append(self.mode.z[self.shared], self.mode.u[self.comparison.noise.scales] / self.spread)

    def whole(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A sampled point as z and u of the likelihood, what is a run's own as at the mode [-]."""
        full, u = self.mode.z.copy(), self.mode.u.copy()
        full[self.shared] = z[: self.shared.size]
        u[self.comparison.noise.scales] = z[self.shared.size :] * self.spread
        return full, u

    def inside(self, z: np.ndarray) -> np.ndarray:
        """Which points lie within the bounds, shape (n,); ``z`` of shape (n, n_unknowns) [-]."""
        return np.all((z >= self.low) & (z <= self.high), axis=1)

    def log_prob(self, z: np.ndarray) -> np.ndarray:
        """Log posterior density up to a constant, shape (n,) [-]. `z`, shape (n, n_unknowns): points [-]."""
        found = np.full(len(z), -np.inf)
        places = np.flatnonzero(self.inside(z))
        points = each(self.at, z[places])
        found[places] = [-np.inf if point is None else point.log_prob for point in points]
        return found

    def tails(self, full: np.ndarray) -> np.ndarray:
        """What the longer tails of the effects' sizes add to the log prior, shape (...,); ``full`` (..., m) [-]."""
        return log_ratio(full[..., self._sizes]).sum(axis=-1)

    def predicted(self, full: np.ndarray) -> np.ndarray | None:
        """The readings expected at a whole point [SI], shape (n,); None where the model has none."""
        try:
            prediction = self.f(full)
        except ArithmeticError:
            return None
        return self.comparison.raw(prediction) if self.comparison.is_told(prediction) else None

    def at(self, z: np.ndarray) -> Point | None:
        """The posterior at one point; None where the model gives no reading."""
        full, u = self.whole(z)
        try:
            prediction = self.f(full)
        except ArithmeticError:
            return None
        return self.given(full, u, prediction) if self.comparison.is_told(prediction) else None

    def given(self, full: np.ndarray, u: np.ndarray, prediction: Any) -> Point | None:
        """The same of a whole point with its prediction, what is a run's own as at the mode; ``full`` is changed."""
        comparison = self.comparison
        white, raw = comparison.whitener(prediction, u), comparison.raw(prediction)
        r, J = white(comparison.read - raw), white(self.D)
        weighed = J * self.weight[:, None]
        A = weighed.T @ J + np.eye(self.own.size)
        delta = np.linalg.solve(A, weighed.T @ r - full[self.own]) - self.off
        full[self.own] += delta
        left = r - J @ delta
        cost = minus_log_posterior(left, white.log_scale, full, u, comparison, found=True)
        log_prob = -cost - 0.5 * float(np.linalg.slogdet(A)[1]) + float(self.tails(full))
        if not np.isfinite(log_prob):
            return None
        root = np.linalg.inv(np.linalg.cholesky(A)).T
        return Point(
            log_prob, full, u, raw + self.D @ delta, prediction, root, robust_weights(left, comparison, found=True)[1]
        )


def log_prob_of(target: Integrated, z: np.ndarray) -> np.ndarray:
    """`Integrated.log_prob`, for a process of its own."""
    return target.log_prob(z)
