"""The parts of a recording that a diagnosis compares with the model: plateaus and runs in time, as plain arrays."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.measurement import OBSERVED, Measurement, gather
from calibration.priors import PASCAL_PER_BAR
from model.layout import L_MIN, RPM
from model.transient import Supply
from rig.recording import Recording, RecordingError, RecordingFile

REST_SHARE = 0.1  # a coast-down is compared down to this share of its first speed: below, it hangs on single pulses
RISEN_SHARE = 0.3  # ... and a start from rest from this share of its highest speed on: how it broke away nobody knows
EMPTYING = (
    2  # samples after the valve closes that are not compared: when it did within one, and what volume then emptied
)
FEWEST_SAMPLES = 4  # a run with fewer to compare says nothing, and is left aside
BEFORE_S = 0.25  # real time that a run in time is simulated before its first sample, to reach its steady state
LEVEL_PA = 3000.0  # gap that parts two pressure levels
REST_RAD_S = 0.5  # below this at the start, the rotor is taken to be at rest


@dataclass(frozen=True)
class Plateaus:
    """Steady rows, SI, arrays of shape (n,); a reading that is missing or censored is nan.

    Attributes
    ----------
    file : tuple of str
        Of each row.
    row : ndarray of int
        Number in its file, from 1.
    pressure : ndarray
        Reading, absolute once a gauge's ambient is added [Pa].
    is_gauge : ndarray of bool
        Whether the ambient is to be added.
    flow, speed : ndarray
        Readings [m3/s], [rad/s].
    time : ndarray
        On the recording's clock [s]; the row's number in seconds where no time was taken.
    up : ndarray
        1 on the way up, -1 down, 0 where that was not noted [-].
    noise_scale : ndarray
        Of the file [-].
    """

    file: tuple[str, ...]
    row: np.ndarray
    pressure: np.ndarray
    is_gauge: np.ndarray
    flow: np.ndarray
    speed: np.ndarray
    time: np.ndarray
    up: np.ndarray
    noise_scale: np.ndarray

    @property
    def size(self) -> int:
        """Number of rows [-]."""
        return int(self.row.size)


@dataclass(frozen=True)
class RunInTime:
    """A transient file, SI.

    Attributes
    ----------
    file : str
        Its name.
    time : ndarray, shape (n,)
        Of the samples, from the file's start [s]; a reading is the mean since the sample before.
    speed : ndarray, shape (n,)
        Readings [rad/s]; nan where there is none, negative-free.
    supply : tuple of Supply
        Spans of the line, by the gauge's mean over each.
    supply_sd : float
        Uncertainty of the open spans' pressure by the gauge's noise [Pa].
    is_gauge : bool
        Whether the ambient is to be added to the supply.
    start_s : float
        On the recording's clock [s].
    noise_scale : float
        Of the file [-].
    from_rest : bool
        Whether it starts at rest; otherwise in the steady state of its first span.
    used : ndarray of bool, shape (n,)
        Samples that are compared: a spin-up's once it is well on its way, a coast-down's from when the line is empty
        until it is nearly over. What it turned at before says no more than a plateau, and is seldom as settled.
    """

    file: str
    time: np.ndarray
    speed: np.ndarray
    supply: tuple[Supply, ...]
    supply_sd: float
    is_gauge: bool
    start_s: float
    noise_scale: float
    from_rest: bool
    used: np.ndarray

    @property
    def size(self) -> int:
        """Number of samples [-]."""
        return int(self.time.size)

    @property
    def wanted(self) -> int:
        """Number of samples up to the last that is compared [-]."""
        return int(np.flatnonzero(self.used)[-1]) + 1 if self.used.any() else 1


@dataclass(frozen=True)
class Vented:
    """What the gauge reads with the line vented: in zero files, and in the vented spans of runs in time.

    Attributes
    ----------
    file : tuple of str
        Of each mean.
    pressure, sd : ndarray, shape (n,)
        Mean reading and its noise [Pa].
    is_gauge : ndarray of bool
        Whether it counts from the ambient.
    """

    file: tuple[str, ...]
    pressure: np.ndarray
    sd: np.ndarray
    is_gauge: np.ndarray


@dataclass(frozen=True)
class Standing:
    """What the flow meter reads while the rotor stands: held at a pressure, or with the line vented in zero files.

    Attributes
    ----------
    file : tuple of str
        Of each mean.
    pressure : ndarray, shape (n,)
        Mean reading of the gauge [Pa]; nan with the line vented.
    is_gauge : ndarray of bool
        Whether it counts from the ambient.
    flow, sd : ndarray, shape (n,)
        Mean reading and its noise [m3/s].
    time : ndarray, shape (n,)
        On the recording's clock [s].
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


def blocks_of(recording: Recording) -> Blocks:
    """The parts of a recording.

    Parameters
    ----------
    recording : Recording
        The recording.

    Raises
    ------
    RecordingError
        When it has neither plateaus nor runs in time that can be used.
    """
    measured = gather(recording)
    every = (_run(file, recording) for file in recording.files if file.kind == "transient")
    runs = tuple(run for run in every if int(run.used.sum()) >= FEWEST_SAMPLES)
    return Blocks(_plateaus(recording, measured), runs, _vented(recording), _standing(recording), measured)


def _vented(recording: Recording) -> Vented:
    found: list[tuple[str, float, float, bool]] = []
    for file in recording.files:
        gauge = "pressure_bar_gauge" in file.columns
        name = "pressure_bar_gauge" if gauge else "pressure_bar_abs"
        if name not in file.columns or file.kind == "steady":
            continue
        rest = np.ones(file.rows, dtype=bool)
        if file.kind == "transient":
            if "supply_open" not in file.columns or "time_s" not in file.columns:
                continue
            rest = _settled(file.columns["time_s"].values, file.columns["supply_open"].values > 0.5)
        read = file.columns[name].values[rest & (file.columns[name].censor == 0)] * PASCAL_PER_BAR
        read = read[np.isfinite(read)]
        if read.size:
            figures = recording.channels[name]
            noise = float(np.hypot(figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0)))
            found.append((file.file, float(np.mean(read)), noise * PASCAL_PER_BAR / np.sqrt(read.size), gauge))
    columns = list(zip(*found, strict=True)) or [(), (), (), ()]
    return Vented(columns[0], np.array(columns[1]), np.array(columns[2]), np.array(columns[3], dtype=bool))


def _standing(recording: Recording) -> Standing:
    found: list[tuple[str, float, bool, float, float, float]] = []
    for file in recording.files:
        held = file.kind == "steady" and "rotor_locked" in file.columns
        if "flow_l_min" not in file.columns or not (held or file.kind == "zero"):
            continue
        gauge = "pressure_bar_gauge" in file.columns
        flow, stamps = file.columns["flow_l_min"], file.columns.get("time_s")
        used = np.isfinite(flow.values) & (flow.censor == 0)
        pressure = np.full(file.rows, np.nan)
        if held:
            read = file.columns["pressure_bar_gauge" if gauge else "pressure_bar_abs"]
            used &= (file.columns["rotor_locked"].values > 0.5) & np.isfinite(read.values) & (read.censor == 0)
            pressure = read.values * PASCAL_PER_BAR
        figures = recording.channels["flow_l_min"]
        noise, rounding = figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0)
        for rows in _apart(np.flatnonzero(used), pressure) if held else [np.flatnonzero(used)]:
            # A meter that shows 0 may have been cut off there: many such readings say no more than one.
            shows_nothing = bool(np.any(flow.values[rows] == 0.0))
            if not rows.size or (shows_nothing and not held):
                continue
            sd = float(np.hypot(noise / np.sqrt(1 if shows_nothing else rows.size), rounding))
            clock = file.start_s + float(np.mean(stamps.values[rows] if stamps is not None else rows + 1.0))
            value = float(np.mean(flow.values[rows])) / L_MIN
            found.append((file.file, float(np.mean(pressure[rows])), gauge, value, sd / L_MIN, clock))
    names, *rest = list(zip(*found, strict=True)) or [(), (), (), (), (), ()]
    line, is_gauge, mean, sds, time = map(np.array, rest)
    return Standing(names, line, is_gauge.astype(bool), mean, sds, time)


def _settled(time: np.ndarray, opened: np.ndarray) -> np.ndarray:
    """Samples in the second half of each vented span: by then the line has emptied."""
    kept = np.zeros(time.size, dtype=bool)
    edges = [0, *(np.flatnonzero(np.diff(opened.astype(int))) + 1).tolist(), time.size]
    for begin, end in itertools.pairwise(edges):
        if end > begin and not opened[begin]:
            kept[(begin + end) // 2 : end] = True
    return kept


def _plateaus(recording: Recording, measured: Measurement) -> Plateaus:
    rows = measured.steady
    files = {file.file: file for file in recording.files}
    time = np.empty(len(rows))
    up = np.zeros(len(rows))
    for i, (name, number) in enumerate(zip(rows.file, rows.row, strict=True)):
        file = files[name]
        index = int(number) - 1
        stamps = file.columns.get("time_s")
        time[i] = file.start_s + (stamps.values[index] if stamps is not None else float(number))
        if file.direction is not None:
            up[i] = {"up": 1.0, "down": -1.0}.get(str(file.direction[index]), 0.0)
    return Plateaus(
        rows.file,
        rows.row,
        rows.pressure * PASCAL_PER_BAR,
        rows.is_gauge,
        np.where(rows.flow_state == OBSERVED, rows.flow / L_MIN, np.nan),
        np.where((rows.speed_state == OBSERVED) & (rows.speed > 0.0), rows.speed / RPM, np.nan),
        time,
        up,
        rows.noise_scale,
    )


def _run(file: RecordingFile, recording: Recording) -> RunInTime:
    gauge = "pressure_bar_gauge" in file.columns
    name = "pressure_bar_gauge" if gauge else "pressure_bar_abs"
    if "time_s" not in file.columns or "speed_rpm" not in file.columns or name not in file.columns:
        raise RecordingError(f"{file.file}: a transient needs time_s, speed_rpm and a pressure for this motor")
    time, speed = file.columns["time_s"].values, file.columns["speed_rpm"]
    pressure = file.columns[name].values * PASCAL_PER_BAR
    opened = file.columns["supply_open"].values > 0.5 if "supply_open" in file.columns else np.ones(time.size, bool)
    step = float(np.median(np.diff(time))) if time.size > 1 else 0.0
    figures = recording.channels[name]
    noise = max(figures.noise_sd, figures.resolution / np.sqrt(12.0)) * file.noise_scale * PASCAL_PER_BAR
    spans, fewest = _spans(time, pressure, opened, step)
    first = speed.values[np.isfinite(speed.values)][:5] / RPM
    from_rest = bool(first.size == 0 or np.mean(first) < REST_RAD_S or not opened[0])
    return RunInTime(
        file.file,
        time,
        speed.values / RPM,
        tuple(spans),
        noise / np.sqrt(max(fewest, 1)),
        gauge,
        file.start_s,
        file.noise_scale,
        from_rest,
        _useful(speed.values / RPM, time, spans, from_rest),
    )


def _useful(speed: np.ndarray, time: np.ndarray, spans: Sequence[Supply], from_rest: bool) -> np.ndarray:
    used = np.isfinite(speed)
    if from_rest:
        opened = next((span.start_s for span in spans if span.is_open), time[0])
        used &= time > opened + 1e-9
        turning = np.flatnonzero(used & (speed > RISEN_SHARE * np.nanmax(np.where(used, speed, np.nan), initial=0.0)))
        if turning.size:
            used[: turning[0]] = False
        return used
    slow = np.flatnonzero(speed < REST_SHARE * np.nanmean(speed[:5]))
    if slow.size:
        used[slow[0] :] = False
    if len(spans) > 1:
        coasting = time > spans[1].start_s + (EMPTYING + 0.5) * float(np.median(np.diff(time)))
        if np.any(used & coasting):
            used &= coasting
    return used


def _spans(time: np.ndarray, pressure: np.ndarray, opened: np.ndarray, step: float) -> tuple[list[Supply], int]:
    """Spans of an open or vented line; a change shows in the first sample after it, so it is at the sample before."""
    edges = np.flatnonzero(np.diff(opened.astype(int))) + 1
    starts = [0, *edges.tolist()]
    ends = [*edges.tolist(), time.size]
    spans, fewest = [], time.size
    for begin, end in zip(starts, ends, strict=True):
        start_s = time[begin - 1] if begin else time[0] - step - BEFORE_S
        readings = pressure[begin:end]
        known = readings[np.isfinite(readings)]
        mean = float(np.mean(known)) if known.size else float("nan")
        is_open = bool(opened[begin])
        if is_open:
            fewest = min(fewest, known.size)
        spans.append(Supply(float(start_s), mean, is_open))
    return spans, fewest


def levels(plateaus: Plateaus) -> list[np.ndarray]:
    """Indices of the plateaus at each pressure level, both directions together.

    Parameters
    ----------
    plateaus : Plateaus
        The rows.
    """
    return _apart(np.arange(plateaus.size), plateaus.pressure)


def _apart(rows: np.ndarray, pressure: np.ndarray) -> list[np.ndarray]:
    """Rows by pressure level."""
    order = rows[np.argsort(pressure[rows])]
    return list(np.split(order, np.flatnonzero(np.diff(pressure[order]) > LEVEL_PA) + 1))
