"""The prior of an effect's parameters, for every use of it.

A figure that shapes a law is log-normal, a factor of 2. An amplitude, in its scale, is the hyperbolic sine of a
standard normal number, folded at 0 where it cannot be negative. A search has a normal law instead, so that it stays a
least-squares problem; the longer tails and the bounds are weighed afterwards (`calibration.likelihood.tails`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from calibration.unknowns.priors import SHAPE_FACTOR, Kind, OfEffect, Unknown
from model.effects.effect import EffectParameter

_CHANGED = "_changed"


def changed(name: str) -> str:
    """The id of an effect, or of a parameter of the motor, that is another in one recording."""
    return name + _CHANGED


def is_change(name: str) -> bool:
    """Whether an id is that of a change."""
    return name.endswith(_CHANGED)


def unchanged(name: str) -> str:
    """The effect, or the parameter of the motor, that a change is of; of what is none, itself."""
    return name.removesuffix(_CHANGED)


def holds(names: Iterable[str]) -> frozenset[str]:
    """The members of a set, and what they hold: an effect that changed is that effect, and more."""
    return frozenset(one for name in names for one in (name, unchanged(name)))


def in_a_fit(effect: str, one: Unknown) -> Unknown:
    """A searched unknown as it stands among those of a fit."""
    return replace(one, own=f"{effect}.{one.own}", of=OfEffect(effect, one.own))


def is_size(parameter: str, amplitude: EffectParameter) -> bool:
    """Whether a parameter is the size of an effect, be it of one recording."""
    return parameter.rpartition(": ")[2] == amplitude.name.rpartition(": ")[2]


def sampled(effect: str, parameter: EffectParameter) -> Unknown:
    """The unknown that a parameter is to a sampler, named ``effect.parameter``."""
    unit, why = "1" if parameter.unit == "-" else parameter.unit, f"effect {effect}: {parameter.text}"
    kind: Kind = "halfsize" if parameter.low == 0.0 else "size"
    a, b = parameter.expected, parameter.scale
    if parameter.shape:
        kind, a, b = "lognormal", parameter.scale, SHAPE_FACTOR
    return in_a_fit(effect, Unknown(parameter.name, unit, kind, a, b, why))


def searched(parameter: EffectParameter) -> Unknown:
    """The unknown that a parameter is to a search, named like it."""
    if parameter.shape:
        return Unknown(parameter.name, parameter.unit, "lognormal", parameter.scale, SHAPE_FACTOR, "effect")
    return Unknown(parameter.name, parameter.unit, "normal", parameter.expected, parameter.scale, "effect")
