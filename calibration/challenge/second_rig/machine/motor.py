"""The motor of the second rig: seven cylinders marched together in time, gas flowing through ports at a finite rate.

Written anew from the article. A leapfrog in time: speeds stand half a step before angles, so a step kicks the speed
with the torque at the present angle, turns the rotor, and lets each cylinder take the new volume. The states of a
cylinder are its mass and internal energy. A port is a nozzle whose area grows as it uncovers; its flow is stiff (a
cylinder of 0.9 cm3 fills in some ten microseconds), so each port is stepped by backward Euler, which for a nozzle is a
quadratic equation in the root of the pressure difference and has a closed solution. Mass and energy are kept to
rounding.
"""

from __future__ import annotations

import math

import numpy as np

from calibration.challenge.second_rig.machine.curve import AREA, BORE, CELLS, GAS_ARM, ROLLER_ARM, VOLUME
from calibration.challenge.second_rig.machine.flows import (
    DROP_IN,
    DROP_OUT,
    PA,
    PLENUM_IN,
    PLENUM_OUT,
    TA,
    TIN,
    heat,
    leak_flow,
    nozzle,
    plenums,
    relaxed,
    uncovered,
)
from calibration.challenge.second_rig.machine.losses import drag, swing
from calibration.challenge.second_rig.machine.slots import AT, CYLINDERS, GAMMA, LOBE, R_AIR
from configs.compiled import njit

STEP_S = 2.5e-5
CV = R_AIR / (GAMMA - 1.0)
CP = GAMMA * CV  # [J/(kg K)], as CV

# State: angle, speed, plenum pressures, masses and energies of the cylinders, then what has passed.
THETA, OMEGA = 0, 1
MASS = 4
ENERGY = MASS + CYLINDERS
IN = ENERGY + CYLINDERS  # mass through the line, leaks included [kg]
OUT = IN + 1  # mass that left the cylinders through the exhaust [kg]
H_IN = OUT + 1  # enthalpy into the cylinders, less what left them [J]
HEAT = H_IN + 1  # heat into the gas [J]
WORK = HEAT + 1  # work of the gas on the pistons [J]
TURNED = WORK + 1  # integral of the gas torque over time [N m s]
PSI = TURNED + 1  # angle within the lobe and volume of each cylinder: they follow from the angle, and are kept
KEPT = PSI + CYLINDERS
SIZE = KEPT + CYLINDERS

FR, J, LAP, PORT = AT["roller_factor"], AT["inertia"], AT["lap"], AT["port_area_m2"]


@njit(cache=True)
def look_up(table: np.ndarray, psi: float, column: int) -> float:
    """A column of the guide curve at an angle, linear between its cells [unit of the column]."""
    place = psi * (CELLS / LOBE)
    cell = min(int(place), CELLS - 1)
    share = place - cell
    return table[cell, column] * (1.0 - share) + table[cell + 1, column] * share


@njit(cache=True)
def rest(p: np.ndarray, table: np.ndarray, theta: float, line: float, is_open: bool) -> np.ndarray:
    """A motor at rest whose cylinders hold the pressure of the port that they see, and a mean where they see none.

    `is_open`: whether the supply is open; the line is vented otherwise.
    """
    y = np.zeros(SIZE)
    y[THETA] = theta
    feed = line - p[DROP_IN] if is_open else p[PA] + p[DROP_OUT]
    back = p[PA] + p[DROP_OUT]
    y[PLENUM_IN], y[PLENUM_OUT] = feed, back
    for i in range(CYLINDERS):
        psi = (theta + i * 4.0 * LOBE / CYLINDERS) % LOBE
        P = feed if psi >= 0.5 * LOBE else back
        V = look_up(table, psi, VOLUME)
        y[MASS + i] = P * V / (R_AIR * p[TIN])
        y[ENERGY + i] = P * V / (GAMMA - 1.0)
        y[PSI + i], y[KEPT + i] = psi, V
    return y


@njit(cache=True)
def opened(p: np.ndarray, start: float, end: float, half: float) -> float:
    """Mean share of a port's area that is open over a step [-]; taken at its end alone it would jump with the step.

    Simpson's rule over start, middle and end.

    `start`, `end`: angles within the lobe [rad].
    `half`: where the port's half of the lobe begins [rad].
    """
    opens, closes = half + p[LAP], half + 0.5 * LOBE - p[LAP]
    return (
        uncovered(start, opens, closes, p)
        + 4.0 * uncovered(0.5 * (start + end), opens, closes, p)
        + uncovered(end, opens, closes, p)
    ) / 6.0


@njit(cache=True)
def torques(p: np.ndarray, table: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Gas torque and size of the roller friction's [N m]: forces of Eq. 22 at the article's arms, Eq. 23-25."""
    gas = roller = 0.0
    for i in range(CYLINDERS):
        psi = y[PSI + i]
        P = (GAMMA - 1.0) * y[ENERGY + i] / y[KEPT + i]
        force = AREA * (P - p[PA])
        gas += force * look_up(table, psi, GAS_ARM)
        roller += p[FR] * abs(force) * look_up(table, psi, ROLLER_ARM)
    return gas, roller


@njit(cache=True)
def kick(p: np.ndarray, table: np.ndarray, y: np.ndarray, line_gauge: float, dt: float) -> None:
    """Change the speed over one step, Eq. 21; dry friction may hold the rotor, and never drives it."""
    gas, roller = torques(p, table, y)
    viscous, dry = drag(p, y[OMEGA], line_gauge)
    free = gas - swing(p, y[THETA])
    half = 0.5 * dt * viscous / p[J]
    omega = (y[OMEGA] * (1.0 - half) + dt * free / p[J]) / (1.0 + half)
    held = dt * (dry + roller) / p[J]
    y[OMEGA] = 0.0 if abs(omega) <= held else omega - math.copysign(held, omega)
    y[TURNED] += gas * dt


# In one piece, its parts share their running values: `second_rig`.
@njit(cache=True)
def step(p: np.ndarray, table: np.ndarray, y: np.ndarray, line: float, is_open: bool, dt: float) -> None:
    """One step of the whole motor, in place.

    `is_open`: whether the supply is open; both ports stand at the exhaust's pressure otherwise.
    """
    kick(p, table, y, line - p[PA] if is_open else 0.0, dt)
    turned = dt * y[OMEGA]
    y[THETA] += turned
    feed, back = y[PLENUM_IN], y[PLENUM_OUT]
    T_feed = p[TIN] if is_open else p[TA]
    entered = left = 0.0
    for i in range(CYLINDERS):
        psi = y[PSI + i] + turned
        psi = psi - LOBE if psi >= LOBE else psi + LOBE if psi < 0.0 else psi
        V0, V = y[KEPT + i], look_up(table, psi, VOLUME)
        y[PSI + i], y[KEPT + i] = psi, V
        mass, energy = y[MASS + i], y[ENERGY + i]
        swept = 0.5 * (GAMMA - 1.0) * (V - V0)
        moved = energy * (1.0 - swept / V0) / (1.0 + swept / V)  # trapezoid of P dV
        y[WORK] += energy - moved
        energy = moved
        half = 0.5 * LOBE
        inlet = psi >= half
        share = opened(p, psi - turned, psi, half if inlet else 0.0)
        through = 0.0
        if share > 0.0:
            P, T = (GAMMA - 1.0) * energy / V, energy / (mass * CV)
            P_port, T_port = (feed, T_feed) if inlet else (back, p[TA])
            gap = P_port - P
            if gap != 0.0:
                inward = gap > 0.0
                T_up = T_port if inward else T
                one = nozzle(share * p[PORT], max(P, P_port), min(P, P_port), T_up)
                gain = GAMMA * R_AIR * T_up / V  # pressure per mass
                through = (abs(gap) - relaxed(abs(gap), dt * one * gain)) / gain
                through = min(through, 0.5 * mass) if not inward else through
                through = through if inward else -through
                mass += through
                energy += CP * T_up * through
                y[H_IN] += CP * T_up * through
                if inlet:
                    entered += through
                else:
                    left -= through
        P, T = (GAMMA - 1.0) * energy / V, energy / (mass * CV)
        piston = abs(V - V0) / (AREA * dt)
        filling = abs(through) / (dt * mass / V * (math.pi * BORE * V / AREA + 2.0 * AREA))
        warmed = heat(p, P, T, V, piston, filling) * dt
        y[HEAT] += warmed
        y[MASS + i], y[ENERGY + i] = mass, energy + warmed
    y[OUT] += left
    leak = leak_flow(p, feed + p[DROP_IN]) if is_open else 0.0
    y[IN] += entered + leak * dt
    plenums(p, y, line, is_open, entered / dt + leak, left / dt, dt)
