"""The most probable point of another rig's model with a set of effects, and its evidence by Laplace's approximation.

Noise scales (log-normal 0.3 a channel) and, along a transient, the correlation of neighbouring readings are fitted too,
so that a diagnosis weighs what a recording shows and not how many rows it has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, log_ndtr

from calibration.diagnosis.other_rigs.coordinates import Coordinates, Estimate
from calibration.diagnosis.other_rigs.noise import Noise, log_scale, noise_of, whitened
from calibration.diagnosis.other_rigs.problem import RigProblem

MOST_ROUNDS = 8
SETTLED = 0.02  # nats
MOST_STEPS = 40  # of a search at given noise
CONVERGED = 1e-4  # nats
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e9
TOUCHES = 1e-9  # a bound


@dataclass(frozen=True)
class RigFit:
    """A fitted model.

    Attributes
    ----------
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


def fit_rig(problem: RigProblem, names: Sequence[str] = (), start: RigFit | None = None) -> RigFit:
    """The most probable point with a set of effects.

    Parameters
    ----------
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
    noise = Noise()  # as declared at first: what the start is off by would pass for noise, and hold the search there
    x = _nearest(at, at.x if start is None else at.begun(start.estimates), noise)
    cost = math.inf
    for _ in range(MOST_ROUNDS):
        noise = noise_of(problem.readings, at.residuals(x))
        x = _nearest(at, x, noise)
        before, cost = cost, _cost(at, x, noise)
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


def _nearest(at: Coordinates, x: np.ndarray, noise: Noise) -> np.ndarray:
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


def _cost(at: Coordinates, x: np.ndarray, noise: Noise) -> float:
    """Minus the log posterior, up to a constant."""
    return 0.5 * float(np.sum(at.whole(x, noise) ** 2)) + log_scale(at.problem.readings, noise)


def _jacobian(at: Coordinates, x: np.ndarray, noise: Noise, here: np.ndarray) -> np.ndarray:
    J = np.zeros((here.size, x.size))
    values, _ = at.values(x)
    predicted = [one.value - r for one, r in zip(at.problem.readings, at.residuals(x), strict=True)]
    for i in range(x.size):
        slope = at.problem.slope(at.labels[i], values, predicted) if i >= at.n_flat else None
        if slope is not None:
            b = at.unknowns[i - at.n_flat].b
            white = whitened(at.problem.readings, [-b * part for part in slope], noise)
            J[: here.size - (x.size - at.n_flat), i] = np.concatenate(white)
            J[here.size - x.size + i, i] = 1.0
            continue
        step = 1e-3 * max(abs(x[i]), 1.0) * (1.0 if i >= at.n_flat else 1e-2)
        step = step if x[i] + step <= at.high[i] else -step
        moved = x.copy()
        moved[i] += step
        J[:, i] = (at.whole(moved, noise) - here) / step
    return J
