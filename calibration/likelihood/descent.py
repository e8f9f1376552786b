"""The search for a model's most probable point: Gauss-Newton. Steps that do not lower the cost are shortened."""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calibration.likelihood.function import Function
from calibration.likelihood.linear import LINE, RUN, Comparison
from calibration.likelihood.mode import Mode, close, minus_log_posterior, robust_weights, suiting_noise
from calibration.likelihood.noise import NOISE_SD, SCALES, SPREAD
from calibration.systems.radial_piston.problem import Prediction, in_si
from calibration.systems.radial_piston.supply import LATE_SD, own_of_line
from calibration.work.threads import each
from model.effects import effects

LARGEST_MOVE = 6.0
MOST_PASSES = 30
HALVINGS = 8  # of an effect with which the motor stalls
TRIES = 4  # of a step that does not lower the cost: as far as the parabola through the last says, and
LONGEST, SHORTEST = 0.5, 0.1  # shares of that one between which it is held
LEAST_GAIN = 0.005  # nats; a step that promises less is not tried shorter
SETTLED = 0.01  # squared length of a move, in posterior sds, below which a search ends
HOPELESS = 70.0  # nats behind the best set's end from which a search is not gone on with
STALE = 25.0  # squared length of a step, in posterior sds, after which derivatives are taken anew
PULLED = 3.0  # sds from which a nuisance is handed over to the effect that has its form
TURNS = 0.3  # share of the speed read above which a level is taken to turn
NOT_NOISE = 5.0  # sds of noise, or digits, above which a speed is not that of a rotor at rest
LOOSENS = ("roller_friction", "port_lap")  # what keeps a level standing
LOOSER, LOOSER_BY = 24, 0.25  # steps of it with which a level that stands is made to turn [-]
EDGE = math.sqrt(3.0)  # half a turn of the shaft, in sds of the angle's prior
ALL_ROUND = np.arange(1, 12) * EDGE / 6.0  # angles tried, beside the one that there is
LATE_S = (-0.12, 0.5, 0.03)  # from, to, step; moments at which a line begins to move, tried likewise,
SLOW = np.arange(-1.5, 2.1, 0.7)  # ... with time constants, in sds of their prior
LOUDER, FOLLOWED, MOST_LOOKS = 10.0, 3, 12  # factor on the noise meanwhile, lines that are followed, steps of each
FAR_OFF = 1e4  # noise sds; farther off is no worse


@dataclass(frozen=True)
class _Point:
    """Where a search stands: the unknowns, the noise, derivatives once they are known, prediction."""

    z: np.ndarray
    u: np.ndarray
    D: np.ndarray
    predicted: Prediction


def find(
    comparison: Comparison,
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
        Cost of another set. With runs in time a search that stays far behind ends early [-].

    Raises
    ------
    ArithmeticError
        When the model gives no reading at any start.
    """
    f = Function(comparison, names)
    ends = []
    for point in _begun(comparison, f, starts or (None,), first or {}):
        z, predicted = turned(f, comparison, point.z, point.u, point.predicted)
        ends.append(_descend(f, comparison, z, point.u, point.D, predicted))
    if comparison.problem.blocks.runs:  # a search there takes its time: the best alone goes on
        ends = [min(ends, key=lambda end: _cost(comparison, end[0], end[1], end[3]))]
        if _cost(comparison, ends[0][0], ends[0][1], ends[0][3]) > best + HOPELESS:
            return close(comparison, names, *ends[0])
    ends += [_trusting(f, comparison, *end) for end in ends if _some_bad(comparison, end)]
    ends = [_descend(f, comparison, *end, correlated=True) for end in ends]
    return max((close(comparison, names, *end) for end in ends), key=lambda mode: mode.log_evidence)


def _begun(
    comparison: Comparison, f: Function, starts: Sequence[Mode | None], first: dict[tuple[str, str], float]
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
    return _Point(z, point.u, point.D, predicted)


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
    elif problem.blocks.runs:
        if comparison.middle is None:  # the same for every set
            comparison.middle = with_lines(Function(comparison, ()), comparison, z[:k], u)
        z[:k] = comparison.middle
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
            return _Point(z, u, D, predicted)
        z[amplitudes] *= 0.5  # the motor may stall with as much of an effect
    raise ArithmeticError("no reading, however little of an effect there is")


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
    fresh: bool = True,
    correlated: bool = False,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Prediction]:
    """Gauss-Newton steps until one is short: the point, the noise, the derivatives and the prediction.

    Derivatives are taken anew only after a long step: those of a place near by lead to the same point.
    """
    for _ in range(MOST_PASSES):
        if fresh:
            D = f.derivatives(z, predicted, D, u)
        white = comparison.whitener(predicted, u)
        r, J = white(comparison.read - comparison.raw(predicted)), white(D)
        weight, _ = robust_weights(r, comparison)
        A = (J * weight[:, None]).T @ J + np.eye(z.size)
        moved, predicted = _step(f, comparison, z, u, A, (J * weight[:, None]).T @ r - z, predicted, D)
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
) -> End:
    """A search that takes no reading for bad, and from its end one that may.

    Close to a stall the speed hangs so steeply on everything that a level given up for bad pulls no more, though a
    little way on it would fit.
    """
    ends = []
    for begun in _turning(f, comparison, z, predicted, D):
        comparison.trusting = True
        try:
            end = _descend(f, comparison, begun, u, D, f(begun), fresh=begun is not z)
        finally:
            comparison.trusting = False
        ends.append(_descend(f, comparison, *end, fresh=False))
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
    z : ndarray, shape (n,)
        The point [-].
    u : ndarray, shape (5,)
        The noise [-].
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


def with_lines(f: Function, comparison: Comparison, z: np.ndarray, u: np.ndarray) -> np.ndarray:
    """A point with the line of each run where it suits the readings best, all else as it is [-], shape (n,).

    Parameters
    ----------
    z : ndarray, shape (n,)
        The point [-].
    u : ndarray, shape (5,)
        The noise [-].
    """
    for run in range(len(comparison.problem.blocks.runs)):
        z = _with_line(f, comparison, z, u, run)
    return z


def _with_line(f: Function, comparison: Comparison, z: np.ndarray, u: np.ndarray, run: int) -> np.ndarray:
    """A point with the line of one run where it suits the readings best.

    The moment at which it begins to move may be anywhere at first: a few are tried, with several time constants, by a
    cost in which the noise is louder, and the best of them followed.
    """
    problem = comparison.problem
    here = f(z, smooth=True)
    white = comparison.whitener(here, u)
    names = [one.name for one in problem.nuisances]
    places = [names.index(name) for name in own_of_line(problem.blocks.runs[run].file) if name in names]
    mine = comparison.known & np.isin(comparison.kind, (RUN + run, LINE))

    def misfit(own: np.ndarray) -> np.ndarray:
        tried = z.copy()
        tried[places] = own
        found = f(f.clip(tried), here, (run,), smooth=True)
        left = white(comparison.read - np.nan_to_num(comparison.raw(found)))[mine]
        return np.append(np.clip(left, -FAR_OFF, FAR_OFF), own)

    begun = []
    for late, slow in [(late, slow) for one, late, slow in f.lines if one == run]:
        sd = problem.nuisances[late].b
        more = math.sqrt(3.0 * max(sd * sd - LATE_SD * LATE_SD, 0.0))  # half of the time in which there was no row
        for when in np.arange(LATE_S[0] - more, LATE_S[1] + more, LATE_S[2]) / sd:
            for constant in SLOW:
                own = z[places].copy()
                own[[places.index(late), places.index(slow)]] = when, constant
                begun.append(own)
    sizes = each(lambda own: float(np.sum(np.log1p((misfit(own) / LOUDER) ** 2))), begun)
    best = [begun[k] for k in np.argsort(sizes)[:FOLLOWED]]
    ends = each(lambda own: least_squares(misfit, own, max_nfev=MOST_LOOKS, diff_step=1e-3), best)
    found = z.copy()
    if ends:
        found[places] = min(ends, key=lambda end: end.cost).x
    return found


def _at_angle(
    f: Function, z: np.ndarray, here: Prediction, place: int, run: int, angle: float
) -> tuple[np.ndarray, Prediction]:
    """A point with one of its angles elsewhere, and the prediction there."""
    tried = z.copy()
    tried[place] = angle
    return tried, f(tried, here, (run,))


def _step(
    f: Function,
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
        found, rise = f(tried), math.inf
        if comparison.is_told(found):
            rise = _cost(comparison, tried, u, found) - before
            if rise <= 1e-6:
                return tried, found
        lowest = falls * share / (2.0 * (rise / share + falls))
        share *= min(max(lowest / share, SHORTEST), LONGEST) if math.isfinite(lowest) else SHORTEST
        if falls * share < LEAST_GAIN:
            break
    return z, predicted
