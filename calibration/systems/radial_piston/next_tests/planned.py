"""Tests that this bench could make, each as a recording of another day that nobody has taken yet."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from calibration.data.blocks import levels
from calibration.data.runs_in_time import placeholders, repeated
from calibration.likelihood.expected import Capture
from calibration.unknowns.priors import column_of
from configs.units import BAR
from rig.recording import Column, Recording, RecordingFile

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

SAMPLE_S = 0.005  # of a run in time, where the recording has none
GAUGE_S = 0.1  # between two readings of the gauge in a run in time, where the recording has none
NOISIER = 2.0  # a sample than a plateau, where the recording does not say
BEFORE = 10  # samples before the valve turns
FIRST_LOOK_S = 4.0  # after it, until the model says how long the event is; longer by the flywheel
HIGHER, LEAST_HIGHER = 1.3, 1.05  # than the highest level so far; where the motor's speed allows less, so much at least
MAY_STAND = 0.1  # share of the highest speed: where it is slower, the rotor may stand in a room of another pressure
OF_THE_LIMIT = 0.95  # of the highest speed that the motor is made for
PLATEAUS, PLATEAU_S = 10, 4.0  # one right after the other
IN_TIME = ("coast-down", "spin-up")
FLYWHEEL = 3.0  # times the rotor's inertia
SLOW = 1.0  # sd of what is usual, from which on a line that empties so slowly drives the motor while it coasts down
VENT = "a valve at the motor that vents"
AN_HOUR_S = 3600.0
SAME = 1e-6  # of a hundredth of a bar: 2.3 bar stays 2.3


@dataclass(frozen=True)
class Planned:
    """A test.

    `recording`: what it would be read as; speeds and flows are placeholders.
    `capture`: what is taken; None where the bench cannot take it by itself.
    `needs`: what the bench lacks for it; with it the line is another one. Empty otherwise.
    """

    words: str
    recording: Recording
    capture: Capture | None = None
    needs: str = ""


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


def planned(
    comparison: Comparison, on: Comparison | None = None, line: Mapping[str, float] | None = None
) -> list[Planned]:
    """Coast-downs, a spin-up, plateaus elsewhere, cold, warm, a reversed sweep, the gauge at rest.

    `on`: the recording whose runs in time show how this bench takes them; the same, when left out.
    `line`: what they say of its line, of `line_of`.
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
        if line and line.get("venting_time", 0.0) > SLOW:
            found.append(replace(found[-1], words=f"{heavy}, the line vented within 0.1 s", capture=None, needs=VENT))
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
        added = self.heavier(flywheel) if flywheel else self.seen.added_inertia_kg_m2
        bar_abs = None if level is None else level.bar_abs
        capture = Capture(kind, bar_abs, added if kind in IN_TIME else 0.0) if kind else None
        return Planned(words, replace(self.seen, files=(file,), added_inertia_kg_m2=added), capture)

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
