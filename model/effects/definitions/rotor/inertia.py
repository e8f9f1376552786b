"""Another inertia than configured."""

from __future__ import annotations

from model.effects.effect import Effect, EffectParameter, Values


def factor(p: Values) -> float:
    """Factor on J [-]."""
    return 1.0 + p["share"]


EFFECT = Effect(
    id="inertia",
    acts_in="rig",
    title="another inertia than configured",
    sentence="The rotor's inertia is {share} larger than configured (negative: smaller).",
    source="article, Eq. 25",
    signature="sweep: nothing but the ripple near stall; transients: stretched in time as a whole",
    parameters=(EffectParameter("share", "-", -0.8, 3.0, 0.3, text="inertia over the configured one, less 1"),),
    factors={"J": factor},
    nuisance="inertia",
    transient_only=True,
)
