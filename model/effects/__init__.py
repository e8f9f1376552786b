"""Physics that the article leaves out, a file an effect. `library` finds them; `effect` says what one is."""

from model.effects.effect import Effect, EffectParameter, State
from model.effects.library import effects

__all__ = ["Effect", "EffectParameter", "State", "effects"]
