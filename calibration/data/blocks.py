"""The parts of a recording that a diagnosis compares with the model: plateaus and runs in time, as plain arrays."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from calibration.data.clock import times_of, times_of_rows
from calibration.data.measurement import OBSERVED, Measurement, gather
from calibration.data.runs import UNTOLD, RunInTime, run_of
from calibration.data.runs_in_time import repeated, turns
from configs.units import BAR
from model.layout import L_MIN, RPM
from rig.recording import Recording, RecordingError
from rig.recording.columns import PRESSURE, pressure_in

FEWEST_SAMPLES = 4  # a run with fewer to compare says nothing, and is left aside
LEVEL_PA = 3000.0  # gap that parts two pressure levels
ROOM_SD_BAR = 0.005  # of the room's pressure, where the recording does not say
ALIKE = 4.0  # sds of its noise within which a gauge shows the same


@dataclass(frozen=True)
class Plateaus:
    """Steady rows, SI, arrays of shape (n,); a reading that is missing or censored is nan.

    `pressure`: reading, absolute once a gauge's ambient is added [Pa].
    `flow`, `speed`: readings [m3/s], [rad/s].
    `time`: on the recording's clock [s]; 0 throughout where some row has none.
    `untimed`: the first row without a time, as ``file, row``; empty where each has one.
    `up`: 1 on the way up, -1 down, 0 where that was not noted [-].
    """

    file: tuple[str, ...]
    row: np.ndarray
    pressure: np.ndarray
    is_gauge: np.ndarray
    flow: np.ndarray
    speed: np.ndarray
    time: np.ndarray
    untimed: str
    up: np.ndarray
    noise_scale: np.ndarray

    @property
    def size(self) -> int:
        """Number of rows [-]."""
        return int(self.row.size)


@dataclass(frozen=True)
class Vented:
    """What the gauge reads with the line vented: in zero files, and in the vented spans of runs in time.

    `pressure`, `sd`, shape (n,): mean reading and its noise [Pa].
    """

    file: tuple[str, ...]
    pressure: np.ndarray
    sd: np.ndarray
    is_gauge: np.ndarray


@dataclass(frozen=True)
class Standing:
    """What the flow meter reads while the rotor stands: held at a pressure, or with the line vented in zero files.

    `pressure`, shape (n,): mean reading of the gauge [Pa]; nan with the line vented.
    `flow`, `sd`, shape (n,): mean reading and its noise [m3/s].
    `time`, shape (n,): on the recording's clock [s].
    """

    file: tuple[str, ...]
    pressure: np.ndarray
    is_gauge: np.ndarray
    flow: np.ndarray
    sd: np.ndarray
    time: np.ndarray


@dataclass(frozen=True)
class Blocks:
    """Everything of a recording that a diagnosis looks at."""

    plateaus: Plateaus
    runs: tuple[RunInTime, ...]
    vented: Vented
    standing: Standing
    measured: Measurement


def blocks_of(recording: Recording, pulse_rad: float) -> Blocks:
    """The parts of a recording; `pulse_rad`: angle of a pulse of the motor's cylinders.

    Raises RecordingError when it has neither plateaus, nor runs in time that can be used, nor zero rows of the gauge.
    """
    measured = gather(recording, needs_plateaus=all(file.kind == "steady" for file in recording.files))
    in_time = [file for file in recording.files if file.kind == "transient" and turns(recording, file)]
    every = [run_of(file, recording, pulse_rad) for file in in_time]
    plateaus = _plateaus(recording, measured)
    runs = tuple(_told(run, plateaus) for run in every if int(run.used.sum()) >= FEWEST_SAMPLES)
    vented = _vented(recording)
    if not runs and not len(measured.steady) and not vented.pressure.size:
        if every:
            raise RecordingError(
                f"{recording.folder}/{every[0].file}: too few speed readings show how the speed changes "
                f"({int(every[0].used.sum())}; {FEWEST_SAMPLES} are needed). Record it again with a tachometer that is "
                "read more often, or add plateaus"
            )
        gather(recording)  # says what is missing
    return Blocks(plateaus, runs, vented, _standing(recording), measured)


def _vented(recording: Recording) -> Vented:
    found: list[tuple[str, float, float, bool]] = []
    is_end: list[bool] = []
    for file in recording.files:
        name, gauge = pressure_in(file.columns)
        if name not in file.columns or file.kind == "steady":
            continue
        rest = np.ones(file.rows, dtype=bool)
        if file.kind == "transient":
            if file.is_open is None or "time_s" not in file.columns:
                continue
            rest = _settled(file.columns["time_s"].values, file.is_open)
            if (
                "speed_rpm" in file.columns
            ):  # a line that a turning motor breathes from is not at the ambient's pressure
                turning = np.flatnonzero(file.columns["speed_rpm"].values > 0.0)
                after = np.flatnonzero(file.is_open)[:1]
                if turning.size and after.size and after[0] < turning[-1]:
                    rest[after[0] : turning[-1] + 1] = False
        figures = recording.channels[name]
        old = repeated(file.columns[name].values, figures.noise_sd * file.noise_scale, figures.resolution)
        read = file.columns[name].values[rest & ~old & (file.columns[name].censor == 0)] * BAR
        read = read[np.isfinite(read)]
        if file.kind == "transient":
            read = _emptied(read, figures.noise_sd * file.noise_scale * BAR)
        if read.size:
            noise = float(np.hypot(figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0)))
            found.append((file.file, float(np.mean(read)), noise * BAR / np.sqrt(read.size), gauge))
            is_end.append(file.kind == "transient" and file.is_open is not None and bool(file.is_open[0]))
    before = [one for one, end in zip(found, is_end, strict=True) if not end]
    found = [one for one, end in zip(found, is_end, strict=True) if not (end and _is_shut(recording, one, before))]
    columns = list(zip(*found, strict=True)) or [(), (), (), ()]
    return Vented(columns[0], np.array(columns[1]), np.array(columns[2]), np.array(columns[3], dtype=bool))


def _is_shut(
    recording: Recording, ended: tuple[str, float, float, bool], vented: list[tuple[str, float, float, bool]]
) -> bool:
    """Whether a run ended higher than the gauge reads with the line vented: the line was shut, and kept some air.

    Where nothing shows what it reads then, the room and the declared errors of the gauge say it.
    """
    _, level, sd, is_gauge = ended
    known = [(other, other_sd) for _, other, other_sd, of_gauge in vented if of_gauge == is_gauge]
    ambient = recording.ambient
    if not known and ambient.pressure_bar_abs is not None:
        figures = recording.channels[PRESSURE[is_gauge]]
        at = 0.0 if is_gauge else ambient.pressure_bar_abs
        room_sd = 0.0 if is_gauge else ambient.pressure_sd_bar or ROOM_SD_BAR
        known = [(at * BAR, float(np.linalg.norm([figures.bias_sd, figures.scale_sd * at, room_sd])) * BAR)]
    return any(level - other > ALIKE * float(np.hypot(sd, other_sd)) for other, other_sd in known)


def _standing(recording: Recording) -> Standing:
    found: list[tuple[str, float, bool, float, float, float]] = []
    for file in recording.files:
        held = file.kind == "steady" and "rotor_locked" in file.columns
        if "flow_l_min" not in file.columns or not (held or file.kind == "zero"):
            continue
        name, gauge = pressure_in(file.columns)
        flow, clock = file.columns["flow_l_min"], times_of(file)
        used = np.isfinite(flow.values) & (flow.censor == 0)
        pressure = np.full(file.rows, np.nan)
        if held:
            read = file.columns[name]
            used &= (file.columns["rotor_locked"].values > 0.5) & np.isfinite(read.values) & (read.censor == 0)
            pressure = read.values * BAR
        figures = recording.channels["flow_l_min"]
        noise, rounding = figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0)
        for rows in _apart(np.flatnonzero(used), pressure) if held else [np.flatnonzero(used)]:
            # A meter that shows 0 may have been cut off there: many such readings say no more than one.
            shows_nothing = bool(np.any(flow.values[rows] == 0.0))
            if not rows.size or (shows_nothing and not held):
                continue
            sd = float(np.hypot(noise / np.sqrt(1 if shows_nothing else rows.size), rounding))
            timed = clock[rows][np.isfinite(clock[rows])]
            when = float(np.mean(timed)) if timed.size else file.start_s
            value = float(np.mean(flow.values[rows])) / L_MIN
            found.append((file.file, float(np.mean(pressure[rows])), gauge, value, sd / L_MIN, when))
    names, *rest = list(zip(*found, strict=True)) or [(), (), (), (), (), ()]
    line, is_gauge, mean, sds, time = map(np.array, rest)
    return Standing(names, line, is_gauge.astype(bool), mean, sds, time)


def _emptied(read: np.ndarray, noise: float) -> np.ndarray:
    """Readings of a line that has emptied: the last ones, as far back as they are alike."""
    if read.size < 2:
        return read[:0]
    last = float(np.median(read[-max(2, read.size // 4) :]))
    apart = np.flatnonzero(np.abs(read - last) > ALIKE * noise)
    return read[apart[-1] + 1 :] if apart.size else read


def _settled(time: np.ndarray, opened: np.ndarray) -> np.ndarray:
    """Samples while the line is surely vented: the first half of a file that begins so, else the last half of a span.

    The valve may have moved before it is said to have; by the end of a later span the line has emptied.
    """
    kept = np.zeros(time.size, dtype=bool)
    edges = [0, *(np.flatnonzero(np.diff(opened.astype(int))) + 1).tolist(), time.size]
    for begin, end in itertools.pairwise(edges):
        if end > begin and not opened[begin]:
            middle = (begin + end) // 2
            kept[slice(middle, end) if begin else slice(0, max(middle, 1))] = True
    return kept


def _plateaus(recording: Recording, measured: Measurement) -> Plateaus:
    rows = measured.steady
    files = {file.file: file for file in recording.files}
    places = [(files[name], int(number)) for name, number in zip(rows.file, rows.row, strict=True)]
    time, untimed = times_of_rows(places)
    up = np.zeros(len(rows))
    for i, (file, number) in enumerate(places):
        if file.direction is not None:
            up[i] = {"up": 1.0, "down": -1.0}.get(str(file.direction[number - 1]), 0.0)
    rests = (rows.speed_state == OBSERVED) & (rows.speed == 0.0)  # what flows then is no matter of the model's
    return Plateaus(
        rows.file,
        rows.row,
        rows.pressure * BAR,
        rows.is_gauge,
        np.where((rows.flow_state == OBSERVED) & ~rests, rows.flow / L_MIN, np.nan),
        np.where((rows.speed_state == OBSERVED) & (rows.speed > 0.0), rows.speed / RPM, np.nan),
        time,
        untimed,
        up,
        rows.noise_scale,
    )


def _told(run: RunInTime, plateaus: Plateaus) -> RunInTime:
    """A run whose gauge was silent with the valve open has the line of the plateaus that turned as fast."""
    known = np.isfinite(plateaus.speed) & np.isfinite(plateaus.pressure)
    if run.settled_sd > 0.0 or not (known.any() or any(span.is_open for span in run.valve)):
        return run
    if not known.any():
        raise RecordingError(
            f"{run.file}: the gauge has no reading in the second half of the time that the supply is open, and no "
            "plateau tells at which pressure the motor turns as fast; record it again with a gauge that is read often "
            "enough, or leave it out (--without)"
        )
    order = np.argsort(plateaus.speed[known])
    fastest = float(np.max(run.speed[run.used]))
    level = float(np.interp(fastest, plateaus.speed[known][order], plateaus.pressure[known][order]))
    valve = tuple(span._replace(pressure_pa=level) if span.is_open else span for span in run.valve)
    return replace(run, valve=valve, settled_sd=UNTOLD * level)


def levels(plateaus: Plateaus) -> list[np.ndarray]:
    """Indices of the plateaus at each pressure level, both directions together."""
    return _apart(np.arange(plateaus.size), plateaus.pressure)


def _apart(rows: np.ndarray, pressure: np.ndarray) -> list[np.ndarray]:
    """Rows by pressure level."""
    order = rows[np.argsort(pressure[rows])]
    return list(np.split(order, np.flatnonzero(np.diff(pressure[order]) > LEVEL_PA) + 1))
