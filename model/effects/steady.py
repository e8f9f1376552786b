"""Steady operating points with effects in them: the base solver, called until state and effects agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from model import layout as at
from model.effects import laws, uneven
from model.effects.effect import State
from model.solvers import steady as base

Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]  # rows of parameters and which rows they are, to the base's out

MOST_PASSES = 60
TOLERANCE = 1e-8
CHOKED = 1e-6  # share of the free mass flow: a motor that stalls with less lost than this flow loses, stalls
TRIED_SPEEDS = 64  # where a tangent leads to a stall, for a speed at which the torques balance after all


@dataclass(frozen=True)
class Points:
    """Operating points, arrays of shape (n,).

    `speed`: mean speed [rad/s]; 0 where the motor stalls.
    `flow`: volume flow at the line's pressure and temperature, leaks included [m3/s].
    `speed_slope`, `flow_slope`: with pressure [rad/s/Pa], [m3/s/Pa]; 0 when not asked for.
    `running`, array of bool: False where the motor stalls or no state was found.
    `state`: the operating state, for what the instruments make of it.
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

    Where the passes do not agree, ``running`` is False.

    `chosen`: effect id to the values of its parameters; a value may be an array of shape (n,), one a row.
    `slopes`: derivatives with pressure too, to 1 %; an effect's share in them is left aside.
    """
    chosen = laws.switched_on(chosen)
    parameters = laws.with_factors(parameters, chosen)

    passes = hang_on_state(chosen)
    known = np.zeros((pressures.size, base.N_KNOWN))

    def solver(rows: np.ndarray, which: np.ndarray) -> np.ndarray:
        theirs = known[which] if passes else None
        found = base.solve_rows(rows, readings, pressures[which], gas[which], slopes, theirs)
        if theirs is not None:
            known[which] = theirs
        return found

    out = solver(parameters, np.arange(pressures.size))
    state = _arrived(out, parameters[:, at.F_R], chosen, given_state(parameters, pressures, gas, time))
    running = out[:, base.STATUS] == base.RUNNING
    if passes:
        free = state
        out, state, running = _passes(out, free, parameters, chosen, solver)
        lost = np.flatnonzero(~running & (free.omega > 0.0))
        if lost.size and any(effect.torque for effect, _ in laws.members(chosen)):
            theirs = laws.rows_of(chosen, lost)
            found = _balanced(_rows(free, lost), parameters[lost], theirs)
            again = _passes(out[lost], found, parameters[lost], theirs, lambda rows, which: solver(rows, lost[which]))
            won = again[2]
            out[lost[won]], running[lost[won]] = again[0][won], True
            _put(state, lost[won], _rows(again[1], won))
    speed = np.where(running, out[:, base.SPEED_OUT], 0.0)
    flow = np.where(running, out[:, base.VOLUME_FLOW], 0.0)
    share = uneven.share_of_speed(parameters, chosen, speed)
    if share is not None:
        speed, flow, running = share * speed, share * flow, running & (share > 0.0)
    flow += laws.leak(chosen, state) * gas[:, at.GAS_R] * parameters[:, at.T_IN] / pressures
    return Points(speed, flow, out[:, base.SPEED_SLOPE], out[:, base.FLOW_SLOPE], running, state)


def hang_on_state(chosen: laws.Chosen) -> bool:
    """Whether a steady solution with the set takes more than one pass."""
    return any(e.torque or e.inlet_drop or e.outlet_rise for e, _ in laws.members(chosen))


def given_state(parameters: np.ndarray, pressures: np.ndarray, gas: np.ndarray, time: np.ndarray) -> State:
    """What is known of the operating state before it is solved for: speed, angle, mass flow and load are nan.

    `parameters`, shape (n, 27): with the effects' factors on them [SI].
    """
    unknown = np.full(pressures.size, np.nan)
    return State(
        omega=unknown,
        angle=unknown.copy(),
        mass_flow=unknown,
        pressure=pressures,
        temperature=parameters[:, at.T_IN],
        ambient=parameters[:, at.P_A],
        gas_constant=gas[:, at.GAS_R],
        friction=parameters[:, at.F_OVERALL],
        load=unknown,
        time=time,
    )


def one_pass(
    parameters: np.ndarray, chosen: laws.Chosen, state: State, solver: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, State]:
    """The effects at a state, and the base solver with them. A state that this leads back to is a solution.

    `parameters`, shape (n, 27): with the effects' factors on them [SI].
    `state`: at which the laws are taken.
    `solver`: from rows of parameters to the base solver's array.
    Returns `out`, shape (n, 9): of the base solver; `state`: at which it arrives.
    """
    changed = laws.row_parameters(parameters, chosen, state, laws.LEAST_FRICTION)
    out = solver(changed)
    return out, _arrived(out, changed[:, at.F_R], chosen, state)


def _passes(
    out: np.ndarray, state: State, parameters: np.ndarray, chosen: laws.Chosen, solver: Solver
) -> tuple[np.ndarray, State, np.ndarray]:
    """Solve, take the effects at the new state, and again.

    The speed follows the tangents of the torques. The mass flow is what a loss of pressure grows with and cuts down:
    one found above what was given bounds it from below, one found below from above; a secant of two passes leads it
    within the bounds, else half the way. Rows that have settled are left alone.
    """
    out = out.copy()
    state = _rows(state, np.arange(len(out)))
    loses = any(effect.inlet_drop or effect.outlet_rise for effect, _ in laws.members(chosen))
    given = state.mass_flow.copy()
    free = np.maximum(given, 1e-12)
    low, high = np.zeros_like(given), np.full_like(given, np.inf)
    before = np.full(
        (2, given.size), np.nan
    )  # what was given in the pass before, and by how much what was found missed
    settled = np.zeros(given.size, dtype=bool)
    for _ in range(MOST_PASSES):
        i = np.flatnonzero(~settled)
        if not i.size:
            break
        now = _rows(state, i).changed(mass_flow=given[i])
        theirs = laws.rows_of(chosen, i)
        out[i], new = one_pass(parameters[i], theirs, now, lambda rows: solver(rows, i))  # noqa: B023
        stalled = out[i, base.STATUS] == base.STALLED
        miss = new.mass_flow - given[i]
        done = (out[i, base.STATUS] == base.RUNNING) & (np.abs(new.omega - now.omega) <= TOLERANCE * new.omega)
        if loses:
            done &= np.abs(miss) <= TOLERANCE * np.abs(given[i])
            done |= stalled & (given[i] <= CHOKED * free[i])
            low[i] = np.where(miss > 0.0, np.maximum(low[i], given[i]), low[i])
            high[i] = np.where(miss < 0.0, np.minimum(high[i], given[i]), high[i])
            closed = ~done & (high[i] - low[i] <= 0.1 * TOLERANCE * high[i])  # the speed has moved what they bound
            low[i], high[i] = np.where(closed, 0.5 * low[i], low[i]), np.where(closed, 2.0 * high[i], high[i])
            following = _next(given[i], miss, before[:, i], low[i], high[i], stalled)
            before[:, i] = np.where(stalled, np.nan, np.array([given[i], miss]))
            given[i] = following
        else:
            done |= stalled
            given[i] = new.mass_flow
        taken = done | ~stalled  # after a stall the next tangent is where the motor ran last
        _put(state, i[taken], _rows(new, taken))
        settled[i[done]] = True
    return out, state, settled & (out[:, base.STATUS] == base.RUNNING)


def _next(
    given: np.ndarray, miss: np.ndarray, before: np.ndarray, low: np.ndarray, high: np.ndarray, stalled: np.ndarray
) -> np.ndarray:
    """The mass flow to try next."""
    bend = miss - before[1]
    safe = np.isfinite(bend) & (np.abs(bend) > 1e-12 * np.abs(given)) & ~stalled
    led = given - miss * (given - before[0]) / np.where(safe, bend, 1.0)
    found = given + miss
    half = np.where(np.isfinite(high), 0.5 * (low + high), found)
    found = np.where((found > low) & (found < high) & ~stalled, found, half)
    return np.where(safe & (led > low) & (led < high), led, found)


def _balanced(state: State, parameters: np.ndarray, chosen: laws.Chosen) -> State:
    """The state at the highest speed at which viscous friction and the effects' torques hold the gas's as it was.

    A tangent far from the solution may lead to a stall where there is none; the gas's torque hardly depends on speed.
    """
    f = parameters[:, at.F_OVERALL]
    share = np.linspace(1.0, 1.0 / TRIED_SPEEDS, TRIED_SPEEDS)
    over = np.array(
        [(s - 1.0) * f * state.omega + laws.torque(chosen, state.changed(omega=s * state.omega)) for s in share]
    )
    crossing = (over[:-1] > 0.0) & (over[1:] <= 0.0)
    best = share[np.where(crossing.any(axis=0), np.argmax(crossing, axis=0) + 1, 0)]
    return state.changed(omega=best * state.omega, mass_flow=best * state.mass_flow)


def _rows(state: State, which: np.ndarray) -> State:
    """Some rows of a state, copied."""
    return State(*(one[which] for one in vars(state).values()))


def _put(state: State, where: np.ndarray, rows: State) -> None:
    """Put rows into a state, in place."""
    for one, theirs in zip(vars(state).values(), vars(rows).values(), strict=True):
        one[where] = theirs


def _arrived(out: np.ndarray, roller_factor: np.ndarray, chosen: laws.Chosen, state: State) -> State:
    """A state with the speed, the mass flow and the load that the base solver finds."""
    load = out[:, base.ROLLER] / np.where(roller_factor > 0.0, roller_factor, np.inf)
    state = state.changed(omega=out[:, base.SPEED_OUT], mass_flow=out[:, base.MASS_FLOW], load=load)
    if any(effect.leak for effect, _ in laws.members(chosen)):
        return state.changed(mass_flow=state.mass_flow + laws.leak(chosen, state))
    return state
