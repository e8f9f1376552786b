"""The periodic state solved directly: steady speed, flow and torque for batches of parameters and pressures.

What makes it fast is what the model is. With the ports open a cylinder stands at the port's pressure, and a closed one
follows P V^gamma: so without heat the torque at every angle is linear in P_s, P_d and P_a, and its integrals are
tabulated once a parameter set (`_tabulate`). Heat shifts the closed pressures and the trapped mass a little; that part
is integrated through one cylinder's cycle (`_heat_cycle`). The ripple of the speed follows from the energy integral
over one of the 28 torque pulses a turn (`_ripple`). A few passes bring the three to agree.

The heat's torque is spread evenly over the pulse, and heat is taken at the mean speed: both are far below the 0.05 % to
which `tests/test_solvers.py` holds this solver against `model.transient`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from model import geometry, motion
from model import layout as at
from model.cylinder import CLOSED, INLET, OUTLET, gas_state, open_port, port_at
from model.heat_transfer import DISCHARGE, EXPANSION, SUCTION, quartic
from model.motor import Motor
from model.transient import N_EDGES, edges

# Torque table: two steps between neighbouring edges, two Gauss points each.
STEPS_PER_EDGE = 2
N_STEPS = N_EDGES * STEPS_PER_EDGE
GAUSS = 0.5 / math.sqrt(3.0)

# Columns of the table of integrals over one step.
WIDTH, NET_S, NET_D, NET_A, GAS_S, GAS_D, GAS_A, SLOPE_S, SLOPE_D = range(9)
N_TABLE = 9

# Heat: segments of the cycle, Runge-Kutta steps in each, and the columns kept at their nodes.
SEGMENT_STEPS = np.array([3, 2, 2, 3, 1, 1])
SEGMENT_PORT = np.array([OUTLET, CLOSED, CLOSED, INLET, CLOSED, CLOSED])
N_NODES = int(np.sum(2 * SEGMENT_STEPS + 1))
VOLUME, DVOLUME, SPEED, AREA, FLOW_RATIO, ARM_NET, ARM_GAS, V_POWER, ANGLE_STEP = range(9)
N_NODE = 9

SPEED_OUT, MASS_FLOW, VOLUME_FLOW, TORQUE, ROLLER, SPEED_SLOPE, FLOW_SLOPE, STATUS, RIPPLE = range(9)
N_OUT = 9
RUNNING, STALLED, NOT_CONVERGED = 0.0, 1.0, 2.0
MOST_PASSES = 60
TOLERANCE = 1e-9
SLOPE_STEP = 1e-3  # relative step of the pressure for the slopes


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
        Derivatives with pressure [rad/s/Pa], [m3/s/Pa]; zero when not asked for.
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
def _tabulate(
    parameters: np.ndarray, readings: np.ndarray, gamma: float, c: np.ndarray, table: np.ndarray, node: np.ndarray
) -> None:
    """Integrals of the torque over the steps of one pulse, and the nodes of the heat's cycle, for one parameter set."""
    A_p, lap, half = c[at.A_P], parameters[at.LAP], 0.25 * math.pi
    f_r, virtual_work = parameters[at.F_R], readings[at.VIRTUAL_WORK] > 0.0
    V_low = geometry.volume(geometry.place(half - lap, c)[0], A_p, c[at.V_OFFSET])
    V_high = geometry.volume(geometry.place(at.LOBE - lap, c)[0], A_p, c[at.V_OFFSET])
    edge = edges(parameters, c)
    table[:] = 0.0
    for k in range(N_EDGES):
        lo = edge[k]
        hi = edge[k + 1] if k < N_EDGES - 1 else edge[0] + at.PULSE
        width = (hi - lo) / STEPS_PER_EDGE
        for j in range(STEPS_PER_EDGE):
            row = table[k * STEPS_PER_EDGE + j]
            row[WIDTH] = width
            for g in range(2):
                th = lo + width * (j + 0.5 + (GAUSS if g else -GAUSS))
                for i in range(at.N_CYLINDERS):
                    psi = (th + i * at.PULSE) % at.LOBE
                    L4, sin_phi, cos_phi, r = geometry.place(psi, c)
                    weight = 0.5 * width * A_p
                    gas_arm = weight * motion.gas_arm(L4, sin_phi, cos_phi, r, virtual_work)
                    net_arm = gas_arm - weight * f_r * cos_phi * r
                    row[NET_A] += net_arm
                    row[GAS_A] += gas_arm
                    port = port_at(psi, lap)
                    if port == INLET:
                        row[NET_S] += net_arm
                        row[GAS_S] += gas_arm
                    elif port == OUTLET:
                        row[NET_D] += net_arm
                        row[GAS_D] += gas_arm
                    else:
                        V = geometry.volume(L4, A_p, c[at.V_OFFSET])
                        if lap <= psi < at.LOBE - lap:  # closed at the inner dead centre, from P_d
                            log = math.log(V_low / V)
                            rise = math.exp(gamma * log)
                            row[NET_D] += rise * net_arm
                            row[GAS_D] += rise * gas_arm
                            row[SLOPE_D] += log * rise * net_arm
                        else:  # closed at the outer dead centre, from P_s
                            log = math.log(V_high / V)
                            rise = math.exp(gamma * log)
                            row[NET_S] += rise * net_arm
                            row[GAS_S] += rise * gas_arm
                            row[SLOPE_S] += log * rise * net_arm

    ends = np.array([lap, half - lap, half, half + lap, at.LOBE - lap, at.LOBE, at.LOBE + lap])
    n = 0
    for s in range(SEGMENT_STEPS.size):
        steps = SEGMENT_STEPS[s]
        h = (ends[s + 1] - ends[s]) / steps
        for j in range(2 * steps + 1):
            psi = (ends[s] + 0.5 * h * j) % at.LOBE
            L4, sin_phi, cos_phi, r = geometry.place(psi, c)
            V = geometry.volume(L4, A_p, c[at.V_OFFSET])
            reach = L4 * sin_phi / cos_phi
            area = math.pi * parameters[at.DP] * V / A_p + 2.0 * A_p
            ratio = A_p / area  # Ug/Vp of an adiabatic cylinder whose gas is as warm as the port's
            node[n, VOLUME] = V
            node[n, DVOLUME] = A_p * reach
            node[n, SPEED] = abs(reach)
            node[n, AREA] = area
            node[n, FLOW_RATIO] = ratio**0.2 if SEGMENT_PORT[s] == OUTLET else ratio**1.4
            node[n, ARM_GAS] = A_p * motion.gas_arm(L4, sin_phi, cos_phi, r, virtual_work)
            node[n, ARM_NET] = node[n, ARM_GAS] - A_p * f_r * cos_phi * r
            node[n, V_POWER] = math.exp(-gamma * math.log(V))
            node[n, ANGLE_STEP] = h
            n += 1


@njit(cache=True)
def _heat(
    phase: int,
    P: float,
    T: float,
    omega: float,
    node: np.ndarray,
    parameters: np.ndarray,
    gas: np.ndarray,
    printed: bool,
) -> float:
    """Heat into the gas per angle [J/rad] at a node: `model.heat_transfer.cylinder_heat`, its powers joined in one."""
    if node[SPEED] <= 0.0 or parameters[at.H_A] <= 0.0:
        return 0.0
    mu = quartic(gas, at.GAS_MU, T)
    k = quartic(gas, at.GAS_K, T)
    u = 1.0
    if phase == DISCHARGE:
        u += node[FLOW_RATIO]
    elif phase == SUCTION:
        u += node[FLOW_RATIO] * math.exp(1.4 * math.log(T / parameters[at.T_IN]))
    D = parameters[at.DP]
    a = 0.12 if phase == EXPANSION else 0.08
    b = 0.9 if phase == SUCTION else 0.8
    Re = P / (gas[at.GAS_R] * T) * D * node[SPEED] * omega * u / mu
    H_g = a * k / D * math.exp(b * math.log(Re) + 0.6 * math.log(mu * gas[at.GAS_CP] / k))
    wall = parameters[at.D_C] / parameters[at.K_C]
    if not printed:
        wall /= node[AREA]
    return (
        (parameters[at.T_A] - T) / (1.0 / (node[AREA] * parameters[at.H_A]) + wall + 1.0 / (node[AREA] * H_g)) / omega
    )


@njit(cache=True)
def _heat_cycle(
    T: float,
    P_s: float,
    P_d: float,
    omega: float,
    heated: bool,
    printed: bool,
    parameters: np.ndarray,
    node: np.ndarray,
    gas: np.ndarray,
) -> tuple[float, float, float, float]:
    """One cycle of one cylinder at constant speed, from the opening of the outlet.

    Parameters
    ----------
    T : float
        Temperature after blow-down [K].
    P_s, P_d, omega : float
        Port pressures [Pa] and speed [rad/s].
    heated, printed : bool
        Heat at all, and the wall's resistance as printed.
    parameters, node, gas : ndarray
        Parameter set, nodes and gas.

    Returns
    -------
    T : float
        The same temperature a cycle later [K].
    m_in : float
        Mass taken from the inlet [kg].
    net, gas_work : float
        What heat adds to the work of a cycle [J], with roller friction and without.
    """
    R, cp = gas[at.GAS_R], gas[at.GAS_CP]
    gamma = cp / (cp - R)
    n = 0
    h = node[0, ANGLE_STEP]
    if heated:  # discharge: m cp dT/dpsi = dQ/dpsi, m = P V / (R T)
        for _ in range(SEGMENT_STEPS[0]):
            f = R / (P_d * cp)
            k1 = f * T / node[n, VOLUME] * _heat(DISCHARGE, P_d, T, omega, node[n], parameters, gas, printed)
            u = T + 0.5 * h * k1
            k2 = f * u / node[n + 1, VOLUME] * _heat(DISCHARGE, P_d, u, omega, node[n + 1], parameters, gas, printed)
            u = T + 0.5 * h * k2
            k3 = f * u / node[n + 1, VOLUME] * _heat(DISCHARGE, P_d, u, omega, node[n + 1], parameters, gas, printed)
            u = T + h * k3
            k4 = f * u / node[n + 2, VOLUME] * _heat(DISCHARGE, P_d, u, omega, node[n + 2], parameters, gas, printed)
            T += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            n += 2
    else:
        n = 2 * SEGMENT_STEPS[0]
    n += 1

    m_before = P_d * node[n, VOLUME] / (R * T)
    P, T, net, gas_work, n = _closed(P_d, T, m_before, 1, 2, n, omega, heated, printed, parameters, node, gas)

    V = node[n, VOLUME]
    T, dm = open_port(P, T, V, P_s, parameters[at.T_IN], gas)
    m = P_s * V / (R * T)
    h = node[n, ANGLE_STEP]
    steps = SEGMENT_STEPS[3]
    if heated:  # suction, Eq. 16: dm/dpsi = (P dV/dpsi cp/R - dQ/dpsi) / (cp T_in), T = P V / (m R)
        scale, area = 1.0 / (cp * parameters[at.T_IN]), P_s * cp / R
        for _ in range(steps):
            m1 = m
            k1 = (
                area * node[n, DVOLUME]
                - _heat(SUCTION, P_s, P_s * node[n, VOLUME] / (m1 * R), omega, node[n], parameters, gas, printed)
            ) * scale
            m1 = m + 0.5 * h * k1
            k2 = (
                area * node[n + 1, DVOLUME]
                - _heat(
                    SUCTION, P_s, P_s * node[n + 1, VOLUME] / (m1 * R), omega, node[n + 1], parameters, gas, printed
                )
            ) * scale
            m1 = m + 0.5 * h * k2
            k3 = (
                area * node[n + 1, DVOLUME]
                - _heat(
                    SUCTION, P_s, P_s * node[n + 1, VOLUME] / (m1 * R), omega, node[n + 1], parameters, gas, printed
                )
            ) * scale
            m1 = m + h * k3
            k4 = (
                area * node[n + 2, DVOLUME]
                - _heat(
                    SUCTION, P_s, P_s * node[n + 2, VOLUME] / (m1 * R), omega, node[n + 2], parameters, gas, printed
                )
            ) * scale
            m += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            n += 2
    else:
        m += P_s * (node[n + 2 * steps, VOLUME] - V) / (R * parameters[at.T_IN])
        n += 2 * steps
    T = P_s * node[n, VOLUME] / (m * R)
    n += 1

    P, T, net_2, gas_2, n = _closed(P_s, T, m, 4, 5, n, omega, heated, printed, parameters, node, gas)
    T, _ = open_port(P, T, node[n - 1, VOLUME], P_d, parameters[at.T_A], gas)
    return T, m - m_before, net + net_2, gas_work + gas_2


@njit(cache=True)
def _closed(
    P: float,
    T: float,
    m: float,
    first: int,
    last: int,
    n: int,
    omega: float,
    heated: bool,
    printed: bool,
    parameters: np.ndarray,
    node: np.ndarray,
    gas: np.ndarray,
) -> tuple[float, float, float, float, int]:
    """Both ports shut, Eq. 17, through the segments ``first..last``: K = P V^gamma changes by heat alone.

    Returns the pressure and temperature at the end, what heat adds to the work (with and without roller friction) [J],
    and the index of the next node.
    """
    R, cp = gas[at.GAS_R], gas[at.GAS_CP]
    g1 = cp / (cp - R) - 1.0
    K0 = P / node[n, V_POWER]
    K = K0
    net = 0.0
    gas_work = 0.0
    if heated:
        for segment in range(first, last + 1):
            # The row of Table 2 follows the sign of dV, which the whole segment shares.
            phase = EXPANSION if node[n + 1, DVOLUME] > 0.0 else 0
            h = node[n, ANGLE_STEP]
            for _ in range(SEGMENT_STEPS[segment]):
                k1 = (
                    g1
                    / (node[n, V_POWER] * node[n, VOLUME])
                    * _heat_closed(phase, K, m, omega, node[n], parameters, gas, printed)
                )
                u = K + 0.5 * h * k1
                mid = n + 1
                factor = g1 / (node[mid, V_POWER] * node[mid, VOLUME])
                k2 = factor * _heat_closed(phase, u, m, omega, node[mid], parameters, gas, printed)
                u = K + 0.5 * h * k2
                k3 = factor * _heat_closed(phase, u, m, omega, node[mid], parameters, gas, printed)
                u = K + h * k3
                end = n + 2
                k4 = (
                    g1
                    / (node[end, V_POWER] * node[end, VOLUME])
                    * _heat_closed(phase, u, m, omega, node[end], parameters, gas, printed)
                )
                K_end = K + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
                K_mid = 0.5 * (K + K_end) + 0.125 * h * (k1 - k4)
                a = (K - K0) * node[n, V_POWER]
                b = (K_mid - K0) * node[mid, V_POWER]
                d = (K_end - K0) * node[end, V_POWER]
                net += h / 6.0 * (a * node[n, ARM_NET] + 4.0 * b * node[mid, ARM_NET] + d * node[end, ARM_NET])
                gas_work += h / 6.0 * (a * node[n, ARM_GAS] + 4.0 * b * node[mid, ARM_GAS] + d * node[end, ARM_GAS])
                K = K_end
                n += 2
            n += 1
    else:
        for segment in range(first, last + 1):
            n += 2 * SEGMENT_STEPS[segment] + 1
    P = K * node[n - 1, V_POWER]
    return P, P * node[n - 1, VOLUME] / (m * R), net, gas_work, n


@njit(cache=True)
def _heat_closed(
    phase: int,
    K: float,
    m: float,
    omega: float,
    node: np.ndarray,
    parameters: np.ndarray,
    gas: np.ndarray,
    printed: bool,
) -> float:
    P = K * node[V_POWER]
    return _heat(phase, P, P * node[VOLUME] / (m * gas[at.GAS_R]), omega, node, parameters, gas, printed)


@njit(cache=True)
def _ripple(w: float, step_work: np.ndarray, table: np.ndarray, f: float, J: float) -> tuple[float, float, float]:
    """Speed within one pulse: w dw/dth = (torque - f w) / J, periodic.

    The torque's integral over a step is exact; friction takes the mean of the speeds at both ends.

    Parameters
    ----------
    w : float
        First guess of the speed at the start of the pulse [rad/s].
    step_work : ndarray, shape (16,)
        Integral of gas torque less roller friction over each step [J].
    table : ndarray, shape (16, 9)
        For the steps' widths [rad].
    f, J : float
        f_overall [N m s] and inertia [kg m2].

    Returns
    -------
    w : float
        Speed at the start of the pulse [rad/s]; -1 when the rotor cannot pass.
    mean : float
        Mean speed in time [rad/s].
    ripple : float
        Peak to peak [rad/s].
    """
    failed = 0
    for _ in range(200):
        v = w
        time = 0.0
        gain_up = 1.0
        gain_down = 1.0
        fastest = w
        slowest = w
        for j in range(N_STEPS):
            width = table[j, WIDTH]
            drag = 0.5 * f * width / J
            square = (v - drag) ** 2 + 2.0 * step_work[j] / J
            after = math.sqrt(square) - drag if square > 0.0 else -1.0
            if after <= 0.0 or v <= drag and step_work[j] <= 0.0:
                time = -1.0
                break
            time += 2.0 * width / (v + after)
            gain_up *= v - drag
            gain_down *= after + drag
            v = after
            fastest = max(fastest, v)
            slowest = min(slowest, v)
        if time < 0.0:
            failed += 1
            if failed > 40:
                return -1.0, 0.0, 0.0
            w = 1.15 * w + 0.1  # from above the iteration comes down to the periodic speed if there is one
            continue
        miss = v - w
        if abs(miss) <= 1e-12 * w:
            return w, at.PULSE / time, fastest - slowest
        gain = gain_up / gain_down
        # Newton; while the start is being raised, the rotor's own approach, which cannot overshoot into a stall.
        w = w + miss / (1.0 - gain) if failed == 0 and gain < 1.0 else v
        if w <= 0.0:
            w = v
            failed += 1
    return -1.0, 0.0, 0.0


@njit(cache=True)
def _solve(
    P_in: float,
    start_T: float,
    start_omega: float,
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    gamma: float,
    table: np.ndarray,
    node: np.ndarray,
    step_work: np.ndarray,
    out: np.ndarray,
) -> float:
    """One operating point; fills ``out`` up to its slopes and returns the temperature after blow-down [K]."""
    P_s = P_in - parameters[at.DP_IN]
    P_a = parameters[at.P_A]
    P_d = P_a + parameters[at.DP_OUT]
    f, J = parameters[at.F_OVERALL], parameters[at.J]
    d_gamma = gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R]) - gamma
    cycles = at.N_CYLINDERS / at.LOBE  # of all cylinders, per angle
    out[:] = 0.0
    out[STATUS] = STALLED

    net = 0.0
    gas_torque = 0.0
    for j in range(N_STEPS):
        row = table[j]
        work = (
            P_s * (row[NET_S] + d_gamma * row[SLOPE_S]) + P_d * (row[NET_D] + d_gamma * row[SLOPE_D]) - P_a * row[NET_A]
        )
        step_work[j] = work
        net += work
        gas_torque += P_s * (row[GAS_S] + d_gamma * row[SLOPE_S]) + P_d * (row[GAS_D] + d_gamma * row[SLOPE_D])
        gas_torque -= P_a * row[GAS_A]
    lost = _friction_below_ambient(P_s, P_a, gamma, parameters, readings, node)
    net = (net - lost * at.PULSE) / at.PULSE
    gas_torque /= at.PULSE
    if not net > 0.0 or P_s <= P_d:
        return start_T

    heated = readings[at.HEAT_TRANSFER] > 0.0
    T = start_T
    omega = start_omega if start_omega > 0.0 else net / f
    w = omega
    applied = -lost  # heat's (and the suction's) share already in step_work [N m]
    for j in range(N_STEPS):
        step_work[j] -= lost * table[j, WIDTH]
    applied = 0.0
    mean, ripple, m_in, heat_gas = omega, 0.0, 0.0, 0.0
    for _ in range(MOST_PASSES):
        T_next, m_in, heat_net, heat_gas = _heat_cycle(
            T, P_s, P_d, omega, heated, readings[at.WALL_AS_PRINTED] > 0.0, parameters, node, gas
        )
        change = heat_net * cycles - applied
        for j in range(N_STEPS):
            step_work[j] += change * table[j, WIDTH]
        applied += change
        w, mean, ripple = _ripple(w, step_work, table, f, J)
        if w < 0.0:
            return start_T
        settled = abs(mean - omega) <= TOLERANCE * mean and abs(T_next - T) <= 1e-7 * T
        T, omega = T_next, mean
        if settled:
            out[STATUS] = RUNNING
            break
    if out[STATUS] != RUNNING:
        out[STATUS] = NOT_CONVERGED
    out[SPEED_OUT] = mean
    out[MASS_FLOW] = m_in * cycles * mean
    out[VOLUME_FLOW] = out[MASS_FLOW] * gas[at.GAS_R] * parameters[at.T_IN] / P_in
    out[TORQUE] = gas_torque + heat_gas * cycles
    out[ROLLER] = out[TORQUE] - (net + applied)
    out[RIPPLE] = ripple
    return T


@njit(cache=True)
def _friction_below_ambient(
    P_s: float, P_a: float, gamma: float, parameters: np.ndarray, readings: np.ndarray, node: np.ndarray
) -> float:
    """Mean torque that roller friction takes more than the tables say, where a closed cylinder falls below P_a [N m].

    The tables hold f_r F; friction is f_r |F| (erratum 5). It matters below 1.1 bar only.
    """
    if readings[at.FRICTION_AS_PRINTED] > 0.0:
        return 0.0
    first = N_NODES - (2 * SEGMENT_STEPS[4] + 1) - (2 * SEGMENT_STEPS[5] + 1)
    V_first = node[first, VOLUME]
    lowest = node[N_NODES - (2 * SEGMENT_STEPS[5] + 1), VOLUME]
    if P_s * math.exp(gamma * math.log(V_first / lowest)) >= P_a:
        return 0.0
    lost = 0.0
    n = first
    for segment in range(4, 6):
        for _ in range(SEGMENT_STEPS[segment]):
            h = node[n, ANGLE_STEP]
            for j in range(3):
                F = P_s * node[n + j, V_POWER] / node[first, V_POWER] - P_a
                if F < 0.0:
                    weight = h / 6.0 * (4.0 if j == 1 else 1.0)
                    lost -= 2.0 * weight * F * (node[n + j, ARM_GAS] - node[n + j, ARM_NET])
            n += 2
        n += 1
    return lost * at.N_CYLINDERS / at.LOBE


@njit(cache=True)
def _solve_set(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool, out: np.ndarray
) -> None:
    """All operating points of one parameter set."""
    c = np.empty(at.N_CURVE)
    table = np.empty((N_STEPS, N_TABLE))
    node = np.empty((N_NODES, N_NODE))
    step_work = np.empty(N_STEPS)
    beside = np.empty(N_OUT)
    geometry.curve(parameters, c)
    gamma = gas[0, at.GAS_CP] / (gas[0, at.GAS_CP] - gas[0, at.GAS_R])
    _tabulate(parameters, readings, gamma, c, table, node)
    for p in range(pressures.size):
        P = pressures[p]
        row = out[p]
        T = _solve(P, 0.95 * parameters[at.T_A], 0.0, parameters, readings, gas[p], gamma, table, node, step_work, row)
        if slopes and row[STATUS] == RUNNING:
            P_1 = P * (1.0 + SLOPE_STEP)
            guess = row[SPEED_OUT] * (1.0 + SLOPE_STEP * P / (P - parameters[at.P_A]))
            _solve(P_1, T, guess, parameters, readings, gas[p], gamma, table, node, step_work, beside)
            row[SPEED_SLOPE] = (beside[SPEED_OUT] - row[SPEED_OUT]) / (P_1 - P)
            row[FLOW_SLOPE] = (beside[VOLUME_FLOW] - row[VOLUME_FLOW]) / (P_1 - P)


@njit(cache=True, parallel=True)
def _solve_batch(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool, out: np.ndarray
) -> None:
    """Every parameter set at its operating points, shared among the cores."""
    for s in prange(parameters.shape[0]):
        _solve_set(parameters[s], readings, pressures[s], gas, slopes, out[s])


def solve(
    parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, gas: np.ndarray, slopes: bool = False
) -> np.ndarray:
    """Steady states of many parameter sets in one compiled call on all cores.

    Parameters
    ----------
    parameters : ndarray, shape (n_sets, >= 20)
        Parameter sets in SI units, in the order of `model.motor.QUANTITIES`.
    readings : ndarray, shape (5,)
        `model.motor.Readings.vector`.
    pressures : ndarray, shape (n_sets, n_points)
        Absolute inlet pressures [Pa].
    gas : ndarray, shape (n_points, 12)
        Gas of each point, of `gas_table`; shared by the sets, on which it depends too little to matter.
    slopes : bool
        Derivatives with pressure too.

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
    if (
        parameters.shape[0] != n_sets
        or parameters.shape[1] < at.N_SOLVER_PARAMETERS
        or gas.shape != (n_points, at.N_GAS)
    ):
        raise ValueError(
            f"steady.solve: parameters {parameters.shape}, pressures {pressures.shape} and gas {gas.shape} do not fit"
        )
    out = np.empty((n_sets, n_points, N_OUT))
    contiguous = (np.ascontiguousarray(array, dtype=np.float64) for array in (parameters, readings, pressures, gas))
    _solve_batch(*contiguous, slopes, out)
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
        Derivatives with pressure too.

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
