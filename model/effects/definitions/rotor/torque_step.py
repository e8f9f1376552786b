"""A torque from one moment on: a seal that slips, a bearing that seizes, a brake that is put on."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """The same at every speed, once the moment is past [N m]."""
    return p["torque_nm"] * (state.time > p["moment_s"])


EFFECT = Effect(
    id="torque_step",
    acts_in="torque",
    title="a torque from one moment on",
    sentence="The motor needs {torque_nm} more than the model from {moment_s} on: something changed on the way.",
    source="Coulomb's law, from a moment on; it stands for what no entry of the list is",
    signature="sweep: all levels after a moment are off, those before it are not; coast-down: as with dry friction",
    parameters=(
        EffectParameter("torque_nm", "N m", -1.0, 1.0, 0.15, text="torque"),
        EffectParameter("moment_s", "s", 1.0, 1e6, 600.0, True, text="moment on the recording's clock"),
    ),
    torque=torque,
    listed=False,
)
