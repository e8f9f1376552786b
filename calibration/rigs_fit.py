"""The most probable point of another rig's model with a set of effects, and its evidence by Laplace's approximation.

Noise scales (log-normal 0.3 a channel) and, along a transient, the correlation of neighbouring readings are fitted too,
so that a diagnosis weighs what a recording shows and not how many rows it has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares
from scipy.special import log_ndtr

from calibration.priors import NOISE_FACTOR
from calibration.rigs_problem import RigProblem
from model.effects import effects

NOISE_SD = math.log(NOISE_FACTOR)
CORRELATIONS = np.linspace(-0.3, 0.95, 26)
MOST_ROUNDS = 8
SETTLED = 0.02  # nats
FIRST_Z = 0.3  # at an amplitude of 0 nothing can be said of a shape


@dataclass(frozen=True)
class Estimate:
    """Mean, standard deviation and unit of an unknown."""

    mean: float
    sd: float
    unit: str


@dataclass(frozen=True)
class RigFit:
    """A fitted model.

    Attributes
    ----------
    names : tuple of str
        Effect ids.
    estimates : dict of str to Estimate
        Unknowns by name; those of an effect as ``effect.parameter``.
    log_evidence : float
        Natural logarithm, up to a constant that all sets of a recording share.
    noise_scale, correlation : dict of str to float
        Of each channel: factor on the declared noise, and correlation of neighbours in time [-].
    residuals : tuple of ndarray
        Reading less prediction of each of the problem's readings [SI].
    at_bound : tuple of str
        Unknowns that a bound holds: wanted beyond what an engineer would believe, or an absent effect.
    """

    names: tuple[str, ...]
    estimates: dict[str, Estimate]
    log_evidence: float
    noise_scale: dict[str, float]
    correlation: dict[str, float]
    residuals: tuple[np.ndarray, ...]
    at_bound: tuple[str, ...]


@dataclass
class _Noise:
    """Logarithm of the scale, and correlation, of each channel."""

    u: dict[str, float] = field(default_factory=dict)
    rho: dict[str, float] = field(default_factory=dict)


class _Coordinates:
    """What a search moves: flat unknowns over their size, then standard normal numbers."""

    def __init__(self, problem: RigProblem, names: Sequence[str]) -> None:
        self.problem, self.flats = problem, problem.flats
        self.of_effects = problem.effect_unknowns(names)
        self.unknowns = [*problem.unknowns, *(unknown for _, unknown, _, _ in self.of_effects)]
        self.n_flat, k = len(self.flats), len(problem.unknowns)
        self.low = np.array([*(flat.low / flat.size for flat in self.flats), *([-8.0] * len(self.unknowns))])
        self.high = np.full(self.low.size, 8.0)
        self.high[: self.n_flat] = np.inf
        self.x = np.array([*(flat.start / flat.size for flat in self.flats), *([0.0] * len(self.unknowns))])
        self.labels = [*(flat.name for flat in self.flats), *(unknown.name for unknown in problem.unknowns)]
        self.folded = []
        for i, (name, unknown, low, high) in enumerate(self.of_effects, start=self.n_flat + k):
            amplitude = effects()[name].amplitude
            self.low[i], self.high[i] = unknown.z(low), unknown.z(high)
            if unknown.name == amplitude.name and amplitude.low == 0.0:
                self.folded.append(i)
                self.x[i] = FIRST_Z
            self.labels.append(f"{name}.{unknown.name}")
        for i, unknown in enumerate(problem.unknowns, start=self.n_flat):
            if unknown.name in ("viscous_friction", "displacement"):
                self.low[i] = max(self.low[i], unknown.z(1e-9 * unknown.a))
        self.x = np.clip(self.x, self.low + 1e-6, self.high - 1e-6)

    def residuals(self, x: np.ndarray) -> list[np.ndarray]:
        """Readings less predictions [SI]."""
        values = {flat.name: float(x[i] * flat.size) for i, flat in enumerate(self.flats)}
        chosen: dict[str, dict[str, float]] = {}
        k = len(self.problem.unknowns)
        for i, unknown in enumerate(self.problem.unknowns, start=self.n_flat):
            values[unknown.name] = float(unknown.value(np.asarray(x[i])))
        for i, (name, unknown, _, _) in enumerate(self.of_effects, start=self.n_flat + k):
            chosen.setdefault(name, {})[unknown.name] = float(unknown.value(np.asarray(x[i])))
        predicted = self.problem.predict(values, chosen)
        return [one.value - p for one, p in zip(self.problem.readings, predicted, strict=True)]

    def whole(self, x: np.ndarray, noise: _Noise) -> np.ndarray:
        """Whitened residuals and, behind them, the standard normal unknowns: half its square is the cost."""
        return np.concatenate([*_white(self.problem, self.residuals(x), noise), x[self.n_flat :]])

    def estimates(self, x: np.ndarray, covariance: np.ndarray) -> dict[str, Estimate]:
        """Each unknown in its own unit."""
        found = {}
        for i, label in enumerate(self.labels):
            sd = math.sqrt(max(covariance[i, i], 0.0))
            if i < self.n_flat:
                flat = self.flats[i]
                found[label] = Estimate(float(x[i] * flat.size), sd * flat.size, flat.unit)
            else:
                unknown = self.unknowns[i - self.n_flat]
                value = float(unknown.value(np.asarray(x[i])))
                spread = unknown.b * sd if unknown.kind == "normal" else value * math.log(unknown.b) * sd
                found[label] = Estimate(value, spread, unknown.unit)
        return found


def fit_rig(problem: RigProblem, names: Sequence[str] = ()) -> RigFit:
    """The most probable point with a set of effects.

    Parameters
    ----------
    problem : RigProblem
        The recording.
    names : sequence of str
        Effect ids; none for the base model, viscous friction alone.

    Raises
    ------
    ValueError
        For an effect that this rig cannot show.
    """
    foreign = sorted(set(names) - set(problem.could_show))
    if foreign:
        raise ValueError(f"{problem.kind}: {', '.join(foreign)} cannot show; it knows {', '.join(problem.could_show)}")
    at = _Coordinates(problem, sorted(names))
    x, noise = at.x, _Noise()
    cost = math.inf
    for _ in range(MOST_ROUNDS):
        noise = _noise(problem, at.residuals(x), noise)
        x = _nearest(at, x, noise)
        before, cost = cost, _cost(problem, at, x, noise)
        if before - cost < SETTLED:
            break
    J = _jacobian(at, x, noise)
    A = J.T @ J
    covariance = np.linalg.pinv(A)
    evidence = -cost - 0.5 * float(np.linalg.slogdet(A)[1])
    for i in at.folded:  # the prior's half that is allowed counts twice, the posterior's cut is lost
        evidence += math.log(2.0) + float(log_ndtr(x[i] / math.sqrt(max(covariance[i, i], 1e-12))))
    held = [label for i, label in enumerate(at.labels) if x[i] - at.low[i] < 1e-3 or at.high[i] - x[i] < 1e-3]
    return RigFit(
        tuple(sorted(names)),
        at.estimates(x, covariance),
        evidence,
        {channel: math.exp(u) for channel, u in noise.u.items()},
        dict(noise.rho),
        tuple(at.residuals(x)),
        tuple(held),
    )


def _nearest(at: _Coordinates, x: np.ndarray, noise: _Noise) -> np.ndarray:
    """The most probable point at given noise."""
    found = least_squares(
        lambda point: at.whole(point, noise),
        x,
        jac=lambda point: _jacobian(at, point, noise),
        bounds=(at.low, at.high),
        x_scale="jac",
        ftol=1e-6,
        xtol=1e-5,
        gtol=1e-6,
        max_nfev=40,
    )
    return np.asarray(found.x)


def _white(problem: RigProblem, residuals: Sequence[np.ndarray], noise: _Noise) -> list[np.ndarray]:
    white = []
    for one, r in zip(problem.readings, residuals, strict=True):
        scaled = one.white(r) * math.exp(-noise.u.get(one.channel, 0.0))
        rho = noise.rho.get(one.channel, 0.0) if one.serial else 0.0
        if rho:
            scaled = np.concatenate([scaled[:1], (scaled[1:] - rho * scaled[:-1]) / math.sqrt(1.0 - rho * rho)])
        white.append(scaled)
    return white


def _log_scale(problem: RigProblem, noise: _Noise) -> float:
    total = 0.0
    for one in problem.readings:
        rho = noise.rho.get(one.channel, 0.0) if one.serial else 0.0
        total += one.value.size * noise.u.get(one.channel, 0.0)
        total += 0.5 * max(one.value.size - 1, 0) * math.log(1.0 - rho * rho)
    return total + 0.5 * sum((u / NOISE_SD) ** 2 for u in noise.u.values())


def _cost(problem: RigProblem, at: _Coordinates, x: np.ndarray, noise: _Noise) -> float:
    """Minus the log posterior, up to a constant."""
    return 0.5 * float(np.sum(at.whole(x, noise) ** 2)) + _log_scale(problem, noise)


def _noise(problem: RigProblem, residuals: Sequence[np.ndarray], noise: _Noise) -> _Noise:
    """Noise scale and correlation that suit the residuals best, channel by channel."""
    found = _Noise(dict(noise.u), dict(noise.rho))
    for channel in {one.channel: None for one in problem.readings}:
        serial = any(one.serial for one in problem.readings if one.channel == channel)
        best = math.inf
        for rho in CORRELATIONS if serial else (0.0,):
            tried = _Noise(found.u | {channel: 0.0}, found.rho | {channel: float(rho)})
            parts = zip(problem.readings, _white(problem, residuals, tried), strict=True)
            white = [w for one, w in parts if one.channel == channel]
            n, square = sum(w.size for w in white), sum(float(np.sum(w * w)) for w in white)
            u = 0.5 * math.log(max(square / max(n, 1), 1e-12))
            for _ in range(30):  # of n u + square exp(-2u) / 2 + (u / sd)^2 / 2, by Newton
                slope = n - square * math.exp(-2.0 * u) + u / NOISE_SD**2
                u -= min(max(slope / (2.0 * square * math.exp(-2.0 * u) + NOISE_SD**-2), -0.5), 0.5)
            tried.u[channel] = u
            cost = 0.5 * square * math.exp(-2.0 * u) + _log_scale(problem, tried)
            if cost < best:
                best, kept = cost, (u, float(rho))
        found.u[channel], found.rho[channel] = kept
    return found


def _jacobian(at: _Coordinates, x: np.ndarray, noise: _Noise) -> np.ndarray:
    here = at.whole(x, noise)
    J = np.empty((here.size, x.size))
    for i in range(x.size):
        step = 1e-3 * max(abs(x[i]), 1.0) * (1.0 if i >= at.n_flat else 1e-2)
        step = step if x[i] + step <= at.high[i] else -step
        moved = x.copy()
        moved[i] += step
        J[:, i] = (at.whole(moved, noise) - here) / step
    return J
