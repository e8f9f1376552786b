"""A pressure gauge that reads high or low by a constant."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def reads(p: Values, true: np.ndarray, state: State) -> np.ndarray:
    """The true pressure and the offset [Pa]."""
    return true + p["offset_pa"]


EFFECT = Effect(
    id="pressure_gauge_offset",
    acts_in="sensor",
    title="gauge reads high or low by a constant",
    sentence="The pressure gauge reads {offset_pa} high (negative: low).",
    source="zero error of a gauge: JCGM 200:2012 (VIM), 4.28; EN 837-1",
    signature="sweep: speed and flow shifted as by another pressure, at all levels alike; coast-down: only its start",
    parameters=(EffectParameter("offset_pa", "Pa", -2e4, 2e4, 4e3, text="reading less true pressure"),),
    reads={"pressure": reads},
    nuisance="pressure_offset",
)
