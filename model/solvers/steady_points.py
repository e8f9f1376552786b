"""Steady points, compiled: a point, a span of pressures, a batch.

`slopes`: derivatives with pressure too, to 1 %: they carry the pressure's noise into speed and flow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from configs.compiled import njit
from model import geometry
from model import layout as at
from model.gas import heat_cycle
from model.solvers import pulse

SPEED_OUT, MASS_FLOW, VOLUME_FLOW, TORQUE, ROLLER, SPEED_SLOPE, FLOW_SLOPE, STATUS, RIPPLE = range(9)
N_OUT = 9
RUNNING, STALLED, NOT_CONVERGED = 0.0, 1.0, 2.0
MOST_PASSES = 60
TOLERANCE = 5e-8  # relative error left of a batch; each pass gains about two digits, and the last two say how many
SLOPE_STEP = 1e-3  # relative step of the pressure for slopes by difference
LARGE_RIPPLE = 0.05  # peak to peak over the mean: above it the ripple bends the slope, and it is taken by difference
AT_ONCE = 16  # rows that one core solves one after the other
GAMMA_STEP = 1e-3  # [-]
KNOWN_T, KNOWN_SHARE, KNOWN_STAGE = range(3)  # temperature after blow-down [K], speed in shares of that without heat
N_KNOWN = KNOWN_STAGE + heat_cycle.N_NODES  # and what heat adds at the points of the cycle


@njit(error_model="numpy", cache=True)
def _table_gamma(gas: np.ndarray) -> float:
    """The ratio of specific heats that tables are made for, the same for all pressures of a bench [-].

    What the point's own differs by is put right to first order, and that is less than GAMMA_STEP.
    """
    gamma: float = np.rint(gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R]) / GAMMA_STEP) * GAMMA_STEP
    return gamma


class _Tables(NamedTuple):
    """All that hangs on the geometry, the lap and gamma alone.

    `gamma`: ratio of specific heats [-].
    `pulse`, shape (32, 11): of `model.solvers.pulse.tabulate`.
    `first`: angle of a pulse's first edge [rad].
    `node`, shape (24, 11): of `model.gas.heat_cycle.place_nodes`.
    `step`, shape (24,): the step of the pulse that each node lies in [-].
    `V_low`, `V_high`: volumes at the port edges [m3].
    `period`: angle of a pulse [rad].
    """

    gamma: float
    pulse: np.ndarray
    first: float
    node: np.ndarray
    step: np.ndarray
    V_low: float
    V_high: float
    period: float


@njit(error_model="numpy", cache=True)
def _tabulate(parameters: np.ndarray, readings: np.ndarray, gamma: float) -> _Tables:
    """Tables of a parameter set."""
    c = np.empty(at.N_CURVE)
    table = np.empty((pulse.N_STEPS, pulse.N_TABLE))
    node = np.empty((heat_cycle.N_NODES, heat_cycle.N_NODE))
    step = np.empty(heat_cycle.N_NODES, np.int64)
    geometry.curve(parameters, c)
    first = pulse.tabulate(parameters, readings, gamma, c, table)
    V_low, V_high = heat_cycle.place_nodes(parameters, readings, gamma, c, node)
    period = c[at.PULSE_ANGLE]
    pulse.steps_of(node[:, heat_cycle.PHASE], table, first, period, step)
    return _Tables(gamma, table, first, node, step, V_low, V_high, period)


# Numba takes arrays one by one; in one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def _solve_point(
    P_in: float,
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    tables: _Tables,
    tolerance: float,
    scratch: np.ndarray,
    known: np.ndarray,
    out: np.ndarray,
) -> None:
    """One operating point.

    Fills ``out`` but for its slopes. ``known`` is what is known of the state from one close by, all 0 where nothing is,
    and is left at this one.
    """
    P_s = P_in - parameters[at.DP_IN]
    P_a = parameters[at.P_A]
    P_d = P_a + parameters[at.DP_OUT]
    f, f_r, J = parameters[at.F_OVERALL], parameters[at.F_R], parameters[at.J]
    out[:] = 0.0
    out[STATUS] = STALLED
    base, step_work = scratch[0, : pulse.N_STEPS], scratch[1, : pulse.N_STEPS]
    speed, coarse_speed = scratch[2, : pulse.N_STEPS + 1], scratch[3, : pulse.N_STEPS + 1]
    omega, work = scratch[4, : heat_cycle.N_NODES], scratch[5, : heat_cycle.N_NODES]
    stage = known[KNOWN_STAGE:]
    table, node, period = tables.pulse, tables.node, tables.period

    gamma = gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R])
    net, gas_torque = pulse.torque_steps(P_s, P_d, P_a, gamma - tables.gamma, f_r, period, table, base)
    extra = parameters[at.EXTRA_TORQUE]
    lost = heat_cycle.friction_below_ambient(P_s, tables.gamma, tables.V_high, parameters, readings, node) + extra
    if net - lost <= 0.0 or P_s <= P_d:
        known[:] = 0.0
        return
    for j in range(pulse.N_STEPS):
        base[j] -= lost * table[j, pulse.WIDTH]

    adiabatic = (net - lost) / f
    T, mean = known[KNOWN_T], known[KNOWN_SHARE] * adiabatic
    if T <= 0.0:
        T, mean = parameters[at.T_IN] * (P_d / P_in) ** (1.0 - 1.0 / gamma), adiabatic
    w = mean
    omega[:] = mean
    ripple, m_in, heat_gas, change = 0.0, 0.0, 0.0, 1.0
    out[STATUS] = NOT_CONVERGED
    for i in range(MOST_PASSES):
        T_next, m_in, heat_gas = heat_cycle.pass_cycle(
            T,
            P_s,
            P_d,
            omega,
            tables.V_low,
            tables.V_high,
            tables.gamma,
            parameters,
            readings,
            node,
            gas,
            stage,
            work,
        )
        step_work[:] = base
        for n in range(heat_cycle.N_NODES):
            step_work[tables.step[n]] += work[n]
        w, new, ripple = pulse.rippled_mean(w, step_work, table, f, J, period, speed, coarse_speed)
        if w < 0.0:
            out[STATUS] = STALLED
            known[:] = 0.0
            return
        pulse.speeds_at(node[:, heat_cycle.PHASE], tables.step, table, tables.first, speed, omega)
        before, change = change, max(abs(new - mean) / mean, abs(T_next - T) / T)
        T, mean = T_next, new
        if i > 0 and (change <= tolerance or (change < before and change * change <= tolerance * before)):
            out[STATUS] = RUNNING
            break
    out[SPEED_OUT] = mean
    out[MASS_FLOW] = m_in / period * mean
    out[VOLUME_FLOW] = out[MASS_FLOW] * gas[at.GAS_R] * parameters[at.T_IN] / P_in
    out[TORQUE] = gas_torque + heat_gas / period
    out[ROLLER] = out[TORQUE] - np.sum(step_work) / period - extra
    out[RIPPLE] = ripple
    known[KNOWN_T], known[KNOWN_SHARE] = T, mean / adiabatic
    if out[STATUS] != RUNNING:
        known[:] = 0.0


# Numba takes arrays one by one: `model.solvers`.
@njit(error_model="numpy", cache=True)
def _add_slopes(
    P: float,
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    tables: _Tables,
    tolerance: float,
    scratch: np.ndarray,
    known: np.ndarray,
    beside: np.ndarray,
    row: np.ndarray,
) -> None:
    """Derivatives with pressure of a point that was solved for."""
    if row[RIPPLE] < LARGE_RIPPLE * row[SPEED_OUT]:
        # The adiabatic torque and charge are linear in P_s; what heat and ripple change in them is below 1 % here.
        gamma = gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R])
        swept = (tables.V_high - tables.V_low + tables.V_low / gamma) / (gas[at.GAS_R] * parameters[at.T_IN])
        gain = pulse.gain(tables.pulse, pulse.GAS_S, pulse.ROLL_S, parameters[at.F_R], tables.period)
        row[SPEED_SLOPE] = gain / parameters[at.F_OVERALL]
        growth = row[SPEED_SLOPE] / row[SPEED_OUT] + swept * row[SPEED_OUT] / (tables.period * row[MASS_FLOW]) - 1.0 / P
        row[FLOW_SLOPE] = row[VOLUME_FLOW] * growth
        return
    P_1 = P * (1.0 + SLOPE_STEP)
    _solve_point(P_1, parameters, readings, gas, tables, tolerance, scratch, known, beside)
    row[SPEED_SLOPE] = (beside[SPEED_OUT] - row[SPEED_OUT]) / (P_1 - P)
    row[FLOW_SLOPE] = (beside[VOLUME_FLOW] - row[VOLUME_FLOW]) / (P_1 - P)


# Numba takes arrays one by one: `model.solvers`.
@njit(error_model="numpy", cache=True)
def _solve_span(
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    slopes: bool,
    tolerance: float,
    follow: bool,
    known: np.ndarray,
    out: np.ndarray,
) -> None:
    """Points one after another, of one parameter set for all or of one each; they share tables as long as they may.

    Each starts from what is known of it, or with ``follow`` from the point before.
    """
    if pressures.size == 0:
        return
    scratch = np.empty((6, max(pulse.N_STEPS + 1, heat_cycle.N_NODES)))
    beside, about = np.empty(N_OUT), np.zeros(N_KNOWN)
    mine = parameters[0]
    tables = _tabulate(mine, readings, _table_gamma(gas[0]))
    for p in range(pressures.size):
        P, before = pressures[p], mine
        if parameters.shape[0] > 1:
            mine = parameters[p]
        gamma = _table_gamma(gas[p])
        if gamma != tables.gamma or not _alike(mine, before):
            tables = _tabulate(mine, readings, gamma)
        if not follow:
            about[:] = known[p]
        elif about[KNOWN_T] > 0.0:
            DP_in = mine[at.DP_IN]
            about[KNOWN_T] *= ((pressures[p - 1] - DP_in) / (P - DP_in)) ** (1.0 - 1.0 / gamma)
        _solve_point(P, mine, readings, gas[p], tables, tolerance, scratch, about, out[p])
        if not follow:
            known[p] = about
        if slopes and out[p, STATUS] == RUNNING:
            _add_slopes(P, mine, readings, gas[p], tables, tolerance, scratch, about, beside, out[p])


@njit(error_model="numpy", cache=True)
def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two parameter sets share their tables."""
    alike = np.all(one[: at.LAP + 1] == other[: at.LAP + 1])
    return bool(alike and np.all(one[at.N_PISTONS :] == other[at.N_PISTONS :]))


@njit(error_model="numpy", cache=True, parallel=True)
def solve_batch(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool, out: np.ndarray
) -> None:
    """Every parameter set at its operating points, shared among the cores.

    `parameters`, shape (n, 27): one set a row [SI].
    `pressures`, shape (n, k): absolute [Pa].
    `gas`: of `gas_table`, for each pressure [SI].
    `out`: gets the columns of each point [SI].
    """
    for s in prange(parameters.shape[0]):
        _solve_span(
            parameters[s : s + 1], readings, pressures[s], gas, slopes, TOLERANCE, True, np.empty((0, N_KNOWN)), out[s]
        )


@njit(error_model="numpy", cache=True, parallel=True)
def solve_each_row(
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    slopes: bool,
    tolerance: float,
    known: np.ndarray,
    out: np.ndarray,
) -> None:
    """One operating point of each parameter set, AT_ONCE of them shared among the cores.

    `parameters`, shape (n, 27): one set a row [SI].
    `pressures`, shape (n,): absolute [Pa].
    `gas`: of `gas_table`, for each pressure [SI].
    `tolerance`: relative, of the speed [-].
    `known`, shape (n, N_KNOWN): what is known of each point from one close by [SI].
    `out`: gets the columns of each point [SI].
    """
    for k in prange((pressures.size + AT_ONCE - 1) // AT_ONCE):
        i, j = k * AT_ONCE, min((k + 1) * AT_ONCE, pressures.size)
        _solve_span(parameters[i:j], readings, pressures[i:j], gas[i:j], slopes, tolerance, False, known[i:j], out[i:j])
