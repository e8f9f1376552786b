"""Drag of the air around the rotor, growing with the square of speed."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """Quadratic drag [N m]."""
    return p["drag_nm_s2"] * state.omega**2


EFFECT = Effect(
    id="windage",
    acts_in="torque",
    title="drag growing with the square of speed",
    sentence="A drag of {drag_nm_s2} times the square of the speed is missing: windage, or another quadratic loss.",
    source="turbulent drag of a rotating body: torque proportional to density and speed squared (Schlichting)",
    signature="sweep: speed lost at the highest levels; coast-down: a steeper start",
    parameters=(EffectParameter("drag_nm_s2", "N m s2", 0.0, 2e-3, 1.5e-4, text="drag coefficient"),),
    torque=torque,
)
