"""Steady operating points with effects in them: the base solver, called until state and effects agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from model import layout as at
from model import steady as base
from model.effects import laws
from model.effects.effect import State

MOST_PASSES = 40
TOLERANCE = 1e-8


@dataclass(frozen=True)
class Points:
    """Operating points, arrays of shape (n,).

    Attributes
    ----------
    speed : ndarray
        Mean speed [rad/s]; 0 where the motor stalls.
    flow : ndarray
        Volume flow at the line's pressure and temperature, leaks included [m3/s].
    speed_slope, flow_slope : ndarray
        With pressure [rad/s/Pa], [m3/s/Pa]; 0 when not asked for.
    running : ndarray of bool
        False where the motor stalls or no state was found.
    state : State
        The operating state, for what the instruments make of it.
    """

    speed: np.ndarray
    flow: np.ndarray
    speed_slope: np.ndarray
    flow_slope: np.ndarray
    running: np.ndarray
    state: State


def solve(
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    chosen: laws.Chosen,
    time: np.ndarray,
    slopes: bool = False,
) -> Points:
    """Operating points of rows that each have a pressure and parameters of their own.

    Parameters
    ----------
    parameters : ndarray, shape (n, 24)
        Base parameters of each row [SI].
    readings : ndarray, shape (5,)
        `model.motor.Readings.vector`.
    pressures : ndarray, shape (n,)
        True line pressures [Pa].
    gas : ndarray, shape (n, 12)
        Gas of each row, of `model.steady.gas_table`.
    chosen : mapping
        Effect id to the values of its parameters.
    time : ndarray, shape (n,)
        Of each row on the recording's clock [s].
    slopes : bool
        Derivatives with pressure too, to 1 %; an effect's share in them is left aside.

    Returns
    -------
    Points
        Where the passes do not agree, ``running`` is False.
    """
    parameters = laws.with_factors(parameters, chosen)
    out = base.solve_rows(parameters, readings, pressures, gas, slopes)
    state = _state(out, parameters, pressures, gas, chosen, time)
    active = any(effect.torque or effect.inlet_drop or effect.outlet_rise for effect, _ in laws.members(chosen))
    agreed = out[:, base.STATUS] == base.RUNNING
    if active:
        out, state, agreed = _passes(out, state, parameters, readings, pressures, gas, chosen, time, slopes)
    running = (out[:, base.STATUS] == base.RUNNING) & agreed
    volume = gas[:, at.GAS_R] * parameters[:, at.T_IN] / pressures
    flow = out[:, base.VOLUME_FLOW] + laws.leak(chosen, state) * volume
    return Points(out[:, base.SPEED_OUT], flow, out[:, base.SPEED_SLOPE], out[:, base.FLOW_SLOPE], running, state)


def _passes(
    out: np.ndarray,
    state: State,
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    chosen: laws.Chosen,
    time: np.ndarray,
    slopes: bool,
) -> tuple[np.ndarray, State, np.ndarray]:
    """Solve, take the effects at the new state, and again; a secant of the last two passes leads the mass flow."""
    given = state.mass_flow
    before: tuple[np.ndarray, np.ndarray] | None = None  # what was given, and by how much what was found differed
    settled = np.zeros(pressures.size, dtype=bool)
    for _ in range(MOST_PASSES):
        speed = state.omega
        changed = laws.row_parameters(parameters, chosen, replace(state, mass_flow=given))
        out = base.solve_rows(changed, readings, pressures, gas, slopes)
        state = _state(out, parameters, pressures, gas, chosen, time)
        miss = state.mass_flow - given
        settled = np.abs(state.omega - speed) <= TOLERANCE * np.abs(speed)
        settled &= np.abs(miss) <= TOLERANCE * np.abs(given)
        settled |= out[:, base.STATUS] == base.STALLED
        if settled.all():
            break
        given, before = _next(given, miss, before), (given, miss)
    return out, state, settled


def _next(given: np.ndarray, miss: np.ndarray, before: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
    """The mass flow to try next: by the secant of two passes where it leads somewhere, else what was found."""
    found = given + miss
    if before is None:
        return found
    given_0, miss_0 = before
    bend = miss - miss_0
    safe = np.abs(bend) > 1e-12 * np.abs(given)
    led = given - miss * (given - given_0) / np.where(safe, bend, 1.0)
    return np.where(safe & (led > 0.3 * found) & (led < 3.0 * found), led, found)


def _state(
    out: np.ndarray,
    parameters: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    chosen: laws.Chosen,
    time: np.ndarray,
) -> State:
    state = State(
        omega=out[:, base.SPEED_OUT],
        angle=np.full(pressures.size, np.nan),
        mass_flow=out[:, base.MASS_FLOW],
        pressure=pressures,
        temperature=parameters[:, at.T_IN],
        ambient=parameters[:, at.P_A],
        gas_constant=gas[:, at.GAS_R],
        friction=parameters[:, at.F_OVERALL],
        load=out[:, base.ROLLER] / np.where(parameters[:, at.F_R] > 0.0, parameters[:, at.F_R], np.inf),
        time=time,
    )
    return replace(state, mass_flow=state.mass_flow + laws.leak(chosen, state))
