"""Section 2.2 of the article: the gas in one cylinder. Ports and phases, Eq. 12-17, filling and blow-down.

The gas is ideal with the R and cp of its operating point (docs/air.md gives the error); u = cv T and h = cp T, counted
from 0 K. With P V = m R T, Eq. 12 and its rearrangements 13-15 become one rate for each kind of phase:

- closed (Eq. 17): ``dP/dt = ((gamma - 1) Q - gamma P dV/dt) / V``, the mass constant;
- discharge at constant pressure: ``m cp dT/dt = Q``;
- suction at constant pressure (Eq. 16): ``mdot_in = (cp/R P dV/dt - Q) / (cp T_in)``.
"""

from __future__ import annotations

import functools

import numpy as np

from configs.compiled import njit
from model import layout as at
from model.gas import air, transport
from model.gas.heat_transfer import COMPRESSION, DISCHARGE, EXPANSION, SUCTION

CLOSED = -1  # no port is open
OUTLET = 0
INLET = 1

# Dry air with constant cp, as the reference figures take it: gamma 1.4, quartics fitted to Sutherland's formulas.
DRY_R = 287.055
DRY_CP = 3.5 * DRY_R
_T_FIT = np.linspace(200.0, 440.0, 97)
DRY_MU = np.polynomial.Polynomial.fit(_T_FIT, transport.sutherland_viscosity(_T_FIT), 4).convert().coef
DRY_K = np.polynomial.Polynomial.fit(_T_FIT, transport.sutherland_conductivity(_T_FIT), 4).convert().coef


@njit(error_model="numpy", cache=True)
def port_at(psi: float, lap: float, lobe: float) -> int:
    """Which port a cylinder sees at an angle: OUTLET, INLET or CLOSED.

    `psi`: cylinder angle within a lobe [rad].
    `lap`: closed angle on each side of both dead centres [rad].
    `lobe`: angle of a lobe [rad].
    """
    half = 0.5 * lobe
    if lap <= psi < half - lap:
        return OUTLET
    if half + lap <= psi < lobe - lap:
        return INLET
    return CLOSED


@njit(error_model="numpy", cache=True)
def phase_of(port: int, dV: float) -> int:
    """Row of Table 2: by the open port, or by the sign of the volume's change when closed.

    `port`: OUTLET, INLET or CLOSED.
    `dV`: change of volume, any scale [-].
    """
    if port == OUTLET:
        return DISCHARGE
    if port == INLET:
        return SUCTION
    return COMPRESSION if dV < 0.0 else EXPANSION


@njit(error_model="numpy", cache=True)
def closed_rate(P: float, V: float, dVdt: float, Q: float, gamma: float) -> float:
    """Rate of pressure with both ports shut [Pa/s], Eq. 17.

    `P`, `V`: pressure [Pa] and volume [m3].
    `dVdt`: rate of volume [m3/s].
    `Q`: heat into the gas [W].
    `gamma`: ratio of specific heats [-].
    """
    return ((gamma - 1.0) * Q - gamma * P * dVdt) / V


@njit(error_model="numpy", cache=True)
def open_flow(P: float, T: float, dVdt: float, Q: float, T_port: float, gas: np.ndarray) -> float:
    """Mass flow into a cylinder whose open port holds its pressure [kg/s], Eq. 15 and 16 with dP/dt = 0.

    `P`, `T`: pressure [Pa] and gas temperature [K].
    `dVdt`: rate of volume [m3/s].
    `Q`: heat into the gas [W].
    `T_port`: temperature of the gas that enters through this port [K]; what leaves has the cylinder's own.
    """
    inward = P * dVdt / gas[at.GAS_R] - Q / gas[at.GAS_CP]
    return inward / T_port if inward > 0.0 else inward / T


@njit(error_model="numpy", cache=True)
def open_port(P: float, T: float, V: float, P_p: float, T_p: float, gas: np.ndarray) -> tuple[float, float]:
    """The gas takes the pressure of a port at once: temperature after, and mass that entered.

    Filling (P < P_p) mixes adiabatically; blow-down (P > P_p) leaves the remaining gas isentropic.

    `P`, `T`, `V`: pressure [Pa], temperature [K] and volume [m3] before.
    `P_p`, `T_p`: pressure [Pa] and temperature [K] behind the port.
    Returns `T`: temperature after [K]; `dm`: mass that entered through the port [kg]; negative when it left.
    """
    R = gas[at.GAS_R]
    gamma = gas[at.GAS_CP] / (gas[at.GAS_CP] - R)
    m = P * V / (R * T)
    if P_p > P:
        dm = (P_p - P) * V / (gamma * R * T_p)
        return P_p * V / (R * (m + dm)), dm
    T_after = T * (P_p / P) ** ((gamma - 1.0) / gamma)
    return T_after, P_p * V / (R * T_after) - m


def gas_state(parameters: np.ndarray, P_in: float, readings: np.ndarray) -> np.ndarray:
    """The gas constants of an operating point.

    The water content is that of the ambient air, less what condenses at the line's pressure. cp is that of
    the ideal gas at the inlet temperature (docs/air.md: nearer the real gas's expansion than its real cp would be);
    viscosity and conductivity are taken at the mean of line and ambient pressure and keep their temperature.

    Returns an array, shape (12,): R [J/(kg K)], cp [J/(kg K)] and the quartics of mu [Pa s] and k [W/(m K)], as
    `model.layout` orders them. Raises ValueError when the state is outside the range of the air properties.
    """
    if readings[at.CONSTANT_AIR] > 0.0:
        return np.concatenate([[DRY_R, DRY_CP], DRY_MU, DRY_K])
    asked = (float(parameters[i]) for i in (at.P_A, at.T_A, at.T_IN, at.HUMIDITY))
    return _moist_gas(float(P_in), *asked).copy()


@functools.lru_cache(maxsize=256)  # a search asks for the same line and weather again and again
def _moist_gas(P_in: float, P_a: float, T_a: float, T: float, humidity: float) -> np.ndarray:
    P = 0.5 * (P_in + P_a)
    x_w = air.water_fraction(T_a, P_a, humidity)
    if air.saturation_vapour_pressure(T) < max(P_in, P_a) * x_w:  # the line is too dense to hold it all as vapour
        x_w = min(x_w, air.water_fraction(T, max(P_in, P_a), 1.0))
    mu, k = air.transport_polynomials(P, x_w)
    return np.concatenate([[air.gas_constant(x_w), air.ideal_heat_capacity(T, x_w)], mu, k])
