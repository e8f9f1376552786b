"""Air that enters and does no work on the pistons: past the control ring, from inlet to exhaust."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values

LAMINAR, ORIFICE = 1.0, 0.4


def leak(p: Values, state: State) -> np.ndarray:
    """Flow of a gas through a gap or a hole [kg/s].

    In a narrow gap it is laminar and goes with the difference of the squared pressures; through a labyrinth with its
    root (Stodola's ellipse); through a hole with its power 0.4, Saint-Venant and Wantzel's nozzle to 2 % between
    1.3 and 3 times the ambient pressure: the volume at the line's pressure then hardly changes.

    `p`: ``conductance_kg_s_pa2``, that of the flow at a line of twice the ambient pressure, and ``exponent``; laminar
        where there is none.
    """
    over = np.maximum(state.pressure**2 - state.ambient**2, 0.0)
    reference = 3.0 * state.ambient**2  # the same at twice the ambient pressure
    conductance, exponent = p["conductance_kg_s_pa2"], p.get("exponent", LAMINAR)
    powered = reference * (over / reference) ** exponent
    return conductance * np.where(np.equal(exponent, LAMINAR), over, powered)


EFFECT = Effect(
    id="leakage",
    acts_in="gas path",
    title="air that does no work",
    sentence="Air enters that does no work on the pistons: a leak of {conductance_kg_s_pa2} times (P2 - Pa2) at twice "
    "the ambient pressure, and elsewhere as (P2 - Pa2) to the power {exponent} (1: a narrow gap, 0.4: a hole).",
    source="isothermal laminar flow in a narrow gap: proportional to the difference of the squared pressures; a hole: "
    "Saint-Venant and Wantzel (1839), as a power of it",
    signature="sweep: flow too high even at the lowest speeds, speed untouched; rotor held: flow; transients: nothing",
    parameters=(
        EffectParameter(
            "conductance_kg_s_pa2", "kg/(s Pa2)", 0.0, 3e-13, 2e-14, text="conductance, the line at twice the ambient"
        ),
        EffectParameter("exponent", "-", ORIFICE, LAMINAR, 0.63, True, text="exponent (1 a narrow gap, 0.4 a hole)"),
    ),
    leak=leak,
)
