"""What a set of effects does to the parameters of a row, given the operating state: the one place where laws meet.

A torque that is a function of speed is taken as its tangent, a constant torque and a share of f_overall, so that the
compiled solvers see nothing new. Losses of pressure add to the article's own fixed ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from model import layout as at
from model.effects.effect import Effect, State, Values
from model.effects.library import effects

Chosen = Mapping[str, Values]  # effect id to the values of its parameters
SPEED_STEP = 1e-4  # relative step of the speed for a torque's slope
SLOWEST = 1e-3  # rad/s; below it a torque is a constant


def members(chosen: Chosen) -> list[tuple[Effect, Values]]:
    """The effects of a set with their values.

    Parameters
    ----------
    chosen : mapping of str to mapping
        Effect id to the values of its parameters.

    Raises
    ------
    KeyError
        When no effect has that id.
    """
    return [(effects()[name], values) for name, values in chosen.items()]


def with_factors(parameters: np.ndarray, chosen: Chosen) -> np.ndarray:
    """Parameters with the factors of a set on them.

    Parameters
    ----------
    parameters : ndarray, shape (..., 24)
        Parameter sets [SI].
    chosen : mapping
        The set.

    Returns
    -------
    ndarray
        A copy where there is a factor; the same array where there is none.
    """
    for effect, values in members(chosen):
        for name, factor in effect.factors.items():
            parameters = parameters.copy()
            parameters[..., getattr(at, name)] *= factor(values)
    return parameters


def torque(chosen: Chosen, state: State) -> np.ndarray:
    """Sum of the torques that oppose the motion [N m].

    Parameters
    ----------
    chosen : mapping
        The set.
    state : State
        Operating state.
    """
    total = np.zeros_like(state.omega)
    for effect, values in members(chosen):
        if effect.torque is not None:
            total += effect.torque(values, state)
    return total


def leak(chosen: Chosen, state: State) -> np.ndarray:
    """Sum of the flows that do no work [kg/s].

    Parameters
    ----------
    chosen : mapping
        The set.
    state : State
        Operating state.
    """
    total = np.zeros_like(state.mass_flow)
    for effect, values in members(chosen):
        if effect.leak is not None:
            total += effect.leak(values, state)
    return total


def row_parameters(parameters: np.ndarray, chosen: Chosen, state: State) -> np.ndarray:
    """Parameters of each row with the set's torques and pressure losses in them, at the state as it stands.

    Parameters
    ----------
    parameters : ndarray, shape (n, 24)
        With the factors on them [SI].
    chosen : mapping
        The set.
    state : State
        Operating state, arrays of shape (n,).

    Returns
    -------
    ndarray, shape (n, 24)
        A copy.
    """
    changed = parameters.copy()
    step = SPEED_STEP * np.abs(state.omega) + 1e-9
    here = torque(chosen, state)
    slope = (torque(chosen, replace(state, omega=state.omega + step)) - here) / step
    constant = here - slope * state.omega
    slow = np.abs(state.omega) < SLOWEST
    chord = ~slow & (constant < 0.0)  # a constant that drove would start a rotor at rest: friction does not
    slope = np.where(chord, here / np.where(slow, 1.0, state.omega), np.where(slow, 0.0, slope))
    constant = np.where(chord, 0.0, np.where(slow, np.maximum(here, 0.0), constant))
    changed[:, at.F_OVERALL] += slope
    changed[:, at.EXTRA_TORQUE] += constant
    for effect, values in members(chosen):
        if effect.inlet_drop is not None:
            changed[:, at.DP_IN] += effect.inlet_drop(values, state)
        if effect.outlet_rise is not None:
            changed[:, at.DP_OUT] += effect.outlet_rise(values, state)
    return changed


def readings_of(chosen: Chosen, channel: str, true: np.ndarray, state: State) -> np.ndarray:
    """What an instrument reads of a true value, by the set.

    Parameters
    ----------
    chosen : mapping
        The set.
    channel : str
        ``pressure`` [Pa], ``flow`` [m3/s] or ``speed`` [rad/s].
    true : ndarray, shape (n,)
        True value [SI].
    state : State
        Operating state.
    """
    for effect, values in members(chosen):
        if channel in effect.reads:
            true = effect.reads[channel](values, true, state)
    return true
