"""A run in time as plain arrays, as a diagnosis compares it with the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibration.data.runs_in_time import lone_zeros, repeated
from configs.units import BAR
from model.layout import RPM
from model.solvers.transient import Supply
from rig.recording import Channel, Recording, RecordingError, RecordingFile
from rig.recording.columns import pressure_in

REST_SHARE = 0.1  # a coast-down is compared down to this share of its first speed,
REST_AT = 5.0  # rad/s; ... and to this speed: below, it hangs on single pulses of the cylinders
RISEN_SHARE = 0.3  # ... and a start from rest from this share of its highest speed on: how it broke away nobody knows
BEFORE_S = 0.25  # real time that a run in time is simulated before its first sample, to reach its steady state
WHOLE = 0.03  # of a tooth by which a sample that spans whole teeth may miss them
ROWS_ARE_TEETH = 0.9  # share of the samples that span whole teeth, from which on the rows are teeth
LEAST_PULSE = 0.8  # of a pulse of the cylinders that a sample has to span
SETTLING = 0.7  # share of a span that began with the valve, after which its line is taken to have settled at first
UNSETTLED = 0.005  # share of its pressure by which a line does not settle where the gauge last was,
UNTOLD = 0.05  # ... and where hardly a reading tells
MOVING_S = 2.0  # after the valve is moved; later readings are taken together
MOST_READINGS = 60  # of the gauge while the line moves; more are taken together
READ_LATE_S = 0.003  # by which the moment of a gauge's reading is off at least; see `scatter`
NORMAL_MEDIAN = 0.6745  # of the size of a standard normal number
FORM = 0.02  # of what the line moves from reading to reading: no form of its course is exact
SETTLED_SHARE = 0.2  # of a run, at its end, in which a spin-up has its settled speed
SHARES = 24  # of the settled speed
REST_RAD_S = 0.5  # below this at the start, the rotor is taken to be at rest


@dataclass(frozen=True)
class Line:
    """What the gauge reads in a run in time, SI; readings that are alike are taken together.

    `time`, shape (n,): of the readings [s].
    `group`, shape (n,): the mean that each goes into.
    `pressure`, `sd`, shape (m,): means of the groups and their noise [Pa].
    """

    time: np.ndarray
    group: np.ndarray
    pressure: np.ndarray
    sd: np.ndarray

    def means(self, at_readings: np.ndarray) -> np.ndarray:
        """Means over the groups, shape (m,). `at_readings`, shape (n,): one value a reading [own unit]."""
        count = np.bincount(self.group, minlength=self.pressure.size)
        return np.bincount(self.group, at_readings, self.pressure.size) / np.maximum(count, 1)


@dataclass(frozen=True)
class RunInTime:
    """A transient file, SI.

    `time`, `begin`, shape (n,): each speed reading is the mean from ``begin`` to ``time``, from the file's start [s].
    `speed`, shape (n,): readings [rad/s]; negative-free.
    `valve`: spans of the valve: when it was moved, and where the gauge settled with it open.
    `unseen_s`: of each span, how long no row was between the last one before the valve was moved and the first one
        after [s].
    `settled_sd`: by how much the settled pressure may be off, the gauge's own errors apart [Pa].
    `is_gauge`: whether the ambient is to be added to the gauge's readings.
    `start_s`: on the recording's clock [s].
    `noise_scale`, shape (n,): of each sample [-].
    `row`, shape (n,): number of its last row in the file, from 1.
    `from_rest`: whether it starts at rest; otherwise in the steady state of its first span.
    `used`, shape (n,): samples that are compared: a spin-up's once it is well on its way, a coast-down's from when the
        valve is moved until it is nearly over. What it turned at before says no more than a plateau, and is seldom as
        settled.
    """

    file: str
    time: np.ndarray
    begin: np.ndarray
    speed: np.ndarray
    valve: tuple[Supply, ...]
    unseen_s: tuple[float, ...]
    settled_sd: float
    line: Line
    is_gauge: bool
    start_s: float
    noise_scale: np.ndarray
    row: np.ndarray
    from_rest: bool
    used: np.ndarray

    @property
    def size(self) -> int:
        """Number of samples [-]."""
        return int(self.time.size)

    @property
    def stood(self) -> float:
        """Share of the time from the valve to the first sample that is compared until which the rotor was seen at rest
        [-]: caught at a dead point, or its line filled slowly.
        """
        opened = next((span.start_s for span in self.valve if span.is_open), math.inf)
        first = float(self.begin[self.used].min(initial=math.inf))
        at_rest = self.time[(self.speed < REST_RAD_S) & (self.time <= first)]
        if not self.from_rest or not at_rest.size or not opened < first < math.inf:
            return 0.0
        return max(float(at_rest[-1]) - opened, 0.0) / (first - opened)

    @cached_property
    def turning(self) -> np.ndarray:
        """When the rotor first comes to even shares of its settled speed [s], shape (SHARES,)."""
        late = self.time > self.time[-1] - SETTLED_SHARE * (self.time[-1] - self.begin[0])
        share = np.maximum.accumulate(self.speed) / max(float(np.median(self.speed[late])), REST_RAD_S)
        middle = 0.5 * (self.begin + self.time)
        return np.interp((np.arange(SHARES) + 0.5) / SHARES, share, middle, left=self.begin[0], right=math.inf)

    @property
    def over(self) -> float:
        """When the last sample that is compared ends [s]."""
        return float(self.time[self.used][-1]) if self.used.any() else float(self.time[-1])


def run_of(file: RecordingFile, recording: Recording, pulse_rad: float) -> RunInTime:
    """A transient file as arrays; `pulse_rad`: angle of a pulse of the motor's cylinders.

    Raises RecordingError: without a clock, a speed or a pressure.
    """
    name, gauge = pressure_in(file.columns)
    if "time_s" not in file.columns or "speed_rpm" not in file.columns or name not in file.columns:
        raise RecordingError(f"{file.file}: a transient needs time_s, speed_rpm and a pressure for this motor")
    clock, read = file.columns["time_s"].values, file.columns["speed_rpm"]
    shown = np.where(read.censor > 0, np.nan, read.values)  # off the scale is no speed
    tachometer = recording.channels["speed_rpm"]
    turning = np.where(shown > 0.0, shown, np.nan)
    sampled = np.isfinite(shown) & ~lone_zeros(shown)
    sampled &= ~repeated(turning, tachometer.noise_sd * file.noise_scale, tachometer.resolution)
    speed, time = shown[sampled] / RPM, clock[sampled]
    opened = np.ones(clock.size, bool) if file.is_open is None else file.is_open
    pressure, noise = _gauge(file, recording.channels[name])
    from_rest = bool(speed.size == 0 or np.mean(speed[:5]) < REST_RAD_S or not opened[0])
    valve, unseen_s, settled_sd = _valve(clock, pressure, opened)
    window = tachometer.window_s
    begin = _begin(time) if window is None else time - window
    if window is None and tachometer.pulses_per_rev:
        begin = _at_the_tooth_before(time, begin, speed, tachometer.pulses_per_rev)
    row, scale = np.flatnonzero(sampled) + 1, np.full(time.size, file.noise_scale)
    if window is None:
        time, begin, speed, row, scale = _by_pulses(time, begin, speed, row, scale, pulse_rad)
    elif tachometer.noise_sd:
        scale = np.hypot(scale, _asked_late(time, speed, tachometer) / tachometer.noise_sd)
    used = _useful(speed, begin, time, valve, from_rest)
    over = float(time[used][-1]) if used.any() else -np.inf
    line = _line(clock, pressure, valve, noise, over)
    return RunInTime(
        file.file, time, begin, speed, valve, unseen_s, settled_sd, line, gauge, file.start_s, scale, row, from_rest,
        used,
    )  # fmt: skip


def _gauge(file: RecordingFile, figures: Channel) -> tuple[np.ndarray, float]:
    """What the gauge read, nan where it shows a reading again or is at its scale's end, and its noise [Pa]."""
    read = file.columns[figures.column]
    old = repeated(read.values, figures.noise_sd * file.noise_scale, figures.resolution)
    noise = float(np.hypot(figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0))) * BAR
    return np.where((read.censor == 0) & ~old, read.values * BAR, np.nan), noise


def _begin(time: np.ndarray) -> np.ndarray:
    """Where the mean that each sample is begins: at the sample before; of the first nobody knows."""
    if time.size < 2:
        return time - 1.0
    return np.concatenate([[time[0] - float(np.median(np.diff(time)))], time[:-1]])


def _at_the_tooth_before(time: np.ndarray, begin: np.ndarray, speed: np.ndarray, teeth: float) -> np.ndarray:
    """Where samples begin of a counter whose rows are teeth: where some were lost, at the tooth before.

    A sample that spans whole teeth is the mean since the row before.
    """
    one = 2.0 * math.pi / teeth
    turned = speed * (time - begin) / one
    whole = np.abs(turned - np.rint(turned)) < WHOLE
    if not speed.size or np.mean(whole[speed > 0.0]) < ROWS_ARE_TEETH:
        return begin
    since = one / np.maximum(speed, 1e-9)
    return np.where(whole | (since > time - begin), begin, time - since)


def _by_pulses(
    time: np.ndarray, begin: np.ndarray, speed: np.ndarray, row: np.ndarray, scale: np.ndarray, pulse_rad: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Samples one after the other taken together until the shaft has turned by most of a pulse of the cylinders.

    In one that is finer the pulse shows, and nobody knows how the shaft stood.
    """
    turned = np.cumsum(speed * (time - begin))
    group = np.zeros(time.size, dtype=int)
    since, last = turned[0] if time.size else 0.0, 0
    gap = np.append(False, begin[1:] > time[:-1] + 1e-9)
    for k in range(1, time.size):
        full = turned[k - 1] - since >= LEAST_PULSE * pulse_rad
        if full or speed[k] == 0.0 or speed[k - 1] == 0.0 or k == 1 or gap[k]:
            last += 1
            since = turned[k - 1]
        group[k] = last
    ends = np.append(np.flatnonzero(np.diff(group)), time.size - 1) if time.size else np.zeros(0, dtype=int)
    starts = np.append(0, ends[:-1] + 1) if time.size else ends
    count = ends - starts + 1
    span = time[ends] - begin[starts]
    mean = np.add.reduceat(speed * (time - begin), starts) / span if time.size else speed
    return time[ends], begin[starts], mean, row[ends], scale[ends] / np.sqrt(count)


def _useful(
    speed: np.ndarray, begin: np.ndarray, time: np.ndarray, valve: Sequence[Supply], from_rest: bool
) -> np.ndarray:
    used = np.ones(speed.size, dtype=bool)
    used[:1] = False  # in a log that was cut the first is no mean of anything that is there
    if not speed.size:
        return used
    if from_rest:
        opened = next((span.start_s for span in valve if span.is_open), time[0])
        used &= (time > opened + 1e-9) & (np.append(0.0, speed[:-1]) > 0.0)  # no mean over a rest
        turning = np.flatnonzero(used & (speed > RISEN_SHARE * np.max(speed, where=used, initial=0.0)))
        if turning.size:  # means over a window that spans several rows are as high before the rotor is as fast
            first = turning[0]
            used &= begin >= max(begin[first], min(time[first - 1], 0.5 * (begin[first] + time[first]))) - 1e-9
        closed = valve[-1].start_s if not valve[-1].is_open else np.inf
        slow = np.flatnonzero((time > closed) & (speed < max(REST_SHARE * float(speed.max()), REST_AT)))
        if slow.size:
            used[slow[0] :] = False
        return used
    slow = np.flatnonzero(speed < max(REST_SHARE * np.mean(speed[:5]), REST_AT))
    if slow.size:
        used[slow[0] :] = False
    coasting = time > valve[1].start_s if len(valve) > 1 else used
    return used & coasting if np.any(used & coasting) else used


def _valve(
    time: np.ndarray, pressure: np.ndarray, opened: np.ndarray
) -> tuple[tuple[Supply, ...], tuple[float, ...], float]:
    """Spans of the valve, how long no row was about each change [s], and by how much the gauge may not be where the
    open line settles [Pa]; 0 where it was silent in the second half of such a span: until then the line fills.

    A change shows in the first row after it: it was somewhere between that and the row before.

    The pressure of an open span is where the gauge settled: the mean over the span before the valve is moved, over the
    last part of one that begins with the valve.
    """
    edges = (np.flatnonzero(np.diff(opened.astype(int))) + 1).tolist()
    step = float(np.median(np.diff(time))) if time.size > 1 else 0.0
    known = np.isfinite(pressure)
    highest = float(np.max(pressure, where=known, initial=0.0))
    spans, unseen_s, sd = [], [], 0.0
    for begin, end in zip([0, *edges], [*edges, time.size], strict=True):
        start_s = 0.5 * (time[begin - 1] + time[begin]) if begin else time[0] - step - BEFORE_S
        unseen_s.append(float(time[begin] - time[begin - 1]) if begin else 0.0)
        mine = np.flatnonzero(known[begin:end]) + begin
        last = mine[min(round(SETTLING * mine.size), mine.size - 1) :] if begin and mine.size else mine
        mean = float(np.mean(pressure[last])) if last.size else highest  # the gauge was silent then
        if opened[begin]:
            half = pressure[mine[mine.size // 2 :]] if begin else pressure[mine]
            told = max(UNSETTLED * mean, float(np.ptp(half)) if half.size > 1 else UNTOLD * mean)
            half_s = 0.5 * (start_s + time[end - 1])
            sd = max(sd, told) if mine.size and (not begin or time[mine[-1]] > half_s) else sd
        spans.append(Supply(float(start_s), mean, bool(opened[begin])))
    return tuple(spans), tuple(unseen_s), sd


def scatter(time: np.ndarray) -> float:
    """By how much the moments of readings that are asked for in a row are off [s], one standard deviation.

    An answer that a busy machine delays is as unevenly spaced as it is late.
    """
    second = np.diff(time, n=2)
    return float(np.median(np.abs(second))) / (NORMAL_MEDIAN * math.sqrt(6.0)) if second.size else 0.0


def _asked_late(time: np.ndarray, speed: np.ndarray, tachometer: Channel) -> np.ndarray:
    """By how much late answers put readings off where the speed changes: one standard deviation of each [rpm].

    A mean since the reading before is as late as it is long, and not off; one over a window of the instrument's own is.
    """
    around = np.clip(np.arange(time.size)[:, None] + np.array([-2, 2]), 0, time.size - 1)
    changed = np.abs(np.diff(speed[around], axis=1)[:, 0]) * RPM
    noise = math.hypot(tachometer.noise_sd, tachometer.resolution / math.sqrt(12.0))
    span_s = np.maximum(np.diff(time[around], axis=1)[:, 0], 1e-3)
    return scatter(time) * np.where(changed > 4.0 * noise, changed, 0.0) / span_s


def _line(time: np.ndarray, pressure: np.ndarray, valve: Sequence[Supply], noise: float, over: float) -> Line:
    """The gauge's readings with the valve open and, once it was moved, up to the end of what is compared."""
    known = np.isfinite(pressure) & (time <= over)
    begins = np.array([span.start_s for span in valve])
    span = np.maximum(np.searchsorted(begins, time, side="right") - 1, 0)
    opened = np.array([one.is_open for one in valve])[span]
    known &= opened | (span > 0)
    when, read, of = time[known], pressure[known], span[known]
    late_s = max(READ_LATE_S, scatter(when))
    groups: list[np.ndarray] = []
    for k in np.unique(of):
        mine = np.flatnonzero(of == k)
        if k == 0:
            groups.append(mine)
            continue
        early = when[mine] - begins[k] < MOVING_S
        moving, still = mine[early], mine[~early]
        groups += np.array_split(moving, min(MOST_READINGS, moving.size)) if moving.size else []
        groups += np.array_split(still, min(4, still.size)) if still.size else []
    group = np.zeros(when.size, dtype=int)
    mean, sd = np.zeros(len(groups)), np.zeros(len(groups))
    for i, mine in enumerate(groups):
        group[mine] = i
        mean[i] = np.mean(read[mine])
        # Where the line moves the moment of a reading counts, and the form that is taken for its course.
        around = slice(max(mine[0] - 1, 0), mine[-1] + 2)
        span_s = max(float(np.ptp(when[around])), 1e-3)
        moves = float(np.ptp(read[around]))
        moves = moves if moves > 4.0 * noise else 0.0
        sd[i] = math.hypot(noise / math.sqrt(mine.size), late_s * moves / span_s, FORM * moves)
    return Line(when, group, mean, sd)
