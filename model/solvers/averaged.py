"""Mean torque and flow over a turn at a given speed: what a run in time follows when single pulses are left aside.

It is the steady cycle of `steady` with the speed held, so it has no ripple, and a change of pressure takes effect
at once. Against `transient` that is wrong by a few per cent of a run's speed for the first hundredths of a second
after a valve turns, and by the pulses. What a run does when a parameter changes a little it has right to about a
hundredth of that change, and smoothly.
"""

from __future__ import annotations

import numpy as np

from configs.compiled import njit
from model import geometry
from model import layout as at
from model.gas import heat_cycle
from model.solvers import pulse

NET, MASS_FLOW, LOAD = range(3)
N_OUT = 3
MOST_PASSES = 30
TOLERANCE = 1e-9  # relative change of the temperature in the last pass


@njit(error_model="numpy", cache=True, nogil=True)
def torques(
    parameters: np.ndarray, readings: np.ndarray, gas: np.ndarray, P_in: float, omega: np.ndarray, out: np.ndarray
) -> tuple[float, float]:
    """Mean torque and flow at speeds that are held, at one pressure of the line.

    `P_in`: pressure of the line [Pa]; that of the ambient where it is vented.
    `omega`, shape (n,): speeds above 0 [rad/s], increasing; where the heat cannot be solved for, the next one stands
        in.
    `out`, shape (n, 3): filled: torque of the gas less roller friction [N m], mass flow through the inlet [kg/s], and
        roller torque per unit of f_r [N m]. Viscous friction and the extra torque are not in it.
    Returns `in_slope, out_slope`: what the torque gains per pressure in the cylinders' suction and in their discharge
    [N m/Pa].
    """
    slopes = np.empty((1, 2))
    each = np.empty((1, omega.size, N_OUT))
    torques_of_line(parameters, readings, gas, np.array([P_in]), omega, each, slopes)
    out[:] = each[0]
    return slopes[0, 0], slopes[0, 1]


# In one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True, nogil=True)
def torques_of_line(
    parameters: np.ndarray,
    readings: np.ndarray,
    gas: np.ndarray,
    pressures: np.ndarray,
    omega: np.ndarray,
    out: np.ndarray,
    slopes: np.ndarray,
) -> None:
    """`torques` at several pressures of the line, which share what hangs on the geometry and the gas alone.

    `pressures`, shape (k,): of the line [Pa].
    `omega`, shape (n,): as in `torques` [rad/s].
    `out`, shape (k, n, 3): filled, as in `torques`.
    `slopes`, shape (k, 2): filled with what `torques` returns [N m/Pa].
    """
    c = np.empty(at.N_CURVE)
    table = np.empty((pulse.N_STEPS, pulse.N_TABLE))
    node = np.empty((heat_cycle.N_NODES, heat_cycle.N_NODE))
    work = np.empty(heat_cycle.N_NODES)
    held = np.empty(heat_cycle.N_NODES)
    steps = np.empty(pulse.N_STEPS)
    geometry.curve(parameters, c)
    gamma = gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R])
    pulse.tabulate(parameters, readings, gamma, c, table)
    V_low, V_high = heat_cycle.place_nodes(parameters, readings, gamma, c, node)
    P_a, f_r, period = parameters[at.P_A], parameters[at.F_R], c[at.PULSE_ANGLE]
    P_d = P_a + parameters[at.DP_OUT]
    for k in range(pressures.size):
        stage = np.zeros(heat_cycle.N_NODES)
        P_s = pressures[k] - parameters[at.DP_IN]
        net, gas_torque = pulse.torque_steps(P_s, P_d, P_a, 0.0, f_r, period, table, steps)
        lost = heat_cycle.friction_below_ambient(P_s, gamma, V_high, parameters, readings, node)
        T_first = parameters[at.T_IN] * min(P_d / P_s, 1.0) ** (1.0 - 1.0 / gamma)
        T, m_in = T_first, 0.0
        for i in range(omega.size):
            held[:] = omega[i]
            for _ in range(MOST_PASSES):
                after, m_in, _ = heat_cycle.pass_cycle(
                    T, P_s, P_d, held, V_low, V_high, gamma, parameters, readings, node, gas, stage, work
                )
                settled = abs(after - T) <= TOLERANCE * T
                T = after
                if settled or not np.isfinite(T):
                    break
            if not np.isfinite(T):  # so much heat at so little speed that the passes run away
                T = T_first
                stage[:] = 0.0
                out[k, i, NET] = np.nan
                continue
            out[k, i, NET] = net - lost + np.sum(work) / period
            out[k, i, MASS_FLOW] = m_in / period * omega[i]
            out[k, i, LOAD] = (gas_torque - net + lost) / max(f_r, 1e-9)
        for i in range(omega.size - 2, -1, -1):  # there the gas has the wall's temperature, as at the next speed
            if not np.isfinite(out[k, i, NET]):
                out[k, i] = out[k, i + 1]
                out[k, i, MASS_FLOW] *= omega[i] / omega[i + 1]
        slopes[k, 0] = pulse.gain(table, pulse.GAS_S, pulse.ROLL_S, f_r, period)
        slopes[k, 1] = pulse.gain(table, pulse.GAS_D, pulse.ROLL_D, f_r, period)
