"""Recordings of a case: the sweep, the runs in time, and the test that a diagnosis asks for. They hold no truth."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.challenge.second_rig import bench, readout, sheets
from calibration.challenge.second_rig.instruments import misread
from calibration.challenge.second_rig.machine.slots import BAR, PULSE
from calibration.challenge.second_rig.sheets import TRANSIENT_NOISE, File
from calibration.challenge.second_rig.truth import Truth

LEVELS_BAR = np.round(np.arange(1.2, 2.45, 0.1), 1)
STEP_S = 40.0  # from plateau to plateau
REGULATOR_BAR = 0.003  # how far a level is from what was meant
RUN_BAR = 2.0  # of the runs in time
SPIN_UP_S, COAST_DOWN_S = 1040.0, 1100.0  # when they begin, on the recording's clock
SPIN_UP_SAMPLES, COAST_DOWN_SAMPLES = 190, 220  # at least, once the supply opens, or shuts
SPIN_UP_FROM, COAST_DOWN_FROM = 10, 20  # at least, before
SETTLES = 2.5  # time constants of regulator and line that a run goes on for
CHOKED_L_S_MM2 = 0.198  # volume that a square millimetre lets through at the line's state, choked
DRAUGHT_L_S = 1.0  # and about what the motor takes
FILLED_BAR = 1.0  # by which a line is filled: with the droop it takes its time, however quick the regulator
MOST_S = 5.0
HALF_STAMP_S = 5e-7
LATER_S = 1200.0  # when a further test begins
FLYWHEEL_KG_M2 = 0.015  # three times the rotor's inertia
PLATEAUS = 10  # of a further test at one level
ROOM_SD_BAR = 0.01  # from day to day
LIMITS_BAR = (1.12, 3.5)  # of the bench


def make_recording(truth: Truth, folder: Path) -> None:
    """Write the recording of a case: a sweep of 26 plateaus up and down, and the runs in time where it has them.

    A level at which the motor stands still is left out, as an operator would.

    `folder`: where to; made when it is not there. Files of a recording in it are overwritten.
    """
    _write(truth, folder, _files(truth, 0.0, ""), 0.0)


def follow_up(truth: Truth, test: str | Mapping[str, Any], folder: Path) -> None:
    """Write the recording of a case with a further test in it.

    Where the folder holds no recording yet, the case's own is made first, to the bit. A flywheel changes every reading
    of a run, so with one the whole recording is taken again and declares it.

    `test`: the test in words, or an entry of ``next_tests`` with the words under ``test``. Understood are coast-down,
        spin-up, flywheel, zero, locked rotor, reversed sweep, cold, and a pressure before "bar"; all else is taken for
        plateaus.
    """
    words = (str(test["test"]) if isinstance(test, Mapping) else str(test))[:200].lower()
    inertia = FLYWHEEL_KG_M2 if "flywheel" in words else 0.0
    files = _files(truth, inertia, "with a flywheel" if inertia else "")
    files.append(_further(truth, words, inertia))
    _write(truth, folder, files, inertia)


def another_day(truth: Truth, capture: Mapping[str, Any], day: int, folder: Path) -> None:
    """Write a recording of the test that was asked for alone, taken with the same instruments in another room.

    `capture`: ``kind``, ``level_bar_abs`` and ``added_inertia_kg_m2``, as in ``next_tests`` of a diagnosis.
    `day`: draws the room and the noise [-].
    """
    kind, inertia = str(capture["kind"]), float(capture["added_inertia_kg_m2"])
    level = float(np.clip(capture["level_bar_abs"] or RUN_BAR, *LIMITS_BAR))
    purpose = f"day {day}|{kind} {level:g}"
    higher_bar = round(float(truth.rng(f"{purpose}|room").normal(0.0, ROOM_SD_BAR)), 4)
    there = replace(truth, nuisances=truth.nuisances | {"ambient_pa": truth.nuisances["ambient_pa"] + higher_bar * BAR})
    if kind == "zero":
        file = _zero(there, inertia, purpose)
    elif kind == "plateaus":
        file = _steady(there, np.full(PLATEAUS, level), 0.0, inertia, purpose, "plateaus.csv", False)
    else:
        file = _run(there, level, kind == "spin-up", 0.0, inertia, purpose, f"{kind.replace('-', '_')}.csv")
    _write(there, folder, [file], inertia, higher_bar)


def _files(truth: Truth, inertia: float, session: str) -> list[File]:
    """The files that a case starts with."""
    up = np.concatenate([LEVELS_BAR, LEVELS_BAR[::-1]])
    files = [_sweep(truth, up, inertia, f"sweep{session}", "sweep.csv", None)]
    if truth.with_transients:
        files.append(_run(truth, RUN_BAR, True, SPIN_UP_S, inertia, f"spin-up{session}", "spin_up.csv"))
        files.append(_run(truth, RUN_BAR, False, COAST_DOWN_S, inertia, f"coast-down{session}", "coast_down.csv"))
    return files


def _further(truth: Truth, words: str, inertia: float) -> File:
    """The test that was asked for."""
    start = 0.0 if "cold" in words else LATER_S
    said = re.search(r"(\d+(?:\.\d+)?)\s*bar", words)
    default = 1.15 if "low" in words else 2.6 if "high" in words else RUN_BAR
    level = float(np.clip(float(said[1]) if said else default, *LIMITS_BAR))
    purpose = f"further|{words}"
    if "coast" in words:
        return _run(truth, level, False, start, inertia, purpose, "further_coast_down.csv")
    if "spin" in words:
        return _run(truth, level, True, start, inertia, purpose, "further_spin_up.csv")
    if "zero" in words or "vented" in words:
        return _zero(truth, inertia, purpose)
    if "lock" in words or "held" in words:
        return _steady(truth, np.full(PLATEAUS, level), start, inertia, purpose, "locked_rotor.csv", True)
    if "revers" in words:
        down = np.concatenate([LEVELS_BAR[::-1], LEVELS_BAR])
        return _sweep(truth, down, inertia, purpose, "reversed_sweep.csv", start)
    return _steady(truth, np.full(PLATEAUS, level), start, inertia, purpose, "plateaus.csv", False)


def _sweep(truth: Truth, levels: np.ndarray, inertia: float, purpose: str, name: str, start: float | None) -> File:
    """Plateaus in a given order, half of them on the way one way."""
    rng = truth.rng(purpose)
    lines = (levels + REGULATOR_BAR * rng.standard_normal(levels.size)) * BAR
    time = STEP_S * np.arange(levels.size)
    first = 1.0 if levels[0] < levels[levels.size // 2] else -1.0
    way = np.where(np.arange(levels.size) < levels.size // 2, first, -first)
    rig = truth.rig(inertia)
    asked = bench.Plateaus(lines, (start or 0.0) + time, way)
    true = bench.plateaus(rig, replace(asked, lines=bench.delivered(rig, asked)))
    shown = sheets.noisy(true, truth.sensors, 1.0, (start or 0.0) + time, rng)
    turning = true.speed > 1.0
    shown = {channel: values[turning] for channel, values in shown.items()}
    if name == "sweep.csv":
        shown = {
            channel: misread(rig.effects, channel, values / sheets.UNIT[channel]) * sheets.UNIT[channel]
            for channel, values in shown.items()
        }
    columns = {"time_s": sheets.stamps(time[turning]), "direction": ["up" if w > 0.0 else "down" for w in way[turning]]}
    return File(name, "steady", start, 1.0, columns | sheets.cells(shown))


def _steady(
    truth: Truth, levels: np.ndarray, start: float, inertia: float, purpose: str, name: str, locked: bool
) -> File:
    """Plateaus at one level, read every four seconds."""
    rng = truth.rng(purpose)
    lines = (levels + REGULATOR_BAR * rng.standard_normal(levels.size)) * BAR
    time = 4.0 * np.arange(levels.size)
    rig, asked = truth.rig(inertia), bench.Plateaus(lines, start + time, np.ones(levels.size), locked)
    true = bench.plateaus(rig, replace(asked, lines=bench.delivered(rig, asked)))
    shown = sheets.cells(sheets.noisy(true, truth.sensors, 1.0, start + time, rng))
    columns = {"time_s": sheets.stamps(time)} | shown
    if locked:
        columns |= {"speed_rpm": ["0.0"] * levels.size, "rotor_locked": ["1"] * levels.size}
    return File(name, "steady", start, 1.0, columns)


def _zero(truth: Truth, inertia: float, purpose: str) -> File:
    """Instruments read with the line vented and the rotor at rest."""
    rng = truth.rng(purpose)
    true = bench.at_rest(truth.rig(inertia), PLATEAUS)
    shown = sheets.noisy(true, truth.sensors, 1.0, np.full(PLATEAUS, LATER_S), rng)
    del shown["speed"]
    return File("zero.csv", "zero", None, 1.0, sheets.cells(shown))


def _run(truth: Truth, level: float, up: bool, start: float, inertia: float, purpose: str, name: str) -> File:
    """A spin-up or a coast-down."""
    rng = truth.rng(purpose)
    longer = 1.0 + inertia / truth.nuisances["inertia"]
    rig, told = truth.rig(inertia), truth.told()
    opened = valve(truth, up, longer)
    line = (level + REGULATOR_BAR * rng.standard_normal()) * BAR
    went = bench.history(rig, bench.Run(float(line), opened, start, float(rng.uniform(0.0, PULSE))))
    pitch = told["pitch_error_sd"] * truth.rng("wheel").standard_normal(max(told["teeth"], 1))
    seen = readout.wheel(went.turned, told["lag_s"])
    ends, speed = readout.speeds(told, seen, pitch, rng, truth.sensors["jitter_s"])
    times, pressure = readout.pressures(told, went.pressure)
    shown = {
        "pressure": (times, bench.shown_pressure(rig, pressure)),
        "speed": (ends, bench.shown_speed(rig, speed, start + ends)),
    }
    shown = {
        channel: (at, sheets.noisy_one(channel, true, truth.sensors, TRANSIENT_NOISE, start + at, rng))
        for channel, (at, true) in shown.items()
    }
    if told["zero_after_s"] > 0.0:
        shown["speed"][1][speed == 0.0] = 0.0  # a counter shows nothing where no tooth came
    stamps, columns = sheets.together(shown, ("pressure",) if told["gauge_held"] else ())
    moment = bench.SAMPLE_S * before(truth, up) + told["supply_off_s"]
    is_open = (stamps > moment + HALF_STAMP_S) == up
    head = {"time_s": sheets.stamps(stamps), "supply_open": [str(int(one)) for one in is_open]}
    columns = {"pressure": columns["pressure"], "flow": np.full(stamps.size, np.nan), "speed": columns["speed"]}
    return File(name, "transient", start, TRANSIENT_NOISE, head | sheets.cells(columns))


def valve(truth: Truth, up: bool, longer: float = 1.0) -> np.ndarray:
    """Whether the valve is driven towards the regulator along a run, a sample of `bench.SAMPLE_S` each, shape (n,).

    A slow line, a slow gauge and a slow tachometer are given their time.

    `longer`: by what factor it is longer, with a flywheel [-].
    """
    first, supply = before(truth, up), truth.supply
    after = (SPIN_UP_SAMPLES if up else COAST_DOWN_SAMPLES) * bench.SAMPLE_S
    if supply:
        volume, area = supply["line_volume_l"], supply["valve_area_mm2" if up else "vent_area_mm2"]
        if up:
            after += SETTLES * (supply["regulator_time_s"] + 60.0 * supply["droop_bar_min_l"] * volume / FILLED_BAR)
        after += SETTLES * volume / (CHOKED_L_S_MM2 * area + (0.0 if up else DRAUGHT_L_S))
    after = min(after * longer, MOST_S * longer)
    place = np.arange(first + round(after / bench.SAMPLE_S))
    return place >= first if up else place < first


def before(truth: Truth, up: bool) -> int:
    """Samples of `bench.SAMPLE_S` before the supply changes."""
    told = truth.told()
    spans = [1.5 / told["gauge_hz"], 3.0 * told["window_s"], 0.6 / told["teeth"] if told["teeth"] else 0.0]
    return max(SPIN_UP_FROM if up else COAST_DOWN_FROM, round(max(spans) / bench.SAMPLE_S))


def _write(truth: Truth, folder: Path, files: list[File], inertia: float, higher_bar: float = 0.0) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        sheets.write_file(folder, file)
    (folder / "recording.toml").write_text(sheets.head(files, inertia, truth.told(), higher_bar), encoding="utf-8")
