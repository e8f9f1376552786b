"""Dry friction: a torque that does not depend on speed."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """The same at every speed [N m]."""
    return np.full_like(state.omega, p["torque_nm"])


EFFECT = Effect(
    id="coulomb_friction",
    acts_in="torque",
    title="dry friction",
    sentence="The motor needs {torque_nm} more than the model at every speed: dry friction.",
    source="Coulomb's law; Armstrong-Helouvry, Dupont, Canudas de Wit (1994), Automatica 30, 1083",
    signature="sweep: the same speed lost at every pressure; coast-down: it ends early, and straight instead of bent",
    parameters=(EffectParameter("torque_nm", "N m", 0.0, 1.0, 0.15, text="dry friction torque"),),
    torque=torque,
    hidden=True,  # by several times the roller friction with less of f_overall and of inertia
)
