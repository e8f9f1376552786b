"""A pressure gauge that reads high or low in proportion."""

from __future__ import annotations

from model.effects.definitions.instruments import scaled
from model.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id="pressure_gauge_scale",
    acts_in="sensor",
    title="gauge reads high or low in proportion",
    sentence="The pressure gauge reads {scale} of the pressure too high (negative: low).",
    source="span error of a gauge, a share of the reading: EN 837-1",
    signature="sweep: the slope of speed with pressure is wrong; spin-up: its end; coast-down: only its start",
    parameters=(EffectParameter("scale", "-", -0.15, 0.15, 0.02, text="reading over true pressure, less 1"),),
    reads={"pressure": scaled},
    nuisance="pressure_scale",
)
