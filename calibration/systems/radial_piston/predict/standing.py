"""What the flow meter reads while the rotor stands: what leaks, and the meter's own errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from model import layout as at
from model.effects import laws
from model.effects.effect import unknown_state


def standing_flow(
    pressure: np.ndarray,
    time: np.ndarray,
    gas_constant: np.ndarray,
    parameters: np.ndarray,
    errors: tuple[float, float],
    chosen: laws.Chosen,
) -> np.ndarray:
    """The flow meter with the rotor held [m3/s], shape (n,).

    `pressure`, shape (n,): True pressure of the line [Pa]; that of the ambient where it is vented.
    `time`, shape (n,): on the recording's clock [s].
    `gas_constant`, shape (n,): of the air [J/(kg K)].
    `parameters`, shape (27,): of the motor [SI].
    `errors`: offset [m3/s] and scale [-] of the meter.
    """
    offset, scale = errors
    none, one = np.zeros_like(pressure), np.ones_like(pressure)
    state = replace(
        unknown_state(pressure),
        omega=none,
        mass_flow=none,
        pressure=pressure,
        temperature=parameters[at.T_IN] * one,
        ambient=parameters[at.P_A] * one,
        gas_constant=gas_constant,
        time=time,
    )
    leaks = laws.leak(laws.switched_on(chosen), state)
    volume = leaks * gas_constant * parameters[at.T_IN] / pressure
    shown = laws.readings_of(chosen, "flow", volume, replace(state, mass_flow=leaks))
    found: np.ndarray = shown * (1.0 + scale) + offset
    return found
