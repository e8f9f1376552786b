"""A flow meter that reads high or low in proportion."""

from __future__ import annotations

from model.effects.definitions.instruments import scaled
from model.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id="flow_scale",
    acts_in="sensor",
    title="flow meter reads high or low in proportion",
    sentence="The flow meter reads {scale} of the flow too high (negative: low).",
    source="span error of a variable-area meter: the share of the reading in VDI/VDE 3513, sheet 2",
    signature="sweep: flow wrong in proportion, speed untouched; transients: nothing, they read no flow",
    parameters=(EffectParameter("scale", "-", -0.5, 0.5, 0.12, text="reading over true flow, less 1"),),
    reads={"flow": scaled},
    nuisance="flow_scale",
)
