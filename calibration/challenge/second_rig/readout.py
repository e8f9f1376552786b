"""What tachometer and gauge make of a run in time: tooth counters, means over a window, a gauge's own rate.

A truth keeps the instruments as plain data (`equipment` draws them). Those of an old truth are empty: means since the
sample before, and a gauge that is read with every sample.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.challenge.second_rig.bench import CELL_S, SAMPLE_S

TOOTH, WINDOW, MEANS = "teeth", "window", "means"
PLAIN: dict[str, Any] = {
    "tachometer": MEANS,
    "period_s": SAMPLE_S,  # between samples
    "window_s": 0.0,  # over which each is the mean
    "teeth": 0,
    "pitch_error_sd": 0.0,  # share of the distance between two teeth
    "zero_after_s": 0.0,  # without a tooth, after which 0 is shown; 0: never
    "lag_s": 0.0,
    "gauge_hz": 1.0 / SAMPLE_S,
    "gauge_phase": 0.0,  # of its first reading, in its periods
    "gauge_held": False,  # whether its last reading is written again until the next
    "gauge_lag_s": 0.0,
    "supply_off_s": 0.0,  # by which supply_open is late
    "told": [],  # which of the keys of [channels.speed_rpm] that could be left out are given
    "supply_told": {},  # of [supply]: value and sd
}
BEFORE_S = 0.04  # over which the speed before the first sample is taken


def slowed(values: np.ndarray, lag_s: float) -> np.ndarray:
    """What an instrument with a first-order lag makes of a quantity in time, from rest at its first value.

    `values`, shape (n,): at the ends of cells of `bench.CELL_S` [own unit].
    """
    if lag_s <= 0.0:
        return values
    kept, out, now = float(np.exp(-CELL_S / lag_s)), np.empty_like(values), float(values[0])
    for k, value in enumerate(values.tolist()):
        now = value + (now - value) * kept
        out[k] = now
    return out


def wheel(turned: np.ndarray, lag_s: float) -> np.ndarray:
    """The angle that a tachometer with a lag sees [rad]; before the start the shaft turned as it does there.

    `turned`, shape (n + 1,): angle of the shaft [rad].
    """
    if lag_s <= 0.0:
        return turned
    speed = np.diff(turned) / CELL_S
    speed[0] = first_speed(turned)
    return np.concatenate([[0.0], np.cumsum(slowed(speed, lag_s)) * CELL_S]) + turned[0]


def first_speed(turned: np.ndarray) -> float:
    """Mean speed at the start of a run [rad/s]. `turned`, shape (n + 1,): angle of the shaft [rad]."""
    cells = min(round(BEFORE_S / CELL_S), turned.size - 1)
    return float(turned[cells] - turned[0]) / (cells * CELL_S)


def speeds(
    told: Mapping[str, Any], turned: np.ndarray, pitch: np.ndarray, rng: np.random.Generator, jitter_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """When a tachometer gives a reading [s], and what speed it gives [rad/s]; arrays of shape (n,).

    `turned`, shape (m + 1,): angle of its wheel at the ends of cells of `bench.CELL_S` [rad].
    `pitch`, shape (teeth,): where each tooth stands, off its place, as a share of the distance between two.
    `jitter_s`: by how much a reading is later or earlier than it says, 1 sd [s].
    """
    last = (turned.size - 1) * CELL_S
    if told["tachometer"] == TOOTH:
        ends, shown = _teeth(told, turned, pitch, float(rng.random()))
        late = np.clip(ends + jitter_s * rng.standard_normal(ends.size), 0.0, last)
        return np.sort(late), shown
    period = told["period_s"]
    stamps = period * np.arange(1, int(last / period + 1e-9) + 1)
    ends = np.minimum(stamps + jitter_s * rng.standard_normal(stamps.size), last)
    begins = ends - told["window_s"] if told["window_s"] else np.concatenate([[0.0], ends[:-1]])
    return stamps, (angle_at(turned, ends) - angle_at(turned, begins)) / (ends - begins)


def angle_at(turned: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The wheel's angle at any time [rad]; before the start it turned as it does there.

    `turned`, shape (m + 1,): angle at the ends of cells of `bench.CELL_S` [rad].
    `times`, shape (n,): from the run's start [s].
    """
    found: np.ndarray = np.interp(times, np.arange(turned.size) * CELL_S, turned)
    return found + first_speed(turned) * np.minimum(times, 0.0)


def _teeth(
    told: Mapping[str, Any], turned: np.ndarray, pitch: np.ndarray, phase: float
) -> tuple[np.ndarray, np.ndarray]:
    """Each reading is the mean since the tooth before; 0 is shown where none came for a while."""
    width = 2.0 * np.pi / told["teeth"]
    farthest = np.maximum.accumulate(turned)  # a shaft that turns back shows the same tooth again: it is not counted
    grid = np.arange(turned.size) * CELL_S
    number = np.arange(int((farthest[-1] - turned[0]) / width) + 2)
    places = turned[0] + (number + phase + pitch[number % pitch.size] - pitch[0]) * width
    places = places[(places > turned[0]) & (places < farthest[-1])]
    moves = np.concatenate([[True], np.diff(farthest) > 0.0])
    edges = np.interp(places, farthest[moves], grid[moves])
    ends, shown = edges[1:], width / np.diff(edges)
    wait = told["zero_after_s"]
    if wait > 0.0:
        marks = np.concatenate([[0.0], edges, [grid[-1]]])
        zeros = [np.arange(a + wait, b, wait) for a, b in itertools.pairwise(marks.tolist())]
        at = np.concatenate(zeros)
        ends, shown = np.concatenate([ends, at]), np.concatenate([shown, np.zeros(at.size)])
        order = np.argsort(ends, kind="stable")
        ends, shown = ends[order], shown[order]
    return ends, shown


def pressures(told: Mapping[str, Any], line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """When a gauge is read [s], and the pressure at it [Pa]; arrays of shape (n,).

    `line`, shape (m + 1,): pressure at the ends of cells of `bench.CELL_S` [Pa].
    """
    period = 1.0 / told["gauge_hz"]
    last = (line.size - 1) * CELL_S
    first = told["gauge_phase"] or 1.0
    times = period * (first + np.arange(int(last / period - first + 1e-9) + 1))
    return times, np.interp(times, np.arange(line.size) * CELL_S, slowed(line, told["gauge_lag_s"]))
