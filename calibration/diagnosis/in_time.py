"""A run in time as the motor would run it: with every pulse of its cylinders, or by its mean torque alone."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from calibration.diagnosis.blocks import RunInTime
from calibration.diagnosis.threads import each
from model import layout as at
from model import steady as base_steady
from model.effects import averaged, effects
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.motor import Motor
from model.recent import Recent
from model.transient import OMEGA, THETA, Supply, rest_state

STRIDE = 4  # samples of a run in time between two looks at the effects' laws, where none follows the angle
LEAD_STEP_S = 0.02  # between the samples of the steady part ahead of a run
SLOWEST_START = 1.0  # rad/s
BESIDE = 4  # samples either side over which the swing of the pulses is taken
LONGEST_PULSE = 60  # samples
STARTS = 2  # courses that starts from rest are made of
UNSURE = 0.3  # share of what the angle does to a start from rest that no model has right
AFTER = 8  # samples beyond the last, for runs that turn a little farther
FINER = 4  # samples in one, where the pulses are followed
LEAST_TURN = 1e-9  # rad from sample to sample, so that the angle is never twice the same
SLOWEST = 1.0  # rad/s; below it the swing is not taken to grow

Chosen = Mapping[str, Mapping[str, float]]

_recent = Recent(32)


def follows_angle(names: Iterable[str]) -> bool:
    """Whether an effect follows the shaft's angle.

    Parameters
    ----------
    names : iterable of str
        Effect ids.
    """
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
    supply : tuple of Supply
        The line, true pressures.
    time : ndarray, shape (k,)
        Sample times, those of a steady part ahead among them [s].
    start : ndarray, shape (23,)
        State at the first of them.
    chosen : dict
        Effects.
    clock : float
        The recording's clock at time 0 of the run [s].
    wanted : int
        Samples at the end that are compared [-].
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
    wanted: int
    angle: float
    set_at: float

    def with_pulses(self, finer: int = 1) -> effect_transient.Run:
        """The run with the pulses of its cylinders.

        Parameters
        ----------
        finer : int
            Samples for each one planned [-].
        """
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
            self.supply,
            self.time,
            float(self.start[OMEGA]),
            self.chosen,
            self.clock,
            float(self.start[THETA]),
        )

    def read(self, mean: np.ndarray, whole: bool = False) -> np.ndarray:
        """What the tachometer makes of mean speeds, of the samples wanted [rad/s], shape (wanted,).

        Parameters
        ----------
        mean : ndarray, shape (k,)
            Since the sample before [rad/s].
        whole : bool
            Whether all samples are wanted; shape (k,) then.
        """
        found = effect_transient.read_with_lag(mean, self.time, self.chosen)
        return found if whole else found[-self.wanted :]

    def angle_of(self, mean: np.ndarray) -> np.ndarray:
        """The shaft's angle at the samples [rad], shape (k,), counted so that it is the plan's where that is set.

        Parameters
        ----------
        mean : ndarray, shape (k,)
            Mean speeds since the sample before [rad/s].
        """
        turned = np.append(0.0, np.cumsum(mean[1:] * np.diff(self.time)))
        found: np.ndarray = turned - np.interp(self.set_at, self.time, turned) + self.angle
        return found


class Pulses:
    """What the cylinders' pulses add to the angle of the shaft, as a function of that angle.

    Parameters
    ----------
    planned : Plan
        The run that it is taken from.

    Attributes
    ----------
    mean, angle : ndarray, shape (k,)
        That run by its mean torque: speeds [rad/s] and angles [rad].
    """

    def __init__(self, planned: Plan) -> None:
        step = float(planned.time[-1] - planned.time[-2])
        planned = replace(planned, time=np.append(planned.time, planned.time[-1] + step * np.arange(1, AFTER + 1)))
        found = planned.with_pulses(FINER)
        self.mean = planned.mean_speed()
        self.angle = planned.angle_of(self.mean)
        smooth = np.interp(found.time, planned.time, self.angle)
        smooth = np.maximum.accumulate(smooth) + LEAST_TURN * np.arange(smooth.size)
        added = found.angle - found.angle[0] - (smooth - smooth[0])
        if not (
            np.all(np.isfinite(smooth)) and np.all(np.isfinite(added))
        ):  # it stalls: nothing is known of its pulses
            smooth, added = np.arange(float(smooth.size)), np.zeros(smooth.size)
        self._added = PchipInterpolator(smooth, added)
        self._ends = (float(smooth[0]), float(smooth[-1]))

    def beside(self, planned: Plan) -> np.ndarray:
        """Mean speeds since the sample before, pulses and all, of a run much like it [rad/s], shape (k,).

        Parameters
        ----------
        planned : Plan
            The run.
        """
        mean = planned.mean_speed()
        angle = planned.angle_of(mean)
        added = self._added(np.clip(angle, *self._ends))
        out = mean.copy()
        out[1:] += np.diff(added) / np.diff(planned.time)
        return out


def plan(
    motor: Motor, run: RunInTime, parameters: np.ndarray, supply: Sequence[Supply], angle: float, chosen: Chosen
) -> Plan:
    """Plan a run.

    Parameters
    ----------
    motor : Motor
        For its readings of the article and its state at rest.
    run : RunInTime
        As it was read.
    parameters : ndarray, shape (24,)
        Of the motor [SI].
    supply : sequence of Supply
        Its line, true pressures.
    angle : float
        Of the shaft, at rest, or when the steady part of a run ends [rad].
    chosen : dict
        Effects.

    Returns
    -------
    Plan
        Its first sample of those wanted is the recording's first; one step before it is there too.
    """
    readings = motor.readings.vector()
    step = float(run.time[1] - run.time[0])
    if run.from_rest:
        start, set_at = rest_state(motor, angle), float(run.time[0]) - step
        time = np.concatenate([[run.time[0] - step], run.time])
    else:
        speed = max(
            _steady_speed(motor, parameters, readings, supply[0].pressure_pa, chosen, run.start_s), SLOWEST_START
        )
        # The angle meant is that at the end of the steady part: it would otherwise turn with every parameter.
        set_at = supply[1].start_s if len(supply) > 1 else float(run.time[0])
        ahead = set_at - supply[0].start_s
        begins = angle - speed * ahead
        # Within one pulse, but where something follows the angle through a whole turn: then it may not jump.
        start = rest_state(motor, begins if follows_angle(chosen) else begins % at.PULSE)
        start[OMEGA] = speed
        before = np.arange(supply[0].start_s, run.time[0] - 0.5 * step, LEAD_STEP_S)
        time = np.concatenate([before[before < run.time[0] - step - 1e-9], [run.time[0] - step], run.time])
    time = time[: time.size - run.size + run.wanted]
    return Plan(parameters, readings, tuple(supply), time, start, chosen, run.start_s, run.wanted, angle, set_at)


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
    """How far the pulses of the cylinders swing the shaft about its mean course, rms [rad], shape (n,).

    Parameters
    ----------
    planned : Plan
        The run.
    run : RunInTime
        As it was read.
    """
    found = planned.with_pulses()
    mean = found.reading
    seen = _ripple((mean - planned.read(planned.mean_speed(), whole=True))[-run.wanted :], mean[-run.wanted :], run)
    between = 0.5 * (mean + np.append(mean[1:], mean[-1]))  # a reading is a mean since the sample before
    within = ((found.speed - between) ** 2)[-run.wanted :]
    width = np.ones(2 * BESIDE + 1) / (2 * BESIDE + 1)
    rms = np.sqrt(np.convolve(np.pad(np.maximum(within, seen**2), BESIDE, "edge"), width, "valid"))
    out = np.zeros(run.size)
    per_radian = 2.0 * math.pi / at.PULSE
    out[: run.wanted] = rms / (per_radian * np.maximum(np.abs(mean[-run.wanted :]), SLOWEST))
    return out


class Start:
    """What the pulses do to a run that starts from rest, over the angles at which its rotor may have stood.

    What the angle does to the start is not smooth: with another cylinder open the rotor breaks away some milliseconds
    later. So it is not an unknown; the few courses that its influence is made of are. They come as late as the air.

    Parameters
    ----------
    plans : sequence of Plan
        The run from several angles.
    run : RunInTime
        As it was read.

    Attributes
    ----------
    swing : ndarray, shape (n,)
        How far the shaft swings beyond the courses, rms [rad].
    """

    def __init__(self, plans: Sequence[Plan], run: RunInTime) -> None:
        self._time, wanted, count = plans[0].time, run.wanted, len(plans)
        step = float(run.time[1] - run.time[0])
        longer = np.append(self._time, self._time[-1] + step * np.arange(1, AFTER + 1))
        runs = each(lambda plan: replace(plan, time=longer).with_pulses(FINER), plans)
        fine = runs[0].time
        smooth = np.append(0.0, np.cumsum(replace(plans[0], time=fine).mean_speed()[1:] * np.diff(fine)))
        added = np.array([found.angle - found.angle[0] for found in runs]) - smooth
        found = np.diff(added[:, ::FINER], axis=1)[:, :wanted] / np.diff(self._time)
        average = found.mean(axis=0)
        apart = (found - average) * run.used[:wanted]
        weights, size, ways = np.linalg.svd(apart, full_matrices=False)
        # That later ones mean the same.
        signs = np.where(ways[:STARTS] @ (plans[0].mean_speed()[1:] + average) < 0.0, -1.0, 1.0)
        shares = np.vstack([np.full(count, 1.0 / count), (weights[:, :STARTS] * signs).T / math.sqrt(count)])
        self._added = PchipInterpolator(fine, shares @ added, axis=1)
        self._ends = float(fine[0]), float(fine[-1])
        courses = ways[:STARTS] * (size[:STARTS, None] / math.sqrt(count))
        rest = np.sqrt(np.maximum(np.mean(apart**2, axis=0) - np.sum(courses**2, axis=0), 0.0))
        rest = np.hypot(rest, UNSURE * np.std(found, axis=0))
        swing_of = rest * step / math.sqrt(2.0)  # a reading is a difference of two angles
        self.swing = np.pad(swing_of, (0, run.size - wanted))

    def added(self, share: np.ndarray, late_s: float) -> np.ndarray:
        """What is added to the speeds by the mean torque [rad/s], shape (wanted,).

        Parameters
        ----------
        share : ndarray, shape (STARTS,)
            How much there is of each way in which starts differ, in sds [-].
        late_s : float
            By how much the air enters later than the samples say [s].
        """
        angle = np.append(1.0, share) @ self._added(np.clip(self._time - late_s, *self._ends))
        found: np.ndarray = np.diff(angle) / np.diff(self._time)
        return found


def _ripple(added: np.ndarray, mean: np.ndarray, run: RunInTime) -> np.ndarray:
    """What the pulses add from reading to reading, where there are several readings to a pulse [rad/s]."""
    step = float(run.time[1] - run.time[0])
    width = np.clip(np.rint(at.PULSE / (np.maximum(np.abs(mean), SLOWEST) * step)).astype(int), 1, LONGEST_PULSE)
    total, n = np.append(0.0, np.cumsum(added)), np.arange(added.size)
    low, high = np.maximum(n - (width - 1) // 2, 0), np.minimum(n + width // 2, n.size - 1) + 1
    found: np.ndarray = added - (total[high] - total[low]) / (high - low)
    return found
