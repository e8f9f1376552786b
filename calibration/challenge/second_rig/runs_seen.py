"""What a recording's runs in time show, in units of noise, for any rig near a base.

Speeds are compared as the tachometer takes them (between teeth, over a window, since the sample before), the gauge's
readings as its rate gives them. The line is an unknown: what of an effect a line that fills a little otherwise would
show as well is not seen. So the whole line moves with its nuisances, and so do what the regulator is set to, the angle
at which the supply changes, and the moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.ndimage import uniform_filter1d

from calibration.challenge.second_rig import bench, readout, recordings
from calibration.challenge.second_rig.bench import CELL_S, Rig
from calibration.challenge.second_rig.machine.slots import BAR, PULSE, RPM
from calibration.challenge.second_rig.sheets import COLUMN, UNIT
from calibration.challenge.second_rig.supply import loaded
from calibration.challenge.second_rig.supply.line import Supply
from calibration.challenge.second_rig.truth import Truth
from rig.recording import Recording, RecordingFile

STEP_S = 2.5e-5  # of the march of a run
SLOWEST = 20.0  # rad/s; below it a run depends on the phase at which it is shut, and not linearly
PHASES, AT_ODDS = 4, 1.0  # within a pulse, from which a run is started, and by how much they may differ [rad/s]
END_S = 0.015  # from either end of a run, in which a pulse is not whole
PULSES_S = 0.02  # over which the gauge's pressure is smoothed: a small line throbs with the motor's draught
MOST = 250  # readings of a channel in a run; of more, neighbours are taken together
GAUGE_LATE_S = 0.005  # by which what a gauge shows may be older or newer than its time says
SETTLED_SHARE = 0.25  # of a run, at the end of a spin-up, over which the gauge tells what the regulator is set to

# Nuisances of the line, in factors of its figures: sd of the logarithm where the recording says nothing of it.
LINE_SDS = {
    "volume_m3": float(np.log(3.0)),
    "regulator_time_s": float(np.log(3.0)),
    "valve_time_s": float(np.log(2.0)),
    "droop": float(np.log(2.0)),
    "valve_m2": float(np.log(1.5)),
    "vent_m2": float(np.log(1.5)),
}
TOLD = {"volume_m3": "line_volume_l", "regulator_time_s": "regulator_time_s", "valve_time_s": "valve_time_s"}
LEAST_SD = 0.02
# A step that a bench calls ideal is a line that nobody would notice: whoever reads the recording does not know better.
QUICK = Supply.of(0.003, 1e-5, 0.003, 100.0, 100.0, 0.02)
TARGET_SD_PA = 2e4  # the gauge tells what the regulator is set to, not a prior
ANGLE_SD = PULSE / np.sqrt(12.0)
MOMENT_SD_S = 0.02  # supply_open may be late by tens of milliseconds
SLOPE_PA, ANGLE_RAD, MOMENT_S = 2000.0, 0.02, 5e-4  # over which slopes are taken
OF_RUN = 3  # nuisances of each run: setting, angle, moment


@dataclass(frozen=True)
class RunAsked:
    """A run of a recording, and what was read of it.

    `begins`, `ends`, shape (n,): between which each speed is the mean [s].
    `tooth`, `tooth_before`, shape (n,): numbers of the teeth at which each speed ends and begins.
    `gauged`, shape (m,): when the gauge was read [s].
    `taken`: how many readings each speed is the mean of [-].
    """

    run: bench.Run
    noise_scale: float
    begins: np.ndarray
    ends: np.ndarray
    tooth: np.ndarray
    tooth_before: np.ndarray
    gauged: np.ndarray
    taken: int = 1


def told_of(recording: Recording, truth: Truth) -> dict[str, Any]:
    """Tachometer and gauge of a recording's runs, as in `readout`; behind a bench's wires the recording's own."""
    if not truth.is_behind_wires:
        return truth.told()
    speed, supply = recording.channels["speed_rpm"], recording.supply
    told = {key: (getattr(supply, key), getattr(supply, f"{key}_sd")) for key in TOLD.values()}
    return dict(readout.PLAIN) | {
        "window_s": speed.window_s or 0.0,
        "teeth": round(speed.pulses_per_rev or 0.0),
        "pitch_error_sd": speed.pitch_error_sd or 0.0,
        "lag_s": speed.lag_s or 0.0,
        "supply_told": {key: list(one) for key, one in told.items() if one[0] is not None},
    }


def run_of(file: RecordingFile, truth: Truth, told: Mapping[str, Any], rig: Rig, angle: float) -> RunAsked:
    """A run of a recording, behind the line that the case has. `angle`: at which its supply changes [rad]."""
    time, pressure = file.columns["time_s"].values, file.columns["pressure_bar_abs"].values
    up = not file.columns["supply_open"].values[0] > 0.5
    if truth.is_behind_wires:
        opened = _opened(time, file.columns["supply_open"].values)
    else:
        opened = recordings.valve(truth, up, 1.0 + rig.added_inertia / truth.nuisances["inertia"])
    fresh = np.isfinite(pressure)
    if told["gauge_held"]:
        fresh[1:] &= ~(pressure[1:] == pressure[:-1])
    gauged = time[fresh]
    true = (pressure[fresh] - truth.errors.get("pressure_offset_bar", 0.0)) * BAR
    true /= 1.0 + truth.errors.get("pressure_scale", 0.0)
    moment = bench.SAMPLE_S * int(np.flatnonzero(opened == opened[-1])[0])
    stands = gauged > (1.0 - SETTLED_SHARE) * time[-1] if up else gauged < moment
    stands = stands if np.any(stands) else true >= true.max()
    p = np.array(list(rig.figures().values()))
    target = loaded.set_for(p, rig.supply or QUICK, float(np.mean(true[stands])))
    begins, ends, rpm = spans(told, time, file.columns["speed_rpm"].values)
    run = bench.Run(target, opened, file.start_s, angle)
    tooth = np.arange(1, ends.size + 1)
    before = tooth - 1
    if told["teeth"] and told["tachometer"] != readout.TOOTH:  # several teeth from one sample to the next
        passed = np.rint(told["teeth"] * rpm / RPM * (ends - begins) / (2.0 * np.pi)).astype(int)
        tooth = np.cumsum(passed)
        before = tooth - passed
    return RunAsked(run, file.noise_scale, begins, ends, tooth, before, gauged)


def _opened(time: np.ndarray, supply_open: np.ndarray) -> np.ndarray:
    """Whether the valve is driven towards the regulator, a sample of `bench.SAMPLE_S` each, as rows say it."""
    at = bench.SAMPLE_S * (np.arange(int(np.ceil(time[-1] / bench.SAMPLE_S)) + 1) + 0.5)
    place = np.clip(np.searchsorted(time, at), 0, time.size - 1)
    return supply_open[place] > 0.5


def spans(
    told: Mapping[str, Any], time: np.ndarray, speed_rpm: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Between which times each speed is the mean [s], and the speed [rpm], a row each that has one.

    `time`, shape (n,): of the rows [s].
    `speed_rpm`, shape (n,): nan where no speed was read.
    """
    counts = told["tachometer"] == readout.TOOTH
    read = np.isfinite(speed_rpm) & ((speed_rpm > 0.0) | (not counts))
    ends, rpm = time[read], speed_rpm[read]
    if counts:
        return ends - 60.0 / told["teeth"] / rpm, ends, rpm
    if told["window_s"]:
        return ends - told["window_s"], ends, rpm
    return np.concatenate([[0.0], ends[:-1]]), ends, rpm


def line_sds(told: Mapping[str, Any]) -> np.ndarray:
    """Sds of the logarithms of the line's figures, in the order of `LINE_SDS`, as far as a recording tells them."""
    found = dict(LINE_SDS)
    for name, key in TOLD.items():
        value, sd = told["supply_told"].get(key, (0.0, None))
        if value > 0.0 and sd is not None:
            found[name] = min(max(sd / value, LEAST_SD), LINE_SDS[name])
    return np.array(list(found.values()))


def moved_supply(supply: Supply, logs: np.ndarray) -> Supply:
    """A line with other figures. `logs`, shape (k,): logarithms of the factors, in the order of `LINE_SDS` [-]."""
    factors = zip(LINE_SDS, np.exp(logs), strict=True)
    return replace(supply, **{name: float(getattr(supply, name) * factor) for name, factor in factors})


def noise_of(recording: Recording) -> dict[str, tuple[float, float]]:
    """Declared noise and resolution of each channel [SI]."""
    channels = {channel: recording.channels[column] for channel, column in COLUMN.items()}
    return {name: (one.noise_sd / UNIT[name], one.resolution / UNIT[name]) for name, one in channels.items()}


def noise_sd(noise: tuple[float, float], scale: float) -> float:
    """Declared noise of a reading, its rounding included [SI]. `noise`: of its channel, of `noise_of` [SI]."""
    return float(np.hypot(noise[0] * scale, noise[1] / np.sqrt(12.0)))


def thinned(times: np.ndarray) -> np.ndarray:
    """At most `MOST` of some times [s]. `times`, shape (n,): the times [s]."""
    return times[:: max(1, -(-times.size // MOST))]


class RunsSeen:
    """The readings of a recording's runs as vectors of unit noise.

    `noise`: of each channel, of `noise_of` [SI].
    `base`: without effects; which readings count is decided here.
    """

    def __init__(
        self,
        asked: Sequence[RunAsked],
        told: Mapping[str, Any],
        noise: Mapping[str, tuple[float, float]],
        base: Rig,
    ) -> None:
        self.told, self.noise = told, noise
        behind = replace(base, supply=base.supply or QUICK)
        self.asked = [self._kept(one, behind) for one in asked]
        self._lower = [self._noise(one) for one in self.asked]
        self._gauge_sd = [self._gauge_noise(one, behind) for one in self.asked]
        self.line_sds = line_sds(told) if asked else np.empty(0)

    @property
    def size(self) -> int:
        """Number of nuisances: of the line, then of each run [-]."""
        return self.line_sds.size + OF_RUN * len(self.asked)

    @property
    def steps(self) -> np.ndarray:
        """Over which slopes with the nuisances are taken, in declared sds, shape (k,)."""
        of_run = (SLOPE_PA / TARGET_SD_PA, ANGLE_RAD / ANGLE_SD, MOMENT_S / MOMENT_SD_S)
        return np.array([*np.log(1.1) / self.line_sds, *(of_run * len(self.asked))])

    @property
    def angles(self) -> slice:
        """Places of the runs' angles among the nuisances."""
        return slice(self.line_sds.size + 1, None, OF_RUN)

    def readings(self, rig: Rig, z: np.ndarray | None = None) -> list[np.ndarray]:
        """Readings of a rig in units of noise, an array a run: speeds, then pressures.

        `z`, shape (k,), or None: by how many declared sds the nuisances are off; nothing for None [-].
        """
        z = np.zeros(self.size) if z is None else z
        lines = self.line_sds.size
        if not self.asked:
            return []
        behind = replace(rig, supply=moved_supply(rig.supply or QUICK, self.line_sds * z[:lines]))
        found = []
        for k, one in enumerate(self.asked):
            target, angle, late = z[lines + OF_RUN * k : lines + OF_RUN * (k + 1)]
            speed, pressure = self._seen(one, behind, TARGET_SD_PA * target, ANGLE_SD * angle, MOMENT_SD_S * late)
            if speed.size:
                speed = solve_triangular(self._lower[k], speed, lower=True)
            found.append(np.concatenate([speed, pressure / self._gauge_sd[k]]))
        return found

    def _seen(
        self, one: RunAsked, rig: Rig, target: float = 0.0, angle: float = 0.0, late: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Speeds [rad/s] and pressures [Pa] that the instruments show."""
        asked = replace(one.run, line=one.run.line + target, angle=one.run.angle + angle)
        went = bench.history(rig, asked, STEP_S, ripple=False)
        turned = readout.wheel(went.turned, self.told["lag_s"])
        line_pa = readout.slowed(went.pressure, self.told["gauge_lag_s"])
        line_pa = uniform_filter1d(line_pa, round(PULSES_S / CELL_S), mode="nearest")
        begins, ends = (readout.angle_at(turned, times - late) for times in (one.begins, one.ends))
        speed = (ends - begins) / (one.ends - one.begins)
        pressure = np.interp(one.gauged - late, np.arange(line_pa.size) * CELL_S, line_pa)
        clock = one.run.start_s + one.ends
        return bench.shown_speed(rig, speed, clock), bench.shown_pressure(rig, pressure)

    def _kept(self, one: RunAsked, base: Rig) -> RunAsked:
        """The run with the readings that count; of many, neighbours are taken together."""
        last = one.run.opened.size * bench.SAMPLE_S
        kept = self._reached(one, base) & (one.begins > END_S) & (one.ends < last - END_S)
        begins, ends, tooth, before = (x[kept] for x in (one.begins, one.ends, one.tooth, one.tooth_before))
        many = max(1, -(-ends.size // MOST))
        follow = not self.told["window_s"] > self.told["period_s"]  # or the means overlap, and some are left out
        first = np.arange(0, max(ends.size - many + 1, 0), many)
        taken = many if follow else 1
        last_one = first + taken - 1
        return replace(
            one,
            begins=begins[first],
            ends=ends[last_one],
            tooth=tooth[last_one],
            tooth_before=before[first],
            gauged=thinned(one.gauged[one.gauged < last - END_S]),
            taken=taken,
        )

    def _reached(self, one: RunAsked, base: Rig) -> np.ndarray:
        """Which speeds hardly depend on the phase at which the run starts, or is shut.

        Behind a slow line a motor breaks away a pulse earlier or later, and then everything is otherwise for a while.
        """
        from_phases = np.array([self._seen(one, base, angle=PULSE * k / PHASES)[0] for k in range(PHASES)])
        kept: np.ndarray = from_phases.min(axis=0) > SLOWEST
        at_odds = np.flatnonzero((np.ptp(from_phases, axis=0) > AT_ODDS) & (from_phases.max(axis=0) > SLOWEST))
        if one.run.opened[-1] and at_odds.size:
            kept[: at_odds[-1] + 1] = False
        elif at_odds.size:
            kept[at_odds[0] :] = False
        return kept

    def _noise(self, one: RunAsked) -> np.ndarray:
        """Cholesky factor of the speeds' covariance [rad/s]: each its own noise, and what teeth out of place do."""
        covariance = np.eye(one.ends.size) * noise_sd(self.noise["speed"], one.noise_scale) ** 2 / one.taken
        if self.told["pitch_error_sd"] > 0.0:
            teeth = np.eye(self.told["teeth"])
            at = one.tooth % len(teeth), one.tooth_before % len(teeth)
            out = (teeth[at[0]] - teeth[at[1]]) / (one.ends - one.begins)[:, None]
            out *= self.told["pitch_error_sd"] * 2.0 * np.pi / len(teeth)
            covariance += out @ out.T
        return np.linalg.cholesky(covariance)

    def _gauge_noise(self, one: RunAsked, base: Rig) -> np.ndarray:
        """Noise of each pressure [Pa]: the gauge's own, and what its time does to a line that moves."""
        (_, early), (_, late) = (self._seen(one, base, late=by) for by in (GAUGE_LATE_S, -GAUGE_LATE_S))
        return np.hypot(noise_sd(self.noise["pressure"], one.noise_scale), 0.5 * (late - early))
