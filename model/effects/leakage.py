"""Air that enters and does no work on the pistons: past the control ring, from inlet to exhaust."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def leak(p: Values, state: State) -> np.ndarray:
    """Laminar flow of a gas through a narrow gap [kg/s].

    Parameters
    ----------
    p : mapping of str to float
        ``conductance_kg_s_pa2``.
    state : State
        Operating state.
    """
    return p["conductance_kg_s_pa2"] * (state.pressure**2 - state.ambient**2)


EFFECT = Effect(
    id="leakage",
    acts_in="gas path",
    title="air that does no work",
    sentence="Air enters that does no work on the pistons, {conductance_kg_s_pa2} times (P2 - Pa2): a leak.",
    source="isothermal laminar flow in a narrow gap: proportional to the difference of the squared pressures",
    signature="sweep: flow too high even at the lowest speeds, speed untouched",
    parameters=(
        EffectParameter("conductance_kg_s_pa2", "kg/(s Pa2)", 0.0, 3e-13, 2e-14, text="conductance of the gap"),
    ),
    leak=leak,
)
