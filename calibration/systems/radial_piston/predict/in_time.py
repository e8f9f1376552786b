"""A run in time as the motor would run it: by its mean torque, and with what the pulses of its cylinders add."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.data.runs import RunInTime
from model import geometry
from model import layout as at
from model.effects import averaged, effects, laws
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.gas.cylinder import gas_state
from model.motor import Motor
from model.solvers import pulse
from model.solvers import steady as base_steady
from model.solvers.crank_angle import OMEGA, THETA
from model.solvers.recent import Recent
from model.solvers.transient import Supply, rest_state

LEAD_STEP_S = 0.02  # between the samples of the steady part ahead of a run
SLOWEST_START = 1.0  # rad/s
LAST_STEP_S = 1e-3  # of the time from rest, over which the speed that is reached is taken
SLOWEST = 2.0  # rad/s; below it the pulses are not taken to grow

Chosen = Mapping[str, Mapping[str, float]]

_recent = Recent(32)


def follows_angle(names: Iterable[str]) -> bool:
    """Whether an effect follows the shaft's angle."""
    return any(effects()[name].periodic for name in names)


@dataclass(frozen=True)
class Plan:
    """What a simulation of a run in time takes.

    Attributes
    ----------
    parameters : ndarray, shape (24,)
        Of the motor [SI].
    readings : ndarray, shape (5,)
        `model.motor.Readings.vector`.
    time : ndarray, shape (k,)
        Sample times, those of a steady part ahead among them [s].
    start : ndarray, shape (23,)
        State at the first of them.
    clock : float
        The recording's clock at time 0 of the run [s].
    begin, end : ndarray of int, shape (wanted,)
        Where the mean of each begins and ends among the times.
    lag_s : float
        The tachometer's own, as stated [s].
    angle, set_at : float
        Angle of the shaft [rad], and the time at which it has that [s].
    """

    parameters: np.ndarray
    readings: np.ndarray
    supply: tuple[Supply, ...]
    time: np.ndarray
    start: np.ndarray
    chosen: Chosen
    clock: float
    wanted: slice
    begin: np.ndarray
    end: np.ndarray
    lag_s: float
    angle: float
    set_at: float

    def mean_speed(self) -> np.ndarray:
        """Mean speeds since the sample before, by the mean torque alone [rad/s], shape (k,)."""
        return averaged.speeds(
            self.parameters,
            self.readings,
            self.supply,
            self.time,
            float(self.start[OMEGA]),
            self.chosen,
            self.clock,
            float(self.start[THETA]),
        )

    def with_pulses(self, angle: np.ndarray, size: float = 1.0) -> np.ndarray:
        """Mean speeds since the sample before, pulses and all [rad/s], shape (k,).

        The pulses are those of a motor that turns steadily at the pressure of the moment: within a pulse the line and
        the speed change little, but for the first of a start and those while a valve moves.

        Parameters
        ----------
        angle : ndarray, shape (k,)
            Of the shaft at the samples [rad].
        size : float
            Of the pulses, in those of the model [-].
        """
        mean = self.mean_speed()
        parameters = laws.with_factors(self.parameters, laws.switched_on(self.chosen))
        begins, pressures, opened = np.array(self.supply, dtype=float).T
        low = float(parameters[at.P_A] + parameters[at.DP_IN] + parameters[at.DP_OUT])
        span = np.maximum(np.searchsorted(begins, self.time, side="right") - 1, 0)
        line = np.where(opened > 0.5, pressures, low)[span]
        high = max(float(line.max()), low + 1.0)
        vented, settled = swings(parameters, self.readings, np.array([low, high]), angle)
        swung = vented + (settled - vented) * (line - low) / (high - low)
        speed = np.maximum(0.5 * (mean + np.append(mean[1:], mean[-1])), SLOWEST)
        mean = mean.copy()
        mean[1:] += np.diff(size * swung / (parameters[at.J] * speed**2)) / np.diff(self.time)
        return mean

    def read(self, mean: np.ndarray) -> np.ndarray:
        """What the tachometer makes of mean speeds, of the samples wanted [rad/s], shape (wanted,).

        Parameters
        ----------
        mean : ndarray, shape (k,)
            Since the time before [rad/s].
        """
        lagged = effect_transient.lagged(mean, self.time, self.lag_s) if self.lag_s else mean
        lagged = effect_transient.read_with_lag(lagged, self.time, self.chosen)
        turned = np.append(0.0, np.cumsum(lagged[1:] * np.diff(self.time)))
        found: np.ndarray = (turned[self.end] - turned[self.begin]) / (self.time[self.end] - self.time[self.begin])
        return found


def swings(parameters: np.ndarray, readings: np.ndarray, pressures: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """What the pulses add to the shaft's angle at pressures of the line, times J w^2 [J], shape (n, k).

    Parameters
    ----------
    pressures : ndarray, shape (n,)
        Of the line [Pa].
    angle : ndarray, shape (k,)
        Of the shaft [rad].
    """
    c, table = np.empty(at.N_CURVE), np.empty((pulse.N_STEPS, pulse.N_TABLE))
    ends, out = np.empty(pulse.N_STEPS + 1), np.empty((pressures.size, angle.size))
    gas = gas_state(parameters, float(pressures.max()), readings)
    geometry.curve(parameters, c)
    first = pulse.tabulate(parameters, readings, gas[at.GAS_CP] / (gas[at.GAS_CP] - gas[at.GAS_R]), c, table)
    places = first + np.append(0.0, np.cumsum(table[:, pulse.WIDTH]))
    P_d = parameters[at.P_A] + parameters[at.DP_OUT]
    for k, P in enumerate(pressures):
        pulse.swing(P - parameters[at.DP_IN], P_d, parameters[at.P_A], parameters[at.F_R], table, ends)
        out[k] = np.interp(angle, places, ends, period=at.PULSE)
    return out


def plan(
    motor: Motor,
    run: RunInTime,
    parameters: np.ndarray,
    supply: Sequence[Supply],
    angle: float,
    chosen: Chosen,
    begun: float = 0.0,
    lag_s: float = 0.0,
) -> Plan:
    """Plan a run.

    Parameters
    ----------
    motor : Motor
        For its readings of the article and its state at rest.
    parameters : ndarray, shape (24,)
        Of the motor [SI].
    angle : float
        Of the shaft where the run begins to be compared, or when its valve is moved [rad].
    begun : float
        Share by which a start from rest is faster there than by the mean torque [-].
    lag_s : float
        The tachometer's own [s].

    Returns
    -------
    Plan
        A start from rest begins where it is compared from, with the speed that the mean torque has given it by then.
    """
    readings = motor.readings.vector()
    compared = np.flatnonzero(run.used)
    wanted = slice(int(compared[0]), int(compared[-1]) + 1) if compared.size else slice(0, 1)
    begins, ends = run.begin[wanted], run.time[wanted]
    first = float(begins.min())
    if run.from_rest:
        set_at, ahead = first, np.zeros(0)
        speed = _reached(parameters, readings, supply, first, chosen, run.start_s) * max(1.0 + begun, 0.0)
        start = rest_state(motor, angle)
    else:
        speed = max(
            _steady_speed(motor, parameters, readings, supply[0].pressure_pa, chosen, run.start_s), SLOWEST_START
        )
        # The angle meant is that at the end of the steady part: it would otherwise turn with every parameter.
        set_at = run.valve[1].start_s if len(run.valve) > 1 else first
        turned = angle - speed * (set_at - supply[0].start_s)
        # Within one pulse, but where something follows the angle through a whole turn: then it may not jump.
        start = rest_state(motor, turned if follows_angle(chosen) else turned % at.PULSE)
        ahead = np.arange(supply[0].start_s, first - 0.5 * LEAD_STEP_S, LEAD_STEP_S)
    start[OMEGA] = speed
    time = np.unique(np.concatenate([ahead, begins, ends]))
    places = np.searchsorted(time, begins), np.searchsorted(time, ends)
    return Plan(
        parameters, readings, tuple(supply), time, start, chosen, run.start_s, wanted, *places, lag_s, angle, set_at
    )


def _reached(
    parameters: np.ndarray, readings: np.ndarray, supply: Sequence[Supply], until: float, chosen: Chosen, clock: float
) -> float:
    """Speed that the mean torque has given a rotor from rest by a time [rad/s]."""
    begins = next((span.start_s for span in supply if span.is_open), until)
    if begins >= until - LAST_STEP_S:
        return 0.0
    time = np.array([begins, until - LAST_STEP_S, until])
    return float(averaged.speeds(parameters, readings, supply, time, 0.0, chosen, clock)[-1])


def _steady_speed(
    motor: Motor, parameters: np.ndarray, readings: np.ndarray, pressure_pa: float, chosen: Chosen, clock: float
) -> float:
    """Speed at which the motor has settled before a coast-down [rad/s]; 0 where it stalls."""

    def solved() -> np.ndarray:
        pressure = np.array([pressure_pa])
        gas = base_steady.gas_table(motor, pressure)
        return effect_steady.solve(parameters[None, :], readings, pressure, gas, chosen, np.array([clock])).speed

    set_of = tuple((name, *sorted(chosen[name].items())) for name in sorted(chosen))
    weather = motor.vector().tobytes()
    return float(_recent((parameters.tobytes(), readings.tobytes(), weather, pressure_pa, clock, set_of), solved)[0])
