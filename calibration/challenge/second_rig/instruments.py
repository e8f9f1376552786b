"""What the second rig's instruments make of the true values: effects on sensors, without noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.challenge.second_rig.concealed import Concealed


def read_pressure(effects: Sequence[Concealed], true: np.ndarray) -> np.ndarray:
    """What the gauge makes of the pressure at it [Pa]: errors of its zero and its span, and a made-up sawtooth.

    `true`, shape (n,): pressure at the gauge [Pa].
    """
    for effect in effects:
        v = effect.values
        if effect.id == "pressure_gauge_offset":
            true = true + v["offset_pa"]
        elif effect.id == "pressure_gauge_scale":
            true = true * (1.0 + v["scale"])
        elif effect.id == "gauge_sawtooth":
            true = true + v["height_pa"] * _sawtooth((true - 1e5) / v["period_pa"] + v["phase"])
    return true


def read_flow(
    effects: Sequence[Concealed], true: np.ndarray, line: np.ndarray, line_k: float, follows: np.ndarray
) -> np.ndarray:
    """What the flow meter makes of the flow [m3/s]: errors of its zero and its span, a sawtooth, a float that sticks.

    A variable-area meter whose scale was drawn for 1 atm and 20 C reads the flow times the root of the density ratio:
    its float balances the drag. The other form takes another power of the ratio.

    `true`, shape (n,): flow at the line's state [m3/s].
    `line`, shape (n,): pressure of the line [Pa].
    `line_k`: temperature of the line [K].
    `follows`, shape (n,): whether a row follows the one before it without the flow having been shut.
    """
    for effect in effects:
        v = effect.values
        if effect.id == "flow_offset":
            true = true + v["offset_m3_s"]
        elif effect.id == "flow_scale":
            true = true * (1.0 + v["scale"])
        elif effect.id == "flow_density_correction":
            power = v.get("exponent", 0.5)
            true = true * (1.0 + v["share"] * ((line / 101_325.0 * 293.15 / line_k) ** power - 1.0))
        elif effect.id == "flow_sawtooth":
            true = true + v["height_m3_s"] * _sawtooth(true / v["period_m3_s"] + v["phase"])
        elif effect.id == "flow_float_sticks":
            true = _sticking(true, v["half_width_m3_s"], follows)
    return true


def read_speed(effects: Sequence[Concealed], true: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """What the tachometer makes of a steady speed [rad/s]: miscounted pulses, and a coupling that begins to slip.

    `true`, shape (n,): speed of the shaft [rad/s].
    """
    for effect in effects:
        v = effect.values
        if effect.id == "speed_scale":
            true = true * (1.0 + v["scale"])
        elif effect.id == "tachometer_slips_from_a_moment_on":
            true = np.where(clock >= v["moment_s"], true * (1.0 - v["slip"]), true)
    return true


def lagged(effects: Sequence[Concealed], speed: np.ndarray, cell_s: float) -> np.ndarray:
    """What a slow tachometer makes of the speed in time [rad/s]: a first-order lag, a pure delay or a moving average.

    `speed`, shape (n,): of cells of equal duration [rad/s].
    """
    for effect in effects:
        if effect.id != "speed_lag":
            continue
        cells = effect.values["time_s"] / cell_s
        first = float(np.mean(speed[: max(1, int(0.04 / cell_s))]))
        ahead = np.concatenate([np.full(int(np.ceil(2.0 * cells)) + 2, first), speed])
        place = np.arange(speed.size) + ahead.size - speed.size
        if effect.form == "delay":
            speed = np.interp(place - cells, np.arange(ahead.size), ahead)
        elif effect.form == "moving_average":  # over twice the time, so that the mean delay is the same
            total = np.concatenate([[0.0], np.cumsum(ahead)])
            grid = np.arange(total.size)
            speed = (total[place + 1] - np.interp(place + 1 - 2.0 * cells, grid, total)) / (2.0 * cells)
        else:
            kept, out = np.exp(-1.0 / cells), np.empty_like(speed)
            now = first
            for k in range(speed.size):
                now = speed[k] + (now - speed[k]) * kept
                out[k] = now
            speed = out
    return speed


def misread(effects: Sequence[Concealed], channel: str, readings: np.ndarray) -> np.ndarray:
    """Readings of the sweep with single ones misread.

    `channel`: ``pressure`` [Pa], ``flow`` [m3/s] or ``speed`` [rad/s].
    `readings`, shape (n,): as they would be [SI].
    """
    readings = readings.copy()
    for effect in effects:
        if effect.id == "bad_reading":
            for name, value in effect.values.items():
                at_channel, _, row = name.partition("_row_")
                if at_channel == channel and int(row) <= readings.size:
                    readings[int(row) - 1] += value
    return readings


def _sawtooth(x: np.ndarray) -> np.ndarray:
    """Rises from -1 to 1 over a period of 1, then falls back at once [-]."""
    return 2.0 * (x % 1.0) - 1.0


def _sticking(true: np.ndarray, half_width: float, follows: np.ndarray) -> np.ndarray:
    """A float that follows only when it is dragged: it lags by up to the half width, whichever way it came."""
    out = true.copy()
    now = 0.0
    for k in range(true.size):
        now = now if follows[k] else max(true[k] - half_width, 0.0)
        now = min(max(now, true[k] - half_width), true[k] + half_width)
        out[k] = now
    return out
