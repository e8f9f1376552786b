"""Viscosity and conductivity by temperature, compiled: a quartic, and Sutherland's law for dry air."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from configs.compiled import njit

Array = NDArray[np.float64]


@njit(cache=True)
def polynomial(c: Array, T: Any) -> Any:
    """Quartic by Horner's rule; compiled, unchecked.

    `c`, shape (5,): coefficients, lowest order first, as of `transport_polynomials`.
    `T`: temperature [K], 180-400 for those.
    Returns c[0] + c[1] T + c[2] T^2 + c[3] T^3 + c[4] T^4 [unit of c[0]].
    """
    return c[0] + T * (c[1] + T * (c[2] + T * (c[3] + T * c[4])))


@njit(cache=True)
def sutherland_viscosity(T: Any) -> Any:
    """Viscosity of dry air by Sutherland's law [Pa s], as the reference figures have it; compiled, unchecked.

    1.716e-5 Pa s at 273.15 K, Sutherland constant 110.4 K (White, Viscous Fluid Flow, chapter 1).

    `T`: temperature [K], positive.
    """
    ratio = T / 273.15
    return 1.716e-5 * ratio * np.sqrt(ratio) * (273.15 + 110.4) / (T + 110.4)


@njit(cache=True)
def sutherland_conductivity(T: Any) -> Any:
    """Conductivity of dry air by Sutherland's law [W/(m K)], as the reference figures have it; compiled, unchecked.

    0.0241 W/(m K) at 273.15 K, Sutherland constant 194.0 K (White, Viscous Fluid Flow, chapter 1).

    `T`: temperature [K], positive.
    """
    ratio = T / 273.15
    return 0.0241 * ratio * np.sqrt(ratio) * (273.15 + 194.0) / (T + 194.0)
