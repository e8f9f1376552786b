"""What no listed effect is and a bench still knows: something that is otherwise from one moment on.

A belt slips, a gauge is knocked, a bearing seizes: a step in the running time of a torque, or of what an instrument
reads. An effect that changes with time can look like it, and so can a misread row. Before anything is named alone, a
step stands in for it, in the model made linear; which moment it has is not known, so its evidence is the mean over all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from calibration.diagnosis.linear_model.coordinates import Along, coordinates
from calibration.diagnosis.linear_model.forces import TorqueAnswer, torque_column
from calibration.diagnosis.linear_model.signatures import project
from calibration.diagnosis.linear_model.terms import LARGEST_N_M
from calibration.diagnosis.steps.locate import METERS, Place
from calibration.diagnosis.steps.search import values_of
from calibration.likelihood.descent import find
from calibration.likelihood.linear import Comparison
from calibration.likelihood.linearized import GOOD
from calibration.likelihood.mode import BAD, Mode, log_bad
from calibration.likelihood.noise import SPREAD

LARGEST_SHARE = 0.05  # sd of the prior of an instrument's step, of its reading
FEWEST = 3  # plateaus on either side of a moment: fewer are misread rows
MOMENTS = 60  # most tried
LOOKS = 2  # for the best moment, each with the noise that suits the one before
PASSES = 4  # of the noise
STEP = "torque_step"  # the effect
LEAST_GAIN = 5.0  # nats over nothing that make a step something
ODDS = 20.0  # of what is named against a step, or it is not named
WORTH_A_REFIT = -40.0  # nats over the member in the linear model

Columns = Callable[[Comparison, Mode], np.ndarray]


@dataclass(frozen=True)
class Step:
    """A step in the running time.

    Attributes
    ----------
    start_s, end_s : float
        From when on, at the most probable, and the recording's end [s].
    gain : float
        Log evidence over nothing in its place, every moment as likely [-].
    over : float
        What it adds to the log evidence in the place of what it stands in for [-].
    """

    channel: str
    balance: str
    start_s: float
    end_s: float
    gain: float
    over: float

    @property
    def explains(self) -> bool:
        """Whether it is something, and what it stands in for is not certain beside it."""
        return self.gain > LEAST_GAIN and self.over > -math.log(ODDS)

    @property
    def text(self) -> str:
        """In words."""
        what = "torque" if self.balance == "torque" else f"{METERS[self.channel]}'s reading"
        return f"a step of the {what} {self.start_s:.0f} s after the start"

    @property
    def place(self) -> Place:
        """Where it is, its p-value the inverse of its Bayes factor."""
        what = "torque balance" if self.balance == "torque" else f"{METERS[self.channel]}'s reading"
        sentence = f"The {what} is off from {self.start_s:.0f} s on (seen in the {self.channel})."
        where = (self.start_s, self.end_s)
        return Place(self.channel, self.balance, "time", where, "s", math.exp(-max(self.gain, 0.0)), sentence, ())


def step_instead(comparison: Comparison, mode: Mode) -> Step | None:
    """The step in time that does best in the place of a member of a set; None where the recording has no clock for one.

    Parameters
    ----------
    mode : Mode
        Of the set; of the base model a step is tried in the place of the readings that it takes for bad.
    """
    time = coordinates(comparison, mode)["time"]
    moments = np.zeros(0) if comparison.problem.blocks.plateaus.untimed else _moments(time)
    if not moments.size:
        return None
    kinds = {key: columns for key, columns in _columns(comparison, mode, time, moments).items() if columns.any()}
    within = _first_after(comparison, time, moments)
    end_s, first = float(time.everything.max()), len(comparison.problem.nuisances)
    owner = np.array([name for name, _ in comparison.problem.effect_unknowns(mode.names)])

    def torque(there: Comparison, at: Mode) -> np.ndarray:
        return _columns(there, at, time, moments)["speed", "torque"]

    found: list[Step] = []
    for member in mode.names or ("",):
        mine = first + np.flatnonzero(owner == member) if member else np.zeros(0, dtype=int)
        rest = _Rest(comparison, mode, mine, within)
        for (channel, balance), columns in kinds.items():
            gain, at = rest.of_a_step(columns)
            one = Step(channel, balance, float(moments[at]), end_s, gain - rest.nothing, gain - rest.instead)
            if balance == "torque" and member and one.over > WORTH_A_REFIT:
                one = _refitted(comparison, mode, member, one, torque, moments, within)
            found.append(one)
    return max(found, key=lambda one: one.over)


def _refitted(
    comparison: Comparison,
    mode: Mode,
    member: str,
    step: Step,
    columns: Columns,
    moments: np.ndarray,
    within: np.ndarray,
) -> Step:
    """A step of the torque with its evidence by a refit: a large one bends what the readings do."""
    k = len(comparison.problem.nuisances)
    names = tuple(sorted({*mode.names, STEP} - {member}))
    best = step
    near, first = mode, {one: z for one, z in values_of(comparison.problem, mode).items() if one[0] != member}
    first[STEP, "torque_nm"] = 0.0
    try:
        for _ in range(LOOKS):
            there = comparison.giving({(STEP, "moment_s"): step.start_s})
            near = find(there, names, near, first=first)
            over = near.log_evidence - math.log(moments.size) - mode.log_evidence  # whichever moment it was
            if over <= best.over:
                break
            best = replace(step, gain=best.gain + over - best.over, over=over)
            place = k + [name for name, _ in there.problem.effect_unknowns(names)].index(STEP)
            at = _Rest(there, near, np.array([place]), within).of_a_step(columns(there, near))[1]
            if moments[at] == step.start_s:
                break
            step, first = replace(step, start_s=float(moments[at])), {}
    except ArithmeticError:  # nothing of it can be simulated
        return best
    return best


class _Rest:
    """A set without a member, made linear: log evidence with other columns in its place, up to what they share.

    The noise is what suits each: a set that needs loud noise to be true is not helped by it here.

    Parameters
    ----------
    mine : ndarray of int
        Places of the member's unknowns; none where the readings taken for bad are left out.
    within : ndarray of bool, shape (m, moments)
        Readings of the plateau during which each moment may be: what of the step they show is free, where it stands
        for a member.

    Attributes
    ----------
    instead : float
        With the member, or with the bad readings taken for bad [-].
    """

    def __init__(self, comparison: Comparison, mode: Mode, mine: np.ndarray, within: np.ndarray) -> None:
        # A step in the place of misread readings may not make one of them up.
        self.comparison, self.mode, self.within = comparison, mode, within & bool(mine.size)
        self.J = np.delete(mode.D, mine, axis=1)
        self.difference = np.nan_to_num(comparison.read - comparison.raw(mode.prediction)) + mode.D @ mode.z
        bad = mode.bad >= GOOD
        kept, nothing = np.where(bad, 0.0, 1.0), np.zeros((bad.size, 0))
        self.good = good = kept if mine.size else np.ones(bad.size)
        self.nothing = self._evidence(nothing, self._noise(nothing), good)
        if mine.size:
            self.instead = self._evidence(mode.D[:, mine], mode.u, good)
        else:
            self.instead = self._evidence(nothing, mode.u, kept)
            r = comparison.whitener(mode.prediction, mode.u)(self.difference - mode.D @ mode.z)[bad]
            self.instead += float(np.sum(log_bad(r) - math.log(1.0 - BAD)))

    def of_a_step(self, columns: np.ndarray) -> tuple[float, int]:
        """Log evidence of a step whose moment is one of several, each as likely, and which does best."""
        u, at = self.mode.u, 0
        for _ in range(LOOKS):
            gains = self._singles(columns, u)
            at = int(np.argmax(gains))
            u = self._noise(np.column_stack([columns[:, at], np.where(self.within[:, at], columns[:, at], 0.0)]))
        gains = self._singles(columns, u)
        return float(logsumexp(gains) - math.log(gains.size)), int(np.argmax(gains))

    def _noise(self, columns: np.ndarray) -> np.ndarray:
        """The noise that suits some columns, from the declared one on [-], shape (5,)."""
        comparison, predicted = self.comparison, self.mode.prediction
        X, u = np.hstack([self.J, columns]), np.zeros(self.mode.u.size)
        for _ in range(PASSES):
            white = comparison.whitener(predicted, u)
            W, y = white(X) * self.good[:, None], white(self.difference) * self.good
            left = self.difference - X @ np.linalg.solve(W.T @ W + np.eye(W.shape[1]), W.T @ y)
            u = u + comparison.noise_step(left, predicted, u, self.good, X)[0]
        return u

    def _evidence(self, columns: np.ndarray, u: np.ndarray, good: np.ndarray) -> float:
        white = self.comparison.whitener(self.mode.prediction, u)
        W, y = white(np.hstack([self.J, columns])) * good[:, None], white(self.difference) * good
        P, b = W.T @ W + np.eye(W.shape[1]), W.T @ y
        fit = 0.5 * (b @ np.linalg.solve(P, b) - y @ y) - 0.5 * np.linalg.slogdet(P)[1]
        return float(fit) - white.log_scale - 0.5 * float(np.sum((u / SPREAD) ** 2))

    def _singles(self, columns: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Log evidence of each step, with a free share of it in the plateau during which it may be, shape (k,)."""
        white = self.comparison.whitener(self.mode.prediction, u)
        J = white(self.J) * self.good[:, None]
        C, W = (white(one) * self.good[:, None] for one in (columns, np.where(self.within, columns, 0.0)))
        r = project(J, white(self.difference) * self.good)
        PC, PW = project(J, C), project(J, W)
        a, b, c = (np.einsum("ij,ij->j", *pair) for pair in ((C, PC), (C, PW), (W, PW)))
        a, c = 1.0 + a, 1.0 + c
        x, y, size = C.T @ r, W.T @ r, a * c - b * b
        gains: np.ndarray = 0.5 * (c * x * x - 2.0 * b * x * y + a * y * y) / size - 0.5 * np.log(size)
        return gains + self._evidence(np.zeros((r.size, 0)), u, self.good)


def _first_after(comparison: Comparison, time: Along, moments: np.ndarray) -> np.ndarray:
    """Readings of the first plateau after each moment, shape (m, moments)."""
    n = comparison.n
    found = np.zeros((comparison.read.size, moments.size), dtype=bool)
    for k, moment in enumerate(moments):
        after = np.where(time.plateaus > moment, time.plateaus, np.inf)
        if np.isfinite(after).any():
            row = int(np.argmin(after))
            found[[row, n + row], k] = True
    return found


def _moments(time: Along) -> np.ndarray:
    """Moments between neighbouring plateaus and runs, with plateaus enough before and after."""
    plateaus = np.sort(time.plateaus[np.isfinite(time.plateaus)])
    starts = [float(run[np.isfinite(run)][0]) for run in time.runs if np.isfinite(run).any()]
    known = np.unique([*plateaus, *starts])
    between = 0.5 * (known[1:] + known[:-1])
    if plateaus.size < 2 * FEWEST:
        return np.zeros(0)
    inside = between[(between > plateaus[FEWEST - 1]) & (between < plateaus[-FEWEST])]
    return inside[np.unique(np.linspace(0, inside.size - 1, min(MOMENTS, inside.size)).astype(int))]


def _columns(comparison: Comparison, mode: Mode, time: Along, moments: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    """What one sd of each kind of step at each moment does to the readings [SI], shape (m, moments)."""
    n, end, size = comparison.n, comparison.end, comparison.read.size
    predicted, plateaus = mode.prediction, comparison.problem.blocks.plateaus
    steady = (time.plateaus[:, None] > moments).astype(float)
    runs = [(run[:, None] > moments).astype(float) for run in time.runs]
    answer = TorqueAnswer(comparison, torque_column(comparison, mode))
    torque = answer(steady * LARGEST_N_M, [one * LARGEST_N_M for one in runs])
    speed, flow, pressure = (np.zeros((size, moments.size)) for _ in range(3))
    speed[n : 2 * n] = steady * predicted.speed[:, None]
    turning = [predicted.runs[i][used] for i, used in enumerate(comparison.used)]
    if turning:
        speed[2 * n : end] = np.vstack(runs) * np.concatenate(turning)[:, None]
    flow[:n] = steady * predicted.flow[:, None]
    for rows, slope in ((slice(0, n), predicted.flow_slope), (slice(n, 2 * n), predicted.speed_slope)):
        pressure[rows] = steady * (slope * plateaus.pressure)[:, None]
    return {
        ("speed", "torque"): np.nan_to_num(torque),
        ("speed", "sensor"): LARGEST_SHARE * np.nan_to_num(speed),
        ("flow", "sensor"): LARGEST_SHARE * np.nan_to_num(flow),
        ("pressure", "sensor"): LARGEST_SHARE * np.nan_to_num(pressure),
    }
