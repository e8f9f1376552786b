"""A tachometer with missed or double pulses, or another number of teeth than configured."""

from __future__ import annotations

from model.effects.definitions.instruments import scaled
from model.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id="speed_scale",
    acts_in="sensor",
    title="missed or double pulses of the tachometer",
    sentence="The tachometer reads {scale} of the speed too high (negative: low): missed or double pulses.",
    source="counted pulses over pulses a turn: a wrong number of marks, pulses missed or counted twice",
    signature="sweep: speed wrong in proportion while the flow stays; transients: the same factor throughout",
    parameters=(EffectParameter("scale", "-", -0.6, 1.2, 0.05, text="reading over true speed, less 1"),),
    reads={"speed": scaled},
    nuisance="speed_scale",
)
