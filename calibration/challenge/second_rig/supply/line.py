"""The line between regulator and motor: air that a regulator lets in through a valve, and that motor and vent take out.

A regulator follows what it is set to with a first-order lag and gives less the more it lets through. A three-way valve
takes its time from one way to the other; the way to the ambient may be shut for good. What the valve lets pass either
way is a nozzle's flow. The pressure at the motor follows from the mass in the volume.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass

import numpy as np

from calibration.challenge.second_rig.machine.flows import nozzle, relaxed
from calibration.challenge.second_rig.machine.motor import DROP_IN, DROP_OUT, IN, OMEGA, PA, THETA, TIN, step
from calibration.challenge.second_rig.machine.slots import BAR, L_MIN, R_AIR
from configs.compiled import njit

MM2 = 1e-6  # in m2
LITRE = 1e-3  # in m3
LEAST_M3 = 1e-5  # of a line that holds air
ROUNDS = 40  # most, of looking for a settled line
SETTLED_PA = 0.01
STILL_CELLS, STILL_PA = 100, 0.01  # cells in which nothing moves, and the line by no more, before none are marched

# State of the line: pressure [Pa], regulator's pressure [Pa], share of the valve that is open, mass through the
# regulator and mass to the vent [kg].
LINE, REGULATED, OPENED, ENTERED, VENTED = range(5)
STATES = 5
DROOP, VALVE = 1, 3  # places among the figures


@dataclass(frozen=True)
class Supply:
    """A line as built; SI units, in the order that the march takes.

    `regulator_time_s`: lag of the regulator [s].
    `droop`: pressure that it loses per volume flow at the line's state [Pa s/m3].
    `valve_time_s`: from one way to the other [s].
    `valve_m2`, `vent_m2`: effective areas to the regulator and to the ambient [m2].
    `volume_m3`: between valve and motor [m3].
    """

    regulator_time_s: float
    droop: float
    valve_time_s: float
    valve_m2: float
    vent_m2: float
    volume_m3: float

    @classmethod
    def of(
        cls,
        regulator_time_s: float,
        droop_bar_min_l: float,
        valve_time_s: float,
        valve_area_mm2: float,
        vent_area_mm2: float,
        line_volume_l: float,
    ) -> Supply:
        """A line from figures in the units of a bench.

        `regulator_time_s`: lag of the regulator [s].
        `droop_bar_min_l`: what it loses for each L/min at the line's state [bar min/L].
        `valve_time_s`: from one way to the other [s].
        `valve_area_mm2`, `vent_area_mm2`: effective areas to the regulator and to the ambient [mm2].
        `line_volume_l`: between valve and motor [L].
        """
        volume = max(line_volume_l * LITRE, LEAST_M3)
        droop = droop_bar_min_l * BAR * L_MIN
        return cls(regulator_time_s, droop, valve_time_s, valve_area_mm2 * MM2, vent_area_mm2 * MM2, volume)

    def figures(self) -> np.ndarray:
        """As the compiled march takes them, shape (6,)."""
        return np.array(astuple(self), dtype=float)


def supply_of(data: Mapping[str, float]) -> Supply | None:
    """A line as a truth keeps it; None for an ideal step in pressure.

    `data`: what `Supply.of` takes, by name; empty for an ideal step.
    """
    return Supply.of(**data) if data else None


def at_rest(p: np.ndarray) -> np.ndarray:
    """State of a vented line, its valve shut, shape (5,)."""
    s = np.zeros(STATES)
    s[LINE] = s[REGULATED] = p[PA]
    return s


@njit(cache=True)
def follow(
    p: np.ndarray, s: np.ndarray, figures: np.ndarray, target: float, is_open: bool, taken: float, dt: float
) -> None:
    """The line after a step: the motor's draught, then each way of the valve by backward Euler.

    `taken`: mass that the motor took in this step [kg].
    """
    lag, droop, valve_time, area, vent, volume = figures
    way = 1.0 if is_open else 0.0
    share = dt / valve_time if valve_time > dt else 1.0
    s[OPENED] += min(share, max(-share, way - s[OPENED]))
    gas = R_AIR * p[TIN]
    stiff = gas / volume
    s[LINE] = max(s[LINE] - stiff * taken, p[PA] if taken > 0.0 else 0.0)
    before = s[LINE]
    s[LINE] = through(s[OPENED] * area, s[LINE], s[REGULATED], p[TIN], dt * stiff)
    entered = (s[LINE] - before) / stiff
    s[ENTERED] += entered
    before = s[LINE]
    s[LINE] = through((1.0 - s[OPENED]) * vent, s[LINE], p[PA], p[TIN], dt * stiff)
    s[VENTED] += (before - s[LINE]) / stiff
    if is_open or s[OPENED] == 0.0:
        # Flow that comes back does not raise what it gives.
        flow = max(entered, 0.0) / dt * gas / s[LINE]
        wanted = max(p[PA], target - droop * flow)
        s[REGULATED] += (wanted - s[REGULATED]) * (1.0 - math.exp(-dt / lag) if lag > 0.0 else 1.0)


@njit(cache=True)
def through(area: float, P: float, far: float, T: float, rate: float) -> float:
    """Pressure of a volume after a step in which an orifice joins it to another pressure [Pa].

    `area`: of the orifice [m2].
    `P`, `far`: before the step, and beyond the orifice [Pa].
    `rate`: step times pressure per mass [Pa s/kg].
    """
    gap = far - P
    if area <= 0.0 or abs(gap) < 0.1:
        return P
    one = nozzle(area, max(far, P), min(far, P), T)
    return far - math.copysign(relaxed(abs(gap), rate * one), gap)


# Numba takes arrays one by one: `second_rig`.
@njit(cache=True)
def together(
    p: np.ndarray,
    table: np.ndarray,
    y: np.ndarray,
    s: np.ndarray,
    figures: np.ndarray,
    target: float,
    is_open: bool,
    less: float,
    dt: float,
) -> float:
    """One step of motor and line; the mass that the motor took [kg].

    Where the line is as good as vented, both ports stand at the exhaust's pressure.
    """
    feed = s[LINE] - less
    feeds = feed > p[PA] + p[DROP_IN] + p[DROP_OUT]
    y[IN] = 0.0
    step(p, table, y, feed, feeds, dt)
    taken = y[IN] if feeds else 0.0
    follow(p, s, figures, target, is_open, taken, dt)
    return taken


# Numba takes arrays one by one: `second_rig`.
@njit(cache=True)
def march(
    p: np.ndarray,
    table: np.ndarray,
    y: np.ndarray,
    s: np.ndarray,
    figures: np.ndarray,
    target: float,
    opened: np.ndarray,
    less: float,
    steps: int,
    dt: float,
    rests: bool,
) -> np.ndarray:
    """March motor and line over cells of so many steps: what they are at the cells' ends, shape (n, 4).

    `y`: state of the motor at the start, laid out as at the top of `motor`; changed.
    `s`, shape (5,): state of the line at the start; changed.
    `opened`, shape (n,): whether the valve is driven towards the regulator in each cell.
    `rests`: whether nothing is marched while the valve is shut and rotor and line have long been at rest.
    Returns angle [rad], speed [rad/s], pressure of the line [Pa] and the mean mass flow into the motor [kg/s].
    """
    found = np.empty((opened.size, 4))
    still = 0
    for k in range(opened.size):
        before, passed = s[LINE], 0.0
        for _ in range(0 if rests and still > STILL_CELLS and not opened[k] else steps):
            passed += together(p, table, y, s, figures, target, opened[k], less, dt)
        found[k, 0], found[k, 1] = y[THETA], y[OMEGA]
        found[k, 2], found[k, 3] = s[LINE], passed / (steps * dt)
        shut = s[OPENED] == 0.0 and not opened[k]
        still = still + 1 if shut and y[OMEGA] == 0.0 and abs(s[LINE] - before) < STILL_PA else 0
    return found


def settled(p: np.ndarray, figures: np.ndarray, target: float, mass_flow: float) -> tuple[float, float]:
    """Pressures of a line that lets so much through, and of its regulator [Pa]: droop, and loss of the valve."""
    line = target
    for _ in range(ROUNDS):
        regulated = max(target - figures[DROOP] * mass_flow * R_AIR * p[TIN] / line, p[PA])
        one = nozzle(figures[VALVE], regulated, min(line, regulated - 1.0), p[TIN])
        found = max(regulated - (mass_flow / one) ** 2, p[PA])
        if abs(found - line) < SETTLED_PA:
            break
        line = 0.5 * (line + found)
    return line, regulated


def needed(p: np.ndarray, figures: np.ndarray, line: float, mass_flow: float) -> float:
    """What the regulator is set to where a line that lets so much through stands at a pressure [Pa]."""
    regulated = line + 1.0
    for _ in range(ROUNDS):
        regulated = line + max((mass_flow / nozzle(figures[VALVE], regulated, line, p[TIN])) ** 2, 1e-3)
    return float(regulated + figures[DROOP] * mass_flow * R_AIR * p[TIN] / line)
