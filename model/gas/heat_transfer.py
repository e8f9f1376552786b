"""Heat between the gas in a cylinder and the ambient: Eq. 18-20 and Table 2 of the article (section 2.2).

`phase`: COMPRESSION, DISCHARGE, EXPANSION or SUCTION.
`P`, `T`, `V`: gas pressure [Pa], temperature [K], volume [m3].
`D`: cylinder diameter [m].
`A_c`: contact area [m2], the same inside and outside.
`mdot`: mass flow through the open port [kg/s], of either sign; 0 when closed.
`rho`, `mu`: gas density [kg/m3] and dynamic viscosity [Pa s].
`V_p`: piston speed, the instantaneous \\|dL4/dt\\| [m/s].
`U_g`: gas velocity of Eq. 20 [m/s].
`Re`, `Pr`: Reynolds and Prandtl number [-].
`T_a`, `T_g`: temperature of the ambient and of the gas [K].
`H_a`, `H_g`: heat transfer coefficients outside and inside [W/(m2 K)].
`d_c`, `k_c`: wall thickness [m] and conductivity [W/(m K)].
`per_area`: True: the wall's resistance is dc/(kc Ac) (erratum 2); False: dc/kc as printed.
"""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit
from model import layout as at

COMPRESSION = 0
DISCHARGE = 1
EXPANSION = 2
SUCTION = 3


@njit(error_model="numpy", cache=True)
def contact_area(V: float, D: float, A_p: float) -> float:
    """Area Ac through which the gas trades heat [m2]: the bore's wet wall and both ends."""
    return math.pi * D * V / A_p + 2.0 * A_p


@njit(error_model="numpy", cache=True)
def gas_velocity(mdot: float, rho: float, A_c: float) -> float:
    """Effective gas velocity Ug [m/s], Eq. 20."""
    return abs(mdot) / (rho * A_c)


@njit(error_model="numpy", cache=True)
def reynolds(phase: int, rho: float, D: float, mu: float, V_p: float, U_g: float) -> float:
    """Reynolds number of a phase [-], Table 2 in its dimensionally consistent form (erratum 3)."""
    if V_p <= 0.0:
        return 0.0
    u = V_p
    if phase == DISCHARGE and U_g > 0.0:
        u += V_p * math.exp(0.2 * math.log(U_g / V_p))  # Vp^0.8 Ug^0.2; a power costs twice a logarithm
    elif phase == SUCTION and U_g > 0.0:
        u += V_p * math.exp(1.4 * math.log(U_g / V_p))  # Vp^-0.4 Ug^1.4
    return rho * D * u / mu


@njit(error_model="numpy", cache=True)
def nusselt(phase: int, Re: float, Pr: float) -> float:
    """Nusselt number a Re^b Pr^c [-], Eq. 19 with the constants of Table 2."""
    a = 0.12 if phase == EXPANSION else 0.08
    b = 0.9 if phase == SUCTION else 0.8
    return a * math.exp(b * math.log(Re) + 0.6 * math.log(Pr)) if Re > 0.0 else 0.0


@njit(error_model="numpy", cache=True)
def heat_rate(
    T_a: float, T_g: float, A_c: float, H_a: float, H_g: float, d_c: float, k_c: float, per_area: bool
) -> float:
    """Heat flow into the gas [W], Eq. 18."""
    if H_a <= 0.0 or H_g <= 0.0:
        return 0.0
    wall = d_c / (k_c * A_c) if per_area else d_c / k_c
    return (T_a - T_g) / (1.0 / (A_c * H_a) + wall + 1.0 / (A_c * H_g))


@njit(error_model="numpy", cache=True)
def quartic(coefficients: np.ndarray, first: int, T: float) -> float:
    """A quartic in temperature, lowest order first, from five entries of an array.

    `coefficients`, shape (>= first + 5,): where the five coefficients stand.
    `first`: index of the lowest.
    """
    value = coefficients[first + 4]
    for i in range(3, -1, -1):
        value = value * T + coefficients[first + i]
    return value


# Numba takes arrays one by one: `model.solvers`.
@njit(error_model="numpy", cache=True)
def cylinder_heat(
    phase: int,
    P: float,
    T: float,
    V: float,
    V_p: float,
    mdot: float,
    parameters: np.ndarray,
    A_p: float,
    gas: np.ndarray,
    per_area: bool,
) -> float:
    """Heat flow into the gas of one cylinder [W]: Eq. 18-20 and Table 2 together."""
    D = parameters[at.DP]
    A_c = contact_area(V, D, A_p)
    mu = quartic(gas, at.GAS_MU, T)
    k = quartic(gas, at.GAS_K, T)
    rho = P / (gas[at.GAS_R] * T)
    Re = reynolds(phase, rho, D, mu, V_p, gas_velocity(mdot, rho, A_c))
    H_g = nusselt(phase, Re, mu * gas[at.GAS_CP] / k) * k / D
    return heat_rate(
        parameters[at.T_A], T, A_c, parameters[at.H_A], H_g, parameters[at.D_C], parameters[at.K_C], per_area
    )
