"""Steady states of a batch of parameter sets, each with effects of its own sizes.

What an effect does to the motor's parameters is often the same whatever speed comes out: a dry friction, a share of
the roller factor. Then the article's own solver takes all points in one call. What differs from row to row, as
friction that warms up does, is solved row by row. An effect that depends on the speed or flow that it changes is
solved in passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from model import layout as at
from model.effects import effects, laws
from model.effects import steady as effect_steady
from model.effects.effect import State
from model.effects.laws import Chosen
from model.motor import Motor
from model.solvers import steady

SPEEDS = (10.0, 30.0)  # rad/s, at which an effect is looked at to see whether it hangs on the speed
SAME, NOTHING = 1e-6, 1e-10  # two sets of parameters alike: relative, and in SI
SLOPE_STEP = 1e-6  # relative, of a reading's slope with its true value
LOWEST_PA, HIGHEST_PA = 2e4, 2e6

Way = Literal["at once", "row by row", "in passes"]


def way_of(names: Sequence[str], motor: Motor, time: np.ndarray) -> Way:
    """How a set of effects is solved. `time`, shape (n_rows,): of the rows on the recording's clock [s]."""
    middle = {name: {p.name: p.scale for p in effects()[name].parameters} for name in names}
    vector, P = motor.vector(), np.linspace(1.5e5, 2.5e5, time.size)
    slow, fast = (_changed(middle, vector, P, time, speed) for speed in SPEEDS)
    if not np.allclose(slow, fast, rtol=SAME, atol=NOTHING):
        return "in passes"
    return "at once" if np.allclose(slow, slow[0], rtol=SAME, atol=NOTHING) else "row by row"


def solve(
    way: Way,
    parameters: np.ndarray,
    readings: np.ndarray,
    shown: np.ndarray,
    above: np.ndarray,
    gas: np.ndarray,
    chosen: Sequence[Chosen],
    time: np.ndarray,
) -> np.ndarray:
    """Steady states as `model.solvers.steady.solve` gives them, speed and flow as the instruments take them up.

    `parameters`, shape (n_sets, 27): parameter sets [SI].
    `readings`, shape (5,): `model.motor.Readings.vector`.
    `shown`, shape (n_sets, n_rows): what the gauge shows, its own offset and scale undone [Pa].
    `above`, shape (n_sets, n_rows): what that is counted from: the ambient's pressure, or 0 [Pa].
    `gas`, shape (n_rows, 12): of `model.solvers.steady.gas_table`.
    `time`, shape (n_rows,): on the recording's clock [s].
    Returns columns as in `solvers.steady.solve`; speed, flow, their slopes and the status are with the effects. A row
    that the passes of an effect give up counts as one where the motor stands still.
    """
    P = np.array([laws.behind_the_gauge(one, row) for one, row in zip(chosen, shown, strict=True)]) + above
    P = np.clip(P, LOWEST_PA, HIGHEST_PA)
    if way == "in passes":
        return _in_passes(parameters, readings, P, gas, chosen, time)
    rows = [_changed(one, parameters[i], P[i], time) for i, one in enumerate(chosen)]
    if way == "row by row":
        every = [steady.solve_rows(row, readings, P[i], gas, slopes=True) for i, row in enumerate(rows)]
        out = np.array(every)
    else:
        out = steady.solve(np.array([row[0] for row in rows]), readings, P, gas, slopes=True)
    for i, one in enumerate(chosen):
        state = _state(parameters[i], P[i], gas, time, out[i])
        volume = gas[:, at.GAS_R] * parameters[i, at.T_IN] / P[i]
        out[i, :, steady.VOLUME_FLOW] += laws.leak(one, state) * volume
        _read(out[i], one, state)
    return out


def _in_passes(
    parameters: np.ndarray,
    readings: np.ndarray,
    P: np.ndarray,
    gas: np.ndarray,
    chosen: Sequence[Chosen],
    time: np.ndarray,
) -> np.ndarray:
    """Where an effect depends on the state that it changes: the rows of all sets in one call."""
    sets, rows = P.shape
    together: dict[str, dict[str, Any]] = {
        name: {key: np.repeat([one[name][key] for one in chosen], rows) for key in values}
        for name, values in chosen[0].items()
    }
    found = effect_steady.solve(
        np.repeat(parameters, rows, axis=0),
        readings,
        P.ravel(),
        np.tile(gas, (sets, 1)),
        together,
        np.tile(time, sets),
        slopes=True,
    )
    out = np.zeros((sets * rows, steady.N_OUT))
    out[:, steady.SPEED_OUT], out[:, steady.SPEED_SLOPE] = found.speed, found.speed_slope
    out[:, steady.VOLUME_FLOW], out[:, steady.FLOW_SLOPE] = found.flow, found.flow_slope
    out[:, steady.STATUS] = np.where(found.running, steady.RUNNING, steady.STALLED)
    _read(out, together, found.state)
    return out.reshape(sets, rows, steady.N_OUT)


def _read(out: np.ndarray, chosen: Chosen, state: State) -> None:
    """Put what the instruments take up in the place of speed and flow of one set."""
    for column, slope, channel in (
        (steady.VOLUME_FLOW, steady.FLOW_SLOPE, "flow"),
        (steady.SPEED_OUT, steady.SPEED_SLOPE, "speed"),
    ):
        if not any(channel in effects()[name].reads for name in chosen):
            continue
        true = out[:, column].copy()
        step = SLOPE_STEP * np.maximum(np.abs(true), 1e-9)
        out[:, column] = laws.readings_of(chosen, channel, true, state)
        out[:, slope] *= (laws.readings_of(chosen, channel, true + step, state) - out[:, column]) / step


def _changed(
    chosen: Chosen, parameters: np.ndarray, P: np.ndarray, time: np.ndarray, speed: float = 20.0
) -> np.ndarray:
    """Parameters of each row with the effects in them, at some speed, shape (n_rows, 27)."""
    rows = laws.with_factors(np.tile(parameters, (time.size, 1)), chosen)
    out = np.zeros((time.size, steady.N_OUT))
    out[:, steady.SPEED_OUT], out[:, steady.MASS_FLOW] = speed, 1e-4 * speed
    state = _state(rows[0], P, np.ones((time.size, at.N_GAS)), time, out, 0.1 * speed)
    return laws.row_parameters(rows, chosen, state, laws.LEAST_FRICTION)


def _state(
    parameters: np.ndarray, P: np.ndarray, gas: np.ndarray, time: np.ndarray, out: np.ndarray, load: float = np.nan
) -> State:
    same = np.ones(time.size)
    return State(
        omega=out[:, steady.SPEED_OUT],
        angle=np.nan * same,
        mass_flow=out[:, steady.MASS_FLOW],
        pressure=P,
        temperature=parameters[at.T_IN] * same,
        ambient=parameters[at.P_A] * same,
        gas_constant=gas[:, at.GAS_R],
        friction=parameters[at.F_OVERALL] * same,
        load=load * same,
        time=time,
    )
