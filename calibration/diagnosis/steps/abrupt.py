"""What no listed effect is and a bench still knows: something that is otherwise from one moment on.

A belt slips, a gauge is knocked, a bearing seizes: a step in the running time of a torque, or of what an instrument
reads. An effect that changes with time can look like it, and so can a misread row. Before anything is named alone, a
step stands in for it, in the model made linear; which moment it has is not known, so its evidence is the mean over all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from calibration.diagnosis.steps.locate import METERS, Kind, Place
from calibration.diagnosis.steps.search import values_of
from calibration.likelihood.bad_reading import BAD, log_bad
from calibration.likelihood.compared import Compared
from calibration.likelihood.descent import find
from calibration.likelihood.linearized import GOOD
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import StepsInTime
from calibration.likelihood.signatures import project

LOOKS = 2  # for the best moment, each with the noise that suits the one before
PASSES = 4  # of the noise
STEP = "torque_step"  # the effect
LEAST_GAIN = 5.0  # nats over nothing that make a step something
ODDS = 20.0  # of what is named against a step, or it is not named
WORTH_A_REFIT = -40.0  # nats over the member in the linear model


@dataclass(frozen=True)
class Step:
    """A step in the running time.

    `start_s`, `end_s`: from when on, at the most probable, and the recording's end [s].
    `gain`: log evidence over nothing in its place, every moment as likely [-].
    `over`: what it adds to the log evidence in the place of what it stands in for [-].
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
        p_value = math.exp(-max(self.gain, 0.0))
        return Place(Kind.STEP, self.channel, self.balance, "time", where, "s", p_value, sentence, ())


def step_instead(comparison: Compared, mode: Mode) -> Step | None:
    """The step in time that does best in the place of a member of a set; None where the recording has no clock for one.

    `mode`: of the set; of the base model a step is tried in the place of the readings that it takes for bad.
    """
    steps = comparison.places.steps_in_time(mode)
    if steps is None:
        return None
    kinds = {key: columns for key, columns in steps.columns(comparison, mode).items() if columns.any()}
    first = len(comparison.problem.nuisances)
    owner = np.array([name for name, _ in comparison.problem.effect_unknowns(mode.names)])
    found: list[Step] = []
    for member in mode.names or ("",):
        mine = first + np.flatnonzero(owner == member) if member else np.zeros(0, dtype=int)
        rest = _Rest(comparison, mode, mine, steps.within)
        for (channel, balance), columns in kinds.items():
            gain, at = rest.of_a_step(columns)
            one = Step(
                channel, balance, float(steps.moments[at]), steps.end_s, gain - rest.nothing, gain - rest.instead
            )
            if balance == "torque" and member and one.over > WORTH_A_REFIT:
                one = _refitted(comparison, mode, member, one, steps)
            found.append(one)
    return max(found, key=lambda one: one.over)


def _refitted(comparison: Compared, mode: Mode, member: str, step: Step, steps: StepsInTime) -> Step:
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
            over = near.log_evidence - math.log(steps.moments.size) - mode.log_evidence  # whichever moment it was
            if over <= best.over:
                break
            best = replace(step, gain=best.gain + over - best.over, over=over)
            place = k + [name for name, _ in there.problem.effect_unknowns(names)].index(STEP)
            columns = steps.columns(there, near)["speed", "torque"]
            at = _Rest(there, near, np.array([place]), steps.within).of_a_step(columns)[1]
            if steps.moments[at] == step.start_s:
                break
            step, first = replace(step, start_s=float(steps.moments[at])), {}
    except ArithmeticError:  # nothing of it can be simulated
        return best
    return best


class _Rest:
    """A set without a member, made linear: log evidence with other columns in its place, up to what they share.

    The noise is what suits each: a set that needs loud noise to be true is not helped by it here.

    `mine`: places of the member's unknowns; none where the readings taken for bad are left out.
    `within`, shape (m, moments): readings of the plateau during which each moment may be: what of the step they show is
        free, where it stands for a member.
    `instead`: with the member, or with the bad readings taken for bad [-].
    """

    def __init__(self, comparison: Compared, mode: Mode, mine: np.ndarray, within: np.ndarray) -> None:
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
        """The noise that suits some columns, from the declared one on [-], shape (k,)."""
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
        return float(fit) - white.log_scale - 0.5 * float(np.sum((u / self.comparison.noise.spread) ** 2))

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
