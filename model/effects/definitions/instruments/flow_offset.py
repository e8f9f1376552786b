"""A flow meter that reads high or low by a constant."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def reads(p: Values, true: np.ndarray, state: State) -> np.ndarray:
    """The true flow and the offset [m3/s]."""
    return true + p["offset_m3_s"]


EFFECT = Effect(
    id="flow_offset",
    acts_in="sensor",
    title="flow meter reads high or low by a constant",
    sentence="The flow meter reads {offset_m3_s} high (negative: low).",
    source="zero error of a meter: JCGM 200:2012 (VIM), 4.28",
    signature="sweep: flow shifted at all levels alike, speed untouched; transients: nothing, they read no flow",
    parameters=(EffectParameter("offset_m3_s", "m3/s", -5e-4, 5e-4, 6e-5, text="reading less true flow"),),
    reads={"flow": reads},
    nuisance="flow_offset",
)
