"""A torque periodic in the shaft angle: imbalance on a horizontal shaft, a bent shaft, one damaged lobe."""

from __future__ import annotations

import math

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """One sine a turn; nothing where the angle is not known [N m]."""
    found = p["sine_nm"] * np.sin(state.angle) + p["cosine_nm"] * np.cos(state.angle)
    return np.where(np.isfinite(found), found, 0.0)


def turned(p: Values, turn: float) -> Values:
    """The same torque of an angle counted from ``turn`` farther back: sin(theta + turn) written out.

    `turn`: how far [rad].
    """
    sine, cosine = p["sine_nm"], p["cosine_nm"]
    return {
        "sine_nm": sine * math.cos(turn) - cosine * math.sin(turn),
        "cosine_nm": sine * math.sin(turn) + cosine * math.cos(turn),
    }


EFFECT = Effect(
    id="once_per_rev_torque",
    acts_in="torque",
    title="torque periodic in shaft angle",
    sentence="A torque of {sine_nm} and {cosine_nm} (sine, cosine) swings once a turn.",
    source="gravity on an unbalanced rotor: T = m g e sin(theta)",
    signature="sweep: a little slower at the lowest speeds; transients: the speed swings once a turn",
    parameters=(
        EffectParameter("sine_nm", "N m", -2.0, 2.0, 0.2, text="sine of the shaft angle"),
        EffectParameter("cosine_nm", "N m", -2.0, 2.0, 0.2, text="cosine of the shaft angle"),
    ),
    torque=torque,
    turned=turned,
    transient_only=True,
    periodic=True,
)
