"""A pressure loss ahead of the cylinders that grows with the flow: a long hose, a small fitting, a clogged filter."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values

REFERENCE_KG_M3 = 2.38  # air at 2 bar and 20 degC: the coefficient is the loss per flow squared there


def inlet_drop(p: Values, state: State) -> np.ndarray:
    """Turbulent loss, proportional to density and the square of the volume flow [Pa]."""
    density = state.pressure / (state.gas_constant * state.temperature)
    volume_flow = state.mass_flow / density
    return p["loss_pa_s2_m6"] * density / REFERENCE_KG_M3 * volume_flow * np.abs(volume_flow)


EFFECT = Effect(
    id="inlet_throttling",
    acts_in="gas path",
    title="pressure loss ahead of the cylinders",
    sentence="Pressure is lost ahead of the cylinders, {loss_pa_s2_m6} times the square of the flow: a "
    "throttled inlet.",
    source="loss of a fitting, dp = zeta rho/2 (Q/A)^2: Idelchik, Handbook of Hydraulic Resistance",
    signature="sweep: speed and flow bend down at the highest levels; spin-up: slower at its end",
    parameters=(
        EffectParameter("loss_pa_s2_m6", "Pa s2/m6", 0.0, 2e10, 1.5e9, text="loss coefficient in air at 2 bar"),
    ),
    inlet_drop=inlet_drop,
)
