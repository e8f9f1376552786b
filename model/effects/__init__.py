"""Physics that the article leaves out.

definitions                  a file an effect; `library` finds them, `effect` says what one is
laws                         sets of effects: their torques, losses, leaks and readings
steady, transient, averaged, uneven, neighbourhood   the solvers that take them up

Parameters
----------
chosen : mapping of str to mapping
    A set of effects: effect id to the values of its parameters.
state : State
    The operating state, arrays of shape (n,).
"""

from model.effects.effect import Effect, EffectParameter, State
from model.effects.library import effects

__all__ = ["Effect", "EffectParameter", "State", "effects"]
