"""Single readings that nothing explains; the likelihood's mixture finds them, there is no law."""

from __future__ import annotations

from model.effects.effect import Effect, EffectParameter

EFFECT = Effect(
    id="bad_reading",
    acts_in="sensor",
    title="single readings that nothing explains",
    sentence="{readings} stand out from everything else: misread or mistyped.",
    source="mixture of good and bad readings: Hogg, Bovy, Lang (2010), arXiv:1008.4686",
    signature="sweep: single rows far off, their neighbours not; transients: single samples, never named",
    parameters=(EffectParameter("readings", "-", 0.0, 100.0, 1.0, text="number of bad readings"),),
)
