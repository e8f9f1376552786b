"""Recordings in which nothing is concealed, drawn from the model and its priors, with noise of several kinds.

The instruments and levels are those of a typical bench: a sweep without load from 1.2 to 2.4 bar, up and down, and,
where runs in time are wanted, a spin-up and a coast-down at 2.0 bar. Nuisances are drawn from the priors that a
diagnosis has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from calibration.data.runs_in_time import placeholders
from calibration.systems.radial_piston.predict.problem import Prediction, Problem
from calibration.unknowns import priors
from calibration.unknowns.priors import CHANNELS, OfRun
from configs.units import BAR
from model.effects.effect import unknown_state
from model.effects.laws import Chosen, readings_of
from model.effects.transient import simulate
from model.geometry import pulse_angle
from model.layout import RPM
from model.solvers.crank_angle import THETA
from model.solvers.transient import rest_state
from rig.recording import Ambient, Channel, Column, Recording, RecordingFile
from rig.recording.columns import OF_CHANNEL

NOISES = ("declared", "misdeclared", "correlated", "coarse", "heavy")
MISDECLARED = 0.3  # one sd of the logarithm of the factor by which a channel's noise is off
CORRELATION = 0.5  # of successive rows
DEGREES = 4  # of freedom of the heavy tails
INSTRUMENTS = {
    "pressure_bar_abs": Channel("pressure_bar_abs", noise_sd=0.0015, bias_sd=0.005, scale_sd=0.002, resolution=0.001),
    "flow_l_min": Channel("flow_l_min", noise_sd=0.8, bias_sd=0.5, scale_sd=0.02, resolution=0.5),
    "speed_rpm": Channel("speed_rpm", noise_sd=0.4, bias_sd=0.1, scale_sd=0.0005, resolution=0.1),
}
AMBIENT = Ambient(pressure_bar_abs=1.01325, pressure_sd_bar=0.0015, temperature_c=20.0, relative_humidity=0.0)
LEVELS_BAR = np.round(np.arange(1.2, 2.45, 0.1), 6)
PLATEAU_S = 40.0
RUN_BAR = 2.0
SAMPLE_S = 0.005
RUN_NOISE = 2.0  # noise of a sample in a run, times that of a plateau's mean
RUNS = {"spin_up.csv": (1040.0, 200, 10, True), "coast_down.csv": (1100.0, 240, 20, False)}
# ... start on the recording's clock [s], samples, the first of them before the valve turns, whether it then opens
# Shares of the priors of a line that one bench's figures are drawn from: when the valve moves is well noted there.
OF_A_BENCH = {"_late": 0.1, "_time": 0.5, "_valve": 0.5}
FULL_SPEED_RPM = 300.0  # a reading of the template, which says no more than that the rotor turns


def null_recording(
    noise: str, with_runs: bool, rng: np.random.Generator, concealed: Chosen | None = None
) -> tuple[Recording, dict[str, float]]:
    """A recording that the model gives, with its nuisances drawn from their priors.

    `concealed`: effects and their parameters [SI], to see that the test notices; a null has none.
    Returns `recording`: as if read; it is nowhere on disk; `truth`: every nuisance in its own unit, and
    ``<channel>_noise_factor`` [-]. Raises ArithmeticError when the model gives no reading somewhere.
    """
    nominal = template(noise, with_runs)
    problem = Problem(nominal)
    z = priors.draw(problem.nuisances, rng, 1)[0]
    for i, unknown in enumerate(problem.nuisances):
        if not isinstance(unknown.of, OfRun):
            continue
        if unknown.of.what == "floor":
            z[i] = unknown.z(0.0)
        else:  # a line as one bench has it: the priors are for all
            z[i] *= next((share for end, share in OF_A_BENCH.items() if unknown.of.what.endswith(end)), 1.0)
    chosen = {name: dict(values) for name, values in (concealed or {}).items()}
    if with_runs:  # a regulator's droop follows the air that the motor takes
        speeds = [_speeds(problem, i, z, chosen, np.random.default_rng(0)) for i in range(len(RUNS))]
        told = Problem(turning := _with_speeds(nominal, speeds))
        if len(told.blocks.runs) == len(RUNS):  # else the rotor was caught, and takes none
            nominal, problem = turning, told
    factor = dict.fromkeys(CHANNELS, 1.0)
    if noise == "misdeclared":
        factor = {channel: math.exp(MISDECLARED * rng.standard_normal()) for channel in CHANNELS}
    exact = problem.predict(z, chosen)
    exact = replace(
        exact, runs=tuple(_speeds(problem, i, z, chosen, rng) for i in range(len(RUNS) if with_runs else 0))
    )
    clocks = {file.file: file.columns["time_s"].values for file in nominal.files if file.kind == "transient"}
    lines = {run.file: problem.gauge_in(run, problem.split(z), chosen, clocks[run.file]) for run in problem.blocks.runs}
    files = tuple(_read(file, nominal, problem, exact, lines, noise, factor, rng) for file in nominal.files)
    truth = {unknown.name: float(unknown.value(z[i])) for i, unknown in enumerate(problem.nuisances)}
    truth |= {f"{channel}_noise_factor": factor[channel] for channel in CHANNELS}
    return replace(nominal, files=files, sha256="simulated"), truth


def _with_speeds(recording: Recording, speeds: list[np.ndarray]) -> Recording:
    """A recording with other speeds in its runs in time [rad/s], one array a run."""
    of_run = dict(zip(RUNS, speeds, strict=True))
    return replace(
        recording,
        files=tuple(
            replace(file, columns={**file.columns, "speed_rpm": _column(np.maximum(of_run[file.file], 0.0) * RPM)})
            if file.file in of_run
            else file
            for file in recording.files
        ),
    )


def template(noise: str, with_runs: bool) -> Recording:
    """What is asked of the rig: levels, times and instruments; its speeds and flows say nothing.

    `noise`: one of NOISES; a coarse instrument shows steps as large as its noise, and declares them.
    """
    if noise not in NOISES:
        raise ValueError(f"'{noise}' is no class of noise; there are {', '.join(NOISES)}")
    channels = INSTRUMENTS
    if noise == "coarse":
        channels = {name: replace(one, resolution=one.noise_sd) for name, one in INSTRUMENTS.items()}
    files = (_sweep(), *(_run(name) for name in RUNS)) if with_runs else (_sweep(),)
    return Recording(Path("null"), "ptm3600", AMBIENT, channels, files)


def unit_noise(noise: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit standard deviation, one number a row, shape (n,)."""
    if noise == "heavy":
        return rng.standard_t(DEGREES, n) * math.sqrt((DEGREES - 2.0) / DEGREES)
    found = rng.standard_normal(n)
    if noise == "correlated":
        new, before = math.sqrt(1.0 - CORRELATION**2), [CORRELATION * found[0]]
        found[1:] = lfilter([new], [1.0, -CORRELATION], found[1:], zi=before)[0]
    return found


def _read(
    file: RecordingFile,
    nominal: Recording,
    problem: Problem,
    exact: Prediction,
    lines: Mapping[str, np.ndarray],
    noise: str,
    factor: Mapping[str, float],
    rng: np.random.Generator,
) -> RecordingFile:
    """A file of the template as the instruments show it: noise, then rounding, then what no tachometer shows."""
    columns = dict(file.columns)
    for channel, without in _without_noise(file, problem, exact, lines).items():
        if not np.all(np.isfinite(without)):
            raise ArithmeticError(
                f"{file.file}: the model gives no {channel} at {int(np.sum(~np.isfinite(without)))} rows"
            )
        figures = nominal.channels[OF_CHANNEL[channel].column]
        sd = figures.noise_sd * file.noise_scale * factor[channel]
        shown = without / OF_CHANNEL[channel].to_si + sd * unit_noise(noise, file.rows, rng)
        shown = np.round(shown / figures.resolution) * figures.resolution
        censor = np.zeros(file.rows, dtype=np.int8)
        if channel == "speed":
            censor[shown <= 0.0] = -1
            shown = np.maximum(shown, 0.0)
        columns[OF_CHANNEL[channel].column] = Column(shown, censor)
    return replace(file, columns=columns)


def _without_noise(
    file: RecordingFile, problem: Problem, exact: Prediction, lines: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """What the instruments would show of a file, but for noise and rounding, by channel [SI]."""
    if file.kind == "steady":
        pressure = file.columns["pressure_bar_abs"].values * BAR
        return {"pressure": pressure, "flow": exact.flow, "speed": exact.speed}
    i = [run.file for run in problem.blocks.runs].index(file.file)
    return {"pressure": lines[file.file], "speed": exact.runs[i]}


def _speeds(problem: Problem, i: int, z: np.ndarray, chosen: Chosen, rng: np.random.Generator) -> np.ndarray:
    """What the tachometer makes of a run with every pulse, from a shaft that stood at any angle [rad/s]."""
    run, split = problem.blocks.runs[i], problem.split(z)
    planned, angle = (
        problem.plan(i, split, {name: dict(values) for name, values in chosen.items()}),
        float(rng.uniform(0.0, pulse_angle(problem.motor.vector()))),
    )
    start = rest_state(problem.motor, angle) if run.from_rest else planned.start.copy()
    start[THETA] = angle
    sampled = SAMPLE_S * np.arange(RUNS[run.file][1] + 1)
    ahead = planned.time[:0] if run.from_rest else planned.time[planned.time < -1e-9]
    time = np.concatenate([ahead, sampled])
    found = simulate(planned.parameters, planned.readings, planned.supply, time, start, chosen, run.start_s)
    true = found.reading[1 - sampled.size :]
    offset, scale = split[1]["speed"]
    return readings_of(chosen, "speed", true, unknown_state(true)) * (1.0 + scale) + offset


def _sweep() -> RecordingFile:
    levels = np.concatenate([LEVELS_BAR, LEVELS_BAR[::-1]])
    n = levels.size
    columns = {
        "time_s": _column(PLATEAU_S * np.arange(n)),
        "pressure_bar_abs": _column(levels),
        "flow_l_min": _column(np.ones(n)),
        "speed_rpm": _column(np.full(n, FULL_SPEED_RPM)),
    }
    way = np.array(["up"] * LEVELS_BAR.size + ["down"] * LEVELS_BAR.size)
    return RecordingFile("sweep.csv", "steady", 0.0, 1.0, n, columns, way)


def _run(name: str) -> RecordingFile:
    start_s, n, before, opens = RUNS[name]
    late = np.arange(n) >= before
    opened = late if opens else ~late
    ambient = AMBIENT.pressure_bar_abs or 0.0
    columns = {
        "time_s": _column(SAMPLE_S * np.arange(1, n + 1)),
        "supply_open": _column(opened.astype(float)),
        "pressure_bar_abs": _column(placeholders(np.where(opened, RUN_BAR, ambient))),
        "speed_rpm": _column(placeholders(np.where(opened | (not opens), FULL_SPEED_RPM, 0.0))),
    }
    return RecordingFile(name, "transient", start_s, RUN_NOISE, n, columns)


def _column(values: np.ndarray) -> Column:
    return Column(values, np.zeros(values.size, dtype=np.int8))
