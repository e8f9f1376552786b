"""What a set of effects does to the parameters of a row, given the operating state: the one place where laws meet.

A torque is taken as its tangent in speed and in roller load: a constant torque, a share of f_overall and a share of the
roller factor, so that the compiled solvers see nothing new. Losses of pressure add to the article's own fixed ones.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from configs.compiled import njit
from model import layout as at
from model.effects.effect import Effect, State, Values, unknown_state
from model.effects.library import effects

Chosen = Mapping[str, Values]  # effect id to the values of its parameters
Members = list[tuple[Effect, Values]]
SPEED_STEP = 1e-4  # relative step of the speed for a torque's slope
LEAST_STEP = 1e-6  # rad/s
LOAD_STEP = 1.0  # N m
SLOWEST = 1e-3  # rad/s; below it the rotor may be at rest
MAY_STOP = 5.0  # rad/s; below it the rotor may come to rest before the next sample
MOST_LOST = 0.9  # share of the line's pressure that a loss ahead of the cylinders may take
ROUNDING = 1e-9  # share of a torque that is no torque: a law in proportion to speed leaves as much at none
GAUGE_PASSES = 4  # to undo the effects on a gauge's reading; each is a few per cent of it
LEAST_FRICTION = 0.2  # share of f_overall that a steady pass leaves; a torque falling faster is stepped, not followed


def switched_on(chosen: Chosen) -> dict[str, Values]:
    """A set without the effects whose amplitudes are all 0: they do nothing, and cost nothing."""
    return {
        effect.id: values
        for effect, values in members(chosen)
        if any(np.any(values[parameter.name] != 0.0) for parameter in effect.parameters if not parameter.shape)
    }


def rows_of(chosen: Chosen, which: np.ndarray) -> dict[str, Values]:
    """A set for some rows: of values that differ from row to row, theirs.

    `chosen`: the set; a value is a number, or an array with one a row.
    `which`, shape (k,) of int: indices of the rows.
    """
    return {
        name: {key: np.asarray(value)[which] if np.ndim(value) else value for key, value in values.items()}
        for name, values in chosen.items()
    }


def members(chosen: Chosen) -> Members:
    """The effects of a set with their values, in alphabetical order whatever the set's: composing has one result.

    Raises KeyError when no effect has that id.
    """
    return [(effects()[name], chosen[name]) for name in sorted(chosen)]


def with_factors(parameters: np.ndarray, chosen: Chosen) -> np.ndarray:
    """Parameters with the factors of a set on them.

    `parameters`, shape (..., 27): parameter sets [SI].
    Returns a copy where there is a factor; the same array where there is none. A factor on J is one on the rotor's.
    """
    for effect, values in members(chosen):
        for name, factor in effect.factors.items():
            parameters, place = parameters.copy(), getattr(at, name)
            fixed = parameters[..., at.J_ADDED] if place == at.J else 0.0
            parameters[..., place] = (parameters[..., place] - fixed) * factor(values) + fixed
    return parameters


def torque(chosen: Chosen, state: State) -> np.ndarray:
    """Sum of the torques that oppose the motion as it turns [N m].

    `state`: operating state; where the motor turns back, the laws see the size of its speed.
    """
    return sum_of_torques(members(chosen), state.changed(omega=np.abs(state.omega)), state.omega < 0.0)


def sum_of_torques(those: Members, state: State, back: np.ndarray) -> np.ndarray:
    """Sum of the torques that oppose the motion [N m].

    `state`: operating state, speeds not negative.
    `back`, shape (n,) of bool: where the motor turns back: a torque that is fixed to the shaft's angle then helps where
        it hindered.
    """
    total = np.zeros_like(state.omega)
    for effect, values in those:
        if effect.torque is not None:
            found = effect.torque(values, state)
            total += np.where(back, -found, found) if effect.periodic else found
    return total


def leak(chosen: Chosen, state: State) -> np.ndarray:
    """Sum of the flows that do no work [kg/s]."""
    total = np.zeros_like(state.mass_flow)
    for effect, values in members(chosen):
        if effect.leak is not None:
            total += effect.leak(values, state)
    return total


@njit(cache=True)
def tangent(here: float, faster: float, loaded: float, speed: float, load: float) -> tuple[float, float, float]:
    """A torque as a share of f_overall, a constant, and a share of the roller factor.

    `here`, `faster`, `loaded`: torque at the state, at a speed of `step_of` more, and at a load of LOAD_STEP more [N
        m].
    `speed`: size of the speed [rad/s].
    `load`: roller torque per unit of f_r [N m].
    Returns `slope`: share of f_overall [N m s]; `constant`: opposing torque [N m]; `roller`: share of the roller factor
    [-].
    """
    roller = (loaded - here) / LOAD_STEP
    rest = here - roller * load
    slope = (faster - here) / step_of(speed)
    constant = rest - slope * speed
    # A constant that drives would start a rotor that comes to rest meanwhile.
    if constant < -ROUNDING * abs(rest) and speed < MAY_STOP:
        if rest >= 0.0 and speed > SLOWEST:
            slope, constant = rest / speed, 0.0
        elif speed > SLOWEST:  # it does drive
            slope, constant = 0.0, rest
        else:
            slope, constant = max(slope, 0.0), max(rest, 0.0)
    return slope, constant, roller


@njit(cache=True)
def step_of(speed: float) -> float:
    """Step of the speed over which a torque's slope is taken [rad/s].

    `speed`: size of the speed [rad/s].
    """
    return SPEED_STEP * speed + LEAST_STEP


@njit(cache=True)
def _add_torques(rows: np.ndarray, torques: np.ndarray, speed: np.ndarray, load: np.ndarray, least: float) -> None:
    """Add tangents to the rows; a negative share of f_overall leaves ``least`` of it."""
    for i in range(speed.size):
        slope, constant, roller = tangent(torques[0, i], torques[1, i], torques[2, i], speed[i], load[i])
        lowest = (least - 1.0) * rows[i, at.F_OVERALL]
        if slope < lowest:
            constant += (slope - lowest) * speed[i]
            slope = lowest
        rows[i, at.F_OVERALL] += slope
        rows[i, at.EXTRA_TORQUE] += constant
        rows[i, at.F_R] += roller


def row_parameters(parameters: np.ndarray, chosen: Chosen, state: State, least_friction: float = -np.inf) -> np.ndarray:
    """Parameters of each row with the set's torques and pressure losses in them, at the state as it stands.

    `parameters`, shape (n, 27): with the factors on them [SI].
    `least_friction`: share of f_overall that is left where a torque falls with speed [-]; unbounded when left out.
    Returns an array, shape (n, 27): a copy.
    """
    changed = parameters.copy()
    those = members(chosen)
    if any(effect.torque is not None for effect, _ in those):
        speed, back = np.abs(state.omega), state.omega < 0.0
        here = state.changed(omega=speed)
        torques = np.array(
            [
                sum_of_torques(those, here, back),
                sum_of_torques(those, state.changed(omega=speed + step_of(speed)), back),
                sum_of_torques(those, here.changed(load=state.load + LOAD_STEP), back),
            ]
        )
        _add_torques(changed, torques, speed, state.load, least_friction)
    add_losses(changed, those, state)
    return changed


def add_losses(rows: np.ndarray, those: Members, state: State) -> None:
    """Add the losses of pressure to the rows' own; some pressure is always left ahead of the cylinders.

    `rows`, shape (n, 27): parameters [SI], changed.
    """
    for effect, values in those:
        if effect.inlet_drop is not None:
            rows[:, at.DP_IN] += effect.inlet_drop(values, state)
        if effect.outlet_rise is not None:
            rows[:, at.DP_OUT] += effect.outlet_rise(values, state)
    rows[:, at.DP_IN] = np.minimum(rows[:, at.DP_IN], MOST_LOST * state.pressure)


def readings_of(chosen: Chosen, channel: str, true: np.ndarray, state: State) -> np.ndarray:
    """What an instrument reads of a true value, by the set.

    `channel`: ``pressure`` [Pa], ``flow`` [m3/s] or ``speed`` [rad/s].
    `true`, shape (n,): true value [SI].
    """
    for effect, values in members(chosen):
        if channel in effect.reads:
            true = effect.reads[channel](values, true, state)
    return true


def behind_the_gauge(chosen: Chosen, shown: np.ndarray) -> np.ndarray:
    """The pressure at which a gauge shows this, the effects on its reading undone [Pa].

    `shown`, shape (n,): reading [Pa].
    """
    true = shown
    if any("pressure" in effect.reads for effect, _ in members(chosen)):
        nothing = unknown_state(shown)
        for _ in range(GAUGE_PASSES):
            true = true + shown - readings_of(chosen, "pressure", true, nothing)
    return true
