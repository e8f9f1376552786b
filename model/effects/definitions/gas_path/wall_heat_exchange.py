"""Gas trading more heat with the cylinder wall than Eq. 18 says."""

from __future__ import annotations

from model.effects.effect import Effect, EffectParameter, Values


def heat_factor(p: Values) -> float:
    """Factor on the heat of Eq. 18 [-]."""
    return 1.0 + p["extra_share"]


EFFECT = Effect(
    id="wall_heat_exchange",
    acts_in="gas path",
    title="gas trading heat with the wall",
    sentence="The gas trades {extra_share} more heat with the cylinder walls than Eq. 18 gives.",
    source="article, Eq. 18 and Table 2; the factor stands for a wall that stores heat within a turn. "
    "Eq. 18 has the 10 W/(m2 K) of still air outside; inside the cylinders of small piston machines it is some "
    "100 W/(m2 K)",
    signature="sweep: more flow at low speed, where the gas has time; transients: hardly anything",
    parameters=(EffectParameter("extra_share", "-", 0.0, 30.0, 12.0, text="extra share of the heat of Eq. 18"),),
    factors={"HEAT_FACTOR": heat_factor},
    usual_sd=0.5,
    hidden=True,  # a little of it slows the motor, much of it less: what starts from none does not get there
)
