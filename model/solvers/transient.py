"""The motor in time: crank-angle resolved, for spin-up, coast-down, stall and break-away.

Between two neighbouring port edges, arc junctions and dead centres everything is smooth, so the integrator (classical
Runge-Kutta of fourth order) steps from one such angle to the next and lands on each exactly: ports open where they
open, and the order of convergence is kept. The cylinders share their edges modulo a pulse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from configs.compiled import njit
from model import geometry
from model import layout as at
from model.gas.cylinder import CLOSED, INLET, gas_state
from model.motor import Motor
from model.solvers.crank_angle import (
    M_IN,
    M_OUT,
    N_EDGES,
    OMEGA,
    P0,
    THETA,
    angle_step,
    edges,
    rates,
)
from model.solvers.port_edges import AT_EDGE, ON_THE_WAY, STOPPED, locate, set_ports

MAX_STEP = 1e-3  # s, divided by the refinement
GIVEN_RAD_S = 30.0  # speed at the start: near its lowest pressure a motor runs on but does not start
MOST_TURNS = 400  # after which a speed does not settle
DONE, TOO_MANY_STEPS, NOT_FINITE = 0, 1, 2


class Supply(NamedTuple):
    """One span of the line: from ``start_s`` on, ``pressure_pa`` (absolute) with the valve open or vented."""

    start_s: float
    pressure_pa: float
    is_open: bool = True


@dataclass(frozen=True)
class Transient:
    """The motor in time.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        The sample times.
    angle_rad, speed_rad_s : ndarray, shape (n,)
        Rotor angle and instantaneous speed.
    inlet_kg, outlet_kg : ndarray, shape (n,)
        Mass that has passed the inlet (in) and the outlet (out) since the start.
    pressure_pa, mass_kg : ndarray, shape (n,)
        Of the cylinder that starts at angle 0.
    state : ndarray, shape (9 + 2 n,)
        At the end; give it to `simulate` to go on.
    """

    time_s: np.ndarray
    angle_rad: np.ndarray
    speed_rad_s: np.ndarray
    inlet_kg: np.ndarray
    outlet_kg: np.ndarray
    pressure_pa: np.ndarray
    mass_kg: np.ndarray
    state: np.ndarray

    def mean_speed_rad_s(self) -> np.ndarray:
        """Mean speed since the sample before [rad/s], shape (n,); the first is the instantaneous one."""
        mean = self.speed_rad_s.copy()
        mean[1:] = np.diff(self.angle_rad) / np.diff(self.time_s)
        return mean


@njit(error_model="numpy", cache=True)
def _interval(theta: float, edge: np.ndarray, pulse: float) -> tuple[int, int]:
    """The pulse an angle lies in, and k: it is in [edge k, edge k + 1) of it; edge 8 is edge 0 of the next."""
    block = math.floor(theta / pulse)
    k = 0
    while k < N_EDGES - 1 and theta >= block * pulse + edge[k + 1]:
        k += 1
    if theta < block * pulse + edge[0]:
        return block - 1, N_EDGES - 1
    return block, k


@njit(error_model="numpy", cache=True)
def _target(theta: float, lo: float, hi: float, sense: float, refine: int) -> float:
    """Where the next step is to end: the next of ``refine`` equal parts between two edges [rad]."""
    width = (hi - lo) / refine
    if sense > 0.0:
        target = lo + width * (math.floor((theta - lo) / width + 1e-9) + 1.0)
        return hi if target > hi - 0.5 * width else target
    target = lo + width * (math.ceil((theta - lo) / width - 1e-9) - 1.0)
    return lo if target < lo + 0.5 * width else target


@njit(error_model="numpy", cache=True)
def _time_to(distance: float, w: float, a: float, sense: float, most: float) -> float:
    """Time to an angle ahead from a speed at an acceleration [s], if it gets there, and no more than ``most``."""
    root = w * w + 2.0 * a * distance
    if root > 0.0:
        reach = 2.0 * distance / (w + sense * math.sqrt(root))
        if reach > 0.0:
            return min(most, reach)
    return most


@njit(error_model="numpy", cache=True)
def _fill_sample(row: np.ndarray, s: float, h: float, y: np.ndarray, new: np.ndarray, c: np.ndarray, R: float) -> None:
    """Fill a sample at a share s of a step h: the angle of a cubic, the rest in a straight line."""
    s2, s3 = s * s, s * s * s
    row[0] = (
        (1.0 - 3.0 * s2 + 2.0 * s3) * y[THETA]
        + (s - 2.0 * s2 + s3) * h * y[OMEGA]
        + (3.0 * s2 - 2.0 * s3) * new[THETA]
        + (s3 - s2) * h * new[OMEGA]
    )
    row[1] = (1.0 - s) * y[OMEGA] + s * new[OMEGA]
    row[2] = (1.0 - s) * y[M_IN] + s * new[M_IN]
    row[3] = (1.0 - s) * y[M_OUT] + s * new[M_OUT]
    row[4] = (1.0 - s) * y[P0] + s * new[P0]
    V = geometry.volume(geometry.place(row[0] % c[at.LOBE_ANGLE], c)[0], c[at.A_P], c[at.V_OFFSET])
    first = (y.size + P0) // 2
    row[5] = row[4] * V / (R * ((1.0 - s) * y[first] + s * new[first]))


# Numba takes arrays one by one; in one piece, its parts share their running values: `model.solvers`.
@njit(error_model="numpy", cache=True, nogil=True)
def integrate(
    y: np.ndarray,
    t_start: float,
    span_start: np.ndarray,
    span_P: np.ndarray,
    span_open: np.ndarray,
    sample_t: np.ndarray,
    samples: np.ndarray,
    pulse_t: np.ndarray,
    parameters: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
    refine: int,
) -> tuple[int, int, int]:
    """Integrate from ``t_start`` to the last sample time.

    `y`, shape (9 + 2 n,): state at the start [SI]; holds the end on return.
    `t_start`: time of the start [s].
    `span_start`, `span_P`, `span_open`, shape (s,): supply: from each time [s] on, absolute pressure [Pa] and open (1)
        or vented (0).
    `sample_t`, shape (n,): increasing sample times [s]; the last ends the run.
    `samples`, shape (n, 6): filled: angle, speed, inlet mass, outlet mass, pressure and mass of the first cylinder
        [SI].
    `pulse_t`, shape (p,): filled with the times at which the rotor has turned another pulse [s]; the run ends when it
        is full.
    Returns `status`: DONE, TOO_MANY_STEPS or NOT_FINITE; `steps`: steps taken; `pulses`: entries of ``pulse_t`` filled.
    """
    c = np.empty(at.N_CURVE)
    geometry.curve(parameters, c)
    edge = edges(parameters, c)
    lap, R = parameters[at.LAP], gas[at.GAS_R]
    pulse = c[at.PULSE_ANGLE]
    work = np.empty((6, y.size))
    port = np.full((y.size - P0) // 2, CLOSED)
    P_vent = parameters[at.P_A] + parameters[at.DP_OUT]
    P_port = np.array([P_vent, P_vent])
    T_port = np.array([parameters[at.T_A], parameters[at.T_A]])

    block, k = _interval(y[THETA], edge, pulse)
    t = t_start
    t_end = sample_t[-1]
    span = -1
    sample = 0
    pulses = 0
    steps = 0
    entering = True
    while sample < sample_t.size and sample_t[sample] <= t:
        _fill_sample(samples[sample], 0.0, 0.0, y, y, c, R)
        sample += 1
    while t < t_end:
        steps += 1
        if steps > 20_000_000:
            return TOO_MANY_STEPS, steps, pulses
        while span + 1 < span_start.size and span_start[span + 1] <= t:
            span += 1
            opened = span_open[span] > 0.0
            P_port[INLET] = span_P[span] - parameters[at.DP_IN] if opened else P_vent
            T_port[INLET] = parameters[at.T_IN] if opened else parameters[at.T_A]
            entering = True
        lo = block * pulse + edge[k]
        hi = block * pulse + edge[k + 1] if k < N_EDGES - 1 else (block + 1) * pulse + edge[0]
        if entering:
            set_ports(y, port, 0.5 * (lo + hi), P_port, T_port, lap, c, gas)
            entering = False
        t_limit = min(t_end, span_start[span + 1]) if span + 1 < span_start.size else t_end

        sense = 1.0 if y[OMEGA] >= 0.0 else -1.0
        hold = rates(y, work[0], port, sense, T_port, parameters, c, gas, readings)
        if y[OMEGA] == 0.0:
            torque = work[0, OMEGA] * parameters[at.J] + sense * hold  # the gas's alone
            at_rest = abs(torque) <= hold
            if not at_rest:
                sense = 1.0 if torque > 0.0 else -1.0
                if sense < 0.0 and y[THETA] <= lo:  # it leaves into the interval below
                    k -= 1
                    if k < 0:
                        k = N_EDGES - 1
                        block -= 1
                    entering = True
                    if y[THETA] > lo:
                        y[THETA] = lo
                    lo_new = block * pulse + edge[k]
                    set_ports(y, port, 0.5 * (lo_new + lo), P_port, T_port, lap, c, gas)
                    entering = False
                    hi = lo
                    lo = lo_new
                hold = rates(y, work[0], port, sense, T_port, parameters, c, gas, readings)
                torque = work[0, OMEGA] * parameters[at.J] + sense * hold
                at_rest = sense * torque <= hold  # opening the port below may have turned the torque
        else:
            at_rest = False

        if at_rest:  # nothing changes until the supply does: Eq. 19 gives no heat without motion
            h = t_limit - t
            work[4][:] = y
            work[0][:] = 0.0
            event = ON_THE_WAY
        else:
            target = _target(y[THETA], lo, hi, sense, refine)
            distance = target - y[THETA]
            h_most = min(MAX_STEP / refine, t_limit - t)
            h = _time_to(distance, y[OMEGA], work[0, OMEGA], sense, h_most)
            event = ON_THE_WAY
            if h < 0.5 * h_most and abs(y[OMEGA]) * h > 0.5 * abs(distance):
                taken = angle_step(y, target, work, port, sense, T_port, parameters, c, gas, readings)
                if taken > 0.0 and taken < h_most:
                    h, event = taken, AT_EDGE
            if event == ON_THE_WAY:
                h, event = locate(y, h, h_most, target, work, port, sense, T_port, parameters, c, gas, readings)
            if not math.isfinite(work[4, OMEGA]):
                return NOT_FINITE, steps, pulses
            if event == AT_EDGE:
                work[4, THETA] = target
            elif event == STOPPED:
                work[4, OMEGA] = 0.0

        new = work[4]
        while sample < sample_t.size and sample_t[sample] <= t + h * (1.0 + 1e-12):
            s = min(max((sample_t[sample] - t) / h, 0.0), 1.0) if h > 0.0 else 1.0
            _fill_sample(samples[sample], s, h, y, new, c, R)
            sample += 1
        if t_limit - (t + h) < 1e-15:
            t = t_limit
        else:
            t += h
        y[:] = new
        if event == AT_EDGE and target == hi and sense > 0.0:
            k += 1
            if k == N_EDGES:
                k = 0
                block += 1
                if pulse_t.size > 0:
                    pulse_t[pulses] = t
                    pulses += 1
                    if pulses == pulse_t.size:
                        return DONE, steps, pulses
            entering = True
        elif event == AT_EDGE and target == lo and sense < 0.0:
            k -= 1
            if k < 0:
                k = N_EDGES - 1
                block -= 1
            entering = True
    return DONE, steps, pulses


def rest_state(motor: Motor, angle_rad: float = 0.0) -> np.ndarray:
    """The motor at rest with the line vented: every cylinder at P_d and T_a.

    `angle_rad`: rotor angle [rad].
    Returns an array, shape (9 + 2 n,): state for `simulate`.
    """
    y = np.zeros(P0 + 2 * motor.n_pistons)
    y[THETA] = angle_rad
    y[P0:] = motor.si("ambient_pressure") + motor.si("outlet_pressure_drop")
    y[P0 + motor.n_pistons :] = motor.si("ambient_temperature")
    return y


def simulate(
    motor: Motor,
    supply: Sequence[Supply],
    time_s: np.ndarray,
    state: np.ndarray | None = None,
    refine: int = 1,
) -> Transient:
    """Simulate the motor from the first to the last sample time.

    `supply`: the line, in the order of time; before the first span it is vented.
    `time_s`, shape (n,): increasing sample times [s]; the first is the start.
    `state`, shape (9 + 2 n,): state at the start; at rest at angle 0 when left out.
    Returns samples and the final state. Raises ValueError when the times do not increase or the state is of another
    motor, ArithmeticError when the integration fails.
    """
    time_s = np.asarray(time_s, dtype=np.float64)
    if time_s.ndim != 1 or time_s.size < 2 or not np.all(np.diff(time_s) > 0):
        raise ValueError("simulate: the sample times must be at least two and increase")
    at_rest = rest_state(motor)
    y = at_rest if state is None else np.array(state, dtype=np.float64)
    if y.shape != at_rest.shape:
        raise ValueError(f"simulate: a state of shape {y.shape} is not of a motor with {motor.n_pistons} pistons")
    samples = np.empty((time_s.size, 6))
    status, _, _ = _run(motor, supply, time_s, y, samples, np.empty(0), refine)
    if status != DONE:
        raise ArithmeticError(f"simulate: the integration failed (status {status}); are the parameters physical?")
    angle, speed, inlet, outlet, pressure, mass = (np.ascontiguousarray(column) for column in samples.T)
    return Transient(time_s, angle, speed, inlet, outlet, pressure, mass, y)


def periodic_state(motor: Motor, P_in: float, refine: int = 1) -> tuple[np.ndarray, float]:
    """Run at constant pressure until the speed repeats.

    Returns `state`, shape (9 + 2 n,): state at angle 0, with nothing passed yet; `mean_speed`: mean speed in time
    [rad/s]; 0 when the motor stalls. Raises ArithmeticError when the speed does not settle.
    """
    y = rest_state(motor)
    y[OMEGA] = GIVEN_RAD_S
    last = -1.0
    for _ in range(MOST_TURNS):
        y[THETA] = 0.0  # after a whole turn the cylinders stand as they stood; counting on would lose digits
        pulse_t = np.full(motor.n_lobes * motor.n_pistons, np.nan)
        status, _, pulses = _run(motor, [Supply(0.0, P_in)], np.array([0.0, 5.0]), y, np.empty((2, 6)), pulse_t, refine)
        if status != DONE:
            break
        if pulses < pulse_t.size:
            return y, 0.0
        mean = geometry.pulse_angle(motor.vector()) / (pulse_t[-1] - pulse_t[-2])
        if abs(mean - last) <= 1e-10 * mean:
            y[THETA] = 0.0
            y[M_IN:P0] = 0.0
            return y, mean
        last = mean
    raise ArithmeticError(f"the speed does not settle at {P_in / 1e5:g} bar within {MOST_TURNS} turns")


def _run(
    motor: Motor,
    supply: Sequence[Supply],
    time_s: np.ndarray,
    y: np.ndarray,
    samples: np.ndarray,
    pulse_t: np.ndarray,
    refine: int,
) -> tuple[int, int, int]:
    parameters, readings = motor.vector(), motor.readings.vector()
    P_top = max((span.pressure_pa for span in supply if span.is_open), default=motor.si("ambient_pressure"))
    gas = gas_state(parameters, P_top, readings)
    starts = np.array([span.start_s for span in supply], dtype=np.float64)
    pressures = np.array([span.pressure_pa for span in supply], dtype=np.float64)
    opened = np.array([float(span.is_open) for span in supply])
    status: tuple[int, int, int] = integrate(
        y, float(time_s[0]), starts, pressures, opened, time_s, samples, pulse_t, parameters, gas, readings, int(refine)
    )
    return status
