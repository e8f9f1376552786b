"""The operating state that the effects' laws see on another rig, and how large their parameters may be there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from model.effects import laws
from model.effects.effect import EffectParameter, State

AIR_R = 287.05  # J/(kg K)
AMBIENT_PA, ROOM_K = 101_325.0, 293.15


@dataclass(frozen=True)
class Sizes:
    """What is ordinary on a rig: the scales of the effects' parameters follow.

    `torque`: [N m], or [N] of a slide.
    `speed`: [rad/s], or [m/s] of a slide.
    `flow`: [m3/s].
    `pressure`: above the ambient [Pa].
    """

    torque: float
    speed: float
    flow: float = 1e-3
    pressure: float = 1e5


MOTOR = Sizes(torque=1.0, speed=40.0)  # what the effects' own figures are meant for
# How a parameter of each unit goes with torque, speed, flow and pressure; all others are no sizes.
POWERS = {
    "N m": (1, 0, 0, 0),
    "rad/s": (0, 1, 0, 0),
    "N m s2": (1, -2, 0, 0),
    "Pa": (0, 0, 0, 1),
    "m3/s": (0, 0, 1, 0),
    "Pa s2/m6": (0, 0, -2, 1),
    "kg/(s Pa2)": (0, 0, 1, -1),
}


def scaled(parameter: EffectParameter, sizes: Sizes) -> EffectParameter:
    """A parameter with bounds and scale that suit a rig.

    `parameter`: as the effect has it, for the article's motor.
    `sizes`: of the rig.
    """
    ratio = (
        sizes.torque / MOTOR.torque,
        sizes.speed / MOTOR.speed,
        sizes.flow / MOTOR.flow,
        sizes.pressure / MOTOR.pressure,
    )
    factor = 1.0
    for base, power in zip(ratio, POWERS.get(parameter.unit, (0, 0, 0, 0)), strict=True):
        factor *= base**power
    return replace(parameter, low=parameter.low * factor, high=parameter.high * factor, scale=parameter.scale * factor)


def state_of(
    speed: np.ndarray,
    friction: float,
    time: ArrayLike = 0.0,
    angle: ArrayLike = np.nan,
    pressure: ArrayLike = AMBIENT_PA,
    ambient: float = AMBIENT_PA,
    temperature: ArrayLike = ROOM_K,
    load: ArrayLike = 0.0,
) -> State:
    """An operating state; what does not vary may be one number.

    `speed`, shape (n,): [rad/s].
    `time`: on the recording's clock [s].
    `angle`: shaft angle [rad].
    `pressure`: line pressure [Pa].
    `temperature`: of the gas [K].
    `load`: what friction may grow with [N m].
    """

    def spread(value: ArrayLike) -> np.ndarray:
        return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), speed.shape))

    return State(
        omega=speed,
        angle=spread(angle),
        mass_flow=spread(0.0),
        pressure=spread(pressure),
        temperature=spread(temperature),
        ambient=spread(ambient),
        gas_constant=spread(AIR_R),
        friction=spread(friction),
        load=spread(load),
        time=spread(time),
    )


def inertia_factor(chosen: laws.Chosen) -> float:
    """What a set of effects multiplies the inertia by [-]."""
    factor = 1.0
    for effect, values in laws.members(chosen):
        if "J" in effect.factors:
            factor *= effect.factors["J"](values)
    return factor
