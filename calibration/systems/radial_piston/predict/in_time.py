"""A run in time as the motor would run it: with every pulse of its cylinders, or by its mean torque alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.interpolate import PchipInterpolator

from calibration.data.runs import RunInTime
from calibration.work.threads import each
from model.effects import averaged, effects
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.laws import Chosen
from model.geometry import pulse_angle
from model.motor import Motor
from model.solvers import steady as base_steady
from model.solvers.crank_angle import OMEGA, THETA
from model.solvers.recent import Recent
from model.solvers.transient import Supply, rest_state

STRIDE = 4  # samples of a run in time between two looks at the effects' laws, where none follows the angle
LEAD_STEP_S = 0.02  # between the samples of the steady part ahead of a run
SLOWEST_START = 1.0  # rad/s
BESIDE = 4  # samples either side over which the swing of the pulses is taken
LONGEST_PULSE = 60  # samples
PLACES = 8  # in a pulse, even
ANGLES = 2  # within a pulse, over which is averaged what the pulses do where nobody knows how the shaft stood
CAUGHT = 0.5  # share of the way by the mean torque up to which a rotor has been caught at a dead point
LAST_STEP_S = 1e-3  # of the time from rest, over which the speed that is reached is taken
BEGUN, BEHIND = "begun", "behind"  # unknowns of a start from rest
LEADS = 16  # speeds on the way from rest, for a tachometer that lags
AFTER = 8  # samples beyond the last, for runs that turn a little farther
FINER = 4  # samples in one, where the pulses are followed
NANOSECONDS = 9  # digits of a time
LEAST_TURN = 1e-9  # rad from sample to sample, so that the angle is never twice the same
SLOWEST = 1.0  # rad/s; below it the swing is not taken to grow


_recent = Recent(32)


def follows_angle(names: Iterable[str]) -> bool:
    """Whether an effect follows the shaft's angle."""
    return any(effects()[name].periodic for name in names)


@dataclass(frozen=True)
class Sampled:
    """When a run is looked at.

    `wanted`: samples that are compared, and those between them.
    `time`, shape (k,): where these begin and end, those of a steady part ahead among them [s].
    `begin`, `end`, shape (wanted,): where the mean of each begins and ends among the times.
    `first`: where the first of them begins [s].
    """

    wanted: slice
    time: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    first: float


@dataclass(frozen=True)
class Plan:
    """What a simulation of a run in time takes.

    `parameters`, shape (27,): of the motor [SI].
    `readings`, shape (5,): `model.motor.Readings.vector`.
    `at`: when it is looked at.
    `start`, shape (9 + 2 n,): state at the first of its times.
    `line`, shape (n, 3): the supply as rows of start [s], pressure [Pa], and 1 where it is open.
    `clock`: the recording's clock at time 0 of the run [s].
    `lag_s`: the tachometer's own, as stated [s].
    `behind`: share by which it shows more, where a start from rest is compared from, than the mean torque has it [-].
    `angle`, `set_at`: angle of the shaft [rad], and the time at which it has that [s].
    `lead_time`, `lead`, shape (l,): of a start from rest, times before the first of its times [s], and the mean speeds
        since the time before [rad/s].
    """

    parameters: np.ndarray
    readings: np.ndarray
    line: np.ndarray
    at: Sampled
    start: np.ndarray
    chosen: Chosen
    clock: float
    lag_s: float
    behind: float
    angle: float
    set_at: float
    lead_time: np.ndarray
    lead: np.ndarray

    @property
    def time(self) -> np.ndarray:
        """Sample times, those of a steady part ahead among them [s], shape (k,)."""
        return self.at.time

    @property
    def supply(self) -> tuple[Supply, ...]:
        """The line as spans of constant pressure."""
        return tuple(Supply(start, pressure, is_open > 0.0) for start, pressure, is_open in self.line.tolist())

    def with_pulses(self) -> np.ndarray:
        """Mean speeds since the time before, with the pulses of the cylinders [rad/s], shape (k,)."""
        found = self.simulated()
        mean: np.ndarray = found.speed.copy()
        mean[1:] = np.diff(found.angle) / np.diff(self.time)
        return mean

    def simulated(self, finer: int = 1) -> effect_transient.Run:
        """The run with the pulses of its cylinders."""
        time = self.time
        if finer > 1:
            count = (time.size - 1) * finer + 1
            time = np.interp(np.arange(count) / finer, np.arange(time.size), time)
        stride = 1 if follows_angle(self.chosen) else STRIDE * finer
        return effect_transient.simulate(
            self.parameters, self.readings, self.supply, time, self.start, self.chosen, self.clock, stride
        )

    def mean_speed(self) -> np.ndarray:
        """Mean speeds since the sample before, by the mean torque alone [rad/s], shape (k,)."""
        return averaged.speeds(
            self.parameters,
            self.readings,
            self.line,
            self.time,
            float(self.start[OMEGA]),
            self.chosen,
            self.clock,
            float(self.start[THETA]),
        )

    def read(self, mean: np.ndarray) -> np.ndarray:
        """What the tachometer makes of mean speeds, of the samples wanted [rad/s], shape (wanted,).

        `mean`, shape (k,): since the time before [rad/s].
        """
        time, lagged, n = np.append(self.lead_time, self.time), np.append(self.lead, mean), self.lead.size
        if self.lag_s:
            lagged = effect_transient.lagged(lagged, time, self.lag_s)
            left = np.exp((self.time[0] - self.time) / self.lag_s)
            lagged[n + 1 :] += self.behind * lagged[n] * self.lag_s * -np.diff(left) / np.diff(self.time)
        lagged = effect_transient.read_with_lag(lagged, time, self.chosen)[n:]
        turned = np.append(0.0, np.cumsum(lagged[1:] * np.diff(self.time)))
        begin, end = self.at.begin, self.at.end
        found: np.ndarray = (turned[end] - turned[begin]) / (self.time[end] - self.time[begin])
        return found

    def angle_of(self, mean: np.ndarray) -> np.ndarray:
        """The shaft's angle at the samples [rad], shape (k,), counted so that it is the plan's where that is set.

        `mean`, shape (k,): mean speeds since the sample before [rad/s].
        """
        turned = np.append(0.0, np.cumsum(mean[1:] * np.diff(self.time)))
        found: np.ndarray = turned - np.interp(self.set_at, self.time, turned) + self.angle
        return found


class Pulses:
    """What the cylinders' pulses add to the angle of the shaft, as a function of that angle.

    `angles`: angles within a pulse that are averaged over; 1 for that of the plan alone [-].
    `mean`, `angle`, shape (k,): that run by its mean torque: speeds [rad/s] and angles [rad].
    """

    def __init__(self, planned: Plan, angles: int = 1) -> None:
        step = float(np.median(np.diff(planned.time)))
        longer = np.append(planned.time, planned.time[-1] + step * np.arange(1, AFTER + 1))
        planned = replace(planned, at=replace(planned.at, time=longer))
        pulse = pulse_angle(planned.parameters)
        starts = [planned.start.copy() for _ in range(angles)]
        for k, start in enumerate(starts):
            start[THETA] += k * pulse / angles
        found = each(lambda start: replace(planned, start=start).simulated(FINER), starts)
        self.mean = planned.mean_speed()
        self.angle = planned.angle_of(self.mean)
        smooth = np.interp(found[0].time, planned.time, self.angle)
        smooth = np.maximum.accumulate(smooth) + LEAST_TURN * np.arange(smooth.size)
        # From some angles a slow rotor is caught at a dead point; the one that was recorded was not.
        turned = [one.angle - one.angle[0] for one in found if np.all(np.isfinite(one.angle))]
        turned = [one for one in turned if one[-1] > CAUGHT * (smooth[-1] - smooth[0])]
        if turned and np.all(np.isfinite(smooth)):
            added = np.mean(turned, axis=0) - (smooth - smooth[0])
        else:  # it stalls: nothing is known of its pulses
            smooth, added = np.arange(float(smooth.size)), np.zeros(smooth.size)
        # Over a whole pulse each comes to nothing, wherever it began; what is left is what the mean torque has wrong.
        grid = np.arange(smooth[0], smooth[-1] + pulse / PLACES, pulse / PLACES)
        width = np.append(np.append(0.5, np.ones(PLACES - 1)), 0.5) / PLACES
        padded = np.pad(np.interp(grid, smooth, added), PLACES // 2, "reflect", reflect_type="odd")
        self._added = PchipInterpolator(grid, np.convolve(padded, width, "valid")) if grid.size > PLACES else None
        self._ends = (float(grid[0]), float(grid[-1]))

    def beside(self, planned: Plan) -> np.ndarray:
        """Mean speeds since the sample before, pulses and all, of a run much like it [rad/s], shape (k,)."""
        mean = planned.mean_speed()
        angle = planned.angle_of(mean)
        if self._added is None:
            return mean
        added = self._added(np.clip(angle, *self._ends))
        out = mean.copy()
        out[1:] += np.diff(added) / np.diff(planned.time)
        return out


def sampled(run: RunInTime) -> Sampled:
    """When a run is looked at: a start from rest from where it is compared, another from a steady part ahead on."""
    compared = np.flatnonzero(run.used)
    wanted = slice(int(compared[0]), int(compared[-1]) + 1) if compared.size else slice(0, 1)
    begins, ends = run.begin[wanted], run.time[wanted]
    first = float(begins.min())
    ahead = np.zeros(0) if run.from_rest else np.arange(run.valve[0].start_s, first - 0.5 * LEAD_STEP_S, LEAD_STEP_S)
    begins, ends = np.round(begins, NANOSECONDS), np.round(ends, NANOSECONDS)  # what begins where another ends
    time = np.unique(np.concatenate([ahead, begins, ends]))
    return Sampled(wanted, time, np.searchsorted(time, begins), np.searchsorted(time, ends), first)


def plan(
    motor: Motor,
    run: RunInTime,
    at: Sampled,
    parameters: np.ndarray,
    line: np.ndarray,
    angle: float,
    chosen: Chosen,
    own: Mapping[str, float] = MappingProxyType({}),
    lag_s: float = 0.0,
) -> Plan:
    """Plan a run.

    `motor`: for its readings of the article and its state at rest.
    `at`: when the run is looked at.
    `parameters`, shape (27,): of the motor [SI].
    `line`, shape (n, 3): the supply as rows of start [s], pressure [Pa], and 1 where it is open.
    `angle`: of the shaft where the run begins to be compared, or when its valve is moved [rad].
    `own`: of a start from rest, the shares by which it is faster there than by the mean torque (BEGUN), and by which
        the tachometer shows more (BEHIND) [-].
    `lag_s`: the tachometer's own [s].
    A start from rest begins where it is compared from, with the speed that the mean torque has given it by then.
    """
    readings = motor.readings.vector()
    lead_time = lead = np.zeros(0)
    if run.from_rest:
        set_at = at.first
        lead_time, lead = _from_rest(parameters, readings, line, set_at, chosen, run.start_s)
        # What broke away late has gathered as much less all the way.
        lead = np.maximum(lead + own.get(BEGUN, 0.0) * lead[-1], 0.0)
        speed, lead_time, lead = float(lead[-1]), lead_time[:-1], lead[:-1]
        start = rest_state(motor, angle)
    else:
        speed = max(_steady_speed(motor, parameters, readings, float(line[0, 1]), chosen, run.start_s), SLOWEST_START)
        # The angle meant is that at the end of the steady part: it would otherwise turn with every parameter.
        set_at = run.valve[1].start_s if len(run.valve) > 1 else at.first
        turned = angle - speed * (set_at - float(line[0, 0]))
        # Within one pulse, but where something follows the angle through a whole turn: then it may not jump.
        start = rest_state(motor, turned if follows_angle(chosen) else turned % pulse_angle(parameters))
    start[OMEGA] = speed
    behind = max(own.get(BEHIND, 0.0), -1.0)
    return Plan(
        parameters, readings, line, at, start, chosen, run.start_s, lag_s, behind, angle, set_at, lead_time, lead
    )


def _from_rest(
    parameters: np.ndarray, readings: np.ndarray, line: np.ndarray, until: float, chosen: Chosen, clock: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times from when the line opens [s], and the mean speeds that the mean torque has given the rotor by then [rad/s].

    The last is that at `until`, 0 where the line opens no sooner.
    """
    begins = float(next(iter(line[line[:, 2] > 0.0, 0]), until))
    if begins >= until - LAST_STEP_S:
        return np.array([until]), np.zeros(1)
    time = np.append(np.linspace(begins, until - LAST_STEP_S, LEADS), until)
    return time, averaged.speeds(parameters, readings, line, time, 0.0, chosen, clock)


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


def swing(planned: Plan, run: RunInTime) -> np.ndarray:
    """How far the pulses of the cylinders swing the shaft about its mean course, rms [rad], shape (n,)."""
    pulse = pulse_angle(planned.parameters)
    found, smooth = planned.simulated(), planned.mean_speed()
    mean = found.speed.copy()
    mean[1:] = np.diff(found.angle) / np.diff(planned.time)
    seen = _ripple(mean - smooth, mean, planned.time, pulse)
    within = np.abs(found.speed - 0.5 * (mean + np.append(mean[1:], mean[-1])))  # a reading is a mean
    width = np.ones(2 * BESIDE + 1) / (2 * BESIDE + 1)
    rms = np.sqrt(np.convolve(np.pad(np.maximum(within, np.abs(seen)) ** 2, BESIDE, "edge"), width, "valid"))
    out = np.zeros(run.size)
    per_radian = 2.0 * math.pi / pulse
    out[planned.at.wanted] = (rms / (per_radian * np.maximum(np.abs(mean), SLOWEST)))[planned.at.end]
    return out


def _ripple(added: np.ndarray, mean: np.ndarray, time: np.ndarray, pulse: float) -> np.ndarray:
    """What the pulses add from reading to reading, where there are several readings to a pulse [rad/s]."""
    step = np.diff(time, prepend=2.0 * time[0] - time[1])
    width = np.clip(np.rint(pulse / (np.maximum(np.abs(mean), SLOWEST) * step)).astype(int), 1, LONGEST_PULSE)
    total, n = np.append(0.0, np.cumsum(added)), np.arange(added.size)
    low, high = np.maximum(n - (width - 1) // 2, 0), np.minimum(n + width // 2, n.size - 1) + 1
    found: np.ndarray = added - (total[high] - total[low]) / (high - low)
    return found
