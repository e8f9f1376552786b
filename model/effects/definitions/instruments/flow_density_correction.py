"""A rotameter whose scale was made for another gas density than the line's."""

from __future__ import annotations

import numpy as np

from model.effects.effect import Effect, EffectParameter, State, Values

SCALE_PRESSURE_PA, SCALE_TEMPERATURE_K = 101_325.0, 293.15


def reads(p: Values, true: np.ndarray, state: State) -> np.ndarray:
    """The float balances drag, so the scale reads the flow times the root of the density ratio [m3/s].

    `p`: ``share``: 1 when the scale was made for 1 atm and 20 degC.
    `true`, shape (n,): flow at the line's state [m3/s].
    """
    ratio = state.pressure / SCALE_PRESSURE_PA * SCALE_TEMPERATURE_K / state.temperature
    return true * (1.0 + p["share"] * (np.sqrt(ratio) - 1.0))


EFFECT = Effect(
    id="flow_density_correction",
    acts_in="sensor",
    title="rotameter scale made for another gas density",
    sentence="The rotameter's scale was made for 1 atm and is read at the line's pressure ({share} of the correction).",
    source="variable-area meter, flow as the root of the inverse density: VDI/VDE 3513, sheet 1",
    signature="sweep: flow too high, more so with pressure; speed untouched; transients: nothing, they read no flow",
    parameters=(
        EffectParameter("share", "-", 0.5, 1.5, 0.2, text="share of the density correction left out", expected=1.0),
    ),
    reads={"flow": reads},
)
