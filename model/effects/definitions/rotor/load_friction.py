"""Friction that grows with the gas force beyond the configured roller factor."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """The roller friction of a larger factor [N m]."""
    return p["roller_factor"] * state.load


EFFECT = Effect(
    id="load_friction",
    acts_in="torque",
    title="friction growing with the gas force",
    sentence="Friction grows with the gas force: the roller factor is {roller_factor} larger than configured.",
    source="article, Eq. 25: the roller's friction factor times the gas force",
    signature="sweep: speed lost in proportion to gauge pressure; coast-down: nothing once the line is vented",
    parameters=(EffectParameter("roller_factor", "-", 0.0, 0.2, 0.03, text="roller factor beyond the configured one"),),
    torque=torque,
    nuisance="roller_friction",
)
