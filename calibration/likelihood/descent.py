"""The search for a model's most probable point: Gauss-Newton. Steps that do not lower the cost are shortened."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.likelihood.compared import Compared, Prediction
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, close, cost_at, robust_weights, suiting_noise
from calibration.unknowns.effects import is_size
from calibration.unknowns.priors import NOISE_SD

LARGEST_MOVE = 6.0
MOST_PASSES = 30
HALVINGS = 8  # of an effect with which the motor stalls
TRIES = 4  # of a step that does not lower the cost: as far as the parabola through the last says, and
LONGEST, SHORTEST = 0.5, 0.1  # shares of that one between which it is held
LEAST_GAIN = 0.005  # nats; a step that promises less is not tried shorter
SAME = 0.1  # prior sds; two ends of searches that are no farther apart in any direction are one
SETTLED = 0.01  # squared length of a move, in posterior sds, below which a search ends
NOISE_SETTLED = 0.05  # of the noise's prior sds: a larger change asks for another point
HOPELESS = 70.0  # nats behind the best set's end from which a search is not gone on with
LITTLE = 1.0  # nats that a search so far behind has to gain by a step
STALE = 25.0  # squared length of a step, in posterior sds, after which derivatives are taken anew
PULLED = 3.0  # sds from which a nuisance is handed over to the effect that has its form


@dataclass(frozen=True)
class _Point:
    """Where a search stands: the unknowns, the noise, derivatives once they are known, prediction."""

    z: np.ndarray
    u: np.ndarray
    D: np.ndarray
    predicted: Prediction


def find(
    comparison: Compared,
    names: Sequence[str],
    *starts: Mode | None,
    first: dict[tuple[str, str], float] | None = None,
    best: float = math.inf,
) -> Mode:
    """The most probable point of the base model with a set of effects.

    Parameters
    ----------
    *starts : Mode or None
        Modes of smaller or equal sets to start from; None for the prior's middle, which is taken when nothing is given.
    best : float
        Cost of another set. A search that stays far behind ends early [-].

    Raises
    ------
    ArithmeticError
        When the model gives no reading at any start.
    """
    f = Function(comparison, names)
    ends = []
    for point in _begun(comparison, f, starts or (None,), first or {}):
        z, predicted = comparison.turned(f, point.z, point.u, point.predicted)
        ends.append(_descend(f, comparison, replace(point, z=z, predicted=predicted), behind=best + HOPELESS))
    costs = [_cost(comparison, end) for end in ends]
    nearest = ends[int(np.argmin(costs))]
    if min(costs) > best + HOPELESS:
        return _closed(comparison, names, nearest)
    # With runs in time a search takes its time: the best alone goes on.
    ends = [nearest] if comparison.in_time else _apart(ends)
    ends += [_trusting(f, comparison, end) for end in ends if _some_bad(comparison, end)]
    ends = [_descend(f, comparison, end, correlated=True, found=True) for end in ends]
    return max((_closed(comparison, names, end) for end in ends), key=lambda mode: mode.log_evidence)


def _closed(comparison: Compared, names: Sequence[str], end: _Point) -> Mode:
    return close(comparison, names, end.z, end.u, end.D, end.predicted)


def _cost(comparison: Compared, at: _Point, found: bool = False) -> float:
    return cost_at(comparison, at.z, at.u, at.predicted, found)


def _begun(
    comparison: Compared, f: Function, starts: Sequence[Mode | None], first: dict[tuple[str, str], float]
) -> list[_Point]:
    """The points to start from.

    A start at which the model gives no reading is left out where another does.
    """
    found = []
    for start in starts:
        with contextlib.suppress(ArithmeticError):
            found.append(_begin(comparison, f, start, first))
    if not found:
        what = " and ".join(f.names) or "nothing added"
        raise ArithmeticError(f"the model with {what} gives no reading to start from")
    handed = [other for point in found if (other := _handed_over(comparison, f, point)) is not None]
    return [*found, *handed]


def _handed_over(comparison: Compared, f: Function, point: _Point) -> _Point | None:
    """A point with what a nuisance is pulled by handed over to the effect that has its form; None where none is.

    The two multiply or add up to the same: along that ridge, which may be curved, a search creeps.
    """
    problem, z = comparison.problem, point.z.copy()
    for i, (name, unknown) in enumerate(problem.effect_unknowns(f.names), start=f.k):
        effect, nuisance_of = problem.effect(name), problem.nuisance_of(name, unknown.name)
        is_handed = nuisance_of and is_size(unknown.name, effect.amplitude)
        place = problem.place(nuisance_of) if is_handed else None
        if place is None or abs(z[place]) < PULLED:
            continue
        nuisance = problem.nuisances[place]
        pulled, usual = (float(one) for one in nuisance.value(np.array([z[place], 0.0])))
        z[i] = unknown.z(pulled / usual - 1.0 if effect.factors else (pulled - usual) * problem.in_si(nuisance.name))
        z[place] = 0.0
    if np.array_equal(z, point.z):
        return None
    z = f.clip(z)
    try:
        predicted = f(z)
    except ArithmeticError:
        return None
    if not comparison.is_told(predicted):
        return None
    return _Point(z, point.u, point.D, predicted)


def _begin(comparison: Compared, f: Function, start: Mode | None, first: dict[tuple[str, str], float]) -> _Point:
    """A point to start from, at which the model gives readings."""
    problem, k = comparison.problem, f.k
    extra = problem.effect_unknowns(f.names)
    z, u = np.zeros(k + len(extra)), np.zeros(comparison.noise.spread.size)
    D = np.zeros((comparison.read.size, z.size))
    values: dict[tuple[str, str], float] = {}
    if start is not None:
        scales = comparison.noise.scales
        z[:k], u[scales] = start.z[:k], np.clip(start.u[scales], -NOISE_SD, NOISE_SD)
        D[:, :k] = start.D[:, :k]
        values = {(e, x.name): start.z[k + i] for i, (e, x) in enumerate(problem.effect_unknowns(start.names))}
    else:
        z[:k] = comparison.middle()
    values |= first
    amplitudes = []
    for i, (name, unknown) in enumerate(extra):
        z[k + i] = values.get((name, unknown.name), 0.0)
        if is_size(unknown.name, problem.amplitude(name)):
            amplitudes.append(k + i)
            if len(problem.effect(name).parameters) > 1 and abs(z[k + i]) < 0.05:
                z[k + i] = 0.1  # at an amplitude of 0 nothing can be said of its shape
    z = f.clip(z)
    for _ in range(HALVINGS):
        predicted = f(z)
        if comparison.is_told(predicted):
            return _Point(z, u, D, predicted)
        z[amplitudes] *= 0.5  # the motor may stall with as much of an effect
    raise ArithmeticError("no reading, however little of an effect there is")


def _descend(
    f: Function,
    comparison: Compared,
    at: _Point,
    fresh: bool = True,
    correlated: bool = False,
    found: bool = False,
    behind: float = math.inf,
) -> _Point:
    """Gauss-Newton steps until one is short.

    With a cost above `behind`, a step that gains little is the last too. Derivatives are taken anew only after a long
    step: those of a place near by lead to the same point.
    """
    for _ in range(MOST_PASSES):
        if fresh:
            at = replace(at, D=f.derivatives(at.z, at.predicted, at.D, at.u))
        white = comparison.whitener(at.predicted, at.u)
        r, J = white(comparison.read - comparison.raw(at.predicted)), white(at.D)
        weight, _ = robust_weights(r, comparison, found)
        A = (J * weight[:, None]).T @ J + np.eye(at.z.size)
        z, predicted, cost, gain = _step(f, comparison, at, A, (J * weight[:, None]).T @ r - at.z, found)
        far = float((z - at.z) @ A @ (z - at.z))
        u = suiting_noise(comparison, predicted, at.u, at.D, correlated, found)
        stands = float(np.max(np.abs(u - at.u) / comparison.noise.spread)) < NOISE_SETTLED
        at = _Point(z, u, at.D, predicted)
        if far < SETTLED and stands and (fresh or far > 0.0):
            break
        if cost > behind and gain < LITTLE and fresh:
            break
        fresh = far > STALE or far == 0.0  # where old derivatives lead nowhere, new ones may
    return at


def _apart(ends: Sequence[_Point]) -> list[_Point]:
    """Ends of searches, one of those that came to the same place."""
    kept: list[_Point] = []
    for end in ends:
        if all(float(np.max(np.abs(end.z - one.z))) > SAME for one in kept):
            kept.append(end)
    return kept


def _some_bad(comparison: Compared, end: _Point) -> bool:
    """Whether any reading is taken for bad at the end of a search."""
    white = comparison.whitener(end.predicted, end.u)
    return bool(np.any(robust_weights(white(comparison.read - comparison.raw(end.predicted)), comparison)[1] > 0.5))


def _trusting(f: Function, comparison: Compared, at: _Point) -> _Point:
    """A search that takes no reading for bad, and from its end one that may, but for a whole level.

    Close to a stall the speed hangs so steeply on everything that a level given up for bad pulls no more, though a
    little way on it would fit.
    """
    ends = []
    for z in comparison.loosened(f, at.z, at.predicted, at.D):
        comparison.trusting = True
        try:
            end = _descend(f, comparison, replace(at, z=z, predicted=f(z)), fresh=z is not at.z)
        finally:
            comparison.trusting = False
        ends.append(_descend(f, comparison, end, fresh=False, found=True))
    return min(ends, key=lambda end: _cost(comparison, end, found=True))


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


def _step(
    f: Function,
    comparison: Compared,
    at: _Point,
    A: np.ndarray,
    downhill: np.ndarray,
    is_end: bool,
) -> tuple[np.ndarray, Prediction, float, float]:
    """A share of a step that lowers the cost, the prediction and the cost there, and the gain; no step if none does."""
    before = _cost(comparison, at, is_end)
    whole = _bounded(A, downhill, f.low - at.z, f.high - at.z)
    falls, share = float(whole @ downhill), 1.0
    for _ in range(TRIES):
        move = share * whole
        move *= min(1.0, LARGEST_MOVE / max(float(np.max(np.abs(move))), 1e-12))
        tried = f.along_valley(at.z, f.clip(f.advance(at.z, move)), at.predicted, at.D)
        found, rise = f(tried), math.inf
        if comparison.is_told(found):
            rise = cost_at(comparison, tried, at.u, found, is_end) - before
            if rise <= 1e-6:
                return tried, found, before + rise, -rise
        lowest = falls * share / (2.0 * (rise / share + falls))
        share *= min(max(lowest / share, SHORTEST), LONGEST) if math.isfinite(lowest) else SHORTEST
        if falls * share < LEAST_GAIN:
            break
    return at.z, at.predicted, before, 0.0
