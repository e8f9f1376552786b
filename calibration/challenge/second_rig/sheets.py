"""From noise-free readings to the CSV files of a recording: noise, resolution, and the way a bench writes them down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.challenge.second_rig.bench import Readings
from calibration.challenge.second_rig.machine.slots import BAR, L_MIN, RPM

# What the recordings declare of each instrument, in the columns' units.
NOISE = {"pressure": 0.0015, "flow": 0.8, "speed": 0.4}  # noise_sd
RESOLUTION = {"pressure": 0.001, "flow": 0.5, "speed": 0.1}
COLUMN = {"pressure": "pressure_bar_abs", "flow": "flow_l_min", "speed": "speed_rpm"}
UNIT = {"pressure": 1.0 / BAR, "flow": L_MIN, "speed": RPM}
DIGITS = {"pressure": 3, "flow": 1, "speed": 1}  # decimals that are written
BIAS = {"pressure": 0.005, "flow": 0.5, "speed": 0.1}  # bias_sd
SCALE = {"pressure": 0.002, "flow": 0.02, "speed": 0.0005}  # scale_sd
TRANSIENT_NOISE = 2.0  # times the declared noise, along a run in time
DRIFT_S = 1000.0  # in which the gauge drifts by the whole of a case's drift


@dataclass(frozen=True)
class File:
    """A file of a recording. `start_s`: on the recording's clock [s]; None: left out."""

    name: str
    kind: str
    start_s: float | None
    noise_scale: float
    columns: dict[str, list[str]]


def noisy(
    true: Readings, sensors: Mapping[str, float], noise_scale: float, clock: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Readings with noise, by channel and in the columns' units. `true`: without noise [SI]."""
    return {channel: noisy_one(channel, getattr(true, channel), sensors, noise_scale, clock, rng) for channel in NOISE}


def noisy_one(
    channel: str,
    true: np.ndarray,
    sensors: Mapping[str, float],
    noise_scale: float,
    clock: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Readings of one channel with noise, shape (n,), in its column's unit. `true`, shape (n,): without noise [SI]."""
    sd = NOISE[channel] * noise_scale * sensors["noise_scale"]
    found = true * UNIT[channel] + sd * unit_noise(sensors, clock.size, rng)
    return found + sensors["drift_bar"] * (clock / DRIFT_S - 0.5) if channel == "pressure" else found


def unit_noise(sensors: Mapping[str, float], n: int, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance, shape (n,) [-]: normal or Student's t, correlated from sample to sample or not."""
    degrees, kept = sensors["tails"], sensors["correlation"]
    white = rng.standard_normal(n)
    if degrees > 2.0:
        white = rng.standard_t(degrees, n) / np.sqrt(degrees / (degrees - 2.0))
    for k in range(1, n):
        white[k] = kept * white[k - 1] + np.sqrt(1.0 - kept**2) * white[k]
    return white


def together(
    readings: Mapping[str, tuple[np.ndarray, np.ndarray]], held: tuple[str, ...]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Channels that were read at times of their own, on one list of times: shape (n,), and the same by channel.

    `readings`: by channel, times [s] and readings [own unit].
    `held`: channels of which the last reading is written again until the next; nan stands between those of others.
    """
    at = {channel: np.round(times, 6) for channel, (times, _) in readings.items()}
    times = np.unique(np.concatenate(list(at.values())))
    found = {}
    for channel, (_, values) in readings.items():
        place = np.searchsorted(at[channel], times, side="right") - 1
        read = place >= 0
        shown = read if channel in held else read & np.isin(times, at[channel])
        found[channel] = np.full(times.size, np.nan)  # of a counter whose tooth never came there is nothing
        found[channel][shown] = values[place[shown]]
    return times, found


def cells(readings: Mapping[str, np.ndarray]) -> dict[str, list[str]]:
    """Readings as an instrument of limited resolution shows them; a tachometer shows no negative speed.

    `readings`: by channel, in the columns' units; nan where one was not sampled.
    """
    found = {}
    for channel, values in readings.items():
        step, digits = RESOLUTION[channel], DIGITS[channel]
        shown = np.round(values / step) * step + 0.0
        if channel == "speed":
            shown = np.maximum(shown, 0.0)
        if channel == "flow":
            shown = np.maximum(shown, -4.0)  # the float lies on its stop
        found[COLUMN[channel]] = ["" if np.isnan(value) else repr(round(float(value), digits)) for value in shown]
    return found


def write_file(folder: Path, file: File) -> None:
    """Write one CSV file."""
    rows = zip(*file.columns.values(), strict=True)
    lines = [",".join(file.columns), *(",".join(row) for row in rows)]
    (folder / file.name).write_text("\n".join(lines) + "\n", encoding="utf-8")


def head(files: list[File], added_inertia: float, told: Mapping[str, Any], higher_bar: float = 0.0) -> str:
    """recording.toml: every case declares the same noise and errors; how a speed is made, and the line, as it has them.

    `added_inertia`: of a flywheel [kg m2].
    `higher_bar`: by which the room's pressure is another day's [bar].
    """
    lines = ['format = "recording/1"', 'motor = "ptm3600"', "files = ["]
    for file in files:
        start = "" if file.start_s is None else f", start_s = {file.start_s:.1f}"
        noise = "" if file.noise_scale == 1.0 else f", noise_scale = {file.noise_scale:.1f}"
        lines.append(f'    {{ file = "{file.name}", kind = "{file.kind}"{start}{noise} }},')
    lines += [
        "]",
        "",
        "[ambient]",
        f"pressure_bar_abs = {1.01325 + higher_bar:.5f}",
        "pressure_sd_bar = 0.0015",
        "temperature_c = 20.0",
    ]
    lines += ["relative_humidity = 0.0"]
    for channel, column in COLUMN.items():
        if not any(column in file.columns for file in files):
            continue
        lines += ["", f"[channels.{column}]", f"noise_sd = {NOISE[channel]}", f"bias_sd = {BIAS[channel]}"]
        lines += [f"scale_sd = {SCALE[channel]}", f"resolution = {RESOLUTION[channel]}"]
        if channel == "speed":
            keys = {"pulses_per_rev": "teeth"}
            lines += [f"{key} = {told[keys.get(key, key)]:.6g}" for key in told["told"]]
    if told["supply_told"]:
        lines += ["", "[supply]"]
        for key, (value, sd) in told["supply_told"].items():
            lines += [f"{key} = {value}", *([] if sd is None else [f"{key}_sd = {sd}"])]
    if added_inertia:
        lines += ["", "[rig]", f"added_inertia_kg_m2 = {added_inertia}"]
    return "\n".join(lines) + "\n"


def stamps(time: np.ndarray) -> list[str]:
    """Times as cells. `time`, shape (n,): from the file's start [s]."""
    return [repr(round(float(t), 6)) for t in time]
