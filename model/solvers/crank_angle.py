"""The motor between two edges of its ports: the state, its rates, and a step in the angle of the crank."""

from __future__ import annotations

import numpy as np

from configs.compiled import njit
from model import geometry, motion
from model import layout as at
from model.gas.cylinder import CLOSED, INLET, closed_rate, open_flow, phase_of
from model.gas.heat_transfer import cylinder_heat

# State vector: angle, speed, what has passed since the start, then the cylinders' pressures and their temperatures.
THETA = 0
OMEGA = 1
M_IN = 2  # mass in through the inlet [kg]
M_OUT = M_IN + 1  # mass out through the outlet [kg]
H_IN = M_OUT + 1  # enthalpy in through the inlet [J]
H_OUT = H_IN + 1  # enthalpy out through the outlet [J]
Q_IN = H_OUT + 1  # heat into the gas [J]
W_GAS = Q_IN + 1  # work of the gas torque on the rotor [J]
W_ROLLER = W_GAS + 1  # work lost in roller friction [J]
P0 = W_ROLLER + 1  # pressure of the first cylinder [Pa]; behind the last one's, their temperatures [K]
N_EDGES = 8


@njit(error_model="numpy", cache=True)
def edges(parameters: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Rotor angles within a pulse where some cylinder passes a port edge, an arc junction or a dead centre [rad]."""
    lap, half, lobe = parameters[at.LAP], c[at.HALF_LOBE], c[at.LOBE_ANGLE]
    psi = np.array(
        [lap, half - lap, half + lap, lobe - lap, c[at.ALPHA], lobe - c[at.ALPHA], half, 0.0], dtype=np.float64
    )
    edge = np.sort(psi % c[at.PULSE_ANGLE])
    for i in range(1, N_EDGES):  # edges that coincide are set apart by what no one can see
        edge[i] = max(edge[i], edge[i - 1] + 1e-9)
    return edge


# Numba takes arrays one by one; in one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def rates(
    y: np.ndarray,
    dy: np.ndarray,
    port: np.ndarray,
    sense: float,
    T_port: np.ndarray,
    parameters: np.ndarray,
    c: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
) -> float:
    """Rate of the whole state, Eq. 12-25, with the ports as they stand.

    `y`, `dy`, shape (9 + 2 n,): state [SI] and, filled, its rate.
    Returns what friction holds: the rollers', and what a left-out effect adds to it [N m].
    """
    R, cp = gas[at.GAS_R], gas[at.GAS_CP]
    gamma = cp / (cp - R)
    A_p, omega = c[at.A_P], y[OMEGA]
    T0 = P0 + port.size
    drive = 0.0
    friction = 0.0
    dy[M_IN:P0] = 0.0
    for i in range(port.size):
        psi = (y[THETA] + i * c[at.PITCH]) % c[at.LOBE_ANGLE]
        L4, sin_phi, cos_phi, r = geometry.place(psi, c)
        V = geometry.volume(L4, A_p, c[at.V_OFFSET])
        dL4dt = L4 * sin_phi / cos_phi * omega
        dVdt = A_p * dL4dt
        P, T = y[P0 + i], y[T0 + i]
        F = motion.piston_force(A_p, P, parameters[at.P_A])
        drive += F * motion.gas_arm(L4, sin_phi, cos_phi, r, readings[at.VIRTUAL_WORK] > 0.0)
        friction += motion.roller_torque(F, parameters[at.F_R], cos_phi, r, readings[at.FRICTION_AS_PRINTED] > 0.0)
        Q = 0.0
        if readings[at.HEAT_TRANSFER] > 0.0:
            # Eq. 20 takes the flow without heat: the heat's own share of it is below 1e-4 of Q.
            flow = 0.0 if port[i] == CLOSED else open_flow(P, T, dVdt, 0.0, T_port[port[i]], gas)
            Q = parameters[at.HEAT_FACTOR] * cylinder_heat(
                phase_of(port[i], dVdt), P, T, V, abs(dL4dt), flow, parameters, A_p, gas, readings[1] == 0.0
            )
        if port[i] == CLOSED:
            dP = closed_rate(P, V, dVdt, Q, gamma)
            dy[P0 + i] = dP
            dy[T0 + i] = T * (dP / P + dVdt / V)
        else:
            T_p = T_port[port[i]]
            mdot = open_flow(P, T, dVdt, Q, T_p, gas)
            h = cp * (T_p if mdot > 0.0 else T)
            dy[P0 + i] = 0.0
            dy[T0 + i] = T * (dVdt / V - mdot * R * T / (P * V))
            if port[i] == INLET:
                dy[M_IN] += mdot
                dy[H_IN] += mdot * h
            else:
                dy[M_OUT] -= mdot
                dy[H_OUT] -= mdot * h
        dy[Q_IN] += Q
    friction += parameters[at.EXTRA_TORQUE]
    dy[THETA] = omega
    dy[OMEGA] = motion.acceleration(drive - sense * friction, parameters[at.F_OVERALL], omega, parameters[at.J])
    dy[W_GAS] = drive * omega
    dy[W_ROLLER] = friction * abs(omega)
    return friction


# Numba takes arrays one by one: `model.solvers`.
@njit(error_model="numpy", cache=True)
def runge_kutta(
    y: np.ndarray,
    h: float,
    work: np.ndarray,
    port: np.ndarray,
    sense: float,
    T_port: np.ndarray,
    parameters: np.ndarray,
    c: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
) -> None:
    """One classical step of fourth order; ``work[0]`` holds the rate at the start, ``work[4]`` receives the new state.

    `h`: step [s].
    """
    new, trial = work[4], work[5]
    trial[:] = y + 0.5 * h * work[0]
    rates(trial, work[1], port, sense, T_port, parameters, c, gas, readings)
    trial[:] = y + 0.5 * h * work[1]
    rates(trial, work[2], port, sense, T_port, parameters, c, gas, readings)
    trial[:] = y + h * work[2]
    rates(trial, work[3], port, sense, T_port, parameters, c, gas, readings)
    new[:] = y + (h / 6.0) * (work[0] + 2.0 * work[1] + 2.0 * work[2] + work[3])


# Numba takes arrays one by one: `model.solvers`.
@njit(error_model="numpy", cache=True)
def angle_step(
    y: np.ndarray,
    target: float,
    work: np.ndarray,
    port: np.ndarray,
    sense: float,
    T_port: np.ndarray,
    parameters: np.ndarray,
    c: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
) -> float:
    """One step of fourth order with the angle as the independent variable: it ends on the edge without a search.

    `target`: angle at the end [rad].
    Returns time taken [s]; -1 when the speed changes too much for this variable, and ``work[4]`` means nothing.
    """
    trial, new = work[5], work[4]
    span = target - y[THETA]
    slowest = 0.3 * abs(y[OMEGA])
    pace = 1.0 / y[OMEGA]
    new[:] = work[0] * (pace / 6.0)
    time = pace / 6.0
    for k in range(1, 4):
        part = 1.0 if k == 3 else 0.5
        trial[:] = y + (part * span * pace) * work[k - 1]
        trial[THETA] = y[THETA] + part * span
        rates(trial, work[k], port, sense, T_port, parameters, c, gas, readings)
        if sense * trial[OMEGA] < slowest:
            return -1.0
        pace = 1.0 / trial[OMEGA]
        weight = pace / 6.0 if k == 3 else pace / 3.0
        new[:] += weight * work[k]
        time += weight
    new[:] = y + span * new
    new[THETA] = target
    return span * time
