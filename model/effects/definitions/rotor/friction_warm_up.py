"""Friction that changes with running time, as bearings and lubricant warm up."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """A share of the viscous friction that dies away [N m]."""
    return p["share_cold"] * np.exp(-state.time / p["time_s"]) * state.friction * state.omega


EFFECT = Effect(
    id="friction_warm_up",
    acts_in="torque",
    title="friction that changes with running time",
    sentence="Friction at the start differs by {share_cold} of f_overall and settles over {time_s}: "
    "the motor warms up.",
    source="viscosity of a lubricant against temperature, and first-order heating of the bearings",
    signature="sweep: up and down differ, most at the start; coast-down: none within one",
    parameters=(
        EffectParameter("share_cold", "-", -0.5, 1.0, 0.15, text="share of f_overall at the start"),
        EffectParameter("time_s", "s", 30.0, 3600.0, 300.0, True, text="time constant"),
    ),
    torque=torque,
)
