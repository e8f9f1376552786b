"""The search for a model's most probable point: steps of Gauss and Newton, damped ones where those creep.

Where a step leaves a curved valley, what it did beyond the straight line is taken back along that line. If it still
does not lower the cost, it is shortened. Where shortened steps creep, a damped one turns downhill. Neither is better
everywhere.
Sources: Nocedal and Wright, Numerical Optimization (2006), 18.3 (second-order correction); Marquardt, An algorithm for
least-squares estimation of nonlinear parameters, SIAM J. 11 (1963) 431.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.likelihood.compared import Compared, Prediction
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, close, cost_at, cost_of, robust_weights, suiting_noise
from calibration.unknowns.effects import is_size
from calibration.unknowns.priors import NOISE_SD

LARGEST_MOVE = 6.0
MOST_PASSES = 30
HALVINGS = 8  # of an effect with which the motor stalls
WAYS = 2  # shortened and damped; a search ends where neither gains
SHORTENED, DAMPED = 4, 5  # tries of a step that does not lower the cost, each shorter or more damped
LONGEST, SHORTEST, PARTS = 0.8, 0.1, 30  # of a step that is shortened, in parts of the last; how many are looked at
LEAST_DAMPING, STEEPER = 1e-3, (5.0, 10.0)  # share of A's diagonal to begin with; after a try that failed, times
EASED, TIGHTENED = 10.0, 3.0  # after a step that gained what it promised, through this; much less, times this
GOOD_GAIN, POOR_GAIN, MUCH = 0.7, 0.25, 4.0  # shares of the promised gain, of which no more than so many nats count
SAME_COST = 1e-6  # nats by which a step may raise the cost
LEAST_GAIN = 0.005  # nats; a step that promises less is not tried further
SAME = 0.1  # prior sds; two ends of searches that are no farther apart in any direction are one
SETTLED, ROUGH = 0.01, 0.05  # nats gained by a step, below which a search ends; with runs in time, which leave waves
NOISE_SETTLED = 0.05  # of the noise's prior sds: a larger change asks for another point
HOPELESS = 70.0  # nats behind the best set's end from which a search is not gone on with
LITTLE = 1.0  # nats that a search so far behind has to gain by a step, or that one loses to a bend of its valley
FEW = 2  # effects from which on a set begins where a smaller one ended, with lines that were looked for again
MOST_RELINED, RELINED_GAIN = 3, 1.0  # times that lines are looked for again, while that gains so many nats
MUCH_ELSE = 10.0  # nats that an effect gained, after which other lines may suit the readings
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
    loud: bool = False,
) -> Mode:
    """The most probable point of the base model with a set of effects.

    `*starts`: modes of smaller or equal sets to start from; None for the prior's middle, which is taken when nothing is
        given.
    `best`: cost of another set. A search that stays far behind ends early [-].
    `loud`: whether the noise begins as loud as suits a start; else near what is declared, since what an effect would
        explain may have passed for noise.
    Raises ArithmeticError when the model gives no reading at any start.
    """
    f = Function(comparison, names)
    ends = []
    for point in _begun(comparison, f, starts or (None,), first or {}, loud):
        z, predicted = comparison.turned(f, point.z, point.u, point.predicted)
        ends.append(_descend(f, comparison, replace(point, z=z, predicted=predicted), behind=best + HOPELESS))
    costs = [_cost(comparison, end) for end in ends]
    nearest = ends[int(np.argmin(costs))]
    if min(costs) > best + HOPELESS:
        return _closed(comparison, names, nearest)
    # With runs in time a search takes its time: the best alone goes on.
    ends = [nearest] if comparison.in_time else _apart(ends)
    looks_again = comparison.in_time and len(f.names) < FEW
    if looks_again and f.names and not comparison.problem.effect(f.names[0]).hidden:
        looks_again = _gained(comparison, starts, nearest) > MUCH_ELSE
    ends += [_trusting(f, comparison, end) for end in ends if _some_bad(comparison, end)]
    ends = [_descend(f, comparison, end, correlated=True, found=True) for end in ends]
    if looks_again:
        ends = [_relined(f, comparison, end) for end in ends]
    return max((_closed(comparison, names, end) for end in ends), key=lambda mode: mode.log_evidence)


def _closed(comparison: Compared, names: Sequence[str], end: _Point) -> Mode:
    return close(comparison, names, end.z, end.u, end.D, end.predicted)


def _cost(comparison: Compared, at: _Point, found: bool = False) -> float:
    return cost_at(comparison, at.z, at.u, at.predicted, found)


def _begun(
    comparison: Compared,
    f: Function,
    starts: Sequence[Mode | None],
    first: dict[tuple[str, str], float],
    loud: bool,
) -> list[_Point]:
    """The points to start from. A start at which the model gives no reading is left out where another does."""
    found = []
    for start in starts:
        with contextlib.suppress(ArithmeticError):
            found.append(_begin(comparison, f, start, first, loud))
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


def _begin(
    comparison: Compared, f: Function, start: Mode | None, first: dict[tuple[str, str], float], loud: bool
) -> _Point:
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
            return _Point(z, suiting_noise(comparison, predicted, u, D, False) if loud else u, D, predicted)
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
    """Steps until one gains little by either way.

    With a cost above `behind`, the second step in a row that gains less than a nat is the last too. Derivatives are
    taken anew only after a long step, or one that gained far less than they promised: those of a place near by lead to
    the same point.
    """
    damping, is_damped, stuck, slow = LEAST_DAMPING, False, 0, 0
    settled = ROUGH if comparison.in_time else SETTLED
    for _ in range(MOST_PASSES):
        if fresh:
            at = replace(at, D=f.derivatives(at.z, at.predicted, at.D, at.u))
        steps = _Steps(f, comparison, at, found)
        step, damping = steps.damped(damping) if is_damped else (steps.shortened(), damping)
        far = float((step.z - at.z) @ steps.A @ (step.z - at.z))
        u = suiting_noise(comparison, step.predicted, at.u, at.D, correlated, found)
        stands = float(np.max(np.abs(u - at.u) / comparison.noise.spread)) < NOISE_SETTLED
        at = _Point(step.z, u, at.D, step.predicted)
        ends = step.gain < settled and stands
        stuck = stuck + 1 if ends and (fresh or stuck) else 0
        if stuck == WAYS or (ends and step.promised < settled):
            break
        slow = slow + 1 if step.gain < LITTLE and fresh else 0
        if step.cost > behind and slow == WAYS:
            break
        creeps = step.gain < POOR_GAIN * min(step.promised, MUCH)
        fresh = (far > STALE or creeps) and not (fresh and far == 0.0)
        is_damped ^= creeps
    return at


def _apart(ends: Sequence[_Point]) -> list[_Point]:
    """Ends of searches, one of those that came to the same place."""
    kept: list[_Point] = []
    for end in ends:
        if all(float(np.max(np.abs(end.z - one.z))) > SAME for one in kept):
            kept.append(end)
    return kept


def _gained(comparison: Compared, starts: Sequence[Mode | None], end: _Point) -> float:
    """How much more probable the end of a search is than the best mode that it began with [nats]."""
    begun = [cost_of(comparison, start) for start in starts if start is not None]
    return min(begun, default=math.inf) - _cost(comparison, end)


def _relined(f: Function, comparison: Compared, end: _Point) -> _Point:
    """The end of a search, or where one leads that looks for the lines of runs once more, while that gains."""
    for _ in range(MOST_RELINED):
        try:
            z = comparison.relined(f, end.z, end.u)
            predicted = None if z is None else f(z)
        except ArithmeticError:  # no reading on the way
            break
        if z is None or predicted is None or not comparison.is_told(predicted):
            break
        other = _descend(f, comparison, replace(end, z=z, predicted=predicted))
        other = _descend(f, comparison, other, correlated=True, found=True)
        gain = _cost(comparison, end, found=True) - _cost(comparison, other, found=True)
        end = other if gain > 0.0 else end
        if gain < RELINED_GAIN:
            break
    return end


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


@dataclass(frozen=True)
class _Step:
    """Where a step led: the cost there, what it gained, and what a whole one promised [nats]."""

    z: np.ndarray
    predicted: Prediction
    cost: float
    gain: float
    promised: float


@dataclass(frozen=True)
class _Tried:
    """A point tried, and how much it raises the cost: without a limit where the model gives no reading [nats]."""

    z: np.ndarray
    predicted: Prediction
    rise: float


class _Steps:
    """Steps from a point in its quadratic, `A` and `downhill`, that lower the cost; no step where none does."""

    def __init__(self, f: Function, comparison: Compared, at: _Point, is_end: bool) -> None:
        self.f, self.comparison, self.at, self.is_end = f, comparison, at, is_end
        self.white = comparison.whitener(at.predicted, at.u)
        self.J, self.r = self.white(at.D), self.white(comparison.read - comparison.raw(at.predicted))
        self.weight = robust_weights(self.r, comparison, is_end)[0]
        self.weighed = self.J * self.weight[:, None]
        self.A = self.weighed.T @ self.J + np.eye(at.z.size)
        self.downhill: np.ndarray = self.weighed.T @ self.r - at.z
        self.before = _cost(comparison, at, is_end)
        self.low, self.high = np.maximum(f.low - at.z, f.farthest_down), f.high - at.z
        self.whole = _bounded(self.A, self.downhill, self.low, self.high)
        self.promised = self._expected(self.whole)

    def shortened(self) -> _Step:
        """A share of the whole step."""
        share = 1.0
        for _ in range(SHORTENED):
            move = share * self.whole
            tried = self._tried(move)
            bent, lost = self._bent(tried, move), tried.rise + self._expected(move)
            if LITTLE < lost < math.inf:  # less is the model's roughness
                tried = min(tried, self._back(tried, bent), key=lambda one: one.rise)
            if tried.rise <= SAME_COST:
                return self._step(tried)
            share *= self._less(share, bent) if math.isfinite(lost) else SHORTEST
            if self._expected(share * self.whole) < LEAST_GAIN:
                break
        return self._none()

    def damped(self, damping: float) -> tuple[_Step, float]:
        """A step as damped as it has to be, and the damping to go on with.

        `damping`: to begin with; a share of A's diagonal [-].
        """
        for turn in range(DAMPED):
            move = _bounded(self.A + damping * np.diag(np.diag(self.A)), self.downhill, self.low, self.high)
            expected = self._expected(move)
            if turn and expected < LEAST_GAIN:
                break
            tried = self._tried(move)
            if tried.rise > SAME_COST:
                damping *= STEEPER[turn > 0]
                continue
            if -tried.rise > GOOD_GAIN * expected:
                damping = max(damping / EASED, LEAST_DAMPING)
            elif -tried.rise < POOR_GAIN * expected:
                damping *= TIGHTENED
            return self._step(tried), damping
        return self._none(), damping

    def _tried(self, move: np.ndarray) -> _Tried:
        """The end of a move."""
        at, f = self.at, self.f
        move = move * min(1.0, LARGEST_MOVE / max(float(np.max(np.abs(move))), 1e-12))
        return self._seen(f.along_valley(at.z, f.clip(f.advance(at.z, move)), at.predicted, at.D))

    def _bent(self, tried: _Tried, move: np.ndarray) -> np.ndarray:
        """What a move did to the readings beyond the straight line, whitened [-], shape (m,)."""
        change = self.comparison.raw(tried.predicted) - self.comparison.raw(self.at.predicted)
        bent: np.ndarray = self.white(change - self.at.D @ move)
        return bent

    def _back(self, tried: _Tried, bent: np.ndarray) -> _Tried:
        """Where a move ends once that is taken back along the straight line."""
        f, z = self.f, tried.z
        back = _bounded(self.A, -self.weighed.T @ bent, f.low - z, f.high - z)
        back *= min(1.0, LARGEST_MOVE / max(float(np.max(np.abs(back))), 1e-12))
        return self._seen(f.along_valley(z, f.clip(f.advance(z, back)), tried.predicted, self.at.D))

    def _less(self, share: float, bent: np.ndarray) -> float:
        """The part of a share at which a step gains most, where what is bent goes with its square."""
        parts = np.geomspace(SHORTEST, LONGEST, PARTS)
        left = self.r[:, None] - np.outer(self.J @ self.whole, share * parts) - np.outer(bent, parts**2)
        cost = self.weight @ left**2 + np.sum((self.at.z[:, None] + np.outer(self.whole, share * parts)) ** 2, axis=0)
        return float(parts[np.argmin(cost)])

    def _seen(self, z: np.ndarray) -> _Tried:
        found, rise = self.f(z), math.inf
        if self.comparison.is_told(found):
            rise = cost_at(self.comparison, z, self.at.u, found, self.is_end) - self.before
        return _Tried(z, found, rise)

    def _step(self, tried: _Tried) -> _Step:
        return _Step(tried.z, tried.predicted, self.before + tried.rise, -tried.rise, self.promised)

    def _none(self) -> _Step:
        return _Step(self.at.z, self.at.predicted, self.before, 0.0, self.promised)

    def _expected(self, move: np.ndarray) -> float:
        return float(move @ self.downhill - 0.5 * move @ self.A @ move)
