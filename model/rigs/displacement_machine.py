"""A machine that turns a volume each revolution: torque and flow of its steady rows.

The gas fills the volume at the pressure behind any throttling and leaves against the ambient and any rise behind it; it
does not expand inside. The torque that holds the speed is f omega + T - V (P_in - P_out) / 2 pi: negative where the
machine delivers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from model import layout as at
from model.effects import laws
from model.effects.effect import State
from model.rigs.state import state_of

HALVINGS = 50


@dataclass(frozen=True)
class Rows:
    """What a machine does at given speeds and pressures, arrays of shape (n,).

    `torque`: drive that holds the speed [N m]; negative where the machine delivers.
    `flow`: at the line's pressure and temperature, leaks included [m3/s].
    `state`: for what the instruments make of it.
    """

    torque: np.ndarray
    flow: np.ndarray
    state: State


def rows(
    displacement: float,
    friction: float,
    speed: np.ndarray,
    pressure: np.ndarray,
    temperature: np.ndarray,
    ambient: float,
    time: np.ndarray,
    chosen: laws.Chosen,
) -> Rows:
    """Torque and flow at given speeds and line pressures.

    `displacement`: volume of a revolution [m3].
    `speed`, shape (n,): [rad/s], not negative.
    `pressure`, `temperature`, shape (n,): of the line [Pa], [K].
    `time`, shape (n,): on the recording's clock [s].
    """
    chosen = laws.switched_on(chosen)
    those = [effect for effect, _ in laws.members(chosen)]
    load = displacement * np.maximum(pressure - ambient, 0.0) / (2.0 * math.pi)
    state = state_of(speed, friction, time, np.nan, pressure, ambient, temperature, load)
    leak = laws.leak(chosen, state)
    volume = displacement * speed / (2.0 * math.pi)
    specific = state.gas_constant * temperature  # of a kilogram, times its pressure [J/kg]
    full = volume * pressure / specific
    drawn = full
    if any(effect.inlet_drop for effect in those):
        low, high = np.zeros_like(full), full.copy()
        for _ in range(HALVINGS):
            drawn = 0.5 * (low + high)
            drop = losses(chosen, replace(state, mass_flow=drawn + leak))[0]
            more = volume * np.maximum(pressure - drop, 0.0) / specific > drawn
            low, high = np.where(more, drawn, low), np.where(more, high, drawn)
    state = replace(state, mass_flow=drawn + leak)
    drop, rise = losses(chosen, state)
    gas = displacement * (pressure - drop - ambient - rise) / (2.0 * math.pi)
    state = replace(state, load=np.abs(gas))
    opposing = friction * speed + laws.torque(chosen, state)
    return Rows(opposing - gas, (drawn + leak) * specific / pressure, state)


def losses(chosen: laws.Chosen, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Pressure lost ahead of the machine, and added behind it [Pa].

    `state`: operating state.
    """
    row = np.zeros((state.pressure.size, at.N_VECTOR))
    laws.add_losses(row, laws.members(chosen), state)
    return row[:, at.DP_IN], row[:, at.DP_OUT]
