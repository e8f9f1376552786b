"""The prior of an effect's parameters, for every use of it.

A figure that shapes a law is log-normal, a factor of 2. An amplitude is as large as is ordinary for the effect:

- sampled: half-normal above 0 where it cannot be negative, normal where it can; about the middle of its bounds where it
  can be no 0;
- searched: normal, so that a search stays a least-squares problem. What a bound at 0 cuts off, and tails longer than
  the normal law's, are weighed afterwards (`calibration.likelihood.mode.folding`, `calibration.likelihood.tails`).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence

from calibration.unknowns.priors import SHAPE_FACTOR, Unknown
from model.effects import effects
from model.effects.effect import EffectParameter

CHANGED = "_changed"  # behind the id of an effect, or of a parameter of the motor, that is another in one recording
OFF_ZERO_SDS = 5.0  # of an amplitude that cannot be 0, from one of its bounds to the other


def unchanged(name: str) -> str:
    """The effect, or the parameter of the motor, that a change is of; of what is none, itself."""
    return name.removesuffix(CHANGED)


def holds(names: Iterable[str]) -> frozenset[str]:
    """The members of a set, and what they hold: an effect that changed is that effect, and more."""
    return frozenset(one for name in names for one in (name, unchanged(name)))


def of_recording(parameter: str) -> tuple[str, str]:
    """The recording that has a parameter for itself, empty where all share it, and the parameter's own name."""
    recording, _, own = parameter.rpartition(": ")
    return recording, own


def unknown_name(effect: str, parameter: str) -> str:
    """What a parameter of an effect is called among the unknowns of a fit."""
    recording, own = of_recording(parameter)
    return f"{recording}: {effect}.{own}" if recording else f"{effect}.{own}"


def is_size(parameter: str, amplitude: EffectParameter) -> bool:
    """Whether a parameter is the size of an effect, be it of one recording."""
    return of_recording(parameter)[1] == of_recording(amplitude.name)[1]


def sampled(effect: str, parameter: EffectParameter) -> Unknown:
    """The unknown that a parameter is to a sampler, named ``effect.parameter``."""
    name, why = f"{effect}.{parameter.name}", f"effect {effect}: {parameter.text}"
    unit = "1" if parameter.unit == "-" else parameter.unit
    if parameter.shape:
        return Unknown(name, unit, "lognormal", parameter.scale, SHAPE_FACTOR, why)
    if parameter.low > 0.0:
        middle, span = 0.5 * (parameter.low + parameter.high), parameter.high - parameter.low
        return Unknown(name, unit, "normal", middle, span / OFF_ZERO_SDS, why)
    return Unknown(name, unit, "halfnormal" if parameter.low == 0.0 else "normal", 0.0, parameter.scale, why)


def searched(parameter: EffectParameter) -> Unknown:
    """The unknown that a parameter is to a search, named like it."""
    if parameter.shape:
        return Unknown(parameter.name, parameter.unit, "lognormal", parameter.scale, SHAPE_FACTOR, "effect")
    return Unknown(parameter.name, parameter.unit, "normal", parameter.expected, parameter.scale, "effect")


def all_searched(names: Sequence[str], given: Container[tuple[str, str]] = ()) -> list[tuple[str, Unknown]]:
    """Effect id and unknown of each parameter of a set, in its order."""
    return [
        (name, searched(parameter))
        for name in names
        for parameter in effects()[name].parameters
        if (name, parameter.name) not in given
    ]
