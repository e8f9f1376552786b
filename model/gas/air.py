"""Moist air: density, heat capacity, viscosity and conductivity by temperature, pressure and water content.

Wide range (230-400 K, 0.5-8 bar): a virial equation of state with its heat capacities, and transport properties mixed
by Wilke's rule, on coefficients generated from CoolProp. CIPM-2007 stands beside it as the metrologists' density in its
own range. docs/air.md gives sources and errors.

The functions here take floats or arrays that broadcast, return the same, and raise ValueError for what lies outside
`RANGES`. A kernel calls only `polynomial` on the coefficients of `transport_polynomials`, or the Sutherland laws: all
compiled.

`T`: temperature [K], 230-400.
`P`: absolute pressure [Pa], 0.5e5-8e5.
`x_w`: mole fraction of water [mol/mol], 0-0.35.
`humidity`: relative humidity [fraction of saturation], 0-1; over ice below 273.16 K.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from model.gas import _air_equations as equations
from model.gas.transport import Array

RANGES: dict[str, tuple[float, float, str]] = {
    "T": (230.0, 400.0, "K"),
    "P": (0.5e5, 8e5, "Pa"),
    "x_w": (0.0, 0.35, "mol/mol"),
    "humidity": (0.0, 1.0, "of saturation"),
}
CIPM2007_RANGES = RANGES | {"T": (288.15, 300.15, "K"), "P": (0.6e5, 1.1e5, "Pa")}
TRANSPORT_RANGE = (180.0, 400.0)  # K, of the quartics: blow-down from 3 bar reaches 214 K, from 5.5 bar 180 K
_NODES = np.polynomial.chebyshev.chebpts1(12) * 110.0 + 290.0  # K
_QUARTIC_OF_NODES = np.stack(  # (5, 12): least-squares quartic in T from the values at the nodes
    [np.polynomial.Polynomial.fit(_NODES, unit, 4, domain=list(TRANSPORT_RANGE)).convert().coef for unit in np.eye(12)],
    axis=1,
)


def _within(name: str, values: ArrayLike, ranges: dict[str, tuple[float, float, str]]) -> Array:
    """The values as an array, or ValueError naming the first that is outside the range (or not a number)."""
    low, high, unit = ranges[name]
    array = np.asarray(values, dtype=float)
    outside = ~((array >= low) & (array <= high))
    if outside.any():
        raise ValueError(f"air: {name} = {array[outside].flat[0]:g} {unit} is outside {low:g} to {high:g} {unit}")
    return array


def _evaluate(
    equation: Callable[..., float], ranges: dict[str, tuple[float, float, str]] = RANGES, **quantities: ArrayLike
) -> Any:
    """A compiled equation over arrays that broadcast, each checked; a float where all are floats."""
    checked = [_within(name, values, ranges) for name, values in quantities.items()]
    return np.vectorize(equation, otypes=[float])(*checked)[()]


def saturation_vapour_pressure(T: ArrayLike) -> Any:
    """Pressure of saturated water vapour without air [Pa], over ice below 273.16 K.

    Fitted to IAPWS-IF97 and, for ice, IAPWS R14-08, both through CoolProp.
    """
    return _evaluate(equations.saturation_pressure, T=T)


def enhancement_factor(T: ArrayLike, P: ArrayLike) -> Any:
    """Factor by which air raises the pressure of saturated water vapour [-]; 1 where the water boils.

    Fitted to ASHRAE RP-1485 (Herrmann et al. 2009).
    """
    return _evaluate(equations.enhancement_factor, T=T, P=P)


def water_fraction(T: ArrayLike, P: ArrayLike, humidity: ArrayLike) -> Any:
    """Mole fraction of water at a relative humidity [mol/mol], x_w = humidity f p_sv/P.

    Picard et al. 2008, appendix A.1, with this module's f and p_sv. Raises ValueError also where the result exceeds
    0.35: mostly steam, not moist air.
    """
    return _within("x_w", _evaluate(equations.water_fraction, T=T, P=P, humidity=humidity), RANGES)[()]


def molar_mass(x_w: ArrayLike) -> Any:
    """Molar mass of moist air [kg/mol], dry air counted with 400 ppm of CO2: masses of Picard et al. 2008."""
    return _evaluate(equations.molar_mass, x_w=x_w)


def gas_constant(x_w: ArrayLike) -> Any:
    """Specific gas constant of moist air [J/(kg K)], 287.05 for dry air: that of CODATA 2018 over `molar_mass`."""
    return _evaluate(equations.gas_constant, x_w=x_w)


def compressibility(T: ArrayLike, P: ArrayLike, x_w: ArrayLike) -> Any:
    """Compressibility factor Z = P v/(R T) [-].

    Virial equation to the third coefficient; mixed coefficients as in ASHRAE RP-1485 (Herrmann et al. 2009).
    """
    return _evaluate(equations.compressibility, T=T, P=P, x_w=x_w)


def density(T: ArrayLike, P: ArrayLike, x_w: ArrayLike) -> Any:
    """Density of moist air over the whole range [kg/m3].

    Dry air: Lemmon et al. 2000. With water: as `compressibility`.
    """
    return _evaluate(equations.density, T=T, P=P, x_w=x_w)


def density_cipm2007(T: ArrayLike, P: ArrayLike, humidity: ArrayLike) -> Any:
    """Density by CIPM-2007 [kg/m3], in the range that formula is stated for: 288.15-300.15 K, 0.6e5-1.1e5 Pa.

    Picard et al. 2008, Metrologia 45, 149, Eq. 1 with appendix A.1, 400 ppm of CO2; relative standard uncertainty of
    the formula 2.2e-5.
    """
    return _evaluate(equations.cipm2007_density, CIPM2007_RANGES, T=T, P=P, humidity=humidity)


def heat_capacity(T: ArrayLike, P: ArrayLike, x_w: ArrayLike) -> Any:
    """Isobaric heat capacity cp of the real gas [J/(kg K)].

    Ideal part by composition (Lemmon et al. 2000, IAPWS-95); pressure part from the same virial equation.
    """
    return _evaluate(equations.heat_capacity, T=T, P=P, x_w=x_w)


def ideal_heat_capacity(T: ArrayLike, x_w: ArrayLike) -> Any:
    """Isobaric heat capacity cp0 of the ideal gas [J/(kg K)]: cp at zero pressure.

    By composition from Lemmon et al. 2000 and IAPWS-95. With `gas_constant` this is a consistent ideal gas.
    """
    return _evaluate(equations.ideal_heat_capacity, T=T, x_w=x_w)


def heat_capacity_ratio(T: ArrayLike, P: ArrayLike, x_w: ArrayLike) -> Any:
    """Ratio gamma = cp/cv of the real gas [-], from the virial equation.

    An ideal-gas kernel needs cp/(cp - R) instead, or its energy does not balance.
    """
    return _evaluate(equations.heat_capacity_ratio, T=T, P=P, x_w=x_w)


def viscosity(T: ArrayLike, P: ArrayLike, x_w: ArrayLike) -> Any:
    """Dynamic viscosity [Pa s].

    Dry air at T and P (Lemmon and Jacobsen 2004), dilute vapour at T (IAPWS 2008), mixed by the rule of Wilke 1950.
    """
    return _evaluate(equations.viscosity, T=T, P=P, x_w=x_w)


def conductivity(T: ArrayLike, P: ArrayLike, x_w: ArrayLike) -> Any:
    """Thermal conductivity [W/(m K)].

    Dry air at T and P (Lemmon and Jacobsen 2004), dilute vapour at T (IAPWS 2011), mixed by Wassiljewa with the factors
    of Wilke (Mason and Saxena 1958).
    """
    return _evaluate(equations.conductivity, T=T, P=P, x_w=x_w)


def transport_polynomials(P: float, x_w: float) -> tuple[Array, Array]:
    """Quartics in temperature for viscosity and conductivity at one pressure and water content.

    Least squares on twelve Chebyshev points of 180-400 K: wider than the other ranges, for expansion inside the motor.
    Returns `mu`, shape (5,): coefficients of the viscosity [Pa s] in T [K], lowest order first, for `polynomial`; `k`,
    shape (5,): coefficients of the conductivity [W/(m K)].
    """
    _within("P", P, RANGES)
    _within("x_w", x_w, RANGES)
    values = np.array([equations.transport(T, float(P), float(x_w)) for T in _NODES])
    mu, k = _QUARTIC_OF_NODES @ values[:, 0], _QUARTIC_OF_NODES @ values[:, 1]
    return mu, k
