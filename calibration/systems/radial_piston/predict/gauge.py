"""What the pressure gauge reads, and what the pressure is behind a reading."""

from __future__ import annotations

import numpy as np

from calibration.data.blocks import Vented
from model.effects.effect import unknown_state
from model.effects.laws import Chosen, behind_the_gauge, readings_of


def absolute(reading: np.ndarray, is_gauge: np.ndarray | bool, ambient_pa: float) -> np.ndarray:
    """Readings as absolute pressures, whatever the instrument counts from, shape (n,) [Pa]."""
    return reading + np.where(is_gauge, ambient_pa, 0.0)


def true_pressure(
    reading: np.ndarray, is_gauge: np.ndarray | bool, ambient_pa: float, errors: tuple[float, float], chosen: Chosen
) -> np.ndarray:
    """True line pressure behind a gauge's reading, its errors and the effects on it undone [Pa].

    `reading`, shape (n,): of the gauge [Pa].
    `ambient_pa`: ambient pressure [Pa].
    `errors`: offset [Pa] and scale [-].
    """
    offset, scale = errors
    true = behind_the_gauge(chosen, (reading - offset) / (1.0 + scale))
    return absolute(true, is_gauge, ambient_pa)


def vented_readings(
    vented: Vented, share: float, ambient_pa: float, errors: tuple[float, float], chosen: Chosen
) -> np.ndarray:
    """The gauge at ambient pressure [Pa]: its span may count from there, from vacuum, or from anywhere between.

    `share`: of its span error that shows at ambient pressure [-].
    `ambient_pa`: ambient pressure [Pa].
    `errors`: offset [Pa] and scale [-].
    """
    if not vented.pressure.size:
        return vented.pressure
    offset, scale = errors
    P_a = np.full(vented.pressure.size, ambient_pa)
    none, high = np.zeros_like(P_a), P_a.copy()
    at_vacuum = readings_of(chosen, "pressure", none, unknown_state(none))
    span = readings_of(chosen, "pressure", high, unknown_state(high)) - at_vacuum - P_a + scale * P_a
    found: np.ndarray = np.where(vented.is_gauge, 0.0, P_a + share * span) + at_vacuum + offset
    return found
