"""Physics that the article leaves out.

definitions                  a file an effect; `library` finds them, `effect` says what one is
laws                         sets of effects: their torques, losses, leaks and readings
steady, transient, averaged, uneven, neighbourhood   the solvers that take them up

`chosen`: a set of effects: effect id to the values of its parameters.
`state`: the operating state, arrays of shape (n,).
`parameters`, shape (n, 27): base parameters of each row [SI].
`pressures`, shape (n,): true line pressures [Pa].
`gas`, shape (n, 12): gas of each row, of `model.solvers.steady.gas_table`.
`time`, shape (n,): of each row on the recording's clock [s].
`clock`: time of the recording's clock at time 0 of the run [s].
`those`: effects of a set, each with its values: `laws.members`.
"""

from model.effects.effect import Effect, EffectParameter, State
from model.effects.library import effects

__all__ = ["Effect", "EffectParameter", "State", "effects"]
