"""A pressure rise behind the cylinders that grows with the flow: a silencer, a long exhaust hose."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values

REFERENCE_KG_M3 = 1.2  # air at ambient: the coefficient is the rise per flow squared there


def outlet_rise(p: Values, state: State) -> np.ndarray:
    """Turbulent loss of the exhaust, at ambient density [Pa]."""
    density = state.ambient / (state.gas_constant * state.temperature)
    volume_flow = state.mass_flow / density
    return p["rise_pa_s2_m6"] * density / REFERENCE_KG_M3 * volume_flow * np.abs(volume_flow)


EFFECT = Effect(
    id="exhaust_back_pressure",
    acts_in="gas path",
    title="pressure rise behind the cylinders",
    sentence="Pressure builds up behind the cylinders, {rise_pa_s2_m6} times the square of the flow: a throttled "
    "exhaust.",
    source="loss of a silencer, dp = zeta rho/2 (Q/A)^2, at the ambient's density",
    signature="sweep: speed bends down at the highest levels, flow a little less; coast-down: nothing",
    parameters=(EffectParameter("rise_pa_s2_m6", "Pa s2/m6", 0.0, 1e10, 5e8, text="rise coefficient in ambient air"),),
    outlet_rise=outlet_rise,
)
