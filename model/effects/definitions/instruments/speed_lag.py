"""A tachometer that averages: it follows the speed with a time constant."""

from __future__ import annotations

from model.effects.effect import Effect, EffectParameter, Values


def time_constant(p: Values) -> float:
    """First-order lag [s]."""
    return p["time_s"]


EFFECT = Effect(
    id="speed_lag",
    acts_in="sensor",
    title="tachometer that averages",
    sentence="The tachometer follows the speed with a time constant of {time_s}.",
    source="first-order instrument: Doebelin, Measurement Systems, chapter 3",
    signature="sweep: nothing; transients: late, and rounded at their start",
    parameters=(EffectParameter("time_s", "s", 0.0, 1.0, 0.03, text="time constant"),),
    lag=time_constant,
    transient_only=True,
    hidden=True,  # by the moments at which a run begins and a line is vented; below a sample's duration it does nothing
)
