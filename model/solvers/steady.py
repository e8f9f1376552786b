"""The periodic state solved directly: steady speed, flow and torque for batches of parameters and pressures.

Three parts meet here: the adiabatic torque over a pulse and the ripple it makes (`pulse`), and what heat changes
in a cylinder's cycle (`gas.heat_cycle`). A few passes bring speed, gas state and heat to agree; the tests hold the
result against `model.solvers.transient`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from model import geometry
from model import layout as at
from model.gas import heat_cycle
from model.gas.cylinder import gas_state
from model.motor import Motor
from model.solvers import pulse
from model.solvers.recent import Recent

SPEED_OUT, MASS_FLOW, VOLUME_FLOW, TORQUE, ROLLER, SPEED_SLOPE, FLOW_SLOPE, STATUS, RIPPLE = range(9)
N_OUT = 9
RUNNING, STALLED, NOT_CONVERGED = 0.0, 1.0, 2.0
MOST_PASSES = 60
TOLERANCE = 5e-8  # relative error left of a batch; each pass gains about two digits, and the last two say how many
SHARPER = 0.01  # share of that where a point starts from one close by: a search goes by their small differences
SLOPE_STEP = 1e-3  # relative step of the pressure for slopes by difference
MOST_KEPT_ROWS = 100  # of a call whose result is kept: the calls of a search, not the batches of a fit
LARGE_RIPPLE = 0.05  # peak to peak over the mean: above it the ripple bends the slope, and it is taken by difference

AT_ONCE = 16  # rows that one core solves one after the other
GAMMA_STEP = 1e-3  # [-]
KNOWN_T, KNOWN_SHARE, KNOWN_STAGE = range(3)  # temperature after blow-down [K], speed in shares of that without heat
N_KNOWN = KNOWN_STAGE + heat_cycle.N_NODES  # and what heat adds at the points of the cycle

_recent = Recent(32)


@dataclass(frozen=True)
class Steady:
    """Steady states, each array of shape (n_sets, n_points).

    Attributes
    ----------
    speed_rad_s : ndarray
        Mean speed in time; 0 when the motor stalls.
    mass_flow_kg_s : ndarray
        Mean flow through the inlet.
    flow_m3_s : ndarray
        The same as volume at P_in and T_in, what a flow meter in the line indicates.
    gas_torque_nm : ndarray
        Mean torque of the gas, before roller friction.
    roller_torque_nm : ndarray
        Mean torque lost in roller friction.
    speed_slope, flow_slope : ndarray
        Derivatives with pressure [rad/s/Pa], [m3/s/Pa], to 1 %; zero when not asked for.
    running : ndarray of bool
        False where the motor stalls or no periodic state was found.
    ripple_rad_s : ndarray
        Speed ripple within a pulse, peak to peak.
    """

    speed_rad_s: np.ndarray
    mass_flow_kg_s: np.ndarray
    flow_m3_s: np.ndarray
    gas_torque_nm: np.ndarray
    roller_torque_nm: np.ndarray
    speed_slope: np.ndarray
    flow_slope: np.ndarray
    running: np.ndarray
    ripple_rad_s: np.ndarray


@njit(cache=True)
def _table_gamma(gas: np.ndarray) -> float:
    """The ratio of specific heats that tables are made for, the same for all pressures of a bench [-].

    What the point's own differs by is put right to first order, and that is less than GAMMA_STEP.
    """
    gamma: float = np.rint(gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R]) / GAMMA_STEP) * GAMMA_STEP
    return gamma


class _Tables(NamedTuple):
    """All that hangs on the geometry, the lap and gamma alone.

    Attributes
    ----------
    gamma : float
        Ratio of specific heats [-].
    pulse : ndarray, shape (32, 11)
        Of `model.solvers.pulse.tabulate`.
    first : float
        Angle of a pulse's first edge [rad].
    node : ndarray, shape (24, 11)
        Of `model.gas.heat_cycle.place_nodes`.
    step : ndarray, shape (24,)
        The step of the pulse that each node lies in [-].
    V_low, V_high : float
        Volumes at the port edges [m3].
    """

    gamma: float
    pulse: np.ndarray
    first: float
    node: np.ndarray
    step: np.ndarray
    V_low: float
    V_high: float


@njit(cache=True)
def _tabulate(parameters: np.ndarray, readings: np.ndarray, gamma: float) -> _Tables:
    """Tables of a parameter set."""
    c = np.empty(at.N_CURVE)
    table = np.empty((pulse.N_STEPS, pulse.N_TABLE))
    node = np.empty((heat_cycle.N_NODES, heat_cycle.N_NODE))
    step = np.empty(heat_cycle.N_NODES, np.int64)
    geometry.curve(parameters, c)
    first = pulse.tabulate(parameters, readings, gamma, c, table)
    V_low, V_high = heat_cycle.place_nodes(parameters, readings, gamma, c, node)
    pulse.steps_of(node[:, heat_cycle.PHASE], table, first, step)
    return _Tables(gamma, table, first, node, step, V_low, V_high)


@njit(cache=True)
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
    table, node = tables.pulse, tables.node

    gamma = gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R])
    net, gas_torque = pulse.torque_steps(P_s, P_d, P_a, gamma - tables.gamma, f_r, table, base)
    extra = parameters[at.EXTRA_TORQUE]
    lost = heat_cycle.friction_below_ambient(P_s, P_a, tables.gamma, tables.V_high, f_r, readings, node) + extra
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
        w, new, ripple = pulse.rippled_mean(w, step_work, table, f, J, speed, coarse_speed)
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
    out[MASS_FLOW] = m_in / at.PULSE * mean
    out[VOLUME_FLOW] = out[MASS_FLOW] * gas[at.GAS_R] * parameters[at.T_IN] / P_in
    out[TORQUE] = gas_torque + heat_gas / at.PULSE
    out[ROLLER] = out[TORQUE] - np.sum(step_work) / at.PULSE - extra
    out[RIPPLE] = ripple
    known[KNOWN_T], known[KNOWN_SHARE] = T, mean / adiabatic
    if out[STATUS] != RUNNING:
        known[:] = 0.0


@njit(cache=True)
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
        gain = pulse.gain(tables.pulse, pulse.GAS_S, pulse.ROLL_S, parameters[at.F_R])
        row[SPEED_SLOPE] = gain / parameters[at.F_OVERALL]
        growth = row[SPEED_SLOPE] / row[SPEED_OUT] + swept * row[SPEED_OUT] / (at.PULSE * row[MASS_FLOW]) - 1.0 / P
        row[FLOW_SLOPE] = row[VOLUME_FLOW] * growth
        return
    P_1 = P * (1.0 + SLOPE_STEP)
    _solve_point(P_1, parameters, readings, gas, tables, tolerance, scratch, known, beside)
    row[SPEED_SLOPE] = (beside[SPEED_OUT] - row[SPEED_OUT]) / (P_1 - P)
    row[FLOW_SLOPE] = (beside[VOLUME_FLOW] - row[VOLUME_FLOW]) / (P_1 - P)


@njit(cache=True)
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


@njit(cache=True)
def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two parameter sets share their tables."""
    return bool(np.all(one[: at.LAP + 1] == other[: at.LAP + 1]))


@njit(cache=True, parallel=True)
def _solve_batch(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool, out: np.ndarray
) -> None:
    """Every parameter set at its operating points, shared among the cores."""
    for s in prange(parameters.shape[0]):
        _solve_span(
            parameters[s : s + 1], readings, pressures[s], gas, slopes, TOLERANCE, True, np.empty((0, N_KNOWN)), out[s]
        )


@njit(cache=True, parallel=True)
def _solve_rows(
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    slopes: bool,
    tolerance: float,
    known: np.ndarray,
    out: np.ndarray,
) -> None:
    """One operating point of each parameter set, AT_ONCE of them shared among the cores."""
    for k in prange((pressures.size + AT_ONCE - 1) // AT_ONCE):
        i, j = k * AT_ONCE, min((k + 1) * AT_ONCE, pressures.size)
        _solve_span(parameters[i:j], readings, pressures[i:j], gas[i:j], slopes, tolerance, False, known[i:j], out[i:j])


def solve_rows(
    parameters: np.ndarray,
    readings: np.ndarray,
    pressures: np.ndarray,
    gas: np.ndarray,
    slopes: bool = False,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """Steady states of rows that each have a pressure and parameters of their own.

    Parameters
    ----------
    parameters : ndarray, shape (n, 24)
        Parameter sets in SI units, one a row.
    readings : ndarray, shape (5,)
        `model.motor.Readings.vector`.
    pressures : ndarray, shape (n,)
        Absolute inlet pressures [Pa].
    gas : ndarray, shape (n, 12)
        Gas of each row, of `gas_table`.
    slopes : bool
        As in `solve`.
    known : ndarray, shape (n, 26), or None
        What a call before left of states close by, 0 where nothing is known: it saves passes. Renewed.

    Returns
    -------
    ndarray, shape (n, 9)
        Columns as in `solve`.
    """
    a, b, c, d = (np.ascontiguousarray(one, dtype=np.float64) for one in (parameters, readings, pressures, gas))
    about = np.zeros((pressures.size, N_KNOWN)) if known is None else known.copy()
    tolerance = TOLERANCE if known is None else SHARPER * TOLERANCE

    def solved() -> np.ndarray:
        found = np.empty((pressures.size, N_OUT + N_KNOWN))
        out, after = np.empty((pressures.size, N_OUT)), about.copy()
        _solve_rows(a, b, c, d, slopes, tolerance, after, out)
        found[:, :N_OUT], found[:, N_OUT:] = out, after
        return found

    if pressures.size > MOST_KEPT_ROWS:
        found = solved()
    else:
        found = _recent((*(one.tobytes() for one in (a, b, c, d, about)), slopes, tolerance), solved)
    if known is not None:
        known[:] = found[:, N_OUT:]
    return np.ascontiguousarray(found[:, :N_OUT])


def solve(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool = False
) -> np.ndarray:
    """Steady states of many parameter sets in one compiled call on all cores.

    Parameters
    ----------
    parameters : ndarray, shape (n_sets, 24)
        Parameter sets in SI units, in the order of `model.motor.QUANTITIES`.
    readings : ndarray, shape (5,)
        `model.motor.Readings.vector`.
    pressures : ndarray, shape (n_sets, n_points)
        Absolute inlet pressures [Pa].
    gas : ndarray, shape (n_points, 12)
        Gas of each point, of `gas_table`; shared by the sets, on which it depends too little to matter.
    slopes : bool
        Derivatives with pressure too, to 1 %: they carry the pressure's noise into speed and flow.

    Returns
    -------
    ndarray, shape (n_sets, n_points, 9)
        Columns SPEED_OUT [rad/s], MASS_FLOW [kg/s], VOLUME_FLOW [m3/s], TORQUE and ROLLER [N m], SPEED_SLOPE
        [rad/s/Pa], FLOW_SLOPE [m3/s/Pa], STATUS (RUNNING, STALLED or NOT_CONVERGED), RIPPLE [rad/s].

    Raises
    ------
    ValueError
        When the shapes do not fit.
    """
    n_sets, n_points = pressures.shape
    if parameters.shape[0] != n_sets or parameters.shape[1] != at.N_VECTOR or gas.shape != (n_points, at.N_GAS):
        raise ValueError(
            f"steady.solve: parameters {parameters.shape}, pressures {pressures.shape} and gas {gas.shape} do not fit"
        )
    out = np.empty((n_sets, n_points, N_OUT))
    _solve_batch(
        np.ascontiguousarray(parameters, dtype=np.float64),
        np.ascontiguousarray(readings, dtype=np.float64),
        np.ascontiguousarray(pressures, dtype=np.float64),
        np.ascontiguousarray(gas, dtype=np.float64),
        slopes,
        out,
    )
    return out


def gas_table(motor: Motor, pressures: ArrayLike) -> np.ndarray:
    """Gas of each operating point, shape (n_points, 12), for `solve`.

    Parameters
    ----------
    motor : Motor
        The motor.
    pressures : array_like, shape (n_points,)
        Absolute inlet pressures [Pa].
    """
    parameters, readings = motor.vector(), motor.readings.vector()
    return np.array([gas_state(parameters, float(P), readings) for P in np.atleast_1d(pressures)])


def steady(motor: Motor, pressures: ArrayLike, slopes: bool = False) -> Steady:
    """Steady states of one motor.

    Parameters
    ----------
    motor : Motor
        The motor.
    pressures : array_like, shape (n_points,)
        Absolute inlet pressures [Pa].
    slopes : bool
        Derivatives with pressure too, to 1 %: they carry the pressure's noise into speed and flow.

    Returns
    -------
    Steady
        Arrays of shape (1, n_points).
    """
    P = np.atleast_1d(np.asarray(pressures, dtype=np.float64))
    return unpack(solve(motor.vector()[None, :], motor.readings.vector(), P[None, :], gas_table(motor, P), slopes))


def unpack(out: np.ndarray) -> Steady:
    """Name the columns of `solve`'s result.

    Parameters
    ----------
    out : ndarray, shape (n_sets, n_points, 9)
        What `solve` returned.
    """
    return Steady(
        speed_rad_s=out[..., SPEED_OUT],
        mass_flow_kg_s=out[..., MASS_FLOW],
        flow_m3_s=out[..., VOLUME_FLOW],
        gas_torque_nm=out[..., TORQUE],
        roller_torque_nm=out[..., ROLLER],
        speed_slope=out[..., SPEED_SLOPE],
        flow_slope=out[..., FLOW_SLOPE],
        running=out[..., STATUS] == RUNNING,
        ripple_rad_s=out[..., RIPPLE],
    )
