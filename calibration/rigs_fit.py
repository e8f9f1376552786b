"""The most probable point of another rig's model with a set of effects, and its evidence by Laplace's approximation.

Noise scales (log-normal 0.3 a channel) and, along a transient, the correlation of neighbouring readings are fitted too,
so that a diagnosis weighs what a recording shows and not how many rows it has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import erfcx, log_ndtr

from calibration.priors import NOISE_FACTOR
from calibration.rigs_problem import RigProblem
from model.effects import effects

NOISE_SD = math.log(NOISE_FACTOR)
CORRELATIONS = np.linspace(-0.6, 0.95, 32)
MOST_ROUNDS = 8
SETTLED = 0.02  # nats
MOST_STEPS = 40  # of a search at given noise
CONVERGED = 1e-4  # nats
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e9
TOUCHES = 1e-9  # a bound
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
        Of each of the problem's readings, by label: factor on the declared noise, correlation of neighbours [-].
    residuals : tuple of ndarray
        Reading less prediction of each of the problem's readings [SI].
    at_bound : tuple of str
        Unknowns that a bound holds: wanted beyond what an engineer would believe, or an absent effect.
    point : ndarray, shape (m,)
        The most probable point in the search's own coordinates, of `Coordinates` [-].
    covariance : ndarray, shape (m, m)
        Of it [-].
    """

    names: tuple[str, ...]
    estimates: dict[str, Estimate]
    log_evidence: float
    noise_scale: dict[str, float]
    correlation: dict[str, float]
    residuals: tuple[np.ndarray, ...]
    at_bound: tuple[str, ...]
    point: np.ndarray
    covariance: np.ndarray


@dataclass
class _Noise:
    """Logarithm of the scale, and correlation, of each of the readings, by label."""

    u: dict[str, float] = field(default_factory=dict)
    rho: dict[str, float] = field(default_factory=dict)


class Coordinates:
    """What a search moves: flat unknowns over their size, then standard normal numbers.

    Parameters
    ----------
    problem : RigProblem
        The recording.
    names : sequence of str
        Effect ids.
    """

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

    def values(self, x: np.ndarray) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Unknowns by name, and the effects' parameters [SI].

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        """
        values = {flat.name: float(x[i] * flat.size) for i, flat in enumerate(self.flats)}
        chosen: dict[str, dict[str, float]] = {}
        k = len(self.problem.unknowns)
        for i, unknown in enumerate(self.problem.unknowns, start=self.n_flat):
            values[unknown.name] = float(unknown.value(np.asarray(x[i])))
        for i, (name, unknown, _, _) in enumerate(self.of_effects, start=self.n_flat + k):
            chosen.setdefault(name, {})[unknown.name] = float(unknown.value(np.asarray(x[i])))
        return values, chosen

    def begun(self, fit: RigFit) -> np.ndarray:
        """A start at another fit's estimates, where it has them [-].

        Parameters
        ----------
        fit : RigFit
            Of the same recording.
        """
        x = self.x.copy()
        for i, label in enumerate(self.labels):
            if label in fit.estimates:
                mean = fit.estimates[label].mean
                x[i] = mean / self.flats[i].size if i < self.n_flat else self.unknowns[i - self.n_flat].z(mean)
        return np.clip(x, self.low + 1e-6, self.high - 1e-6)

    def residuals(self, x: np.ndarray) -> list[np.ndarray]:
        """Readings less predictions [SI].

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        """
        values, chosen = self.values(x)
        predicted = self.problem.predict(values, chosen)
        return [one.value - p for one, p in zip(self.problem.readings, predicted, strict=True)]

    def whole(self, x: np.ndarray, noise: _Noise) -> np.ndarray:
        """Whitened residuals and, behind them, the standard normal unknowns: half its square is the cost.

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        noise : _Noise
            Scales and correlations.
        """
        return np.concatenate([*_white(self.problem, self.residuals(x), noise), x[self.n_flat :]])

    def estimates(self, x: np.ndarray, covariance: np.ndarray) -> dict[str, Estimate]:
        """Each unknown in its own unit.

        Parameters
        ----------
        x : ndarray, shape (m,)
            A point [-].
        covariance : ndarray, shape (m, m)
            Of it [-].
        """
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


def fit_rig(problem: RigProblem, names: Sequence[str] = (), start: RigFit | None = None) -> RigFit:
    """The most probable point with a set of effects.

    Parameters
    ----------
    problem : RigProblem
        The recording.
    names : sequence of str
        Effect ids; none for the base model, viscous friction alone.
    start : RigFit or None
        A fit to begin at, of fewer effects or of others.

    Raises
    ------
    ValueError
        For an effect that this rig cannot show.
    """
    foreign = sorted(set(names) - set(problem.could_show))
    if foreign:
        raise ValueError(f"{problem.kind}: {', '.join(foreign)} cannot show; it knows {', '.join(problem.could_show)}")
    at = Coordinates(problem, sorted(names))
    noise = _Noise()  # as declared at first: what the start is off by would pass for noise, and hold the search there
    x = _nearest(at, at.x if start is None else at.begun(start), noise)
    cost = math.inf
    for _ in range(MOST_ROUNDS):
        noise = _noise(problem, at.residuals(x))
        x = _nearest(at, x, noise)
        before, cost = cost, _cost(problem, at, x, noise)
        if before - cost < SETTLED:
            break
    here = at.whole(x, noise)
    J = _jacobian(at, x, noise, here)
    A = J.T @ J
    covariance = np.linalg.pinv(A)
    evidence = -cost - 0.5 * float(np.linalg.slogdet(A)[1])
    slope = J.T @ here
    for i in range(x.size):
        folded = i in at.folded  # the prior's half that is allowed counts twice
        evidence += math.log(2.0) * folded
        if x[i] - at.low[i] < 1e-3 and slope[i] > 0.0:  # the posterior falls from the bound: its integral, not a peak's
            evidence += math.log(0.5 * erfcx(slope[i] * math.sqrt(0.5 * max(covariance[i, i], 1e-12))))
        elif folded:  # what the bound cuts off is lost
            evidence += float(log_ndtr(x[i] / math.sqrt(max(covariance[i, i], 1e-12))))
    held = [label for i, label in enumerate(at.labels) if x[i] - at.low[i] < 1e-3 or at.high[i] - x[i] < 1e-3]
    return RigFit(
        tuple(sorted(names)),
        at.estimates(x, covariance),
        evidence,
        {label: math.exp(u) for label, u in noise.u.items()},
        dict(noise.rho),
        tuple(at.residuals(x)),
        tuple(held),
        x,
        covariance,
    )


def _nearest(at: Coordinates, x: np.ndarray, noise: _Noise) -> np.ndarray:
    """The most probable point at given noise, by Levenberg and Marquardt within the bounds."""
    r = at.whole(x, noise)
    damping = FIRST_DAMPING
    for _ in range(MOST_STEPS):
        J = _jacobian(at, x, noise, r)
        A, g = J.T @ J, J.T @ r
        free = ~((x <= at.low + TOUCHES) & (g > 0.0)) & ~((x >= at.high - TOUCHES) & (g < 0.0))
        if not free.any():
            break
        gained = 0.0
        while damping < MOST_DAMPING:
            scaled = A[np.ix_(free, free)] + damping * np.diag(np.maximum(np.diag(A)[free], 1e-12))
            tried = x.copy()
            tried[free] -= np.linalg.solve(scaled, g[free])
            tried = np.clip(tried, at.low, at.high)
            there = at.whole(tried, noise)
            gained = 0.5 * float(r @ r - there @ there)
            if gained > 0.0:
                x, r, damping = tried, there, max(damping * 0.1, LEAST_DAMPING)
                break
            damping *= 10.0
        if gained < CONVERGED:
            break
    return x


def uncorrelated(white: np.ndarray, rho: float) -> np.ndarray:
    """Take the correlation of neighbours out of whitened residuals [-].

    Parameters
    ----------
    white : ndarray, shape (n,) or (n, k)
        Residuals in units of their noise [-].
    rho : float
        Correlation of neighbours [-].
    """
    if not rho:
        return white
    return np.concatenate([white[:1], (white[1:] - rho * white[:-1]) / math.sqrt(1.0 - rho * rho)])


def _white(problem: RigProblem, residuals: Sequence[np.ndarray], noise: _Noise) -> list[np.ndarray]:
    return [
        uncorrelated(one.white(r) * math.exp(-noise.u.get(one.label, 0.0)), noise.rho.get(one.label, 0.0))
        for one, r in zip(problem.readings, residuals, strict=True)
    ]


def _log_scale(problem: RigProblem, noise: _Noise) -> float:
    total = 0.0
    for one in problem.readings:
        rho = noise.rho.get(one.label, 0.0)
        total += one.value.size * noise.u.get(one.label, 0.0)
        total += 0.5 * max(one.value.size - 1, 0) * math.log(1.0 - rho * rho)
    return total + 0.5 * sum((u / NOISE_SD) ** 2 for u in noise.u.values())


def _cost(problem: RigProblem, at: Coordinates, x: np.ndarray, noise: _Noise) -> float:
    """Minus the log posterior, up to a constant."""
    return 0.5 * float(np.sum(at.whole(x, noise) ** 2)) + _log_scale(problem, noise)


def _noise(problem: RigProblem, residuals: Sequence[np.ndarray]) -> _Noise:
    """Noise scale and correlation that suit the residuals best, one array after the other."""
    found = _Noise()
    for one, r in zip(problem.readings, residuals, strict=True):
        white, best = one.white(r), math.inf
        n = white.size
        for rho in CORRELATIONS if one.serial else (0.0,):
            square = float(np.sum(uncorrelated(white, float(rho)) ** 2))
            u = 0.5 * math.log(max(square / max(n, 1), 1e-12))
            for _ in range(30):  # of n u + square exp(-2u) / 2 + (u / sd)^2 / 2, by Newton
                slope = n - square * math.exp(-2.0 * u) + u / NOISE_SD**2
                step = slope / (2.0 * square * math.exp(-2.0 * u) + NOISE_SD**-2)
                u -= min(max(step, -0.5), 0.5)
                if abs(step) < 1e-9:
                    break
            cost = 0.5 * square * math.exp(-2.0 * u) + n * u + 0.5 * (u / NOISE_SD) ** 2
            cost += 0.5 * max(n - 1, 0) * math.log(1.0 - rho * rho)
            if cost < best:
                best, found.u[one.label], found.rho[one.label] = cost, u, float(rho)
    return found


def _jacobian(at: Coordinates, x: np.ndarray, noise: _Noise, here: np.ndarray) -> np.ndarray:
    J = np.zeros((here.size, x.size))
    values, _ = at.values(x)
    predicted = [one.value - r for one, r in zip(at.problem.readings, at.residuals(x), strict=True)]
    for i in range(x.size):
        slope = at.problem.slope(at.labels[i], values, predicted) if i >= at.n_flat else None
        if slope is not None:
            b = at.unknowns[i - at.n_flat].b
            white = _white(at.problem, [-b * part for part in slope], noise)
            J[: here.size - (x.size - at.n_flat), i] = np.concatenate(white)
            J[here.size - x.size + i, i] = 1.0
            continue
        step = 1e-3 * max(abs(x[i]), 1.0) * (1.0 if i >= at.n_flat else 1e-2)
        step = step if x[i] + step <= at.high[i] else -step
        moved = x.copy()
        moved[i] += step
        J[:, i] = (at.whole(moved, noise) - here) / step
    return J
