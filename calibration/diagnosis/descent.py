"""The search for a model's most probable point: Gauss-Newton, with runs in time first by their mean torque.

Steps that do not lower the cost are shortened. With runs in time what the pulses of the cylinders add is kept at first,
as a function of the shaft's angle: that leads near from far away. Then derivatives are taken with every pulse.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.diagnosis.function import Function, Predicts
from calibration.diagnosis.linear import Comparison
from calibration.diagnosis.mode import Mode, close, minus_log_posterior, robust_weights, suiting_noise
from calibration.diagnosis.noise import NOISE_SD, SCALES, SPREAD
from calibration.diagnosis.problem import Prediction, in_si
from calibration.diagnosis.threads import each
from model.effects import effects

LARGEST_MOVE = 6.0
MOST_PASSES = 30
HALVINGS = 8  # of an effect with which the motor stalls
TRIES = 4  # of a step that does not lower the cost: as far as the parabola through the last says, and
LONGEST, SHORTEST = 0.5, 0.1  # shares of that one between which it is held
LEAST_GAIN = 0.005  # nats; a step that promises less is not tried shorter
SETTLED = 0.01  # squared length of a move, in posterior sds, below which a search ends
HOPELESS, ROUGHLY_HOPELESS = 70.0, 120.0  # nats behind the best set's end from which a search is not gone on with
MOST_ROUNDS = 8  # times that derivatives with the pulses are taken
STALE = 25.0  # squared length of a step, in posterior sds, after which derivatives are taken anew
LEAST_ROUND = 0.05  # nats that a round with new derivatives has to gain
PULLED = 3.0  # sds from which a nuisance is handed over to the effect that has its form
TURNS = 0.3  # share of the speed read above which a level is taken to turn
NOT_NOISE = 5.0  # sds of noise, or digits, above which a speed is not that of a rotor at rest
LOOSENS = ("roller_friction", "port_lap")  # what keeps a level standing
LOOSER, LOOSER_BY = 24, 0.25  # steps of it with which a level that stands is made to turn [-]
EDGE = math.sqrt(3.0)  # half a pulse, or half a turn of the shaft, in sds of the angle's prior
ALL_ROUND = np.arange(1, 12) * EDGE / 6.0  # angles tried, beside the one that there is
OPENINGS = (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0)  # of a run from rest, tried likewise, in sds of their prior


@dataclass(frozen=True)
class _Point:
    """Where a search stands: the cost, the unknowns, the noise, derivatives once they are known, prediction."""

    cost: float
    z: np.ndarray
    u: np.ndarray
    D: np.ndarray
    predicted: Prediction
    reached: float = math.inf  # lowest cost so far, the pulses of the start kept


@dataclass(frozen=True)
class Outset:
    """Where a search with runs in time is after its rough start.

    Attributes
    ----------
    reached : float
        Lowest cost, the pulses of the start kept [-].
    plain, handed_over : tuple of _Point
        Points from which it may go on, without and with a nuisance's pull handed over to an effect.
    """

    reached: float
    plain: tuple[_Point, ...]
    handed_over: tuple[_Point, ...]


def find(
    comparison: Comparison,
    names: Sequence[str],
    *starts: Mode | None,
    first: dict[tuple[str, str], float] | None = None,
    best: float = math.inf,
    roughly: bool = False,
    outset: Outset | None = None,
) -> Mode:
    """The most probable point of the base model with a set of effects.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    names : sequence of str
        Effect ids.
    *starts : Mode or None
        Modes of smaller or equal sets to start from; None for the prior's middle, which is taken when nothing is given.
        With runs in time the start that leads farthest by the mean torque goes on.
    first : dict or None
        Starting values of effects' unknowns by (effect, parameter) [-].
    best : float
        Cost of another set. With runs in time a search that stays far behind ends early [-].
    roughly : bool
        Whether a search with runs in time only begins another one: readings taken for bad are not looked at again.
    outset : Outset or None
        The rough start, if it is made already; starts and first are not looked at then.

    Raises
    ------
    ArithmeticError
        When the model gives no reading at any start.
    """
    f = Function(comparison, names)
    if not comparison.problem.blocks.runs:
        begun, _ = _begun(comparison, f, starts or (None,), first or {})
        ends = [_descend(f, comparison, p.z, p.u, p.D, p.predicted, f) for p in begun]
        ends += [_trusting(f, comparison, *end, f) for end in ends if _some_bad(comparison, end)]
        ends = [_descend(f, comparison, *end, f, correlated=True) for end in ends]
        return max((close(comparison, names, *end) for end in ends), key=lambda mode: mode.log_evidence)
    outset = outset or set_out(comparison, names, *starts, first=first)
    with comparison.on_its_way():
        # What was handed over goes on beside the rest: the rough start says little of which ends lower.
        here, *other = [min(some, key=lambda point: point.cost) for some in (outset.plain, outset.handed_over) if some]
        hopeless = outset.reached > best + ROUGHLY_HOPELESS and math.isfinite(here.cost)
        if not hopeless:
            here = min((_with_pulses(f, comparison, point) for point in (here, *other)), key=lambda point: point.cost)
            hopeless = here.cost > best + HOPELESS
        for another in () if hopeless else (_begun_otherwise,) if roughly else (_begun_otherwise, _looked_at_again):
            tried = another(f, comparison, here)
            if tried is not here:
                here = min(here, _with_pulses(f, comparison, tried), key=lambda point: point.cost)
    if not hopeless:
        here = _with_pulses(f, comparison, here, correlated=True)
    return close(comparison, names, here.z, here.u, here.D, here.predicted)


def set_out(
    comparison: Comparison,
    names: Sequence[str],
    *starts: Mode | None,
    first: dict[tuple[str, str], float] | None = None,
) -> Outset:
    """The rough start of a search with runs in time.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    names : sequence of str
        Effect ids.
    *starts : Mode or None
        As of `find`.
    first : dict or None
        As of `find`.

    Raises
    ------
    ArithmeticError
        When the model gives no reading at any start.
    """
    f = Function(comparison, names)
    begun, plain = _begun(comparison, f, starts or (None,), first or {})
    with comparison.on_its_way():
        rough = [_rough(f, comparison, point) for point in begun]
    return Outset(min(point.reached for point in rough), tuple(rough[:plain]), tuple(rough[plain:]))


def _with_pulses(f: Function, comparison: Comparison, here: _Point, correlated: bool = False) -> _Point:
    """The end of a search with runs in time: what the pulses add changes with every step, and so in the derivatives."""
    z, u, D, predicted = here.z, here.u, here.D, here.predicted
    cost = _cost(comparison, z, u, predicted)
    for _ in range(MOST_ROUNDS):
        z = _within_a_pulse(f, z)
        D = f.derivatives(z, predicted, D, u, f)
        z, u, D, predicted = _descend(f, comparison, z, u, D, predicted, f, fresh=False, correlated=correlated)
        before, cost = cost, _cost(comparison, z, u, predicted)
        if before - cost < LEAST_ROUND:
            break
    return _Point(cost, z, u, D, predicted)


def _begun_otherwise(f: Function, comparison: Comparison, here: _Point) -> _Point:
    """The point with the angles and the openings at which its runs begin at the best of a few, if that is better."""
    z, _ = turned(f, comparison, here.z, here.u, here.predicted)
    z = opened(f, comparison, z, here.u)
    predicted = f(z)
    cost, u = _at(comparison, z, here.u, predicted, here.D)
    return _Point(cost, z, u, here.D, predicted) if cost < here.cost - LEAST_ROUND else here


def _looked_at_again(f: Function, comparison: Comparison, here: _Point) -> _Point:
    """Where a search with runs in time ends up when no reading may be taken for bad at first, if that is better."""
    if not _some_bad(comparison, (here.z, here.u, here.D, here.predicted)):
        return here
    z, u, D, predicted = _trusting(f, comparison, here.z, here.u, here.D, here.predicted, f)
    cost, u = _at(comparison, z, u, predicted, D)
    return _Point(cost, z, u, D, predicted) if cost < here.cost else here


def _begun(
    comparison: Comparison, f: Function, starts: Sequence[Mode | None], first: dict[tuple[str, str], float]
) -> tuple[list[_Point], int]:
    """The points to start from, and how many of them hand nothing over.

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
    return [*found, *handed], len(found)


def _handed_over(comparison: Comparison, f: Function, point: _Point) -> _Point | None:
    """A point with what a nuisance is pulled by handed over to the effect that has its form; None where none is.

    The two multiply or add up to the same: along that ridge, which may be curved, a search creeps.
    """
    problem, z = comparison.problem, point.z.copy()
    for i, (name, unknown) in enumerate(problem.effect_unknowns(f.names), start=f.k):
        effect = effects()[name]
        place = problem.place(effect.nuisance) if effect.nuisance and unknown.name == effect.amplitude.name else None
        if place is None or abs(z[place]) < PULLED:
            continue
        nuisance = problem.nuisances[place]
        pulled, usual = (float(one) for one in nuisance.value(np.array([z[place], 0.0])))
        z[i] = unknown.z(pulled / usual - 1.0 if effect.factors else (pulled - usual) * in_si(nuisance.name))
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
    return _Point(math.inf, z, point.u, point.D, predicted)


def _begin(comparison: Comparison, f: Function, start: Mode | None, first: dict[tuple[str, str], float]) -> _Point:
    """A point to start from, at which the model gives readings."""
    problem, k = comparison.problem, f.k
    extra = problem.effect_unknowns(f.names)
    z, u = np.zeros(k + len(extra)), np.zeros(SPREAD.size)
    D = np.zeros((comparison.read.size, z.size))
    values: dict[tuple[str, str], float] = {}
    if start is not None:
        z[:k], u[SCALES] = start.z[:k], np.clip(start.u[SCALES], -NOISE_SD, NOISE_SD)
        D[:, :k] = start.D[:, :k]
        values = {(e, x.name): start.z[k + i] for i, (e, x) in enumerate(problem.effect_unknowns(start.names))}
    values |= first
    amplitudes = []
    for i, (name, unknown) in enumerate(extra):
        z[k + i] = values.get((name, unknown.name), 0.0)
        if unknown.name == effects()[name].amplitude.name:
            amplitudes.append(k + i)
            if len(effects()[name].parameters) > 1 and abs(z[k + i]) < 0.05:
                z[k + i] = 0.1  # at an amplitude of 0 nothing can be said of its shape
    z = f.clip(z)
    for _ in range(HALVINGS):
        predicted = f(z)
        if comparison.is_told(predicted):
            return _Point(math.inf, z, u, D, predicted)
        z[amplitudes] *= 0.5  # the motor may stall with as much of an effect
    raise ArithmeticError("no reading, however little of an effect there is")


def _rough(f: Function, comparison: Comparison, here: _Point) -> _Point:
    """The start of a search with runs in time: what the pulses add at its angles is kept."""
    z, predicted = turned(f, comparison, here.z, here.u, here.predicted)
    cost, u = _at(comparison, z, here.u, predicted, here.D)
    begun = _Point(cost, z, u, here.D, predicted)
    z = _within_a_pulse(f, z)
    of = f.near(z)
    there = of(z)
    if not comparison.is_told(there):
        return replace(begun, reached=begun.cost)  # the mean torque says nothing here, the pulses do
    z, u, D, there = _descend(f, comparison, z, u, here.D, there, of)
    reached = _cost(comparison, z, u, there)
    predicted = f(z)
    cost, u = _at(comparison, z, u, predicted, D)
    # What the pulses add has changed on the way, so it may end higher than it began.
    ended = _Point(cost, z, u, D, predicted)
    return replace(min(begun, ended, key=lambda point: point.cost), reached=min(begun.cost, reached))


def _within_a_pulse(f: Function, z: np.ndarray) -> np.ndarray:
    """The same point with each angle counted from the nearest pulse, or from the nearest whole turn.

    Where an effect follows the shaft, a pulse on is another angle: then only whole turns are taken off.
    """
    z = z.copy()
    for place in f.wraps:
        z[place] = (z[place] + EDGE) % (2.0 * EDGE) - EDGE
    return z


def _at(
    comparison: Comparison, z: np.ndarray, u: np.ndarray, predicted: Prediction, D: np.ndarray
) -> tuple[float, np.ndarray]:
    """The cost of a point, and the noise that suits it."""
    if not comparison.is_told(predicted):
        return math.inf, u
    u = suiting_noise(comparison, predicted, u, D, False)
    return _cost(comparison, z, u, predicted), u


def _cost(comparison: Comparison, z: np.ndarray, u: np.ndarray, predicted: Prediction) -> float:
    """The cost of a point with a noise."""
    white = comparison.whitener(predicted, u)
    return minus_log_posterior(white(comparison.read - comparison.raw(predicted)), white.log_scale, z, u, comparison)


def _descend(
    f: Function,
    comparison: Comparison,
    z: np.ndarray,
    u: np.ndarray,
    D: np.ndarray,
    predicted: Prediction,
    of: Predicts,
    fresh: bool = True,
    correlated: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Prediction]:
    """Gauss-Newton steps until one is short: the point, the noise, the derivatives and the prediction.

    Derivatives are taken anew only after a long step: those of a place near by lead to the same point.
    """
    for _ in range(MOST_PASSES):
        if fresh:
            D = f.derivatives(z, predicted, D, u, of)
        white = comparison.whitener(predicted, u)
        r, J = white(comparison.read - comparison.raw(predicted)), white(D)
        weight, _ = robust_weights(r, comparison)
        A = (J * weight[:, None]).T @ J + np.eye(z.size)
        moved, predicted = _step(f, of, comparison, z, u, A, (J * weight[:, None]).T @ r - z, predicted, D)
        far = float((moved - z) @ A @ (moved - z))
        z, u = moved, suiting_noise(comparison, predicted, u, D, correlated)
        if far < SETTLED and (fresh or far > 0.0):
            break
        fresh = far > STALE or far == 0.0  # where old derivatives lead nowhere, new ones may
    return z, u, D, predicted


def _turning(
    f: Function, comparison: Comparison, z: np.ndarray, predicted: Prediction, D: np.ndarray
) -> list[np.ndarray]:
    """Points at which each level that was seen to turn does: with less roller friction, or with less lap.

    The point itself where they turn already, or where neither helps.
    """
    names = [unknown.name for unknown in comparison.problem.nuisances]
    speeds = slice(comparison.n, 2 * comparison.n)
    known, read = comparison.known[speeds], np.nan_to_num(comparison.read[speeds])
    problem, friction = comparison.problem, names.index("f_overall")
    seen = read > NOT_NOISE * max(problem.noise["speed"], problem.resolution["speed"])

    def turns(tried: np.ndarray) -> bool:
        speed = f(tried, predicted, ()).speed[seen]
        return bool(np.all(np.isfinite(speed)) and np.all(speed > TURNS * read[seen]))

    if turns(z):
        return [z]
    found, g = [], D[speeds, friction][known]
    for place in (names.index(name) for name in LOOSENS):
        # f_overall goes up with it, so that the other levels stay where they are.
        instead = float(g @ D[speeds, place][known]) / max(float(g @ g), 1e-30)
        tried = z.copy()
        for _ in range(LOOSER):
            tried = tried.copy()
            tried[place] -= LOOSER_BY
            tried[friction] += instead * LOOSER_BY
            tried = f.along_valley(z, f.clip(tried), predicted, D)
            if turns(tried):
                found.append(tried)
                break
    return found or [z]


End = tuple[np.ndarray, np.ndarray, np.ndarray, Prediction]


def _some_bad(comparison: Comparison, end: End) -> bool:
    """Whether any reading is taken for bad at the end of a search."""
    white = comparison.whitener(end[3], end[1])
    return bool(np.any(robust_weights(white(comparison.read - comparison.raw(end[3])), comparison)[1] > 0.5))


def _trusting(
    f: Function,
    comparison: Comparison,
    z: np.ndarray,
    u: np.ndarray,
    D: np.ndarray,
    predicted: Prediction,
    of: Predicts,
) -> End:
    """A search that takes no reading for bad, and from its end one that may.

    Close to a stall the speed hangs so steeply on everything that a level given up for bad pulls no more, though a
    little way on it would fit.
    """
    ends = []
    for begun in _turning(f, comparison, z, predicted, D):
        comparison.trusting = True
        try:
            end = _descend(f, comparison, begun, u, D, of(begun), of, fresh=begun is not z)
        finally:
            comparison.trusting = False
        ends.append(_descend(f, comparison, *end, of, fresh=False))
    return min(ends, key=lambda end: _cost(comparison, end[0], end[1], end[3]))


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


def turned(
    f: Function, comparison: Comparison, z: np.ndarray, u: np.ndarray, here: Prediction
) -> tuple[np.ndarray, Prediction]:
    """A point with each of its angles at the best of a few, and the prediction there.

    Parameters
    ----------
    f : Function
        Of the set.
    comparison : Comparison
        The recording.
    z : ndarray, shape (n,)
        The point [-].
    u : ndarray, shape (5,)
        The noise [-].
    here : Prediction
        At the point.
    """
    for place, run in f.angles.items():
        white = comparison.whitener(here, u)
        best = _cost(comparison, z, u, here)
        angles = (float(z[place]) + ALL_ROUND + EDGE) % (2.0 * EDGE) - EDGE
        for tried, there in each(functools.partial(_at_angle, f, z, here, place, run), angles):
            r = white(comparison.read - comparison.raw(there))
            cost = minus_log_posterior(r, white.log_scale, tried, u, comparison)
            if cost < best:
                best, z, here = cost, tried, there
    return z, here


def opened(f: Function, comparison: Comparison, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A point with the opening of each run from rest at the best of a few [-], shape (n,).

    Parameters
    ----------
    f : Function
        Of the set.
    comparison : Comparison
        The recording.
    z : ndarray, shape (n,)
        The point [-].
    u : ndarray, shape (5,)
        The noise [-].
    """
    here = f(z)
    for place, (run, ways) in f.openings.items():
        best = _cost(comparison, z, u, here)
        for tried, there in each(functools.partial(_at_opening, f, z, here, u, place, run, ways), OPENINGS):
            cost = _cost(comparison, tried, u, there)
            if cost < best:
                best, z, here = cost, tried, there
    return z


def _at_angle(
    f: Function, z: np.ndarray, here: Prediction, place: int, run: int, angle: float
) -> tuple[np.ndarray, Prediction]:
    """A point with one of its angles elsewhere, and the prediction there."""
    tried = z.copy()
    tried[place] = angle
    return tried, f(tried, here, (run,))


def _at_opening(
    f: Function,
    z: np.ndarray,
    here: Prediction,
    u: np.ndarray,
    place: int,
    run: int,
    ways: Sequence[int],
    opening: float,
) -> tuple[np.ndarray, Prediction]:
    """A point with the opening of a run from rest elsewhere, its start at its best there, and the prediction."""
    tried = z.copy()
    tried[[place, *ways]] = opening, *np.zeros(len(ways))
    return _started(f, f.comparison, tried, u, f(tried, here, (run,)), run, ways)


def _started(
    f: Function, comparison: Comparison, z: np.ndarray, u: np.ndarray, here: Prediction, run: int, ways: Sequence[int]
) -> tuple[np.ndarray, Prediction]:
    """A point with the ways in which a start differs at their best, in which its readings are linear."""
    white, raw = comparison.whitener(here, u), comparison.raw(here)
    columns = []
    for way in ways:
        moved = z.copy()
        moved[way] += 1.0
        columns.append(white(np.nan_to_num(comparison.raw(f(moved, here, (run,))) - raw)))
    X = np.column_stack(columns)
    r = white(comparison.read - raw)
    weight, _ = robust_weights(r, comparison)
    A = (X * weight[:, None]).T @ X + np.eye(len(ways))
    found = z.copy()
    found[list(ways)] += np.linalg.solve(A, (X * weight[:, None]).T @ r - z[list(ways)])
    found = f.clip(found)
    return found, f(found, here, (run,))


def _step(
    f: Function,
    of: Predicts,
    comparison: Comparison,
    z: np.ndarray,
    u: np.ndarray,
    A: np.ndarray,
    downhill: np.ndarray,
    predicted: Prediction,
    D: np.ndarray,
) -> tuple[np.ndarray, Prediction]:
    """A share of a step that lowers the cost, and the prediction there; where none is found, no step."""
    before = _cost(comparison, z, u, predicted)
    whole = _bounded(A, downhill, f.low - z, f.high - z)
    falls, share = float(whole @ downhill), 1.0
    for _ in range(TRIES):
        move = share * whole
        move *= min(1.0, LARGEST_MOVE / max(float(np.max(np.abs(move))), 1e-12))
        tried = f.along_valley(z, f.clip(f.advance(z, move)), predicted, D)
        found, rise = of(tried), math.inf
        if comparison.is_told(found):
            rise = _cost(comparison, tried, u, found) - before
            if rise <= 1e-6:
                return tried, found
        lowest = falls * share / (2.0 * (rise / share + falls))
        share *= min(max(lowest / share, SHORTEST), LONGEST) if math.isfinite(lowest) else SHORTEST
        if falls * share < LEAST_GAIN:
            break
    return z, predicted
