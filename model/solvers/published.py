"""The article's own algorithm (section 2.4 and 3), kept plain: explicit steps of 75 us.

Each step solves the motion from the old gas state, moves the angle, then the volume, the phase and the gas. It is the
reference that the other solvers are held to, and it carries the article's own error: 0.3 % in speed, most of it
unfinished spin-up (docs/model.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from configs.compiled import njit
from model import geometry, motion
from model import layout as at
from model.gas.cylinder import CLOSED, INLET, OUTLET, gas_state, open_flow, open_port, phase_of, port_at
from model.gas.heat_transfer import cylinder_heat
from model.motor import Motor

TIME_STEP = 75e-6  # s
STEPS = 9000
FIRST_AVERAGED = 5000


@dataclass(frozen=True)
class March:
    """What the published algorithm gives.

    `time_s`, shape (steps,): end of each step.
    `speed_rad_s`, `angle_rad`, shape (steps,): rotor speed and angle.
    `pressure_pa`, `mass_kg`, shape (steps,): of the cylinder that starts at angle 0.
    `inlet_kg_s`, `outlet_kg_s`, shape (steps,): flow through all inlet and outlet ports, in and out counted positive.
    `mean_speed_rpm`: average over the steps from ``FIRST_AVERAGED`` on (the second half, if fewer were asked for).
    """

    time_s: np.ndarray
    speed_rad_s: np.ndarray
    angle_rad: np.ndarray
    pressure_pa: np.ndarray
    mass_kg: np.ndarray
    inlet_kg_s: np.ndarray
    outlet_kg_s: np.ndarray
    mean_speed_rpm: float


# In one piece, its parts share their running values: `model.solvers`.
@njit(cache=True)
def march_kernel(
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    P_in: float,
    dt: float,
    steps: int,
    history: np.ndarray,
) -> None:
    """March ``steps`` steps from rest; the equations in the article's order.

    `dt`: time step [s].
    `steps`: number of steps.
    `history`, shape (steps, 6): filled with speed [rad/s], angle [rad], pressure [Pa] and mass [kg] of the first
        cylinder, inlet and outlet flow of all [kg/s].
    """
    n, lobes = int(parameters[at.N_PISTONS]), parameters[at.N_LOBES]
    c = np.empty(at.N_CURVE)
    geometry.curve(parameters, c)
    R, cp = gas[at.GAS_R], gas[at.GAS_CP]
    cv = cp - R
    A_p, lap, P_a, lobe = c[at.A_P], parameters[at.LAP], parameters[at.P_A], c[at.LOBE_ANGLE]
    P_port = np.array([P_a + parameters[at.DP_OUT], P_in - parameters[at.DP_IN]])
    T_port = np.array([parameters[at.T_A], parameters[at.T_IN]])
    virtual_work = readings[at.VIRTUAL_WORK] > 0.0
    as_printed = readings[at.FRICTION_AS_PRINTED] > 0.0
    per_area = readings[at.WALL_AS_PRINTED] == 0.0
    heated = readings[at.HEAT_TRANSFER] > 0.0

    # At rest every cylinder holds vented air; the supply opens at t = 0 into those that stand at an inlet port.
    P = np.full(n, P_port[OUTLET])
    T = np.full(n, parameters[at.T_A])
    V = np.empty(n)
    m = np.empty(n)
    flow = np.zeros(n)
    port = np.empty(n, np.int64)
    for i in range(n):
        psi = (i * lobe * lobes / n) % lobe
        L4, _, _, _ = geometry.place(psi, c)
        V[i] = geometry.volume(L4, A_p, c[at.V_OFFSET])
        port[i] = port_at(psi, lap, lobe)
        if port[i] == INLET:
            T[i], _ = open_port(P[i], T[i], V[i], P_port[INLET], T_port[INLET], gas)
            P[i] = P_port[INLET]
        m[i] = P[i] * V[i] / (R * T[i])

    omega = 0.0
    theta = 0.0
    for step in range(steps):
        # Motion, from the previous gas state.
        drive = 0.0
        friction = 0.0
        for i in range(n):
            L4, sin_phi, cos_phi, r = geometry.place((theta + i * lobe * lobes / n) % lobe, c)
            F = motion.piston_force(A_p, P[i], P_a)
            drive += F * motion.gas_arm(L4, sin_phi, cos_phi, r, virtual_work)
            friction += motion.roller_torque(F, parameters[at.F_R], cos_phi, r, as_printed)
        if omega > 0.0 or (omega == 0.0 and drive > friction):
            omega += dt * motion.acceleration(drive - friction, parameters[at.F_OVERALL], omega, parameters[at.J])
        elif omega < 0.0 or drive < -friction:
            omega += dt * motion.acceleration(drive + friction, parameters[at.F_OVERALL], omega, parameters[at.J])
        theta += omega * dt

        # Volume, phase and gas, at the new angle.
        through = np.zeros(2)
        for i in range(n):
            psi = (theta + i * lobe * lobes / n) % lobe
            L4, sin_phi, cos_phi, _ = geometry.place(psi, c)
            V_new = geometry.volume(L4, A_p, c[at.V_OFFSET])
            dV = V_new - V[i]
            now = port_at(psi, lap, lobe)
            Q = 0.0
            if heated:
                V_p = abs(L4 * sin_phi / cos_phi * omega)
                Q = cylinder_heat(phase_of(now, dV), P[i], T[i], V[i], V_p, flow[i], parameters, A_p, gas, per_area)
            if now == CLOSED:  # Eq. 17: the work of the volume exactly, the heat explicitly
                T[i] = T[i] * (V[i] / V_new) ** (R / cv) + Q * dt / (m[i] * cv)
                P[i] = m[i] * R * T[i] / V_new
                flow[i] = 0.0
            else:
                if port[i] != now:
                    T[i], _ = open_port(P[i], T[i], V[i], P_port[now], T_port[now], gas)
                    P[i] = P_port[now]
                flow[i] = open_flow(P[i], T[i], dV / dt, Q, T_port[now], gas)  # Eq. 15 and 16
                m_new = P[i] * V[i] / (R * T[i]) + flow[i] * dt
                T[i] = P[i] * V_new / (R * m_new)
                through[now] += m_new - m[i]
                m[i] = m_new
            V[i] = V_new
            port[i] = now

        history[step, 0] = omega
        history[step, 1] = theta
        history[step, 2] = P[0]
        history[step, 3] = m[0]
        history[step, 4] = through[INLET] / dt
        history[step, 5] = -through[OUTLET] / dt


def march(motor: Motor, P_in: float, steps: int = STEPS, dt: float = TIME_STEP) -> March:
    """Run the published algorithm from rest.

    `steps`: number of steps [-].
    `dt`: time step [s].
    Returns histories and the averaged speed. Raises ValueError when ``steps`` is below 2 or ``dt`` is not positive.
    """
    if steps < 2 or not dt > 0.0:
        raise ValueError(f"march: needs at least 2 steps of positive length, got {steps} of {dt:g} s")
    history = np.empty((steps, 6))
    parameters, readings = motor.vector(), motor.readings.vector()
    gas = gas_state(parameters, P_in, readings)
    march_kernel(parameters, readings, gas, float(P_in), float(dt), steps, history)
    first = FIRST_AVERAGED if steps > FIRST_AVERAGED else steps // 2
    speed = history[:, 0]
    return March(
        time_s=dt * np.arange(1, steps + 1),
        speed_rad_s=speed,
        angle_rad=history[:, 1],
        pressure_pa=history[:, 2],
        mass_kg=history[:, 3],
        inlet_kg_s=history[:, 4],
        outlet_kg_s=history[:, 5],
        mean_speed_rpm=float(speed[first:].mean()) * 30.0 / math.pi,
    )
