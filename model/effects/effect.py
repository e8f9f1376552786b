"""What an effect is: physics that the article leaves out, as a law that the solvers and the sensors take up.

An effect is a module below `definitions` with an `EFFECT` in it; nothing else has to know of a new one. Its law says
what it adds where it enters: a torque, a pressure loss, a leak, a factor on a parameter of the motor, or a change of
what an instrument reads. Laws are pure functions of its parameters and of the operating state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

Where = Literal["torque", "gas path", "sensor", "rig"]
Channel = Literal["pressure", "flow", "speed"]


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect.

    `name`: with its unit: ``torque_nm``.
    `unit`: as reports print it.
    `low`, `high`: bounds of what an engineer would believe [own unit]; a fit that wants more is refused, not reported.
    `scale`: size that is ordinary for the effect [own unit]: the scale of the prior.
    `expected`: where the prior of an amplitude is centred [own unit]: 0, but where a rig either has the effect or has
        it not.
    `shape`: whether it shapes the law (a time constant, a speed) and says nothing without an amplitude. An amplitude
        has a prior of that scale with longer tails than the normal law's (`calibration.likelihood.tails`), folded at 0
        where ``low`` is 0; a shape a log-normal one of a factor of 2.
    `text`: what it is.
    """

    name: str
    unit: str
    low: float
    high: float
    scale: float
    shape: bool = False
    text: str = ""
    expected: float = 0.0


@dataclass(frozen=True)
class State:
    """The operating state that laws see, arrays of shape (n,), a row or sample each.

    `omega`: size of the speed [rad/s].
    `angle`: shaft angle [rad]; nan where it is not known.
    `mass_flow`: through the inlet [kg/s].
    `pressure`: in the line [Pa], absolute.
    `temperature`: of the gas in the line [K].
    `ambient`: ambient pressure [Pa].
    `gas_constant`: R of the gas [J/(kg K)].
    `friction`: f_overall [N m s].
    `load`: roller torque per unit of f_r [N m]: the gas force on its arm.
    `time`: on the recording's clock [s].
    """

    omega: np.ndarray
    angle: np.ndarray
    mass_flow: np.ndarray
    pressure: np.ndarray
    temperature: np.ndarray
    ambient: np.ndarray
    gas_constant: np.ndarray
    friction: np.ndarray
    load: np.ndarray
    time: np.ndarray

    def changed(self, **values: np.ndarray) -> State:
        """As `dataclasses.replace`, in a tenth of the time: a solver asks for it at every pass."""
        found = object.__new__(State)
        found.__dict__.update(self.__dict__, **values)
        return found


def unknown_state(like: np.ndarray) -> State:
    """A state of which nothing is known, for sensors whose law looks at none.

    `like`, shape (n,): for its size.
    """
    return State(*[np.full_like(like, np.nan)] * 10)


Values = Mapping[str, float]  # or arrays of the state's shape, a value a row: laws are arithmetic on either
Law = Callable[[Values, State], np.ndarray]
Reads = Callable[[Values, np.ndarray, State], np.ndarray]


@dataclass(frozen=True)
class Effect:
    """One effect.

    `id`: its stable name, that of its module.
    `acts_in`: ``torque``, ``gas path``, ``sensor`` or ``rig``.
    `title`: for people.
    `sentence`: how a finding is reported, with the parameters' names in braces.
    `source`: where the law comes from.
    `signature`: what it looks like in a sweep and in a transient.
    `parameters`: amplitude first.
    `torque`: torque that opposes the motion [N m]; laws see the size of the speed, whichever way the motor turns.
    `inlet_drop`, `outlet_rise`: pressure lost ahead of the cylinders, and added behind them [Pa].
    `leak`: flow that enters and does no work [kg/s].
    `factors`: parameter of the motor (a name of `model.layout`) to the factor on it [-].
    `reads`: ``pressure`` [Pa], ``flow`` [m3/s] or ``speed`` [rad/s]: what the instrument reads of the true value.
    `lag`: time constant of the speed channel [s].
    `nuisance`: the instrument error or parameter that every fit carries and this effect exceeds; empty where there is
        none.
    `usual_sd`: how far the article's own law may be off in this effect's way, where no parameter of the motor says so:
        a size of three of it and less is no missing effect [the amplitude's unit].
    `transient_only`: whether a steady row says nothing of it.
    `hidden`: whether a straight model about the base model does not see it: the motor's own parameters take it up
        along a curved valley, or its ordinary size does something else than a small one. It is then refitted whatever
        that model says of it.
    `listed`: whether a diagnosis may name it. One that is not stands for what nothing listed is: if it explains a
        recording, that is unresolved. A fit or a simulation can have it like any other.
    `turned`: its values for a shaft whose angle is counted from so many radians farther back, where it follows the
        angle.
    `periodic`: whether the torque is fixed to the shaft's angle: it then opposes turning forward, and helps turning
        back.
    """

    id: str
    acts_in: Where
    title: str
    sentence: str
    source: str
    signature: str
    parameters: tuple[EffectParameter, ...]
    torque: Law | None = None
    inlet_drop: Law | None = None
    outlet_rise: Law | None = None
    leak: Law | None = None
    factors: Mapping[str, Callable[[Values], float]] = field(default_factory=dict)
    reads: Mapping[str, Reads] = field(default_factory=dict)
    lag: Callable[[Values], float] | None = None
    nuisance: str = ""
    usual_sd: float | None = None
    transient_only: bool = False
    hidden: bool = False
    listed: bool = True
    turned: Callable[[Values, float], Values] | None = None
    periodic: bool = False

    @property
    def amplitude(self) -> EffectParameter:
        """The parameter that is 0 when the effect is absent."""
        return self.parameters[0]
