"""The line between valve and motor in a run in time: what its pressure does, from a few unknowns with priors.

A line that fills is two first-order lags in a row: a regulator or a volume, and a valve. A share of the step may pass
ahead of the slower one, where the regulator was filled before the valve. A regulator gives less pressure the more air
is taken from it, so a line stands higher until the motor turns. A line that empties does so through a valve that opens
evenly, and through the motor. Both begin some time after the valve is said to move. What no such form has right (an
orifice that chokes) is left to a few free deviations. A step is the special case. Shares count from the vented line (0)
to the settled one (1).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.data.runs import RunInTime
from calibration.unknowns.priors import Unknown, unknown_of_run
from configs.compiled import njit
from model.solvers.transient import Supply
from rig.recording import SupplyFigures

LATE_SD = 0.1  # s; by so much the line follows later, or earlier, than the samples say that the valve is moved
GAUGE_LATE_SD = 0.02  # s; by so much what a gauge shows is older, or newer, than its time says
REGULATOR_S, EMPTYING_S, VALVE_S = 0.05, 0.03, 0.01  # time constants where nothing is stated
LEAST_S = 1e-3  # what is stated to be quicker, a step among them, is taken to need so long
UNSTATED, UNSTATED_VALVE, STATED = 5.0, 3.0, 2.0  # factors by which they may be off
FORMS = (0.4, 1.0, 2.5, 6.0)  # where the free deviations have their middles, in sums of the time constants
FORM_SD = 0.02  # of each, in shares of the step
MIDDLES, LOG_WIDTH = np.log(FORMS), math.log(2.5)
BEND, BEND_SD = 0.3, 0.3  # of what empties a line: a root, 0.5, and a straight line, 0, lie within it
STRAIGHT, EMPTY = 1e-9, 1e-12  # a bend that is as good as none; what is left of a line, to the power of its bend
FLOOR_PA = 1000.0  # by which a line that is being vented stays above the ambient while the motor turns
DROOP, DROOP_FACTOR = 0.03, 3.0  # by which a line stands higher while the motor takes no air, in shares of the step
LEAD_SD = 0.25  # share of the step that passes ahead of the slower lag
WANDERS, WANDER_SD = 8, 0.002  # pieces in which an open line goes up and down, and by how much, in shares of the step
STEADY_STEP_S = 0.02  # of the staircase, once the line has settled
MOST_SHARE = 1.5
ALIKE = 1e-3  # share by which two time constants differ that count as one
# Of the staircase that stands for the line: its edges, in sums of the time constants after the line begins to move.
EDGES = np.concatenate([np.linspace(0.0, 1.0, 41), np.geomspace(1.0, 12.0, 121)[1:]])
OPENING, VENTING = "opening", "venting"
# What of a run is the bench's, and stays as it is until another run.
OF_THE_BENCH = (
    *(f"{way}_{what}" for way in (OPENING, VENTING) for what in ("time", "valve")),
    *(f"{way}_form_{k}" for way in (OPENING, VENTING) for k in range(len(FORMS))),
    *("opening_lead", "opening_droop", "venting_bend", "floor"),
)


def ways_of(run: RunInTime) -> list[str]:
    """How the line of a run changes: it is opened, vented, or both."""
    moved = {span.is_open for span in run.valve[1:]}
    return [way for way, opens in ((OPENING, True), (VENTING, False)) if opens in moved]


def line_unknowns(run: RunInTime, stated: SupplyFigures) -> list[Unknown]:
    """The unknowns of a run's line, named after its file."""
    sd = max(run.settled_sd, 1.0)
    found = [unknown_of_run(run.file, "supply", "Pa", "normal", 0.0, sd, "what had not settled")]
    valve = _constant(stated.valve_time_s, stated.valve_time_s_sd, VALVE_S, UNSTATED_VALVE)
    for way in ways_of(run):
        slow = (
            _constant(stated.regulator_time_s, stated.regulator_time_s_sd, REGULATOR_S, UNSTATED)
            if way == OPENING
            else (EMPTYING_S, UNSTATED)
        )
        unseen = max(gap for gap, span in zip(run.unseen_s, run.valve, strict=True) if span.is_open == (way == OPENING))
        moved = math.hypot(LATE_SD, unseen / math.sqrt(12.0))
        found += [
            unknown_of_run(run.file, f"{way}_late", "s", "normal", 0.0, moved, "when the valve moved"),
            unknown_of_run(run.file, f"{way}_time", "s", "lognormal", *slow, "a line that fills or empties"),
            unknown_of_run(run.file, f"{way}_valve", "s", "lognormal", *valve, "a valve's time"),
        ]
        for k in range(len(FORMS)):
            found.append(unknown_of_run(run.file, f"{way}_form_{k}", "-", "normal", 0.0, FORM_SD, "no line is exact"))
    if OPENING in ways_of(run):
        found += [
            unknown_of_run(run.file, "opening_lead", "-", "normal", 0.0, LEAD_SD, "a regulator that was filled before"),
            unknown_of_run(run.file, "opening_droop", "-", "lognormal", DROOP, DROOP_FACTOR, "a regulator's droop"),
        ]
        for k in range(WANDERS):
            found.append(
                unknown_of_run(run.file, f"wander_{k}", "-", "normal", 0.0, WANDER_SD, "no regulator stands still")
            )
    found.append(unknown_of_run(run.file, "gauge_late", "s", "normal", 0.0, GAUGE_LATE_SD, "a gauge's own time"))
    if VENTING in ways_of(run):
        found.append(unknown_of_run(run.file, "venting_bend", "-", "normal", BEND, BEND_SD, "orifice or motor"))
        found.append(unknown_of_run(run.file, "floor", "Pa", "normal", FLOOR_PA, FLOOR_PA, "a vent's own loss"))
    return found


def own_of_line(file: str) -> list[str]:
    """Names of the unknowns that say how a run's line goes, without the small deviations."""
    ways = [f"{way}_{what}" for way in (OPENING, VENTING) for what in ("late", "time", "valve")]
    names = ["supply", *ways, "opening_lead", "opening_droop", "venting_bend", "floor", "begun"]
    return [f"{file}.{name}" for name in names]


def _constant(stated: float | None, sd: float | None, otherwise: float, factor: float) -> tuple[float, float]:
    """Middle and factor of a time constant's prior: a stated one is seldom defined as it is here."""
    if stated is None:
        return otherwise, factor
    middle = max(stated, LEAST_S)
    return middle, max(STATED, math.exp(min((sd or 0.0) / middle, 2.0)))


@dataclass(frozen=True)
class Course:
    """The line of a run at a point.

    `own`: the run's own unknowns, by the ends of their names.
    `over`: when the last sample that is compared ends [s].
    `turning`, shape (n,): when the rotor comes to even shares of its settled speed, and takes as much more air [s].
    """

    valve: tuple[Supply, ...]
    own: Mapping[str, float]
    over: float
    turning: np.ndarray

    def share(self, time: np.ndarray) -> np.ndarray:
        """Share of the settled pressure above the vented one [-], same shape as ``time``.

        `time`: on the run's clock [s].
        """
        (starts, opens), (ways, forms, bends, wander) = self._spans, self._figures
        when = np.asarray(time, dtype=np.float64)
        found: np.ndarray = _shares(
            when.ravel(), starts, opens, ways, forms, bends, wander, self.over, self.turning
        ).reshape(when.shape)
        return found

    def staircase(self, settled_pa: float, vented_pa: float, shut_pa: float) -> np.ndarray:
        """The line as spans of constant pressure: rows of start [s], pressure [Pa], and 1 where it is open.

        `settled_pa`, `vented_pa`: True pressure of the settled and of the vented line [Pa].
        `shut_pa`: pressure from which on downwards the inlet holds what a vented one does [Pa].
        """
        begin = _edges(*self._spans, self._figures[0], self.over)
        last = begin[-1] + (begin[-1] - begin[-2] if begin.size > 1 else 1.0)
        middle = 0.5 * (begin + np.append(begin[1:], last))
        pressure = vented_pa + (settled_pa - vented_pa) * self.share(middle)
        is_open = shut_pa < pressure
        kept = is_open | np.append(True, is_open[:-1])  # while it stays shut, one span will do
        return np.column_stack([begin, np.where(is_open, pressure, vented_pa), is_open])[kept]

    @cached_property
    def _spans(self) -> tuple[np.ndarray, np.ndarray]:
        """When each span of the valve begins [s], and whether it is open."""
        return np.array([span.start_s for span in self.valve]), np.array([span.is_open for span in self.valve])

    @cached_property
    def _figures(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The run's own unknowns as `_shares` takes them: `ways`, `forms`, `bends` and `wander`."""
        own, ways, forms = self.own, np.ones((2, 3)), np.zeros((2, len(FORMS)))
        for is_open in {span.is_open for span in self.valve[1:]}:
            way = OPENING if is_open else VENTING
            ways[int(is_open)] = own[f"{way}_late"], own[f"{way}_time"], own[f"{way}_valve"]
            forms[int(is_open)] = [own[f"{way}_form_{k}"] for k in range(len(FORMS))]
        bends = np.array([own.get("opening_lead", 0.0), own.get("opening_droop", 0.0), own.get("venting_bend", 0.0)])
        wander = np.array([own.get(f"wander_{k}", 0.0) for k in range(WANDERS)])
        return ways, forms, bends, wander


LEAD, SPARE, EMPTIES = range(3)  # share that passes ahead, droop and bend [-]


@njit(cache=True, nogil=True)
def _shares(
    time: np.ndarray,
    starts: np.ndarray,
    opens: np.ndarray,
    ways: np.ndarray,
    forms: np.ndarray,
    bends: np.ndarray,
    wander: np.ndarray,
    over: float,
    turning: np.ndarray,
) -> np.ndarray:
    """`Course.share`.

    `starts`, `opens`, shape (k,): when each span of the valve begins [s], and whether it is open.
    `ways`, shape (2, 3): of a line that empties, then of one that fills, how late it is and its time constants [s].
    `forms`, shape (2, 4): their free deviations [-].
    `bends`, shape (3,): LEAD, SPARE, EMPTIES [-].
    `wander`, shape (8,): how far an open line is above where it should be, at even times [-].
    """
    out = np.empty(time.size)
    for i in range(time.size):
        share = 1.0 if opens[0] else 0.0
        for span in range(1, starts.size):
            late, slow, fast = ways[int(opens[span])]
            begun = time[i] - starts[span] - late
            if opens[span]:
                share += _wandered(time[i], starts[span], over, wander)
            if begun <= 0.0:
                continue
            moved = _deviation(begun / (slow + fast), forms[int(opens[span])])
            if opens[span]:
                filled = _filled(begun, slow, fast, bends[LEAD])
                spare = filled - _taken(begun, turning, starts[span] + late, slow, fast, bends[LEAD])
                share += filled + moved + bends[SPARE] * spare
            else:  # up is more pressure: an empty line goes nowhere else, and derivatives are taken upwards
                share -= _emptied(begun, slow, fast, bends[EMPTIES]) - moved
        out[i] = min(max(share, 0.0), MOST_SHARE)
    return out


@njit(cache=True, nogil=True)
def _edges(starts: np.ndarray, opens: np.ndarray, ways: np.ndarray, over: float) -> np.ndarray:
    """When the spans of the staircase begin [s]."""
    found = [starts[0]]
    for span in range(1, starts.size):
        late, slow, fast = ways[int(opens[span])]
        until = starts[span + 1] if span + 1 < starts.size else np.inf
        least, edge = found[-1], 0.0
        for one in EDGES:
            edge = starts[span] + late + (slow + fast) * one
            if least < edge < until:
                found.append(edge)
        settled, step = edge, 1
        while opens[span] and settled + step * STEADY_STEP_S < min(over, until):
            if settled + step * STEADY_STEP_S > least:
                found.append(settled + step * STEADY_STEP_S)
            step += 1
    return np.array(found)


@njit(cache=True, nogil=True)
def _wandered(time: float, opened: float, over: float, wander: np.ndarray) -> float:
    """How far an open line is above where it should be [-]."""
    place = (time - opened) / (max(over - opened, 1e-3) / wander.size)
    if place <= 0.0:
        return 0.0
    if place >= wander.size:
        return float(wander[-1])
    k = int(place)
    before = wander[k - 1] if k else 0.0
    return float(before + (place - k) * (wander[k] - before))


@njit(cache=True, nogil=True)
def _filled(begun: float, slow: float, fast: float, lead: float) -> float:
    """Step response of two first-order lags in a row, of which a share passes ahead of the slower one [-]."""
    if begun <= 0.0:
        return 0.0
    if abs(slow - fast) < ALIKE * slow:  # the limit, to second order the same
        mean = begun / (0.5 * (slow + fast))
        return 1.0 - (1.0 + (1.0 - lead) * mean) * np.exp(-mean)
    held, passed = (1.0 - lead) * slow, fast - lead * slow
    return 1.0 - (held * np.exp(-begun / slow) - passed * np.exp(-begun / fast)) / (slow - fast)


@njit(cache=True, nogil=True)
def _taken(begun: float, turning: np.ndarray, moved: float, slow: float, fast: float, lead: float) -> float:
    """What the motor takes of the air of a line [-], of which an even part is from each of some times on [s].

    `moved`: when the line begins to move [s].
    """
    gone = 0.0
    for one in turning:
        gone += _filled(begun - max(one - moved, 0.0), slow, fast, lead)
    return gone / turning.size


@njit(cache=True, nogil=True)
def _emptied(begun: float, slow: float, fast: float, bend: float) -> float:
    """How far a line has emptied through a valve which opens evenly [-], by dx/dt = -open x^(1 - bend) / time.

    A bend of 0.5 is a flow that goes with the root of the overpressure, as through an orifice; one of 0 goes with it,
    as through a motor. The valve is open after twice its time constant, which delays as much as its lag would.
    """
    opens = 2.0 * fast
    if abs(bend) <= STRAIGHT:
        bend = STRAIGHT
    passed = begun - 0.5 * opens if begun >= opens else begun * begun / (2.0 * opens)
    return 1.0 - np.exp(np.log1p(max(-bend * (passed / slow), EMPTY - 1.0)) / bend)


@njit(cache=True, nogil=True)
def _deviation(begun: float, forms: np.ndarray) -> float:
    """The free deviations: hats over the logarithm of the time in sums of the time constants [-]."""
    place, found = np.log(max(begun, 1e-6)), 0.0
    for k in range(forms.size):
        found += forms[k] * max(0.0, 1.0 - abs(place - MIDDLES[k]) / LOG_WIDTH)
    return found
