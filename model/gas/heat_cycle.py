"""What heat changes in the cycle of one cylinder at constant speed.

The adiabatic part is known in closed form; heat shifts the closed pressures and the trapped mass a little. That shift
is integrated by Gauss collocation over the six segments of the cycle. The values at the points are those of the pass
before (Picard), since `steady` passes several times anyway. Where much heat has long to act that would run away, and a
step of Newton's is taken from them. The points never touch a dead centre, where the
piston's speed and with it Eq. 19 fall to zero within an angle that no step would resolve. The speed at each point is
the local one, ripple included: near the lowest pressure that decides a third of a per cent.

`node`, shape (24, 11): the collocation points, of `place_nodes`.
`gamma`: ratio of specific heats that the points were placed with [-].
"""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit
from model import geometry, motion
from model import layout as at
from model.gas.cylinder import CLOSED, INLET, OUTLET, open_port
from model.gas.heat_transfer import COMPRESSION, DISCHARGE, EXPANSION, SUCTION, contact_area, quartic

SEGMENT_PORT = np.array([OUTLET, CLOSED, CLOSED, INLET, CLOSED, CLOSED])
N_GAUSS = 4
N_NODES = 6 * N_GAUSS
STIFF = 1.0  # times that heat acts longer than it takes to settle, from which on a segment needs Newton's step
# Columns; ARM_ROLL is roller friction's per f_r, and PHASE the point's angle within a pulse [rad].
VOLUME, DVOLUME, SPEED, AREA, FLOW_RATIO, ARM_ROLL, ARM_GAS, V_POWER, LOG_V, SPAN, PHASE = range(11)
N_NODE = 11


def _collocation(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, weights and integration matrix of Gauss collocation on 0..1: shapes (n,), (n,), (n, n)."""
    x, w = np.polynomial.legendre.leggauss(n)
    points = 0.5 * (x + 1.0)
    basis = [np.polynomial.Polynomial.fromroots(np.delete(points, j)) for j in range(n)]
    basis = [poly / poly(points[j]) for j, poly in enumerate(basis)]
    matrix = np.array([[poly.integ()(point) for poly in basis] for point in points])
    return points, 0.5 * w, matrix


GAUSS_POINT, GAUSS_WEIGHT, GAUSS_MATRIX = _collocation(N_GAUSS)


@njit(error_model="numpy", cache=True)
def place_nodes(
    parameters: np.ndarray, readings: np.ndarray, gamma: float, c: np.ndarray, node: np.ndarray
) -> tuple[float, float]:
    """Everything at the collocation points that hangs on the geometry, the lap and gamma alone.

    `node`, shape (24, 11): filled.
    Returns `V_low, V_high`: volumes at the port edges [m3], piston in and piston out.
    """
    A_p, lap, half, lobe = c[at.A_P], parameters[at.LAP], c[at.HALF_LOBE], c[at.LOBE_ANGLE]
    virtual_work = readings[at.VIRTUAL_WORK] > 0.0
    ends = np.array([lap, half - lap, half, half + lap, lobe - lap, lobe, lobe + lap])
    for n in range(N_NODES):
        s = n // N_GAUSS
        span = ends[s + 1] - ends[s]
        psi = (ends[s] + span * GAUSS_POINT[n % N_GAUSS]) % lobe
        L4, sin_phi, cos_phi, r = geometry.place(psi, c)
        V = geometry.volume(L4, A_p, c[at.V_OFFSET])
        reach = L4 * sin_phi / cos_phi
        area = contact_area(V, parameters[at.DP], A_p)
        ratio = A_p / area  # Ug/Vp of an adiabatic cylinder whose gas is as warm as the port's
        node[n, VOLUME] = V
        node[n, DVOLUME] = A_p * reach
        node[n, SPEED] = abs(reach)
        node[n, AREA] = area
        node[n, FLOW_RATIO] = ratio**0.2 if SEGMENT_PORT[s] == OUTLET else ratio**1.4
        node[n, ARM_GAS] = A_p * motion.gas_arm(L4, sin_phi, cos_phi, r, virtual_work)
        node[n, ARM_ROLL] = A_p * cos_phi * r
        node[n, LOG_V] = math.log(V)
        node[n, V_POWER] = math.exp(-gamma * node[n, LOG_V])
        node[n, SPAN] = span
        node[n, PHASE] = psi % c[at.PULSE_ANGLE]
    V_low = geometry.volume(geometry.place(half - lap, c)[0], A_p, c[at.V_OFFSET])
    V_high = geometry.volume(geometry.place(lobe - lap, c)[0], A_p, c[at.V_OFFSET])
    return V_low, V_high


@njit(error_model="numpy", cache=True)
def resistance_per_angle(
    phase: int,
    P: float,
    T: float,
    omega: float,
    node: np.ndarray,
    parameters: np.ndarray,
    gas: np.ndarray,
    printed: bool,
) -> float:
    """Kelvin that the gas is colder than the ambient per heat into it and angle, by Eq. 18 [K rad/J].

    Heat by it is `gas.heat_transfer.cylinder_heat` over omega, its powers joined in one. Infinite where none is traded.

    `phase`: row of Table 2.
    `P`, `T`, `omega`: pressure [Pa], temperature [K] and speed [rad/s].
    `node`, shape (11,): the point.
    `printed`: the wall's resistance as printed (erratum 2).
    """
    if parameters[at.H_A] <= 0.0:
        return np.inf
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
    resistance = 1.0 / (node[AREA] * parameters[at.H_A]) + wall + 1.0 / (node[AREA] * H_g)
    return resistance * omega


# Numba takes arrays one by one; in one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def pass_cycle(
    T: float,
    P_s: float,
    P_d: float,
    omega: np.ndarray,
    V_low: float,
    V_high: float,
    table_gamma: float,
    parameters: np.ndarray,
    readings: np.ndarray,
    node: np.ndarray,
    gas: np.ndarray,
    stage: np.ndarray,
    work: np.ndarray,
) -> tuple[float, float, float]:
    """One pass over the cycle, from the opening of the outlet.

    `T`: temperature after blow-down [K].
    `P_s`, `P_d`: port pressures [Pa].
    `omega`, shape (24,): speed at the points [rad/s].
    `V_low`, `V_high`: volumes at the port edges [m3].
    `table_gamma`: ratio of specific heats that the points were placed with [-].
    `stage`, shape (24,): what heat adds at the points: to T [K] in discharge, to P V^gamma when closed, to the mass
        [kg] in suction. Taken from the pass before, and renewed.
    `work`, shape (24,): filled with what heat adds to the work of a cycle at each point, less roller friction [J].
    Returns `T`: the same temperature a cycle later [K]; `m_in`: mass taken from the inlet [kg]; `gas_work`: what heat
    adds to the gas's work in a cycle [J], before roller friction.
    """
    R, cp, T_in, T_a = gas[at.GAS_R], gas[at.GAS_CP], parameters[at.T_IN], parameters[at.T_A]
    factor = parameters[at.HEAT_FACTOR]
    heated = readings[at.HEAT_TRANSFER] > 0.0
    printed = readings[at.WALL_AS_PRINTED] > 0.0
    rate, falls_by = np.empty(N_GAUSS), np.empty(N_GAUSS)
    work[:] = 0.0

    if heated:  # discharge: m cp dT/dpsi = dQ/dpsi, m = P V / (R T)
        for i in range(N_GAUSS):
            u = T + stage[i]
            resistance = resistance_per_angle(DISCHARGE, P_d, u, omega[i], node[i], parameters, gas, printed)
            warmed = R * u / (P_d * cp * node[i, VOLUME])
            rate[i] = warmed * (factor * (T_a - u) / resistance)
            falls_by[i] = warmed * factor / resistance
        T += _collect(rate, falls_by, node[0, SPAN], stage[:N_GAUSS])

    m_before = P_d * V_low / (R * T)
    P, gas_work = _closed(
        P_d, V_low, m_before, 1, table_gamma, omega, heated, printed, parameters, node, gas, stage, work
    )
    T, dm = open_port(P, P * V_low / (m_before * R), V_low, P_s, T_in, gas)

    m_open = m_before + dm
    m = m_open + P_s * (V_high - V_low) / (R * T_in)
    if heated:  # suction, Eq. 16: dm/dpsi = (P dV/dpsi cp/R - dQ/dpsi) / (cp T_in), T = P V / (m R)
        first = 3 * N_GAUSS
        for i in range(N_GAUSS):
            n = first + i
            u = m_open + P_s * (node[n, VOLUME] - V_low) / (R * T_in) + stage[n]
            T = P_s * node[n, VOLUME] / (u * R)
            resistance = resistance_per_angle(SUCTION, P_s, T, omega[n], node[n], parameters, gas, printed)
            rate[i] = -(factor * (T_a - T) / resistance) / (cp * T_in)
            falls_by[i] = factor / resistance * T / (u * cp * T_in)
        m += _collect(rate, falls_by, node[first, SPAN], stage[first : first + N_GAUSS])

    P, gas_2 = _closed(P_s, V_high, m, 4, table_gamma, omega, heated, printed, parameters, node, gas, stage, work)
    T, _ = open_port(P, P * V_high / (m * R), V_high, P_d, parameters[at.T_A], gas)
    return T, m - m_before, gas_work + gas_2


@njit(error_model="numpy", cache=True)
def _collect(rate: np.ndarray, falls_by: np.ndarray, span: float, stage: np.ndarray) -> float:
    """Integrate over a segment what changes at ``rate``, and returns the change.

    `rate`, shape (4,): at the points, with what ``stage`` has added there; per angle.
    `falls_by`, shape (4,): how much the rate falls with what is added [1/rad].
    `stage`, shape (4,): renewed.
    """
    total = 0.0
    if span * np.max(falls_by) < STIFF:
        for i in range(N_GAUSS):
            added = 0.0
            for j in range(N_GAUSS):
                added += GAUSS_MATRIX[i, j] * rate[j]
            stage[i] = span * added
            total += GAUSS_WEIGHT[i] * rate[i]
        return span * total
    # (1 + span A diag(falls_by)) stage = span A (rate + falls_by stage)
    matrix, value = np.empty((N_GAUSS, N_GAUSS)), np.empty(N_GAUSS)
    for i in range(N_GAUSS):
        value[i] = 0.0
        for j in range(N_GAUSS):
            weight = span * GAUSS_MATRIX[i, j]
            value[i] += weight * (rate[j] + falls_by[j] * stage[j])
            matrix[i, j] = weight * falls_by[j]
        matrix[i, i] += 1.0
    for i in range(N_GAUSS):  # no pivot is below 1, for heat only ever pulls towards the wall's temperature
        for k in range(i + 1, N_GAUSS):
            factor = matrix[k, i] / matrix[i, i]
            for j in range(i + 1, N_GAUSS):
                matrix[k, j] -= factor * matrix[i, j]
            value[k] -= factor * value[i]
    for i in range(N_GAUSS - 1, -1, -1):
        for j in range(i + 1, N_GAUSS):
            value[i] -= matrix[i, j] * value[j]
        value[i] /= matrix[i, i]
        total += GAUSS_WEIGHT[i] * (rate[i] - falls_by[i] * (value[i] - stage[i]))
        stage[i] = value[i]
    return span * total


# Numba takes arrays one by one; in one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def _closed(
    P: float,
    V_end: float,
    m: float,
    first: int,
    table_gamma: float,
    omega: np.ndarray,
    heated: bool,
    printed: bool,
    parameters: np.ndarray,
    node: np.ndarray,
    gas: np.ndarray,
    stage: np.ndarray,
    work: np.ndarray,
) -> tuple[float, float]:
    """Both ports shut, Eq. 17, through the segments ``first`` and ``first + 1``: K = P V^gamma changes by heat alone.

    The ports are symmetric, so the volume at the end is that at the start. Returns the pressure at the end [Pa] and
    what heat adds to the gas's work [J].
    """
    if not heated:
        return P, 0.0
    R, cp, T_a, factor = gas[at.GAS_R], gas[at.GAS_CP], parameters[at.T_A], parameters[at.HEAT_FACTOR]
    gamma = cp / (cp - R)
    power = math.exp(gamma * math.log(V_end))
    added = 0.0
    gas_work = 0.0
    rate, falls, falls_by = np.empty(N_GAUSS), np.empty(N_GAUSS), np.empty(N_GAUSS)
    for segment in range(first, first + 2):
        begin = segment * N_GAUSS
        # The row of Table 2 follows the sign of dV, which the whole segment shares.
        phase = EXPANSION if node[begin, DVOLUME] > 0.0 else COMPRESSION
        span = node[begin, SPAN]
        for i in range(N_GAUSS):
            n = begin + i
            V = node[n, VOLUME]
            x = (table_gamma - gamma) * node[n, LOG_V]  # below a hundredth, so that this is V^-gamma to 1e-9
            falls[i] = node[n, V_POWER] * (1.0 + x * (1.0 + x * (0.5 + x / 6.0)))
            p = (P * power + added + stage[n]) * falls[i]
            T = p * V / (m * R)
            resistance = resistance_per_angle(phase, p, T, omega[n], node[n], parameters, gas, printed)
            rate[i] = (gamma - 1.0) / (falls[i] * V) * (factor * (T_a - T) / resistance)
            falls_by[i] = (gamma - 1.0) * factor / resistance / (m * R)
        change = _collect(rate, falls_by, span, stage[begin : begin + N_GAUSS])
        for i in range(N_GAUSS):
            n = begin + i
            pressure = span * GAUSS_WEIGHT[i] * (added + stage[n]) * falls[i]
            work[n] = pressure * (node[n, ARM_GAS] - parameters[at.F_R] * node[n, ARM_ROLL])
            gas_work += pressure * node[n, ARM_GAS]
        added += change
    return P + added / power, gas_work


@njit(error_model="numpy", cache=True)
def friction_below_ambient(
    P_s: float, gamma: float, V_high: float, parameters: np.ndarray, readings: np.ndarray, node: np.ndarray
) -> float:
    """Mean torque that roller friction takes beyond f_r F, where a closed cylinder falls below P_a (erratum 5) [N m].

    It matters below 1.1 bar only.

    `P_s`: pressure in suction [Pa].
    `V_high`: volume when the inlet shuts [m3].
    """
    if readings[at.FRICTION_AS_PRINTED] > 0.0:
        return 0.0
    P_a, f_r = parameters[at.P_A], parameters[at.F_R]
    power = math.exp(gamma * math.log(V_high))
    lost = 0.0
    for n in range(4 * N_GAUSS, N_NODES):
        F = P_s * node[n, V_POWER] * power - P_a
        if F < 0.0:
            lost -= 2.0 * node[n, SPAN] * GAUSS_WEIGHT[n % N_GAUSS] * F * f_r * node[n, ARM_ROLL]
    return lost * parameters[at.N_PISTONS] / geometry.lobe_angle(parameters)
