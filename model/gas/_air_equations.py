"""The equations of moist air: compiled, scalar, SI, and without a range check. `model.gas.air` is the door to them.

Virial equation of state to the third coefficient in the pressure form; water and dry air mixed by composition.
Nothing here is a power: products, exp and sqrt only.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from configs.compiled import njit
from configs.units import BAR
from model.gas import air_coefficients as fitted

Array = NDArray[np.float64]

R_GAS = 8.314462618  # J/(mol K), CODATA 2018
M_AIR = 0.02896546  # kg/mol, dry air with 400 ppm CO2, Picard et al. 2008
M_WATER = 0.01801528  # kg/mol, same
T_TRIPLE = 273.16  # K
T_REFERENCE = 300.0  # K, of the polynomials in s = T_REFERENCE/T - 1


@njit(cache=True)
def horner(c: Array, s: float) -> float:
    """Value of a polynomial of any degree."""
    value = 0.0
    for i in range(c.size - 1, -1, -1):
        value = value * s + c[i]
    return value


@njit(cache=True)
def horner_2(c: Array, s: float) -> tuple[float, float, float]:
    """Value, first and second derivative of a polynomial."""
    value, first, half_second = 0.0, 0.0, 0.0
    for i in range(c.size - 1, -1, -1):
        half_second = half_second * s + first
        first = first * s + value
        value = value * s + c[i]
    return value, first, 2.0 * half_second


@njit(cache=True)
def horner_rows(c: Array, s: float, p: float, q: float) -> float:
    """Three rows of polynomials in s, weighted 1, p and q."""
    return horner(c[0], s) + p * horner(c[1], s) + q * horner(c[2], s)


@njit(cache=True)
def molar_mass(x_w: float) -> float:
    """Molar mass of the mixture, kg/mol."""
    return M_AIR + x_w * (M_WATER - M_AIR)


@njit(cache=True)
def gas_constant(x_w: float) -> float:
    """Specific gas constant, J/(kg K)."""
    return R_GAS / molar_mass(x_w)


@njit(cache=True)
def saturation_pressure(T: float) -> float:
    """Saturation vapour pressure, Pa, over ice below the triple point."""
    s = T_REFERENCE / T - 1.0
    if T < T_TRIPLE:
        return math.exp(horner(fitted.LOG_P_ICE, s))
    return math.exp(horner(fitted.LOG_P_WATER, s))


@njit(cache=True)
def enhancement_factor(T: float, P: float) -> float:
    """Saturated water in air over saturated water alone; 1 where the water boils."""
    p_sv = saturation_pressure(T)
    if p_sv >= P:
        return 1.0
    slope = horner_rows(fitted.ENHANCEMENT, T_REFERENCE / T - 1.0, p_sv / P, P / BAR)
    return 1.0 + slope * (P - p_sv) / BAR


@njit(cache=True)
def water_fraction(T: float, P: float, humidity: float) -> float:
    """Mole fraction of water at a relative humidity."""
    return humidity * enhancement_factor(T, P) * saturation_pressure(T) / P


@njit(cache=True)
def volume_terms(T: float, x_w: float) -> tuple[float, float, float, float, float, float]:
    """B and X of v = R T/P + B + X P, X = (C - B^2)/(R T), each with its first and second derivative by T, molar."""
    s = T_REFERENCE / T - 1.0
    a, w = 1.0 - x_w, x_w
    aa, aa1, aa2 = horner_2(fitted.B_AA, s)
    aw, aw1, aw2 = horner_2(fitted.B_AW, s)
    ww, ww1, ww2 = horner_2(fitted.B_WW, s)
    B = a * a * aa + 2.0 * a * w * aw + w * w * ww
    B1 = a * a * aa1 + 2.0 * a * w * aw1 + w * w * ww1
    B2 = a * a * aa2 + 2.0 * a * w * aw2 + w * w * ww2
    aaa, aaa1, aaa2 = horner_2(fitted.C_AAA, s)
    aaw, aaw1, aaw2 = horner_2(fitted.C_AAW, s)
    aww, aww1, aww2 = horner_2(fitted.C_AWW, s)
    www, www1, www2 = horner_2(fitted.C_WWW, s)
    C = a * a * (a * aaa + 3.0 * w * aaw) + w * w * (3.0 * a * aww + w * www)
    C1 = a * a * (a * aaa1 + 3.0 * w * aaw1) + w * w * (3.0 * a * aww1 + w * www1)
    C2 = a * a * (a * aaa2 + 3.0 * w * aaw2) + w * w * (3.0 * a * aww2 + w * www2)
    G, G1, G2 = C - B * B, C1 - 2.0 * B * B1, C2 - 2.0 * (B1 * B1 + B * B2)
    RT0, u = R_GAS * T_REFERENCE, 1.0 + s
    X, X1, X2 = G * u / RT0, (G1 * u + G) / RT0, (G2 * u + 2.0 * G1) / RT0
    s1 = -u / T  # ds/dT, and d2s/dT2 = -2 s1/T
    return B, B1 * s1, s1 * (B2 * s1 - 2.0 * B1 / T), X, X1 * s1, s1 * (X2 * s1 - 2.0 * X1 / T)


@njit(cache=True)
def compressibility(T: float, P: float, x_w: float) -> float:
    """Z = P v/(R T)."""
    B, _, _, X, _, _ = volume_terms(T, x_w)
    return 1.0 + P * (B + X * P) / (R_GAS * T)


@njit(cache=True)
def density(T: float, P: float, x_w: float) -> float:
    """Density, kg/m3."""
    return P / (compressibility(T, P, x_w) * gas_constant(x_w) * T)


@njit(cache=True)
def ideal_heat_capacity(T: float, x_w: float) -> float:
    """cp at zero pressure, J/(kg K)."""
    s = T_REFERENCE / T - 1.0
    molar = (1.0 - x_w) * horner(fitted.CP0_AIR, s) + x_w * horner(fitted.CP0_WATER, s)
    return molar / molar_mass(x_w)


@njit(cache=True)
def heat_capacity(T: float, P: float, x_w: float) -> float:
    """cp, J/(kg K): cp0 - T times the integral of d2v/dT2 over P."""
    _, _, B_TT, _, _, X_TT = volume_terms(T, x_w)
    return ideal_heat_capacity(T, x_w) - T * P * (B_TT + 0.5 * X_TT * P) / molar_mass(x_w)


@njit(cache=True)
def heat_capacity_ratio(T: float, P: float, x_w: float) -> float:
    """cp/cv, with cp - cv = -T (dv/dT)^2/(dv/dP)."""
    _, B_T, _, X, X_T, _ = volume_terms(T, x_w)
    v_T = R_GAS / P + B_T + X_T * P
    v_P = X - R_GAS * T / (P * P)
    cp = heat_capacity(T, P, x_w)
    return cp / (cp + T * v_T * v_T / (v_P * molar_mass(x_w)))


@njit(cache=True)
def wilke_factors(mu_a: float, mu_w: float) -> tuple[float, float]:
    """Phi_aw and Phi_wa of Wilke 1950."""
    m = M_AIR / M_WATER
    root = math.sqrt(mu_a / mu_w) / math.sqrt(math.sqrt(m))
    phi_aw = (1.0 + root) * (1.0 + root) / math.sqrt(8.0 * (1.0 + m))
    return phi_aw, phi_aw * (mu_w / mu_a) * m


@njit(cache=True)
def transport(T: float, P: float, x_w: float) -> tuple[float, float]:
    """Viscosity and conductivity; dry air at T and P, water as dilute vapour at T."""
    s, p = T_REFERENCE / T - 1.0, P / BAR
    mu_a, mu_w = horner_rows(fitted.MU_AIR, s, p, p * p), horner(fitted.MU_WATER, s)
    k_a, k_w = horner_rows(fitted.K_AIR, s, p, p * p), horner(fitted.K_WATER, s)
    phi_aw, phi_wa = wilke_factors(mu_a, mu_w)
    share_a = (1.0 - x_w) / (1.0 - x_w + x_w * phi_aw)
    share_w = x_w / (x_w + (1.0 - x_w) * phi_wa)
    return share_a * mu_a + share_w * mu_w, share_a * k_a + share_w * k_w


@njit(cache=True)
def viscosity(T: float, P: float, x_w: float) -> float:
    """Viscosity, Pa s."""
    return transport(T, P, x_w)[0]


@njit(cache=True)
def conductivity(T: float, P: float, x_w: float) -> float:
    """Conductivity, W/(m K)."""
    return transport(T, P, x_w)[1]


@njit(cache=True)
def cipm2007_density(T: float, P: float, humidity: float) -> float:
    """Density, kg/m3: Picard et al. 2008, Eq. 1 with appendix A.1; its own gas constant, saturation, f and Z."""
    t = T - 273.15
    p_sv = math.exp(T * (1.2378847e-5 * T - 1.9121316e-2) + 33.93711047 - 6.3431645e3 / T)
    f = 1.00062 + 3.14e-8 * P + 5.6e-7 * t * t
    x = humidity * f * p_sv / P
    first = (
        1.58123e-6 + t * (-2.9331e-8 + 1.1043e-10 * t) + x * (5.707e-6 - 2.051e-8 * t + x * (1.9898e-4 - 2.376e-6 * t))
    )
    second = 1.83e-11 - 0.765e-8 * x * x
    Z = 1.0 - P / T * (first - P / T * second)
    return P * M_AIR / (Z * 8.314472 * T) * (1.0 - x * (1.0 - M_WATER / M_AIR))
