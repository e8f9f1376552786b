"""Whether the named set predicts readings that it has not seen.

Blocks are pressure levels (both directions together) and segments of the runs in time, or whole runs where there are
several. The levels of a fold lie apart, so that what goes with the running time has readings before and after. In each
fold the sets are weighed anew on the readings that are left, and with these weights they predict those that are not
together, in the model made linear at each set's own most probable point. The best alone would not do: where one block
tells two sets apart, the other blocks cannot choose between them.

A declared figure of the motor or of an instrument is a reading too, and is held out as one: a model that needs an
inertia far from what was declared explains every reading, and predicts the inertia badly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from scipy.special import log_softmax, logsumexp, softmax

from calibration.diagnosis.steps.candidate import Candidate
from calibration.likelihood.bad_reading import BAD, bad_weight, log_bad
from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import GOOD
from calibration.likelihood.mode import Mode


class Predicted(StrEnum):
    """What was predicted, and by what."""

    BY_SET = "set"  # folds, by the sets of effects as probable as they are without them
    BY_CORRECTION = "correction"  # folds, by a smooth correction
    UNSEEN_RUN = "unseen run"  # a run of its own, by the set that was named


SELECTED = {
    Predicted.BY_SET: ", selection repeated in each fold",
    Predicted.BY_CORRECTION: "; the correction's coordinate, length and size weighed anew in each fold",
}


@dataclass(frozen=True)
class HeldOut:
    """What the held-out readings say.

    `folds`, `same`: folds, and those in which the same set was the most probable [-].
    `before`, `after`: rmse by channel, of the base model and of the sets weighed [SI].
    `gain`, `gain_se`: in log predictive density, and its standard error over the blocks [-].
    `declared`: the same of the declared figures, each predicted from the readings and the other figures [-].
    `size`: root mean square of the readings themselves by channel [SI]; empty where it is not told.
    """

    folds: int
    same: int
    before: dict[str, float]
    after: dict[str, float]
    gain: float
    gain_se: float
    scheme: str
    kind: Predicted
    size: dict[str, float] = field(default_factory=dict)
    declared: float = 0.0


def cross_validate(
    comparison: Compared, found: Sequence[Candidate], names: tuple[str, ...], choose: bool = True
) -> HeldOut:
    """Predict each block from the others.

    `choose`: whether the sets are weighed anew in each fold; otherwise ``names`` alone predicts.
    """
    blocks = comparison.folds()[0]
    others = [c for c in found if not c.refused or not c.names]
    counts = [choose or one.names == names for one in others]
    # With nothing held out a set has the weight that it has in the whole recording: prior, doubt and bounds are in it.
    whole = [fit_on(comparison, one.mode, comparison.known) for one in others]
    beside = [one.log_probability - evidence for one, (_, _, evidence) in zip(others, whole, strict=True)]
    of_base = next(i for i, one in enumerate(others) if not one.names)
    gains, same = [], 0
    errors: dict[str, list[np.ndarray]] = {"before": [], "after": []}
    for held in blocks:
        log_weights, densities, left = [], [], []
        for one, its, is_weighed in zip(others, beside, counts, strict=True):
            z, A, evidence = fit_on(comparison, one.mode, ~held)
            density, error = predict_held(comparison, one.mode, z, A, held)
            log_weights.append(evidence + its if is_weighed else -math.inf)
            densities.append(density)
            left.append(error)
        weights = softmax(log_weights)
        same += others[int(np.argmax(weights))].names == names
        gains.append(float(logsumexp(densities + log_softmax(log_weights))) - densities[of_base])
        errors["before"].append(left[of_base])
        errors["after"].append(weights @ np.array(left))
    of_figures = np.array([_declared(comparison, z, A) for z, A, _ in whole])
    log_weights = np.array([one.log_probability for one in others])[:, None] - of_figures
    log_weights[~np.array(counts)] = -math.inf
    declared = logsumexp(of_figures + log_softmax(log_weights, axis=0), axis=0) - of_figures[of_base]
    return replace(summed_up(comparison, blocks, int(same), gains, errors), declared=float(np.sum(declared)))


def _declared(comparison: Compared, z: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Log density of each declared figure given all readings and the other figures, shape (k,), but for a constant.

    What belongs to a run in time alone, such as the angle at which it starts, nobody has declared.

    `z`, shape (n,): the most probable point [-].
    `A`, shape (n, n): its precision [-].
    """
    figures = [i for i in range(len(comparison.problem.nuisances)) if comparison.problem.run_of(i) is None]
    # Without its own prior, N(0, 1), the variance of a figure is v and its mean m: 1 / v = 1 / C_ii - 1.
    C = np.diag(np.linalg.inv(A))[figures]
    rest = np.maximum(1.0 - C, np.finfo(float).eps)
    m, one_and_v = z[figures] / rest, 1.0 / rest
    return -0.5 * (m**2 / one_and_v + np.log(one_and_v))


def summed_up(
    comparison: Compared,
    folds: Sequence[np.ndarray],
    same: int,
    gains: Sequence[float],
    errors: dict[str, list[np.ndarray]],
    kind: Predicted = Predicted.BY_SET,
) -> HeldOut:
    """What the folds say together.

    `folds`, shape (m,): readings held out in each.
    `errors`: of the readings held out in each, ``before`` and ``after`` [SI].
    """
    index = np.concatenate([np.flatnonzero(held) for held in folds])
    rmse = {key: by_channel(comparison, index, np.concatenate(errors[key])) for key in errors}
    se = float(np.std(gains, ddof=1) * math.sqrt(len(gains))) if len(gains) > 1 else 0.0
    scheme = f"{comparison.folds()[1]}{SELECTED[kind]}"
    size = by_channel(comparison, index, comparison.read[index]) if comparison.rig else {}
    return HeldOut(len(folds), same, rmse["before"], rmse["after"], float(np.sum(gains)), se, scheme, kind, size)


def fit_on(comparison: Compared, mode: Mode, used: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Most probable point, precision and log evidence on some of the readings, in the linear model of a mode.

    `used`, shape (m,): readings that are used.
    Returns `z`: the point [-]; `A`: its precision [-]; `evidence`: natural logarithm [-].
    """
    width, price = _as_read(mode)
    weight = used / width
    J = mode.J * weight[:, None]
    r = (mode.r + mode.J @ mode.z) * weight
    A = J.T @ J + np.eye(mode.z.size)
    z = np.linalg.solve(A, J.T @ r)
    rest = r - J @ z
    white = comparison.whitener(mode.prediction, mode.u)
    counted = used & comparison.known
    logs = float(np.sum(price[counted] - np.log(white.scale[counted])))
    evidence = -0.5 * float(rest @ rest + z @ z) + logs - 0.5 * float(np.linalg.slogdet(A)[1])
    return z, A, evidence


def predict_held(
    comparison: Compared, mode: Mode, z: np.ndarray, A: np.ndarray, held: np.ndarray
) -> tuple[float, np.ndarray]:
    """Log density of held-out readings, and their errors.

    `held`, shape (m,): readings held out.
    Returns `density`: natural logarithm, up to a constant that all models share: all readings held out count in each of
    them, those that it takes for bad with a wide error and at the price of a bad one; `error`: readings less
    predictions, those held out alone [SI].
    """
    width, price = _as_read(mode)
    r = ((mode.r + mode.J @ (mode.z - z)) / width)[held]
    J = (mode.J / width[:, None])[held]
    C = np.eye(r.size) + J @ np.linalg.solve(A, J.T)
    white = comparison.whitener(mode.prediction, mode.u)
    density = -0.5 * float(r @ np.linalg.solve(C, r)) - 0.5 * float(np.linalg.slogdet(C)[1])
    density += float(np.sum((price - np.log(white.scale))[held]))
    error = (comparison.read - comparison.raw(mode.prediction) + mode.D @ (mode.z - z))[held]
    return density, np.nan_to_num(error)


def _as_read(mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Each reading's error in units of its noise, wide where a model takes it for bad, and the log of its price.

    About the mode a bad reading's error is normal, of a width and at a price that are those of its own law there.
    """
    bad, weight = mode.bad >= GOOD, bad_weight(mode.r)
    price = log_bad(mode.r) + 0.5 * weight * mode.r**2
    return np.where(bad, weight**-0.5, 1.0), np.where(bad, price, math.log(1.0 - BAD))


def by_channel(comparison: Compared, index: np.ndarray, error: np.ndarray) -> dict[str, float]:
    """Root mean square of errors by channel [SI]. `error`: readings less predictions [SI]."""
    found = {}
    for key, of_channel in comparison.channels().items():
        mine = of_channel[index]
        if mine.any():
            found[key] = float(np.sqrt(np.mean(error[mine] ** 2)))
    return found
