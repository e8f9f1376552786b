"""Runs in time by the mean torque, effects included: fast and smooth, for what a run does when something changes.

Torque and flow are tabulated over the speed for each span of the supply; the speed then follows by Runge-Kutta steps.

`parameters`, shape (27,): base parameters [SI].
`gas`, shape (12,): gas of an operating point.
`time`, shape (n,): increasing sample times [s]; the first is the start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.interpolate import PchipInterpolator

from configs.compiled import njit
from model import layout as at
from model.effects import laws, uneven
from model.effects.effect import State
from model.gas.cylinder import gas_state
from model.solvers import averaged as base
from model.solvers.recent import Recent
from model.solvers.transient import Supply

SPEEDS = 8  # at which the cycle is solved
FINE = 96  # to which its torque is interpolated, and at which the laws are taken
FLOWS = 32  # at which a loss of pressure is taken
SLOWEST = 0.02  # of the highest speed, for the slowest at which the cycle is solved
AHEAD = 1.3  # highest speed of the tables, of the one at which viscous friction alone holds the torque
LONGEST_STEP_S = 0.004
LEAST_TORQUE = 0.05  # N m; so that the tables of a line that drives nothing reach somewhere
START_MARGIN = 1.1
OF_INERTIA = [at.J, at.J_ADDED]
ASKED = (1.0, 4.0, 16.0, 64.0, 256.0)  # rad/s; speeds at which the torque is asked for that the highest one hangs on
NEWTON = 4  # steps to the flow through a loss; its law is a power of the flow

NEXT_NODE, FARTHER_NODE, MOST_NODES = 1.2, 1.35, 24  # factors from one pressure to the next at which cycles are solved

TORQUE, FLOW, SLOPE = slice(0, FINE), slice(FINE, 2 * FINE), slice(2 * FINE, 2 * FINE + 2)  # columns of `_at_nodes`
LOSS = slice(SLOPE.stop, SLOPE.stop + 2 * FLOWS)

_recent = Recent(32)
_recent_nodes = Recent(16)
_recent_cycles = Recent(16)
_recent_tops = Recent(32)


def speeds(
    parameters: np.ndarray,
    readings: np.ndarray,
    supply: Sequence[Supply] | np.ndarray,
    time: np.ndarray,
    start_rad_s: float,
    chosen: laws.Chosen,
    clock: float = 0.0,
    start_rad: float = 0.0,
) -> np.ndarray:
    """Mean speed since the sample before [rad/s], shape (n,); a tachometer's lag is not in it.

    `supply`: the line, true pressures; or as an array, shape (n, 3), of start [s], pressure [Pa], and 1 where open.
    `start_rad_s`: speed at the start [rad/s].
    `start_rad`: angle of the shaft at the start, for torques that follow it [rad].
    """
    chosen = laws.switched_on(chosen)
    if not any(effect.periodic for effect, _ in laws.members(chosen)):
        start_rad = 0.0  # nothing follows it
    line = np.array(supply, dtype=np.float64).reshape(-1, 3)
    key = (
        *(one.tobytes() for one in (parameters, readings, time, line)),
        *((name, *sorted(chosen[name].items())) for name in sorted(chosen)),
        (start_rad_s, clock, start_rad),
    )
    return _recent(key, lambda: _speeds(parameters, readings, line, time, start_rad_s, chosen, clock, start_rad))


def _speeds(
    parameters: np.ndarray,
    readings: np.ndarray,
    line: np.ndarray,
    time: np.ndarray,
    start_rad_s: float,
    chosen: laws.Chosen,
    clock: float,
    start_rad: float,
) -> np.ndarray:
    """As `speeds`; the line as rows of start [s], pressure [Pa], and 1 where it is open."""
    parameters = laws.with_factors(parameters, chosen)
    those = [(effect, values) for effect, values in laws.members(chosen) if not effect.periodic]
    around = uneven.around([(effect, values) for effect, values in laws.members(chosen) if effect.periodic])
    vented = float(parameters[at.P_A] + parameters[at.DP_OUT] + parameters[at.DP_IN])  # both ports at the same pressure
    pressures = np.where(line[:, 2] > 0.0, line[:, 1], vented)
    nodes = _nodes(pressures)
    gas = gas_state(parameters, float(nodes[-1]), readings)
    top = _top_speed(parameters, readings, gas, float(nodes[-1]), start_rad_s)
    key = (
        *(one.tobytes() for one in (_without(parameters, OF_INERTIA), readings, nodes)),
        *((effect.id, *sorted(values.items())) for effect, values in those),
        (top, clock),
    )
    table = _recent_nodes(key, lambda: _at_nodes(parameters, readings, gas, nodes, top, those, clock))
    ends = (top, _most_flow(table[:, FLOW]))
    begins = np.ascontiguousarray(line[:, 0])
    found: np.ndarray = _march(
        time, begins, pressures, nodes, table, ends, start_rad_s, parameters[at.J], start_rad, around
    )
    return found


def _at_nodes(
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    nodes: np.ndarray,
    top: float,
    those: laws.Members,
    clock: float,
) -> np.ndarray:
    """What the march looks up at each node, beside one another, shape (nodes, LOSS.stop).

    TORQUE: net torque over the speed, evenly up to `top` [N m].
    FLOW: mass flow into the cylinders over the speed [kg/s].
    SLOPE: what the torque gains per pressure in suction and in discharge [N m/Pa].
    LOSS: pressure lost ahead of the cylinders, then behind them [Pa], over the flow, evenly up to `_most_flow`.
    """
    fine = np.linspace(0.0, top, FINE)
    coarse = top * (SLOWEST + (1.0 - SLOWEST) * 0.5 * (1.0 - np.cos(np.pi * np.arange(SPEEDS) / (SPEEDS - 1))))
    slope, torque, flow, load = _cycles(parameters, readings, gas, nodes, coarse, fine)
    torque -= parameters[at.F_OVERALL] * fine + parameters[at.EXTRA_TORQUE]
    if any(effect.torque is not None for effect, _ in those):
        speeds_of_all, lines = np.tile(fine, nodes.size), np.repeat(nodes, FINE)
        state = _state(speeds_of_all, flow.ravel(), lines, load.ravel(), parameters, gas, clock)
        torque -= laws.sum_of_torques(those, state, np.zeros(torque.size, dtype=bool)).reshape(torque.shape)
    loss = _losses(those, nodes, np.linspace(0.0, _most_flow(flow), FLOWS), parameters, gas, clock)
    return np.hstack([torque, flow, slope, loss.reshape(nodes.size, -1)])


def _most_flow(flow: np.ndarray) -> float:
    """The end of the tables of what a flow loses [kg/s]; of flows that are not numbers, the least."""
    return max([1e-12, *(1.5 * one for one in flow.max(axis=1).tolist())])


def _losses(
    those: laws.Members, nodes: np.ndarray, flows: np.ndarray, parameters: np.ndarray, gas: np.ndarray, clock: float
) -> np.ndarray:
    """Pressure lost ahead of the cylinders and behind them, at each node and flow [Pa]."""
    loss = np.zeros((nodes.size, 2, FLOWS))
    if any(effect.inlet_drop or effect.outlet_rise for effect, _ in those):
        for s, P in enumerate(nodes):
            state = _state(np.zeros(FLOWS), flows, float(P), np.zeros(FLOWS), parameters, gas, clock)
            rows = np.zeros((FLOWS, at.N_VECTOR))
            laws.add_losses(rows, those, state)
            loss[s, 0], loss[s, 1] = rows[:, at.DP_IN], rows[:, at.DP_OUT]
    return loss


@njit(cache=True, nogil=True)
def _nodes(pressures: np.ndarray) -> np.ndarray:
    """Pressures at which the cycle is solved [Pa]: those of the line, or where these are many a few that hold them."""
    least, most, is_many = pressures.min(), pressures.max(), False
    for P in pressures:
        is_many |= least < P < most
    if not is_many:
        return np.array([least, most]) if least < most else np.array([least])
    nodes, count = np.empty(MOST_NODES + 1), 1
    nodes[0] = least
    while count <= MOST_NODES and nodes[count - 1] < most:
        nodes[count] = least * NEXT_NODE * FARTHER_NODE ** (count - 1)
        count += 1
    return nodes[:count]


def _cycles(
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    nodes: np.ndarray,
    coarse: np.ndarray,
    fine: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`solvers.averaged.torques` at each pressure and at speeds between those that are solved, kept.

    Slopes, then torque, flow and roller load.
    """

    def solved() -> np.ndarray:
        out, found = np.empty((nodes.size, coarse.size, base.N_OUT)), np.zeros((nodes.size, 4, fine.size))
        slopes = np.empty((nodes.size, 2))
        base.torques_of_line(parameters, readings, gas, nodes, coarse, out, slopes)
        found[:, 0, :2] = slopes
        from_rest, flow = np.append(0.0, coarse), np.zeros((nodes.size, coarse.size + 1))
        flow[:, 1:] = out[:, :, base.MASS_FLOW]
        for s in range(nodes.size):
            found[s, 2] = np.interp(fine, from_rest, flow[s])
            found[s, 3] = np.interp(fine, coarse, out[s, :, base.LOAD])
        net = out[:, :, base.NET]
        told = np.all(np.isfinite(net), axis=1)
        found[~told, 1] = np.nan
        if told.any():
            found[told, 1] = PchipInterpolator(coarse, net[told], axis=1)(np.maximum(fine, coarse[0]))
        return found

    key = _of_the_gas(parameters), *(one.tobytes() for one in (readings, gas, nodes, coarse))
    found = _recent_cycles(key, solved)
    return found[:, 0, :2], found[:, 1], found[:, 2], found[:, 3]


def _top_speed(parameters: np.ndarray, readings: np.ndarray, gas: np.ndarray, P: float, start: float) -> float:
    def at_speed(speed: float) -> np.ndarray:
        out = np.empty((1, base.N_OUT))
        base.torques(parameters, readings, gas, P, np.array([speed]), out)
        return out

    key, net = (_of_the_gas(parameters), readings.tobytes(), gas.tobytes(), P), math.nan
    for speed in ASKED:  # with much heat from the wall there is no cycle at a slow speed
        net = float(_recent_tops((*key, speed), partial(at_speed, speed))[0, base.NET])
        if math.isfinite(net):
            break
    f = max(float(parameters[at.F_OVERALL]), 1e-6)
    return max(AHEAD * max(net, LEAST_TORQUE) / f, START_MARGIN * start)


def _of_the_gas(parameters: np.ndarray) -> bytes:
    """All of a parameter set that the torque of the gas hangs on: not inertia, viscous friction nor extra torque."""
    return _without(parameters, [*OF_INERTIA, at.F_OVERALL, at.EXTRA_TORQUE]).tobytes()


def _without(parameters: np.ndarray, which: list[int]) -> np.ndarray:
    """A parameter set in which some stand at 0."""
    rest = parameters.copy()
    rest[which] = 0.0
    return rest


def _state(
    omega: np.ndarray,
    flow: np.ndarray,
    pressure: np.ndarray | float,
    load: np.ndarray,
    parameters: np.ndarray,
    gas: np.ndarray,
    clock: float,
) -> State:
    one = np.ones_like(omega)
    return State(
        omega=omega,
        angle=np.full_like(omega, np.nan),
        mass_flow=flow,
        pressure=pressure * one,
        temperature=parameters[at.T_IN] * one,
        ambient=parameters[at.P_A] * one,
        gas_constant=gas[at.GAS_R] * one,
        friction=parameters[at.F_OVERALL] * one,
        load=load,
        time=clock * one,
    )


@njit(cache=True, nogil=True)
def _at(x: float, step: float, table: np.ndarray) -> float:
    """Linear interpolation in a table that starts at 0; beyond its end the last piece goes on."""
    k = min(max(int(x / step), 0), table.size - 2)
    s = x / step - k
    return (1.0 - s) * table[k] + s * table[k + 1]


@njit(cache=True, nogil=True)
def _of_angle(angle: float, around: np.ndarray) -> float:
    """A torque that follows the shaft's angle [N m]."""
    if around.size == 1:
        return 0.0
    turn = 2.0 * np.pi
    return _at(angle % turn, turn / (around.size - 1), around)


@njit(cache=True, nogil=True)
def _passing(free: float, pressure: float, step: float, drop: np.ndarray) -> float:
    """Mean flow through a loss ahead of the cylinders that takes its share of what would flow without [kg/s]."""
    passing = free
    for _ in range(NEWTON):
        k = min(max(int(passing / step), 0), drop.size - 2)
        slope, lost = (drop[k + 1] - drop[k]) / step, _at(passing, step, drop)
        if lost > laws.MOST_LOST * pressure:
            slope, lost = 0.0, laws.MOST_LOST * pressure
        passing -= (passing - free * (1.0 - lost / pressure)) / (1.0 + free * slope / pressure)
    return passing


@njit(cache=True, nogil=True)
def _rate(
    omega: float, row: np.ndarray, step: float, flow_step: float, is_lossy: bool, pressure: float, J: float
) -> float:
    """Rate of the speed [rad/s2]; the air passes as it would at that speed for ever, for it waits for nothing.

    `row`: of `_at_nodes`, at the pressure.
    `step`, `flow_step`: between its speeds [rad/s] and between its flows [kg/s].
    """
    turning = _at(omega, step, row[:FINE])
    if not is_lossy:
        return turning / J
    ahead, behind = row[LOSS.start : LOSS.start + FLOWS], row[LOSS.start + FLOWS :]
    passing = _passing(_at(omega, step, row[FINE : 2 * FINE]), pressure, flow_step, ahead)
    drop = min(_at(passing, flow_step, ahead), laws.MOST_LOST * pressure)
    rise = _at(passing, flow_step, behind)
    turning += -row[SLOPE.start] * drop + row[SLOPE.start + 1] * rise
    return turning / J


@njit(cache=True, nogil=True)
def _put_row(table: np.ndarray, nodes: np.ndarray, pressure: float, out: np.ndarray) -> None:
    """Fill `out` with the first columns of a table at a pressure: between two nodes all goes straight with it."""
    low = 0
    while low + 2 < nodes.size and nodes[low + 1] <= pressure:
        low += 1
    high = min(low + 1, nodes.size - 1)
    up = (pressure - nodes[low]) / max(nodes[high] - nodes[low], 1e-9) if high > low else 0.0
    for k in range(out.size):
        out[k] = (1.0 - up) * table[low, k] + up * table[high, k]


# Numba takes arrays one by one: `model.solvers`.
@njit(cache=True, nogil=True)
def _march(
    time: np.ndarray,
    spans: np.ndarray,
    pressures: np.ndarray,
    nodes: np.ndarray,
    table: np.ndarray,
    ends: tuple[float, float],
    start: float,
    J: float,
    angle: float,
    around: np.ndarray,
) -> np.ndarray:
    """Mean speed since the sample before; the rotor does not turn back.

    `spans`, `pressures`: of the line, where each begins [s] and its pressure [Pa].
    `nodes`, `table`, `ends`: of `_at_nodes`, with the last of its speeds [rad/s] and of its flows [kg/s].
    """
    step, flow_step = ends[0] / (FINE - 1), ends[1] / (FLOWS - 1)
    is_lossy = bool(np.any(table[:, LOSS.start :] != 0.0))
    row, rowed = np.empty(table.shape[1] if is_lossy else FINE), -1  # nothing else of it is looked at
    out = np.empty(time.size)
    out[0] = start
    omega, t, span = start, time[0], 0
    while span + 1 < spans.size and spans[span + 1] <= t:
        span += 1
    for k in range(1, time.size):
        turned, began = 0.0, t
        while t < time[k] - 1e-12:
            end = time[k]
            if span + 1 < spans.size and spans[span + 1] < end - 1e-12:
                end = spans[span + 1]
            steps = max(1, int(np.ceil((end - t) / LONGEST_STEP_S - 1e-9)))
            h, P = (end - t) / steps, pressures[span]
            if span != rowed:
                _put_row(table, nodes, P, row)
                rowed = span
            for _ in range(steps):
                w, v = omega, omega
                a1 = _rate(v, row, step, flow_step, is_lossy, P, J) - _of_angle(angle, around) / J
                v = max(w + 0.5 * h * a1, 0.0)
                a2 = _rate(v, row, step, flow_step, is_lossy, P, J) - _of_angle(angle + 0.5 * h * w, around) / J
                v = max(w + 0.5 * h * a2, 0.0)
                a3 = _rate(v, row, step, flow_step, is_lossy, P, J)
                a3 -= _of_angle(angle + 0.5 * h * (w + 0.5 * h * a1), around) / J
                v = max(w + h * a3, 0.0)
                a4 = _rate(v, row, step, flow_step, is_lossy, P, J)
                a4 -= _of_angle(angle + h * (w + 0.5 * h * a2), around) / J
                omega = max(w + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4), 0.0)
                # Of the cubic through both ends and their slopes.
                by = 0.5 * h * (w + omega) + h * h / 12.0 * (a1 - a4)
                turned += by
                angle += by
            t = end
            if span + 1 < spans.size and t >= spans[span + 1] - 1e-12:
                span += 1
        t = time[k]
        out[k] = turned / (t - began)
    return out
