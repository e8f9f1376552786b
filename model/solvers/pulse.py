"""The torque over one pulse, 28 a turn for seven pistons on four lobes, and the ripple of the speed that it makes.

With the ports open a cylinder stands at the port's pressure; without heat a closed one follows P V^gamma. So the torque
at every angle is linear in P_s, P_d and P_a, and its integrals over small steps of angle are tabulated once for a
parameter set. The speed within a pulse then follows from the energy integral, w dw/dth = (torque - f w) / J.

`table`, shape (n_steps, 11): of `tabulate`; the steps' widths are in it [rad].
`step_work`, shape (n_steps,): gas torque less roller friction, integrated over each step [J].
`speed`, shape (n_steps + 1,): of `ripple`, at the ends of the steps [rad/s].
`pulse`: angle of a pulse [rad].
`first`: angle of the first edge [rad].
`phase`, shape (n,): angles within the pulse [rad].
`step`, shape (n,): the step that each angle lies in [-].
"""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit
from model import geometry, motion
from model import layout as at
from model.gas.cylinder import INLET, OUTLET, port_at
from model.solvers.crank_angle import N_EDGES, edges

STEPS_PER_EDGE = 4  # steps between neighbouring edges, two Gauss points each
N_STEPS = N_EDGES * STEPS_PER_EDGE
GAUSS = 0.5 / math.sqrt(3.0)

# Columns: the step's width [rad]; torque integrals for each pressure [m3], of the gas and of roller friction per f_r;
# derivatives of both with gamma.
WIDTH, GAS_S, GAS_D, GAS_A, ROLL_S, ROLL_D, ROLL_A, SLOPE_S, SLOPE_D, ROLL_SLOPE_S, ROLL_SLOPE_D = range(11)
N_TABLE = 11


# In one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def tabulate(parameters: np.ndarray, readings: np.ndarray, gamma: float, c: np.ndarray, table: np.ndarray) -> float:
    """Integrals of the adiabatic torque of all cylinders over the steps of one pulse; returns its first edge [rad].

    They hang on the geometry, the lap and gamma alone: rows that differ in other things share them.

    `gamma`: ratio of specific heats of the table [-].
    `table`, shape (n_steps, 11): filled.
    """
    A_p, lap, half, lobe = c[at.A_P], parameters[at.LAP], c[at.HALF_LOBE], c[at.LOBE_ANGLE]
    pulse, n = c[at.PULSE_ANGLE], int(parameters[at.N_PISTONS])
    virtual_work = readings[at.VIRTUAL_WORK] > 0.0
    V_low = geometry.volume(geometry.place(half - lap, c)[0], A_p, c[at.V_OFFSET])
    V_high = geometry.volume(geometry.place(lobe - lap, c)[0], A_p, c[at.V_OFFSET])
    edge = edges(parameters, c)
    table[:] = 0.0
    for step in range(N_STEPS):
        k = step // STEPS_PER_EDGE
        hi = edge[k + 1] if k < N_EDGES - 1 else edge[0] + pulse
        width = (hi - edge[k]) / STEPS_PER_EDGE
        row = table[step]
        row[WIDTH] = width
        for g in range(2):
            th = edge[k] + width * (step % STEPS_PER_EDGE + 0.5 + (GAUSS if g else -GAUSS))
            for i in range(n):
                psi = (th + i * pulse) % lobe
                L4, sin_phi, cos_phi, r = geometry.place(psi, c)
                weight = 0.5 * width * A_p
                gas_arm = weight * motion.gas_arm(L4, sin_phi, cos_phi, r, virtual_work)
                roll_arm = weight * cos_phi * r
                row[GAS_A] += gas_arm
                row[ROLL_A] += roll_arm
                port = port_at(psi, lap, lobe)
                if port == INLET:
                    row[GAS_S] += gas_arm
                    row[ROLL_S] += roll_arm
                elif port == OUTLET:
                    row[GAS_D] += gas_arm
                    row[ROLL_D] += roll_arm
                else:
                    V = geometry.volume(L4, A_p, c[at.V_OFFSET])
                    inner = lap <= psi < lobe - lap  # shut at P_d around the inner dead centre, at P_s the outer
                    log = math.log((V_low if inner else V_high) / V)
                    rise = math.exp(gamma * log)
                    if inner:
                        row[GAS_D] += rise * gas_arm
                        row[ROLL_D] += rise * roll_arm
                        row[SLOPE_D] += log * rise * gas_arm
                        row[ROLL_SLOPE_D] += log * rise * roll_arm
                    else:
                        row[GAS_S] += rise * gas_arm
                        row[ROLL_S] += rise * roll_arm
                        row[SLOPE_S] += log * rise * gas_arm
                        row[ROLL_SLOPE_S] += log * rise * roll_arm
    first: float = edge[0]
    return first


@njit(error_model="numpy", cache=True)
def torque_steps(
    P_s: float,
    P_d: float,
    P_a: float,
    d_gamma: float,
    f_r: float,
    pulse: float,
    table: np.ndarray,
    step_work: np.ndarray,
) -> tuple[float, float]:
    """Adiabatic torque at given pressures.

    `P_s`, `P_d`, `P_a`: pressure in suction, in discharge and of the ambient [Pa].
    `d_gamma`: the point's gamma less the table's [-].
    `step_work`, shape (n_steps,): filled with gas torque less roller friction, integrated over each step [J].
    Returns `net, gas`: mean torque less roller friction, and of the gas alone [N m].
    """
    net = 0.0
    gas = 0.0
    for j in range(N_STEPS):
        row = table[j]
        of_gas = P_s * (row[GAS_S] + d_gamma * row[SLOPE_S]) + P_d * (row[GAS_D] + d_gamma * row[SLOPE_D])
        rolling = P_s * (row[ROLL_S] + d_gamma * row[ROLL_SLOPE_S]) + P_d * (row[ROLL_D] + d_gamma * row[ROLL_SLOPE_D])
        of_gas -= P_a * row[GAS_A]
        step_work[j] = of_gas - f_r * (rolling - P_a * row[ROLL_A])
        net += step_work[j]
        gas += of_gas
    return net / pulse, gas / pulse


@njit(error_model="numpy", cache=True, nogil=True)
def gain(table: np.ndarray, of_gas: int, rolling: int, f_r: float, pulse: float) -> float:
    """What the mean torque less roller friction gains per pressure [N m/Pa].

    `of_gas`, `rolling`: columns of the pressure: GAS_S and ROLL_S, or GAS_D and ROLL_D [-].
    """
    found: float = (np.sum(table[:, of_gas]) - f_r * np.sum(table[:, rolling])) / pulse
    return found


# In one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True)
def ripple(
    w: float,
    step_work: np.ndarray,
    table: np.ndarray,
    f: float,
    J: float,
    pulse: float,
    stride: int,
    speed: np.ndarray,
) -> tuple[float, float, float]:
    """The periodic speed within one pulse, w dw/dth = (torque - f w) / J.

    The torque's integral over a step is exact; friction takes the mean of the speeds at both ends (second order).

    `w`: first guess of the speed at the start of the pulse [rad/s].
    `f`, `J`: f_overall [N m s] and inertia [kg m2].
    `stride`: steps of the table taken as one: 1, or 2 for the coarse solution that `rippled_mean` extrapolates from.
    `speed`, shape (n_steps + 1,): filled with the speed at the ends of the steps taken [rad/s].
    Returns `w`: speed at the start of the pulse [rad/s]; -1 when the rotor cannot pass; `mean`: mean speed in time
    [rad/s]; `peak_to_peak`: ripple [rad/s].
    """
    failed = 0
    for _ in range(200):
        v = w
        time = 0.0
        gain_up = 1.0
        gain_down = 1.0
        fastest = w
        slowest = w
        speed[0] = w
        for j in range(0, N_STEPS, stride):
            width = stride * table[j, WIDTH]
            work = step_work[j]
            for i in range(1, stride):
                work += step_work[j + i]
            drag = 0.5 * f * width / J
            square = (v - drag) ** 2 + 2.0 * work / J
            after = math.sqrt(square) - drag if square > 0.0 else -1.0
            if after <= 0.0 or (v <= drag and work <= 0.0):
                time = -1.0
                break
            time += 2.0 * width / (v + after)
            gain_up *= v - drag
            gain_down *= after + drag
            v = after
            speed[j // stride + 1] = v
            fastest = max(fastest, v)
            slowest = min(slowest, v)
        if time < 0.0:
            failed += 1
            if failed > 40:
                break
            w = 1.15 * w + 0.1  # from above the iteration comes down to the periodic speed if there is one
            continue
        miss = v - w
        if abs(miss) <= 1e-11 * w:
            return w, pulse / time, fastest - slowest
        gain = gain_up / gain_down
        # Newton; while the start is being raised, the rotor's own approach, which cannot overshoot into a stall.
        w = w + miss / (1.0 - gain) if failed == 0 and gain < 1.0 else v
        if w <= 0.0:
            w = v
            failed += 1
    return -1.0, 0.0, 0.0


@njit(error_model="numpy", cache=True)
def rippled_mean(
    w: float,
    step_work: np.ndarray,
    table: np.ndarray,
    f: float,
    J: float,
    pulse: float,
    speed: np.ndarray,
    coarse_speed: np.ndarray,
) -> tuple[float, float, float]:
    """`ripple`, its mean speed extrapolated from two step widths (Richardson): the error falls to fourth order.

    `w`, `step_work`, `table`, `f`, `J`, `pulse`, `speed`: as in `ripple`.
    `coarse_speed`, shape (n_steps + 1,): scratch [rad/s].
    Returns `w, mean, peak_to_peak`: as in `ripple` [rad/s].
    """
    w, fine, peak_to_peak = ripple(w, step_work, table, f, J, pulse, 1, speed)
    if w < 0.0:
        return w, fine, peak_to_peak
    w_coarse, coarse, _ = ripple(w, step_work, table, f, J, pulse, 2, coarse_speed)
    return w, fine if w_coarse < 0.0 else fine + (fine - coarse) / 3.0, peak_to_peak


@njit(error_model="numpy", cache=True)
def speeds_at(
    phase: np.ndarray, step: np.ndarray, table: np.ndarray, first: float, speed: np.ndarray, omega: np.ndarray
) -> None:
    """Speed at angles within the pulse; within a step the square of the speed is linear in the angle.

    `omega`, shape (n,): filled [rad/s].
    """
    start = first
    j = 0
    for n in range(phase.size):
        while j > step[n]:
            j -= 1
            start -= table[j, WIDTH]
        while j < step[n]:
            start += table[j, WIDTH]
            j += 1
        s = (phase[n] - start) / table[j, WIDTH]
        omega[n] = math.sqrt((1.0 - s) * speed[j] ** 2 + s * speed[j + 1] ** 2)


@njit(error_model="numpy", cache=True)
def steps_of(phase: np.ndarray, table: np.ndarray, first: float, pulse: float, step: np.ndarray) -> None:
    """The step of the table in which each angle lies.

    `phase`, shape (n,): angles within the pulse [rad]; those before the first edge are moved on by a pulse.
    `step`, shape (n,): filled [-].
    """
    for n in range(phase.size):
        if phase[n] < first:
            phase[n] += pulse
        j = 0
        end = first + table[0, WIDTH]
        while j < N_STEPS - 1 and phase[n] > end:
            j += 1
            end += table[j, WIDTH]
        step[n] = j
