"""What several recordings of one motor share of an effect.

An effect is there in all of them with the same sizes, unless it was asked to be each recording's own: then each has
sizes of its own, and all of them are one effect. Where a change between two days is looked for, every effect is there
both ways, shared and changed, and each parameter of the motor may have changed too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from calibration.systems.radial_piston.batch.effects import EffectsError, refuse_effects
from calibration.systems.radial_piston.comparison import OF_THE_MOTOR
from calibration.unknowns.effects import changed, is_change, unchanged
from calibration.unknowns.priors import full_name
from model.effects import Effect, EffectParameter, effects

# What is ordinary for a parameter of the motor that changes at all: a fifth. The prior has long tails
# (`calibration.likelihood.tails`), so that a change of a factor of two is nothing unheard of.
CHANGE = EffectParameter("share", "-", -0.8, 3.0, 0.2, text="change, as a share of its value before")


@dataclass(frozen=True)
class Sharing:
    """How effects are shared.

    `own`: ids of the effects whose sizes are each recording's own.
    `changes`: whether what changed from the first recording to the last is looked for.
    """

    own: frozenset[str] = frozenset()
    changes: bool = False

    def effect(self, name: str, recordings: Sequence[str]) -> Effect:
        """An effect as the recordings have it, by its id."""
        effect = shared(name)
        if not self.is_own(name):
            return effect
        parameters = tuple(
            replace(one, name=full_name(one.name, mine)) for mine in recordings for one in effect.parameters
        )
        return replace(effect, id=name, parameters=parameters)

    def whose(self, name: str, recordings: Sequence[str]) -> Sequence[str]:
        """The recordings that have the sizes of an effect for themselves; an empty name where all share them."""
        return recordings if self.is_own(name) else [""]

    def is_own(self, name: str) -> bool:
        """Whether each recording has the sizes of an effect for itself."""
        return name in self.own or (is_change(name) and name not in OF_THE_MOTOR_CHANGED)


def shared(name: str) -> Effect:
    """An effect with the sizes that all recordings share, or a change of the motor, by its id."""
    of = unchanged(name)
    if name in OF_THE_MOTOR_CHANGED:
        # Refitted in any case: how far f_overall may have moved is asked for whatever moved.
        return Effect(name, "rig", of.replace("_", " "), "", "", "", (CHANGE,), hidden=True)
    return effects()[of]


def own_of_each(names: Sequence[str], recordings: int, held: Sequence[str] | None = None) -> Sharing:
    """Effects whose sizes are to be each recording's own.

    `recordings`: how many there are [-].
    `held`: the effects that the model holds, where they are given.
    Raises EffectsError for an id that there is not (one that is close is named), or that the model does not hold; for a
    single recording.
    """
    refuse_effects(names, effects())
    if names and recordings < 2:
        raise EffectsError(f"{names[0]} cannot be of each recording: there is one only; name two or more")
    for name in names:
        if held is not None and name not in held:
            raise EffectsError(f"{name} cannot be of each recording: the model does not hold it; add it to the effects")
    return Sharing(frozenset(names))


OF_THE_MOTOR_CHANGED = tuple(changed(name) for name in OF_THE_MOTOR)
SHARED = Sharing()
