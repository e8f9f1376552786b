"""The peer of the two solvers: the same rates, integrated by `scipy.integrate.solve_ivp` as a careful user would.

The right-hand side is the model's own compiled one. A port that opens is a jump, so the run is cut at every edge by a
terminal event on the angle and started again behind it; without that no tolerance below 1e-3 is kept.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from model import geometry
from model import layout as at
from model.gas.cylinder import CLOSED, gas_state
from model.motor import Motor
from model.solvers import crank_angle, port_edges, transient

PASSED, P0 = crank_angle.M_IN, crank_angle.P0  # the states between are left out: what has passed
LADDER = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)  # relative tolerances tried, coarse first
METHODS = ("LSODA", "RK45")
SETTLED = 1e-6  # relative change of the speed from turn to turn


@dataclass(frozen=True)
class Problem:
    """A motor at constant pressure: everything that `model.solvers.crank_angle.rates` takes but the state."""

    parameters: np.ndarray
    readings: np.ndarray
    gas: np.ndarray
    curve: np.ndarray
    edges: np.ndarray
    P_port: np.ndarray
    T_port: np.ndarray
    start: np.ndarray


@dataclass(frozen=True)
class Tuned:
    """The coarsest tolerance that keeps an error, its error [-] and the wall time of one run [s]."""

    method: str
    rtol: float
    error: float
    seconds: float
    reached: bool


def problem(motor: Motor, P_in: float) -> Problem:
    """The motor with its supply open.

    Parameters
    ----------
    motor : Motor
        The motor.
    P_in : float
        Absolute inlet pressure [Pa].
    """
    parameters, readings = motor.vector(), motor.readings.vector()
    curve = np.empty(at.N_CURVE)
    geometry.curve(parameters, curve)
    return Problem(
        parameters,
        readings,
        gas_state(parameters, P_in, readings),
        curve,
        crank_angle.edges(parameters, curve),
        np.array([parameters[at.P_A] + parameters[at.DP_OUT], P_in - parameters[at.DP_IN]]),
        np.array([parameters[at.T_A], parameters[at.T_IN]]),
        transient.rest_state(motor),
    )


@njit(cache=True)
def rate(
    y: np.ndarray,
    port: np.ndarray,
    T_port: np.ndarray,
    parameters: np.ndarray,
    curve: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
) -> np.ndarray:
    """Rate of angle, speed, pressures and temperatures, shape (2 + 2 n,) [SI per s].

    Parameters
    ----------
    y : ndarray, shape (2 + 2 n,)
        State [SI].
    port, T_port, parameters, curve, gas, readings : ndarray
        As in `model.solvers.crank_angle.rates` [SI].
    """
    state = np.zeros(y.size + P0 - PASSED)
    state[:PASSED], state[P0:] = y[:PASSED], y[PASSED:]
    found = np.empty(state.size)
    crank_angle.rates(state, found, port, 1.0, T_port, parameters, curve, gas, readings)
    return np.concatenate((found[:PASSED], found[P0:]))


def run(
    p: Problem, start_rad_s: float, t_end: float, method: str, rtol: float, until: Callable[[list[float]], bool]
) -> tuple[np.ndarray, list[float]]:
    """Integrate from angle 0 to ``t_end``, cut at every edge.

    Parameters
    ----------
    p : Problem
        The motor and its supply.
    start_rad_s, t_end : float
        Speed at the start [rad/s] and time of the end [s].
    method : str
        Of `solve_ivp`.
    rtol : float
        Relative tolerance [-]; the absolute one is as much of 1 rad, 1 rad/s, 1 bar and 100 K.
    until : callable
        Told the times of all pulses so far [s]; True ends the run.

    Returns
    -------
    y : ndarray, shape (9 + 2 n,)
        State at the end [SI].
    pulses : list of float
        Times at which the rotor has turned another pulse [s].
    """
    y = p.start.copy()
    y[crank_angle.OMEGA] = start_rad_s
    n, pulse = (y.size - P0) // 2, p.curve[at.PULSE_ANGLE]
    kept = np.r_[0:PASSED, P0 : y.size]
    scale = np.repeat([1.0, 1e5, 100.0], [PASSED, n, n])  # of the absolute tolerance
    port = np.full(n, CLOSED)
    marks = np.append(p.edges, p.edges[0] + pulse)
    block, k, t = 0, int(np.searchsorted(p.edges, 0.0, side="right")) - 1, 0.0
    if k < 0:
        block, k = -1, crank_angle.N_EDGES - 1
    pulses: list[float] = []

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        found: np.ndarray = rate(state, port, p.T_port, p.parameters, p.curve, p.gas, p.readings)
        return found

    while t < t_end:
        low, high = block * pulse + marks[k], block * pulse + marks[k + 1]
        port_edges.set_ports(y, port, 0.5 * (low + high), p.P_port, p.T_port, p.parameters[at.LAP], p.curve, p.gas)

        def at_edge(_: float, state: np.ndarray, edge: float = high) -> float:
            return float(state[0] - edge)

        at_edge.terminal = True  # type: ignore[attr-defined]
        at_edge.direction = 1.0  # type: ignore[attr-defined]
        done = solve_ivp(rates, (t, t_end), y[kept], method=method, rtol=rtol, atol=rtol * scale, events=at_edge)
        y[kept], t = done.y[:, -1], float(done.t[-1])
        if done.status != 1:
            break
        y[crank_angle.THETA] = high
        k += 1
        if k == crank_angle.N_EDGES:
            block, k = block + 1, 0
            pulses.append(t)
            if until(pulses):
                break
    return y, pulses


def spin_up(p: Problem, t_end: float, method: str, rtol: float) -> np.ndarray:
    """From rest to ``t_end``: angle and speed at the end, shape (2,) [rad, rad/s].

    Parameters
    ----------
    p : Problem
        The motor and its supply.
    t_end : float
        Time of the end [s].
    method : str
        Of `solve_ivp`.
    rtol : float
        Relative tolerance [-].
    """
    y, _ = run(p, 0.0, t_end, method, rtol, lambda pulses: False)
    return y[:2].copy()


def steady_speed(p: Problem, start_rad_s: float, method: str, rtol: float) -> float:
    """Mean speed once it repeats from turn to turn [rad/s].

    Parameters
    ----------
    p : Problem
        The motor and its supply.
    start_rad_s : float
        Speed at the start [rad/s].
    method : str
        Of `solve_ivp`.
    rtol : float
        Relative tolerance [-].
    """
    in_a_turn = int(p.parameters[at.N_PISTONS] * p.parameters[at.N_LOBES])

    def settled(pulses: list[float]) -> bool:
        if len(pulses) % in_a_turn or len(pulses) < 2 * in_a_turn:
            return False
        last, before = (pulses[i] - pulses[i - 1] for i in (-1, -1 - in_a_turn))
        return abs(last - before) <= SETTLED * last

    _, pulses = run(p, start_rad_s, 60.0, method, rtol, settled)
    return float(p.curve[at.PULSE_ANGLE]) / (pulses[-1] - pulses[-2])


def tune(solve: Callable[[str, float], object], error_of: Callable[[object], float], most: float, method: str) -> Tuned:
    """The coarsest tolerance of the ladder whose error is small enough; the finest, if none is.

    Parameters
    ----------
    solve : callable
        Given method and relative tolerance [-], returns a result.
    error_of : callable
        Relative error of a result [-].
    most : float
        Error allowed [-].
    method : str
        Of `solve_ivp`.
    """
    found = None
    for rtol in LADDER:
        begun = time.perf_counter()
        result = solve(method, rtol)
        seconds = time.perf_counter() - begun
        error = error_of(result)
        found = Tuned(method, rtol, error, seconds, error <= most)
        if found.reached:
            break
    assert found is not None
    return found
