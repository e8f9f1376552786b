"""Extra friction near standstill, which falls with speed as a lubricating film builds up."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values


def torque(p: Values, state: State) -> np.ndarray:
    """Falls as a Gaussian with speed [N m]."""
    return p["torque_nm"] * np.exp(-((state.omega / p["speed_rad_s"]) ** 2))


EFFECT = Effect(
    id="stribeck_friction",
    acts_in="torque",
    title="friction near standstill",
    sentence="Near standstill the motor needs {torque_nm} more than the model, falling over {speed_rad_s}: Stribeck "
    "friction.",
    source="Stribeck (1902); the Gaussian form of Armstrong-Helouvry, Dupont, Canudas de Wit (1994), "
    "Automatica 30, 1083",
    signature="sweep: speed lost at the lowest levels only; coast-down: a sudden end",
    parameters=(
        EffectParameter("torque_nm", "N m", 0.0, 1.0, 0.15, text="extra torque at standstill"),
        EffectParameter("speed_rad_s", "rad/s", 1.0, 40.0, 8.0, True, text="speed over which it falls"),
    ),
    torque=torque,
)
