"""Marching the second rig's motor: plateaus until they are periodic, and runs in time as a bench samples them."""

from __future__ import annotations

import math

import numpy as np

from calibration.challenge.second_rig.machine import curve
from calibration.challenge.second_rig.machine.flows import PA
from calibration.challenge.second_rig.machine.losses import COSINE, SECOND, SINE, F, drag
from calibration.challenge.second_rig.machine.motor import FR, IN, OMEGA, STEP_S, THETA, TURNED, J, rest, step
from calibration.challenge.second_rig.machine.slots import PULSE
from configs.compiled import njit

TABLE = curve.table()
LOBE_PULSES, TURN_PULSES = 7, 28  # pulses in a lobe, and in a turn of four lobes
AVERAGED_S = 0.3  # of a periodic motor, over which a plateau is averaged
MOST_S = 8.0  # of marched time
ENOUGH = 1e-5  # relative change of the speed over a block
STALLED_S = 0.3  # below the slowest speed, after which the rotor counts as standing
SPARE_RAD_S = 2.0  # above the guess: near stall a motor that starts too slow stays standing
SLOWEST = 0.5  # rad/s; below it the rotor may have stalled


@njit(cache=True)
def _to(
    p: np.ndarray, table: np.ndarray, y: np.ndarray, line: float, end: float, dt: float
) -> tuple[float, float, float, bool]:
    """March to an angle, the last step cut to end there: time, inlet mass, torque integral, and whether it turned."""
    y[IN] = y[TURNED] = 0.0
    t = still = 0.0
    while y[THETA] < end:
        left = (end - y[THETA]) / y[OMEGA] if y[OMEGA] > SLOWEST else dt
        one = min(dt, max(left, 1e-9))
        step(p, table, y, line, True, one)
        t += one
        still = still + one if y[OMEGA] < SLOWEST else 0.0
        if still > STALLED_S or t > MOST_S:
            return t, y[IN], y[TURNED], False
        if end - y[THETA] < 1e-9:
            break
    return t, y[IN], y[TURNED], True


@njit(cache=True)
def swings(p: np.ndarray) -> bool:
    """Whether a torque is fixed to the shaft's angle, so that the motor repeats itself only once a turn."""
    return bool(p[SINE] != 0.0 or p[COSINE] != 0.0 or p[SECOND] != 0.0)


@njit(cache=True)
def settle(p: np.ndarray, table: np.ndarray, y: np.ndarray, line: float, dt: float) -> bool:
    """March until the speed is periodic; whether the rotor still turns."""
    block = TURN_PULSES if swings(p) else LOBE_PULSES
    width = block * PULSE
    took, _, _, runs = _to(p, table, y, line, y[THETA] + width, dt)
    passed, speed, calm = took, width / took, 0
    while runs and passed < MOST_S and calm < 2:
        took, _, _, runs = _to(p, table, y, line, y[THETA] + width, dt)
        passed += took
        now = width / took
        change, speed = now - speed, now
        calm = calm + 1 if abs(change) < ENOUGH * now else 0
        # The speed settles as exp(-t s/J), with the slope s of the losses: go on to where that ends.
        here, near = drag(p, now, line - p[PA]), drag(p, 1.01 * now, line - p[PA])
        slope = (near[0] * 1.01 * now + near[1] - here[0] * now - here[1]) / (0.01 * now)
        decay = math.exp(-took * max(slope, 0.3 * p[F]) / p[J])
        if runs and calm == 0 and decay > 1e-3:
            jump = min(max(change * decay / (1.0 - decay), -0.1 * now), 0.3 * now)
            y[OMEGA] += jump
            took, _, _, runs = _to(p, table, y, line, y[THETA] + width, dt)
            passed += took
            speed = width / took
    return runs


@njit(cache=True)
def plateau(p: np.ndarray, table: np.ndarray, line: float, omega: float, dt: float) -> tuple[float, float, float]:
    """March at one pressure until it is periodic, and average over whole lobes, or turns where one is unlike the next.

    `omega`: speed to start from [rad/s].
    Returns `speed`: mean over time [rad/s]; 0 when it stalls; `flow`: mass through the line [kg/s]; `torque`: mean gas
    torque [N m].
    """
    y = rest(p, table, 0.0, line, True)
    y[OMEGA] = omega
    if settle(p, table, y, line, dt):
        lobes = math.ceil(AVERAGED_S * y[OMEGA] / (LOBE_PULSES * PULSE))
        width = 2.0 * TURN_PULSES * PULSE if swings(p) else max(lobes, 2) * LOBE_PULSES * PULSE
        took, inlet, turned, runs = _to(p, table, y, line, y[THETA] + width, dt)
        if runs:
            return width / took, inlet / took, turned / took
    y[IN] = y[TURNED] = 0.0
    steps = int(0.1 / dt)
    for _ in range(steps):
        step(p, table, y, line, True, dt)
    return 0.0, y[IN] / (steps * dt), y[TURNED] / (steps * dt)


@njit(cache=True)
def plateaus(rows: np.ndarray, table: np.ndarray, lines: np.ndarray, omegas: np.ndarray, dt: float) -> np.ndarray:
    """Plateaus one after the other: speed [rad/s], mass flow [kg/s] and gas torque [N m], shape (n, 3).

    `omegas`, shape (n,): speeds to start from [rad/s].
    """
    found = np.empty((lines.size, 3))
    for i in range(lines.size):
        found[i] = plateau(rows[i], table, lines[i], omegas[i], dt)
    return found


@njit(cache=True)
def turning(
    p: np.ndarray, table: np.ndarray, line: float, omega: float, angle: float, ahead: float, dt: float
) -> np.ndarray:
    """The periodic state from which the rotor comes to an angle within a pulse after some time.

    `omega`: speed to start from [rad/s].
    `angle`: angle within a pulse [rad].
    `ahead`: the time [s].
    """
    y = rest(p, table, 0.0, line, True)
    y[OMEGA] = omega
    settle(p, table, y, line, dt)
    trial = y.copy()
    for _ in range(round(ahead / dt)):
        step(p, table, trial, line, True, dt)
    _to(p, table, y, line, y[THETA] + (angle - trial[THETA]) % PULSE, dt)
    return y


@njit(cache=True)
def run_in_time(
    p: np.ndarray, table: np.ndarray, y: np.ndarray, line: float, opened: np.ndarray, cell: float, dt: float
) -> np.ndarray:
    """March over cells of equal duration; the angle at their ends [rad], shape (n + 1,).

    `y`: state of the motor at the start, laid out as at the top of `motor`; changed.
    `line`: pressure of the line when the supply is open [Pa].
    `opened`, shape (n,): whether the supply is open in each cell.
    """
    angle = np.empty(opened.size + 1)
    angle[0] = y[THETA]
    steps = max(1, math.ceil(cell / dt - 1e-9))
    for k in range(opened.size):
        for _ in range(steps):
            step(p, table, y, line, opened[k], cell / steps)
        angle[k + 1] = y[THETA]
    return angle


@njit(cache=True)
def gas_torque(p: np.ndarray, gauge: float) -> float:
    """Roughly, the mean torque of gas and rollers on a rotor that turns [N m]; within a few percent at the defaults."""
    return 2.82e-5 * (gauge - 2000.0) - p[FR] * roller_arm(gauge)


@njit(cache=True)
def roller_arm(gauge: float) -> float:
    """Roughly, the mean friction torque of the rollers over their factor [N m]; as good as `gas_torque`."""
    return 5.9 + 1.02e-4 * gauge


@njit(cache=True)
def guess(p: np.ndarray, line: float) -> float:
    """Speed to start from [rad/s]: gas torque proportional to gauge pressure, less what the losses take."""
    gauge = line - p[PA]
    torque = gas_torque(p, gauge)
    low, high = 3.0, 120.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        viscous, dry = drag(p, middle, gauge)
        if viscous * middle + dry < torque:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high) + SPARE_RAD_S


def steady(rows: np.ndarray, lines: np.ndarray, dt: float = STEP_S) -> np.ndarray:
    """Plateaus of rows of figures, or of one row for all: speed [rad/s], mass flow [kg/s], gas torque [N m].

    `rows`, shape (k,) or (n, k): figures of the motor, laid out as in `slots`.
    """
    rows = np.ascontiguousarray(np.broadcast_to(rows, (lines.size, np.shape(rows)[-1])))
    omegas = np.array([guess(row, line) for row, line in zip(rows, lines, strict=True)])
    return plateaus(rows, TABLE, lines, omegas, dt)
