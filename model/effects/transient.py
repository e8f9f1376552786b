"""Runs in time with effects in them: the base integrator, with the laws taken anew at each sample.

Between two samples a torque is its tangent in speed, so the error is of second order in what the speed changes
meanwhile. A pressure loss follows the mean flow, which settles within a few pulses of the cylinders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model import layout as at
from model import transient as base
from model.cylinder import gas_state
from model.effects import laws
from model.effects.effect import State
from model.transient import Supply

FLOW_S = 0.02  # time over which the flow of single cylinders is averaged for a pressure loss
NONE = np.empty(0)


@dataclass(frozen=True)
class Run:
    """A run in time, arrays of shape (n,).

    Attributes
    ----------
    time : ndarray
        Of the samples [s].
    angle, speed : ndarray
        Shaft angle [rad] and speed [rad/s] at the samples.
    reading : ndarray
        Speed as the tachometer has it: the mean since the sample before, with its lag [rad/s].
    inlet : ndarray
        Mass that entered [kg].
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
) -> Run:
    """Simulate from the first to the last sample.

    Parameters
    ----------
    parameters : ndarray, shape (24,)
        Base parameters [SI].
    readings : ndarray, shape (5,)
        `model.motor.Readings.vector`.
    supply : sequence of Supply
        The line, true pressures.
    time : ndarray, shape (n,)
        Increasing sample times [s]; the first is the start.
    start : ndarray, shape (23,)
        State at the start.
    chosen : mapping
        Effect id to the values of its parameters.
    clock : float
        Time of the recording's clock at time 0 of the run [s].

    Returns
    -------
    Run
        The samples.

    Raises
    ------
    ArithmeticError
        When the integration fails.
    """
    parameters = laws.with_factors(parameters, chosen)
    highest = max((span.pressure_pa for span in supply if span.is_open), default=float(parameters[at.P_A]))
    gas = gas_state(parameters, highest, readings)
    spans = (
        np.array([span.start_s for span in supply], dtype=np.float64),
        np.array([span.pressure_pa for span in supply], dtype=np.float64),
        np.array([float(span.is_open) for span in supply]),
    )
    y = np.array(start, dtype=np.float64)
    active = any(effect.torque or effect.inlet_drop or effect.outlet_rise for effect, _ in laws.members(chosen))
    if active:
        samples = _stepwise(y, spans, time, parameters, gas, readings, chosen, clock)
    else:
        samples = np.empty((time.size, 6))
        _check(base.integrate(y, time[0], *spans, time, samples, NONE, parameters, gas, readings, 1)[0])
    angle, speed = samples[:, 0].copy(), samples[:, 1].copy()
    mean = speed.copy()
    mean[1:] = np.diff(angle) / np.diff(time)
    return Run(time, angle, speed, _read(mean, time, chosen), samples[:, 2].copy())


def _stepwise(
    y: np.ndarray,
    spans: tuple[np.ndarray, np.ndarray, np.ndarray],
    time: np.ndarray,
    parameters: np.ndarray,
    gas: np.ndarray,
    readings: np.ndarray,
    chosen: laws.Chosen,
    clock: float,
) -> np.ndarray:
    """One call of the integrator from sample to sample."""
    samples = np.empty((time.size, 6))
    samples[0] = [y[base.THETA], y[base.OMEGA], y[base.M_IN], y[base.M_OUT], y[base.P0], np.nan]
    flow = 0.0
    one = np.empty((1, 6))
    for k in range(1, time.size):
        t0, t1 = time[k - 1], time[k]
        state = _state(y, flow, spans, t0, 0.5 * (t0 + t1), parameters, gas, clock)
        row = laws.row_parameters(parameters[None, :], chosen, state)[0]
        entered = y[base.M_IN]
        _check(base.integrate(y, t0, *spans, time[k : k + 1], one, NONE, row, gas, readings, 1)[0])
        samples[k] = one[0]
        flow += ((y[base.M_IN] - entered) / (t1 - t0) - flow) * (1.0 - np.exp(-(t1 - t0) / FLOW_S))
    return samples


def _state(
    y: np.ndarray,
    flow: float,
    spans: tuple[np.ndarray, np.ndarray, np.ndarray],
    start: float,
    middle: float,
    parameters: np.ndarray,
    gas: np.ndarray,
    clock: float,
) -> State:
    span = int(np.searchsorted(spans[0], start, side="right")) - 1
    opened = span >= 0 and spans[2][span] > 0.0
    pressure = spans[1][span] if opened else parameters[at.P_A]
    omega = y[base.OMEGA]
    return State(
        omega=np.array([omega]),
        angle=np.array([y[base.THETA] + omega * (middle - start)]),
        mass_flow=np.array([max(flow, 0.0)]),
        pressure=np.array([pressure]),
        temperature=np.array([parameters[at.T_IN]]),
        ambient=np.array([parameters[at.P_A]]),
        gas_constant=np.array([gas[at.GAS_R]]),
        friction=np.array([parameters[at.F_OVERALL]]),
        load=np.array([_load(y, parameters)]),
        time=np.array([clock + middle]),
    )


def _load(y: np.ndarray, parameters: np.ndarray) -> float:
    """Roller torque per unit of f_r, Eq. 25, at the cylinders' present pressures [N m]."""
    from model import geometry

    c = np.empty(at.N_CURVE)
    geometry.curve(parameters, c)
    total = 0.0
    for i in range(at.N_CYLINDERS):
        psi = (y[base.THETA] + i * 4.0 * at.PULSE) % at.LOBE
        _, _, cos_phi, r = geometry.place(psi, c)
        total += c[at.A_P] * abs(y[base.P0 + i] - parameters[at.P_A]) * cos_phi * r
    return total


def _read(mean: np.ndarray, time: np.ndarray, chosen: laws.Chosen) -> np.ndarray:
    """What the tachometer makes of the mean speed: first-order lags, one after the other."""
    for effect, values in laws.members(chosen):
        if effect.lag is None:
            continue
        tau = effect.lag(values)
        if tau <= 0.0:
            continue
        lagged = mean.copy()
        for k in range(1, mean.size):
            lagged[k] = mean[k] + (lagged[k - 1] - mean[k]) * np.exp(-(time[k] - time[k - 1]) / tau)
        mean = lagged
    return mean


def _check(status: int) -> None:
    if status != base.DONE:
        raise ArithmeticError(f"the integration failed (status {status}); are the parameters physical?")
