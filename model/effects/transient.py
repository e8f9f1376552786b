"""Runs in time with effects in them: the base integrator, with the laws taken anew at each sample.

Between two samples, or oftener where the speed changes fast, a torque is its tangent in speed and in roller load, so
the error is of second order in what they change meanwhile. A pressure loss follows the mean flow, which settles within
a few pulses of the cylinders.

`parameters`, shape (27,): base parameters [SI].
`gas`, shape (12,): gas of an operating point.
`time`, shape (n,): increasing sample times [s]; the first is the start.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from configs.compiled import njit
from model import geometry, motion
from model import layout as at
from model.effects import laws
from model.effects.effect import State
from model.gas.cylinder import gas_state
from model.solvers import averaged
from model.solvers import transient as base
from model.solvers.crank_angle import M_IN, M_OUT, OMEGA, P0, THETA
from model.solvers.transient import Supply

FLOW_S = 0.02  # time over which the flow of single cylinders is averaged for a pressure loss, in share of the speed
SLOWEST_FLOW = 1.0  # rad/s; below it the flow has no share of the speed
LATE_S = 1e-9  # a change of the supply so soon after a step is at its end
LOSS_STEP_S = 0.01  # laws are taken anew at least so often where there is a loss of pressure,
SPEED_STEP = 2.0  # rad/s; ... so often where there is a torque,
ANGLE_STEP = 0.3  # rad; ... and so often where a torque follows the angle,
LEAST_STEP_S = 0.002  # ... but not oftener than this
NONE = np.empty(0)


@dataclass(frozen=True)
class Run:
    """A run in time, arrays of shape (n,).

    `time`: of the samples [s].
    `angle`, `speed`: shaft angle [rad] and speed [rad/s] at the samples.
    `reading`: speed as the tachometer has it: the mean since the sample before, with its lag [rad/s].
    `inlet`: mass that entered since the start, leaks included [kg].
    """

    time: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    reading: np.ndarray
    inlet: np.ndarray


def simulate(
    parameters: np.ndarray,
    readings: np.ndarray,
    supply: Sequence[Supply],
    time: np.ndarray,
    start: np.ndarray,
    chosen: laws.Chosen,
    clock: float = 0.0,
    stride: int = 1,
) -> Run:
    """Simulate from the first to the last sample.

    `supply`: the line, true pressures.
    `start`, shape (9 + 2 n,): state at the start.
    `stride`: samples from one look at the laws to the next [-].
    Raises ArithmeticError when the integration fails.
    """
    chosen = laws.switched_on(chosen)
    parameters = laws.with_factors(parameters, chosen)
    highest = max((span.pressure_pa for span in supply if span.is_open), default=float(parameters[at.P_A]))
    gas = gas_state(parameters, highest, readings)
    spans = (
        np.array([span.start_s for span in supply], dtype=np.float64),
        np.array([span.pressure_pa for span in supply], dtype=np.float64),
        np.array([float(span.is_open) for span in supply]),
    )
    case = _Case(spans, parameters, gas, readings, chosen, clock)
    y = np.array(start, dtype=np.float64)
    those = [effect for effect, _ in laws.members(chosen)]
    if any(effect.torque or effect.inlet_drop or effect.outlet_rise for effect in those):
        samples = _stepwise(y, case, time, stride)
    else:
        samples = np.empty((time.size, 6))
        _check(base.integrate(y, time[0], *spans, time, samples, NONE, parameters, gas, readings, 1)[0])
    angle, speed = samples[:, 0].copy(), samples[:, 1].copy()
    mean = speed.copy()
    mean[1:] = np.diff(angle) / np.diff(time)
    inlet = samples[:, 2].copy()
    if any(effect.leak for effect in those):
        inlet[1:] += np.cumsum(_leaked(time, mean, np.diff(inlet), case))
    return Run(time, angle, speed, read_with_lag(mean, time, chosen), inlet)


@dataclass(frozen=True)
class _Case:
    """What stays the same along a run; the supply's spans by their starts, pressures, and whether they are open."""

    spans: tuple[np.ndarray, np.ndarray, np.ndarray]
    parameters: np.ndarray
    gas: np.ndarray
    readings: np.ndarray
    chosen: laws.Chosen
    clock: float

    def pressure(self, t: float) -> float:
        """Pressure of the line at a time [Pa]."""
        starts, pressures, is_open = self.spans
        span = int(np.searchsorted(starts, t, side="right")) - 1
        return float(pressures[span] if span >= 0 and is_open[span] > 0.0 else self.parameters[at.P_A])

    def changes(self, start: float, end: float) -> bool:
        """Whether the supply changes between two times."""
        return bool(np.any((self.spans[0] > start) & (self.spans[0] < end)))


class _Flow:
    """Mean flow through the inlet, which a loss of pressure follows [kg/s]."""

    def __init__(self, case: _Case, omega: float, t: float) -> None:
        self._turning = omega
        self.now = self._mean = _flow_at(omega, case.pressure(t), case.parameters, case.gas, case.readings)

    def step(self, case: _Case, start: float, end: float, entered: float, speed: float, later: float) -> None:
        """Go on by a step from a speed to a later one, in which a mass entered [kg]."""
        dt = end - start
        if case.changes(start, end + LATE_S):  # the volume that the cylinders take in is the same
            self._mean *= case.pressure(end + LATE_S) / case.pressure(start)
        else:
            share = 1.0 - math.exp(-dt / FLOW_S)
            self._mean += (entered / dt - self._mean) * share
            self._turning += (0.5 * (speed + later) - self._turning) * share
        # The air does not wait: at another speed another flow passes at once.
        self.now = self._mean * later / self._turning if self._turning > SLOWEST_FLOW else self._mean


def _stepwise(y: np.ndarray, case: _Case, time: np.ndarray, stride: int) -> np.ndarray:
    """The integrator over some samples or a part of one, with the laws taken anew at the start of each step."""
    those = laws.members(case.chosen)
    turns = any(effect.torque for effect, _ in those)
    loses = any(effect.inlet_drop or effect.outlet_rise for effect, _ in those)
    follows = any(effect.periodic for effect, _ in those)
    leaks = any(effect.leak for effect, _ in those)
    samples = np.empty((time.size, 6))
    samples[0] = [y[THETA], y[OMEGA], y[M_IN], y[M_OUT], y[P0], np.nan]
    state, curve = _scratch(case.parameters, case.gas)
    here = State(*(getattr(state, field.name)[:1] for field in fields(State)))  # the same arrays
    flow = _Flow(case, float(y[OMEGA]), time[0]) if loses else None
    change = 0.0
    k = 1
    while k < time.size:
        t, rate = time[k - 1], change if turns else 0.0
        steps_in = functools.partial(_steps, omega=y[OMEGA], rate=rate, loses=loses, follows=follows)
        last, ends = _ahead(case, time, k, stride, steps_in)
        for until in ends:
            before, speed = y[M_IN], y[OMEGA]
            _fill(state, y, flow.now if flow else 0.0, case, t, until[-1], curve)
            if leaks:
                state.mass_flow[:] += float(laws.leak(case.chosen, here)[0])
            row = _row(case, those if turns else [], state, speed)
            if loses:
                laws.add_losses(row, those, here)
            into = samples[k : last + 1]
            _check(base.integrate(y, t, *case.spans, until, into, NONE, row[0], case.gas, case.readings, 1)[0])
            if flow:
                flow.step(case, t, until[-1], y[M_IN] - before, speed, y[OMEGA])
            change = abs(y[OMEGA] - speed) / (until[-1] - t)
            t = until[-1]
        k = last + 1
    return samples


def _ahead(
    case: _Case, time: np.ndarray, k: int, stride: int, steps_in: Callable[[float], int]
) -> tuple[int, list[np.ndarray]]:
    """The last of the samples from k on up to which the laws stay as they are, and the ends of the steps to it."""
    t, last = time[k - 1], min(k + stride, time.size) - 1
    while last > k and (steps_in(time[last] - t) > 1 or case.changes(t, time[last])):
        last -= 1
    steps = 1 if last > k else steps_in(time[k] - t)
    if steps == 1:
        return last, [time[k : last + 1]]
    ends = np.linspace(t, time[k], steps + 1)[1:]
    return last, [ends[n : n + 1] for n in range(steps)]


def _row(case: _Case, those: laws.Members, state: State, speed: float) -> np.ndarray:
    """Parameters with the tangent of these torques in them, shape (1, 27)."""
    row = case.parameters[None, :].copy()
    if those:
        T = laws.sum_of_torques(those, state, np.full(3, speed < 0.0))
        slope, constant, roller = laws.tangent(T[0], T[1], T[2], abs(speed), state.load[0])
        row[0, at.F_OVERALL] += slope
        row[0, at.EXTRA_TORQUE] += constant
        row[0, at.F_R] += roller
    return row


def _flow_at(omega: float, pressure: float, parameters: np.ndarray, gas: np.ndarray, readings: np.ndarray) -> float:
    """Mean flow at a speed, for ever, without effects [kg/s]: what a run that begins there has had."""
    if omega <= SLOWEST_FLOW:
        return 0.0
    out = np.empty((1, averaged.N_OUT))
    averaged.torques(parameters, readings, gas, pressure, np.array([omega]), out)
    return float(out[0, averaged.MASS_FLOW])


def _steps(dt: float, omega: float, rate: float, loses: bool, follows: bool) -> int:
    """Steps within a time ``dt``, for a speed that goes on changing at ``rate``."""
    steps = rate * dt / SPEED_STEP
    if loses:
        steps = max(steps, dt / LOSS_STEP_S)
    if follows:
        steps = max(steps, abs(omega) * dt / ANGLE_STEP)
    return max(1, min(math.ceil(steps - 1e-9), math.ceil(dt / LEAST_STEP_S - 1e-9)))


def _scratch(parameters: np.ndarray, gas: np.ndarray) -> tuple[State, np.ndarray]:
    """A state of three places, filled anew at each step: as it is, at a little more speed, at a little more load."""
    values = {
        "temperature": parameters[at.T_IN],
        "ambient": parameters[at.P_A],
        "gas_constant": gas[at.GAS_R],
        "friction": parameters[at.F_OVERALL],
    }
    curve = np.empty(at.N_CURVE)
    geometry.curve(parameters, curve)
    return State(**{field.name: np.full(3, values.get(field.name, 0.0)) for field in fields(State)}), curve


def _fill(state: State, y: np.ndarray, flow: float, case: _Case, start: float, end: float, curve: np.ndarray) -> None:
    """Fill the state of three places; angle and time are those of the step's middle."""
    omega, load = y[OMEGA], _load(y, curve, case.parameters[at.P_A])
    speed = abs(omega)
    state.omega[:] = (speed, speed + laws.step_of(speed), speed)
    state.load[:] = (load, load, load + laws.LOAD_STEP)
    state.angle[:] = y[THETA] + 0.5 * omega * (end - start)
    state.mass_flow[:] = max(flow, 0.0)
    state.pressure[:] = case.pressure(start)
    state.time[:] = case.clock + 0.5 * (start + end)


@njit(cache=True)
def _load(y: np.ndarray, curve: np.ndarray, ambient: float) -> float:
    """Roller torque per unit of f_r, Eq. 25, at the cylinders' present pressures [N m]."""
    total = 0.0
    for i in range((y.size - P0) // 2):
        psi = (y[THETA] + i * curve[at.PITCH]) % curve[at.LOBE_ANGLE]
        _, _, cos_phi, r = geometry.place(psi, curve)
        total += motion.roller_torque(
            abs(motion.piston_force(curve[at.A_P], y[P0 + i], ambient)), 1.0, cos_phi, r, True
        )
    return total


def _leaked(time: np.ndarray, speed: np.ndarray, entered: np.ndarray, case: _Case) -> np.ndarray:
    """Mass that leaked between two samples each [kg], shape (n - 1,)."""
    dt = np.diff(time)
    one = np.ones_like(dt)
    parameters = case.parameters
    pressure = np.array([case.pressure(t) for t in time[:-1]])
    state = State(
        omega=np.abs(speed[1:]),
        angle=np.full_like(dt, np.nan),
        mass_flow=entered / dt,
        pressure=pressure,
        temperature=parameters[at.T_IN] * one,
        ambient=parameters[at.P_A] * one,
        gas_constant=case.gas[at.GAS_R] * one,
        friction=parameters[at.F_OVERALL] * one,
        load=np.full_like(dt, np.nan),
        time=case.clock + 0.5 * (time[1:] + time[:-1]),
    )
    return laws.leak(case.chosen, state) * dt


def read_with_lag(mean: np.ndarray, time: np.ndarray, chosen: laws.Chosen) -> np.ndarray:
    """What the tachometer makes of the mean speed [rad/s]: first-order lags, one after the other.

    `mean`, shape (n,): mean speed since the sample before [rad/s].
    """
    for effect, values in laws.members(chosen):
        if effect.lag is None:
            continue
        tau = effect.lag(values)
        if tau > 0.0:
            mean = lagged(mean, time, tau)
    return mean


@njit(cache=True, nogil=True)
def lagged(mean: np.ndarray, time: np.ndarray, tau: float) -> np.ndarray:
    """Mean speeds behind a first-order lag [rad/s], shape (n,).

    Between two times the speed goes in a straight line, through its mean and as steeply as the means before and after
    say; at the first time the lag has settled.

    `mean`, shape (n,): mean speed since the time before [rad/s].
    `tau`: the lag's time constant, above 0 [s].
    """
    found = mean.copy()
    reached = mean[0]
    for k in range(1, mean.size):
        h = time[k] - time[k - 1]
        low, high = max(k - 1, 1), min(k + 1, mean.size - 1)
        apart = 0.5 * (time[high] + time[high - 1] - time[low] - time[low - 1])
        slope = (mean[high] - mean[low]) / apart if high > low else 0.0
        begins, left = mean[k] - slope * (0.5 * h + tau), np.exp(-h / tau)
        found[k] = mean[k] - slope * tau + (reached - begins) * tau / h * (1.0 - left)
        reached = begins + slope * h + (reached - begins) * left
    return found


def _check(status: int) -> None:
    if status != base.DONE:
        raise ArithmeticError(f"the integration failed (status {status}); are the parameters physical?")
