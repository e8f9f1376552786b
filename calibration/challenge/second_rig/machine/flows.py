"""Gas on its way through the second rig's motor: ports, throttles, leaks, heat from the walls. Compiled; SI units."""

from __future__ import annotations

import math

import numpy as np

from calibration.challenge.second_rig.machine.curve import AREA, BORE
from calibration.challenge.second_rig.machine.slots import AT, R_AIR
from configs.compiled import njit

CHOKED = 0.528  # pressure ratio below which a nozzle's flow no longer grows: (2/(g + 1))^(g/(g - 1)) for g = 1.4
NOZZLE = 0.6847  # choked flow: NOZZLE A P / sqrt(R T)
PLENUM_M3 = 5e-5  # between a throttle and the ports
QUADRATIC, ORIFICE, LAMINAR = 0, 1, 2  # forms of a throttle
PRANDTL = 0.71**0.6  # of air, to the power of Eq. 19
VISCOSITY, CONDUCTIVITY = 1.82e-5, 0.0257  # of air at 293.15 K [Pa s], [W/(m K)]
OUTSIDE = 1.0 / 10.0 + 0.005 / 16.0  # Eq. 18: natural convection, and the wall [m2 K/W]
DENSITY_IN, DENSITY_OUT = 2.38, 1.2  # at which the loss coefficients are given [kg/m3]

PA, TA, TIN = AT["ambient_pa"], AT["ambient_k"], AT["inlet_k"]
DROP_IN, DROP_OUT = AT["inlet_drop_pa"], AT["outlet_drop_pa"]
RAMP, LEAD = AT["port_ramp_rad"], AT["port_lead"]
HEAT_FACTOR, WALL = AT["heat_factor"], AT["wall_w_m2k"]
LOSS_IN, AREA_IN, FORM_IN = AT["inlet_loss"], AT["inlet_area_m2"], AT["inlet_form"]
LOSS_OUT, AREA_OUT, FORM_OUT = AT["outlet_loss"], AT["outlet_area_m2"], AT["outlet_form"]
LEAK, LEAK_AREA = AT["leak_kg_s_pa2"], AT["leak_area_m2"]
PLENUM_IN, PLENUM_OUT = 2, 3  # in the state vector


@njit(cache=True)
def uncovered(psi: float, opens: float, closes: float, p: np.ndarray) -> float:
    """Share of a port's area that is open [-]; a little of it at the angles where the article opens and closes it.

    `opens`, `closes`: the article's angles [rad].
    """
    return max(0.0, min(1.0, min(psi - opens, closes - psi) / p[RAMP] + p[LEAD]))


@njit(cache=True)
def nozzle(area: float, high: float, low: float, T: float) -> float:
    """Mass flow per root of the pressure difference, of a nozzle [kg/(s Pa^0.5)].

    Choked flow of an ideal gas; from there to no flow at all the quarter of an ellipse that ISO 6358 draws.

    `area`: effective area [m2].
    `high`, `low`: pressure ahead of it and behind it [Pa].
    `T`: temperature ahead of it [K].
    """
    ratio = low / high
    choked = NOZZLE * area / math.sqrt(R_AIR * T)
    if ratio <= CHOKED:
        return choked * high / math.sqrt(high - low)
    return choked * math.sqrt(high * (1.0 + ratio - 2.0 * CHOKED)) / (1.0 - CHOKED)


@njit(cache=True)
def relaxed(gap: float, rate: float) -> float:
    """What is left of a pressure difference after a step that takes ``rate`` times its root away [Pa].

    Backward Euler: left + rate sqrt(left) = gap, a quadratic equation in the root. At rate 0 all of it is left.

    `gap`: before the step [Pa].
    `rate`: step times conductance times stiffness [Pa^0.5].
    """
    root = 0.5 * (math.sqrt(rate * rate + 4.0 * gap) - rate)
    return root * root


@njit(cache=True)
def leak_flow(p: np.ndarray, high: float) -> float:
    """Air that passes straight to the exhaust and does no work [kg/s].

    Through a gap it flows laminar, in proportion to the difference of the squared pressures; through a hole as through
    a nozzle.

    `high`: pressure behind the inlet's throttle [Pa].
    """
    if high <= p[PA]:
        return 0.0
    flow = p[LEAK] * (high * high - p[PA] * p[PA])
    if p[LEAK_AREA] > 0.0:
        flow += nozzle(p[LEAK_AREA], high, p[PA], p[TIN]) * math.sqrt(high - p[PA])
    return flow


@njit(cache=True)
def heat(p: np.ndarray, P: float, T: float, V: float, piston_speed: float, filling: float) -> float:
    """Heat into a cylinder's gas [W]: Eq. 18-19 through gas, wall and ambient air in series.

    Instead of the rows of Table 2, Nu = 0.09 Re^0.8 Pr^0.6 in all phases, between those rows; Re with the gas's speed
    added to the piston's. The other form is a wall at the ambient's temperature with a constant coefficient.

    `P`, `T`, `V`: gas pressure [Pa], temperature [K] and volume [m3].
    `piston_speed`: size of it [m/s].
    `filling`: speed of the gas that passes the port, over the cylinder's surface [m/s].
    """
    surface = math.pi * BORE * V / AREA + 2.0 * AREA
    if p[WALL] > 0.0:
        return p[WALL] * surface * (p[TA] - T)
    if p[HEAT_FACTOR] <= 0.0:
        return 0.0
    # Sutherland's conductivity over viscosity to the power 0.8, as a straight line in temperature.
    Re = P / (R_AIR * T) * BORE * (piston_speed + filling) / VISCOSITY
    inside = 0.09 * Re**0.8 * PRANDTL * CONDUCTIVITY * (1.0 + 0.3 * (T / 293.15 - 1.0)) / BORE + 1e-6
    return p[HEAT_FACTOR] * (p[TA] - T) * surface / (OUTSIDE + 1.0 / inside)


@njit(cache=True)
def plenums(p: np.ndarray, y: np.ndarray, line: float, is_open: bool, entered: float, left: float, dt: float) -> None:
    """Pressures ahead of the ports and behind them after a step.

    Without a throttle they are the line's and the ambient's, less and plus the article's fixed losses. With one, a
    small volume between throttle and ports smooths the flow of single cylinders.

    `entered`, `left`: mass flows through the ports in this step [kg/s].
    """
    back = p[PA] + p[DROP_OUT]
    feed = line - p[DROP_IN] if is_open else back
    if p[LOSS_IN] > 0.0 or p[AREA_IN] > 0.0:
        ahead = feed + p[DROP_IN]
        y[PLENUM_IN] = settled(
            y[PLENUM_IN], feed, -entered, p[LOSS_IN], p[AREA_IN], p[FORM_IN], ahead, p[TIN], DENSITY_IN, dt
        )
    else:
        y[PLENUM_IN] = feed
    if p[LOSS_OUT] > 0.0 or p[AREA_OUT] > 0.0:
        y[PLENUM_OUT] = settled(
            y[PLENUM_OUT], back, left, p[LOSS_OUT], p[AREA_OUT], p[FORM_OUT], p[PA], p[TA], DENSITY_OUT, dt
        )
    else:
        y[PLENUM_OUT] = back


# Numba takes arrays one by one: `second_rig`.
@njit(cache=True)
def settled(
    P: float,
    far: float,
    source: float,
    loss: float,
    area: float,
    form: float,
    counted: float,
    T: float,
    reference: float,
    dt: float,
) -> float:
    """Pressure of a small volume behind a throttle after a step, backward Euler.

    `P`: before the step [Pa].
    `far`: on the other side of the throttle [Pa].
    `source`: mass flow into the volume from the ports [kg/s].
    `counted`: pressure at which the volume flow is counted [Pa].
    `reference`: density at which ``loss`` is given [kg/m3].
    """
    stiff = R_AIR * T / PLENUM_M3
    free = P + dt * stiff * source
    gap = free - far
    if gap == 0.0:
        return far
    density = counted / (R_AIR * T)
    if form == LAMINAR:
        return far + gap / (1.0 + dt * stiff * density / loss)
    if form == ORIFICE:
        one = nozzle(area, max(free, far), max(min(free, far), 1e3), T)
    else:
        one = math.sqrt(density * reference / loss)  # loss rho/reference Q2 = gap, with Q = flow/rho
    return far + math.copysign(relaxed(abs(gap), dt * stiff * one), gap)
