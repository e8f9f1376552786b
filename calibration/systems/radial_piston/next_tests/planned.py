"""Tests that this bench could make, each as a recording of another day that nobody has taken yet."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from calibration.data.blocks import levels
from calibration.data.runs import RunInTime
from calibration.data.runs_in_time import placeholders, repeated
from calibration.likelihood.expected import MODEL_SD, Capture, Expected, directions
from calibration.likelihood.function import Function, Predicts
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.predict.carried import carried, of_any_day
from calibration.systems.radial_piston.predict.kinds import RUN
from calibration.systems.radial_piston.predict.supply import OF_THE_BENCH
from calibration.unknowns.priors import OfRun, Unknown, column_of, drift_of
from configs.units import BAR
from model.layout import RPM
from rig.recording import DOWN_TO, LEAST_IN_A_RUN, UP_TO, Column, Recording, RecordingFile, captured_s
from rig.recording.columns import OF_CHANNEL

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison
    from calibration.systems.radial_piston.noise import Whitener

SAMPLE_S = 0.005  # of a run in time, where the recording has none
GAUGE_S = 0.1  # between two readings of the gauge in a run in time, where the recording has none
NOISIER = 2.0  # a sample than a plateau, where the recording does not say
LEAST_TOLD = 1e-3  # of a prior's own precision: what a recording tells less of, it does not tell
TANGENT = 1e-3  # step of a derivative [-]
LEAST_LEFT = 0.02  # of a quantity that may not vanish, or of its usual size, to which a step leads at most
BEFORE = 10  # samples before the valve turns
FIRST_LOOK_S = 4.0  # after it, until the model says how long the event is; longer by the flywheel
HIGHER, LEAST_HIGHER = 1.3, 1.05  # than the highest level so far; where the motor's speed allows less, so much at least
MAY_STAND = 0.1  # share of the highest speed: where it is slower, the rotor may stand in a room of another pressure
OF_THE_LIMIT = 0.95  # of the highest speed that the motor is made for
PLATEAUS, PLATEAU_S = 10, 4.0  # one right after the other
IN_TIME = ("coast-down", "spin-up")
FLYWHEEL = 3.0  # times the rotor's inertia
AN_HOUR_S = 3600.0
SAME = 1e-6  # of a hundredth of a bar: 2.3 bar stays 2.3
ANCHOR = "anchor.csv"  # one plateau, which a recording must have; it is not looked at


@dataclass(frozen=True)
class Planned:
    """A test.

    `recording`: what it would be read as; speeds and flows are placeholders.
    `capture`: what is taken; None where the bench cannot take it by itself.
    """

    words: str
    recording: Recording
    capture: Capture | None = None


@dataclass(frozen=True)
class Level:
    """A pressure that a test asks for, to the hundredth of a bar: the same in its words, its command and its model.

    `bar_abs`, `read_bar`: the pressure, and what the recording's gauge shows at it [bar].
    """

    bar_abs: float
    read_bar: float
    is_gauge: bool

    @property
    def words(self) -> str:
        """As a person is told it."""
        absolute = f"{self.bar_abs:g} bar abs"
        return f"{absolute} ({self.read_bar:.2f} bar gauge)" if self.is_gauge else absolute

    @property
    def ten(self) -> np.ndarray:
        """Of ten plateaus, as the gauge shows it [bar]."""
        return np.full(PLATEAUS, self.read_bar)


def planned(comparison: Comparison, on: Comparison | None = None) -> list[Planned]:
    """Coast-downs, a spin-up, plateaus elsewhere, cold, warm, a reversed sweep, the gauge at rest.

    `on`: the recording whose runs in time show how this bench takes them; the same, when left out.
    """
    bench = _Bench(comparison, on or comparison)
    top = min(bench.top, bench.allowed())
    bottom = min(bench.low, top)
    low, middle, highest, more = map(bench.settable, (bottom, 0.5 * (bottom + top), top, bench.higher()))
    found = []
    if bench.columns["speed"]:
        found += [
            bench.plan(f"coast-down from {level.words}", bench.run(level.read_bar, False), "coast-down", level)
            for level in (middle, highest)
        ]
        mounted = bench.seen.added_inertia_kg_m2
        flywheel = f"{bench.heavier(FLYWHEEL):g} kg m2 in all" if mounted else "three times the inertia"
        heavy = f"coast-down from {middle.words} with a flywheel of {flywheel}"
        in_time = bench.run(middle.read_bar, False, 1.0 + FLYWHEEL)
        found.append(bench.plan(heavy, in_time, "coast-down", middle, FLYWHEEL))
        found.append(bench.plan(f"spin-up to {highest.words}", bench.run(highest.read_bar, True), "spin-up", highest))
    steady = [more, low, middle] if more.read_bar >= LEAST_HIGHER * top else [low, middle]
    found += [
        bench.plan(f"ten plateaus at {level.words}", bench.steady(level.ten), "plateaus", level) for level in steady
    ]
    warm = bench.steady(middle.ten, AN_HOUR_S)
    found.append(bench.plan(f"ten plateaus at {middle.words}, after an hour's running", warm))
    steps = np.array([level for level in bench.levels if level <= top])
    if steps.size > 2:
        reversed_ = np.concatenate([steps[::-1], steps])
        words = 'reversed sweep, from the highest level down and up: order = "down-up" in the bench file'
        found.append(bench.plan(words, bench.steady(reversed_)))
    found.append(bench.plan("zero: read the gauge with the line vented", bench.zero(), "zero"))
    return found


class _Bench:
    """The instruments and habits of a recording, and of its runs in time, or of those of another."""

    def __init__(self, comparison: Comparison, on: Comparison) -> None:
        self.seen = comparison.problem.recording
        plateaus, runs = comparison.problem.blocks.plateaus, on.problem.blocks.runs
        self.columns = {channel: column_of(self.seen, channel) for channel in ("pressure", "flow", "speed")}
        self.is_gauge = "gauge" in str(self.columns["pressure"])
        self.room = comparison.problem.motor.si("ambient_pressure") / BAR
        self.ambient = 0.0 if self.is_gauge else self.room
        groups = levels(plateaus)
        self.levels = [float(np.mean(plateaus.pressure[group])) / BAR for group in groups]
        self.speeds, self.speed_limit = plateaus.speed, comparison.problem.motor.si("speed_limit")
        least = MAY_STAND * np.nanmax(self.speeds, initial=0.0)
        turns = [least == 0.0 or bool(np.all(self.speeds[group] > least)) for group in groups]
        self.low = min((level for level, surely in zip(self.levels, turns, strict=True) if surely), default=math.inf)
        self.top = max(self.levels)
        self.pressures = plateaus.pressure / BAR
        self.pause = float(np.median(np.diff(np.unique(plateaus.time)))) if np.ptp(plateaus.time) > 0.0 else 40.0
        shown_every = self.seen.channels[str(self.columns["speed"])].window_s if self.columns["speed"] else None
        self.sample = float(np.median(np.diff(runs[0].time))) if runs else max(SAMPLE_S, shown_every or 0.0)
        self.gauge_every = max(round(_gauge_s(on.problem.recording) / self.sample), 1)
        self.noisier = float(np.max(runs[0].noise_scale)) if runs else NOISIER
        self.inertia = comparison.problem.motor.si("inertia")

    def allowed(self) -> float:
        """The highest level at which the motor without load turns no faster than it may; infinite where none tells.

        Without load the speed goes about with the pressure above the ambient.
        """
        if not np.any(self.speeds > 0.0):
            return math.inf
        fastest = int(np.nanargmax(self.speeds))
        above = float(self.pressures[fastest]) - self.ambient
        share = OF_THE_LIMIT * self.speed_limit / float(self.speeds[fastest])
        return math.floor(10.0 * (self.ambient + share * above)) / 10.0

    def higher(self) -> float:
        """A level higher than the highest, as far as the motor may turn; the highest where no speed tells how far."""
        allowed = self.allowed()
        return min(HIGHER * self.top, allowed) if math.isfinite(allowed) else self.top

    def settable(self, read_bar: float) -> Level:
        """A level that is asked for, no higher than a pressure that the gauge shows [bar]."""
        above = self.room if self.is_gauge else 0.0
        bar_abs = math.floor(100.0 * (read_bar + above) + SAME) / 100.0
        return Level(bar_abs, bar_abs - above, self.is_gauge)

    def heavier(self, flywheel: float) -> float:
        """Inertia of what is on the shaft with one more flywheel [kg m2]. `flywheel`: in rotors."""
        return float(f"{self.seen.added_inertia_kg_m2 + flywheel * self.inertia:.2g}")

    def plan(
        self, words: str, file: RecordingFile, kind: str = "", level: Level | None = None, flywheel: float = 0.0
    ) -> Planned:
        """A test; ``kind`` as it is captured, ``flywheel`` in rotors."""
        anchor = replace(self.steady(np.array([self.top])), file=ANCHOR)
        added = self.heavier(flywheel) if flywheel else self.seen.added_inertia_kg_m2
        bar_abs = None if level is None else level.bar_abs
        capture = Capture(kind, bar_abs, added if kind in IN_TIME else 0.0) if kind else None
        return Planned(words, replace(self.seen, files=(anchor, file), added_inertia_kg_m2=added), capture)

    def steady(self, pressure: np.ndarray, start: float = 0.0) -> RecordingFile:
        pause = self.pause if np.ptp(pressure) > 0.0 else PLATEAU_S
        values = {"time_s": pause * np.arange(pressure.size)} | self._read(pressure)
        highest = int(np.argmin(pressure)) if pressure.size > PLATEAUS else pressure.size
        way = np.where(np.arange(pressure.size) < highest, "down", "up") if pressure.size > PLATEAUS else None
        return _file("planned.csv", "steady", start, 1.0, values, way)

    def run(self, pressure: float, from_rest: bool, longer: float = 1.0) -> RecordingFile:
        count = BEFORE + math.ceil(FIRST_LOOK_S * longer / self.sample)
        opened = (np.arange(count) >= BEFORE) == from_rest
        line = np.where(opened, pressure, self.ambient)
        values = {"time_s": self.sample * (1.0 + np.arange(count)), "supply_open": opened.astype(float)}
        values |= self._read(line)
        values[str(self.columns["pressure"])] = np.where(np.arange(count) % self.gauge_every, np.nan, line)
        values[str(self.columns["speed"])] = np.where(opened | (not from_rest), 100.0, 0.0)
        values.pop(str(self.columns["flow"]), None)
        return _file("planned.csv", "transient", 0.0, self.noisier, values)

    def zero(self) -> RecordingFile:
        values = {str(self.columns["pressure"]): np.full(PLATEAUS, self.ambient)}
        return _file("planned.csv", "zero", 0.0, 1.0, values)

    def _read(self, pressure: np.ndarray) -> dict[str, np.ndarray]:
        """Placeholders of speed and flow: that there is a reading is all that counts."""
        found = {str(self.columns["pressure"]): pressure}
        for channel in ("flow", "speed"):
            if self.columns[channel]:
                found[str(self.columns[channel])] = np.full(pressure.size, 100.0)
        return found


def _gauge_s(seen: Recording) -> float:
    """How long it is from one reading of the gauge to the next in a recording's runs in time [s].

    What only repeats the reading before is none.
    """
    column = str(column_of(seen, "pressure"))
    gaps, figures = [np.zeros(0)], seen.channels.get(column)
    for file in seen.files:
        if figures is not None and file.kind == "transient" and column in file.columns:
            values = file.columns[column].values
            old = repeated(values, figures.noise_sd * file.noise_scale, figures.resolution)
            gaps.append(np.diff(file.columns["time_s"].values[np.isfinite(values) & ~old]))
    found = np.concatenate(gaps)
    return float(np.median(found)) if found.size else GAUGE_S


def _file(
    name: str, kind: str, start: float, noise: float, values: dict[str, np.ndarray], way: np.ndarray | None = None
) -> RecordingFile:
    columns = {key: Column(placeholders(value), np.zeros(value.size, np.int8)) for key, value in values.items()}
    rows = next(iter(values.values())).size
    return RecordingFile(name, kind, start, noise, rows, columns, way)  # type: ignore[arg-type]


def expected_readings(
    plan: Planned, seen: Comparison, rivals: Sequence[Mode], line: Mapping[str, float] | None = None
) -> list[Expected]:
    """What a test would read under each rival, with all that the recording leaves open of it.

    The motor, the effects and the errors of instruments that have a serial number are known as well as the recording
    tells, but for a drift that is declared. What is new on another day, such as the room or the shaft's angle, is
    anybody's guess; so is the line, about what a run of the recording says of the bench's. Raises ArithmeticError when
    the rotor would not turn in a run in time, or the bench's tachometer gives too few readings of it.

    `line`: what a run says of it, of `line_of`; of this recording's own, when left out.
    """
    there, line = seen.of(plan.recording), line_of(seen, rivals[0]) if line is None else line
    stays = of_any_day(seen.problem)
    first = _on_this_bench(line, there, carried(seen.problem, rivals[0], there.problem, stays)[0])
    if there.problem.blocks.runs:  # which samples are compared hangs on the speeds that are read
        likely = _mean(there, rivals[0].names)(first)
        there = seen.of(_as_captured(plan.recording, there.problem.blocks.runs[0], likely.runs[0]))
        if not there.problem.blocks.runs:
            raise FloatingPointError("the rotor would not turn")
    common = there.whitener(_mean(there, rivals[0].names)(first), rivals[0].u)
    found = []
    for one in rivals:
        z, covariance, new = carried(seen.problem, one, there.problem, stays)
        z = _on_this_bench(line, there, z)  # no rival's own: a line tells nothing of the motor
        found.append(_expected(there, common, one, z, covariance, new))
    return found


def line_of(seen: Comparison, likeliest: Mode) -> dict[str, float]:
    """How the line fills and empties in the last run of a recording that does so: what of it, and its unknown [-]."""
    return {
        unknown.of.what: float(value)
        for unknown, value in zip(seen.problem.nuisances, likeliest.z, strict=False)
        if isinstance(unknown.of, OfRun) and unknown.of.what in OF_THE_BENCH
    }


def _on_this_bench(line: Mapping[str, float], there: Comparison, z: np.ndarray) -> np.ndarray:
    """A point there [-] with the bench's line."""
    z = z.copy()
    for i, unknown in enumerate(there.problem.nuisances):
        if isinstance(unknown.of, OfRun) and unknown.of.what in line:
            z[i] = line[unknown.of.what]
    return z


def _expected(
    there: Comparison, common: Whitener, one: Mode, z: np.ndarray, covariance: np.ndarray, new: np.ndarray
) -> Expected:
    """What a test would read under a rival, from its point and covariance there, and which of its unknowns are new."""
    f, mean = Function(there, one.names), _mean(there, one.names)
    looked_at = there.known & ~((there.kind < RUN) & (there.index == 0))
    unknowns = [*there.problem.nuisances, *(unknown for _, unknown in there.problem.effect_unknowns(one.names))]
    open_ = directions(np.where(new[:, None] | new, 0.0, covariance))

    def white(difference: np.ndarray) -> np.ndarray:
        found: np.ndarray = common(np.nan_to_num(difference))[looked_at]
        return found

    def at(place: np.ndarray) -> np.ndarray:
        found = mean(f.clip(_straight_on(unknowns, z, open_ @ place)))
        return white(there.raw(found)) if there.is_told(found) else np.full(int(looked_at.sum()), np.nan)

    here = mean(z)
    if not there.is_told(here):
        raise FloatingPointError(f"the model with {' and '.join(one.names) or 'nothing added'} gives no reading of it")
    J = white(f.derivatives(z, here, np.zeros((there.read.size, z.size)), one.u, mean))
    raw = there.raw(here)
    inexact = white(
        np.column_stack([np.where(there.kind == 0, raw, 0.0), np.where(there.kind > 0, raw, 0.0)]) * MODEL_SD
    )
    own = J[:, new] @ covariance[np.ix_(new, new)] @ J[:, new].T + np.eye(int(looked_at.sum()))
    for i, unknown in enumerate(there.problem.nuisances):
        drift = None if new[i] else drift_of(there.problem.recording, unknown)
        if drift is not None:  # in an sd of the offset
            own += (drift.b / unknown.b) ** 2 * np.outer(J[:, i], J[:, i])
    return Expected(
        white(raw), J @ open_, inexact @ inexact.T, own, at, _left_open(unknowns, z, covariance, new, open_)
    )


def _left_open(
    unknowns: Sequence[Unknown], z: np.ndarray, covariance: np.ndarray, new: np.ndarray, open_: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """From a place along the directions in which a recording leaves a rival open [-] to what there is against it.

    What it says is straight in the quantities, a prior in its own coordinate. At the point the two pull alike.

    `z`, `covariance`: the point there and what it is known by [-]. `new`: what the recording does not tell.
    `open_`, shape (n, k): directions there [-].
    Returns the residuals, of `Expected.left`.
    """
    known = np.flatnonzero(~new)
    precision, unit = np.linalg.eigh(
        np.linalg.pinv(covariance[np.ix_(known, known)], hermitian=True) - np.eye(known.size)
    )
    told = precision > LEAST_TOLD
    J = np.sqrt(precision[told])[:, None] * unit[:, told].T
    r = (unit[:, told].T @ z[known]) / np.sqrt(precision[told])

    def left(place: np.ndarray) -> np.ndarray:
        move = open_ @ place
        return np.append(r - J @ move[known], _straight_on(unknowns, z, move)[known])

    return left


def _straight_on(unknowns: Sequence[Unknown], z: np.ndarray, move: np.ndarray) -> np.ndarray:
    """A step that is straight in the quantities themselves, not in their priors' coordinates [-].

    `z`, `move`, shape (n,): where from, and how far along the tangent [-].
    """
    found = z + move
    for i, one in enumerate(unknowns):
        if one.kind == "normal" or move[i] == 0.0:
            continue
        here, ahead, behind = (float(one.value(np.asarray(at))) for at in (z[i], z[i] + TANGENT, z[i] - TANGENT))
        to = here + (ahead - behind) / (2.0 * TANGENT) * move[i]
        if one.kind == "lognormal":
            to = max(to, LEAST_LEFT * here)
        elif one.kind == "loguniform":
            to = min(max(to, one.a * (1.0 + LEAST_LEFT)), one.b * (1.0 - LEAST_LEFT))
        elif one.kind == "halfsize":
            to = max(to, one.a + LEAST_LEFT * one.b)
        found[i] = one.z(to)
    return found


def _mean(there: Comparison, names: tuple[str, ...]) -> Predicts:
    """Predictions by the mean torque: nobody can count on the phase of the pulses."""
    return functools.partial(Function(there, names), smooth=True)


def _as_captured(recording: Recording, planned: RunInTime, speed: np.ndarray) -> Recording:
    """With the speeds that are likely, as long as the bench would record it.

    Raises FloatingPointError when the bench would refuse it: too few readings of the tachometer would fall in the
    event.
    """
    anchor, run = recording.files
    name = OF_CHANNEL["speed"].column
    held, told = run.columns[name], np.isfinite(speed)
    time, is_open = run.columns["time_s"].values, run.columns["supply_open"].values > 0.5
    likely = np.interp(time, planned.time[told], speed[told]) if told.any() else np.zeros(time.size)
    shown = np.where(held.values > 0.0, np.maximum(likely * RPM, 0.1), 0.0)

    moved = int(np.argmax(is_open != is_open[0]))
    after = shown[moved:]
    over = after >= UP_TO * after[-1] if is_open[moved] else after <= DOWN_TO * shown[moved - 1]
    length = int(np.argmax(over)) if over.any() else over.size
    pulses = recording.channels[name].pulses_per_rev
    sample_s = float(time[1] - time[0])
    turns = float(np.sum(after[:length])) / 60.0 * sample_s
    readings = turns * pulses if pulses else length
    if readings < LEAST_IN_A_RUN:
        raise FloatingPointError(f"{readings:.0f} readings of the speed where {LEAST_IN_A_RUN} are needed")
    kept = min(moved + math.ceil(captured_s(length * sample_s) / sample_s), run.rows)
    columns = {**run.columns, name: replace(held, values=placeholders(shown))}
    cut = {key: Column(one.values[:kept], one.censor[:kept]) for key, one in columns.items()}
    return replace(recording, files=(anchor, replace(run, rows=kept, columns=cut)))
