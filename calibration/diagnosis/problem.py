"""A recording against the model as one vector: what was read less what is predicted, each in units of its noise.

The unknowns are standard normal numbers z, as in the fit: every nuisance first (f_overall, lap, roller
friction, ambient, offsets and scales of the instruments, and for each run in time the angle that it starts at),
then the parameters of the effects in question. The gauge's own noise is integrated out: it moves speed and flow
of a plateau together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.blocks import Blocks, RunInTime, blocks_of
from calibration.priors import PASCAL_PER_BAR, Unknown, at_ambient, column_of, unknowns
from model import layout as at
from model import steady as base_steady
from model.effects import effects
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.effect import Effect, State
from model.effects.laws import readings_of
from model.layout import L_MIN, RPM
from model.motor import QUANTITIES, Motor, read_motor
from model.transient import OMEGA, Supply, rest_state
from rig.recording import Recording, RecordingError

SI_OF = {"pressure": PASCAL_PER_BAR, "flow": 1.0 / L_MIN, "speed": 1.0 / RPM}
CHANNELS = ("pressure", "flow", "speed")
SHAPE_FACTOR = 2.0  # one sd of a shape parameter's log-normal prior
ANGLE_SD = at.PULSE / math.sqrt(12.0)  # of a starting angle that may be anywhere within a pulse [rad]
STRIDE = 4  # samples of a run in time between two looks at the effects' laws, where none follows the angle
VENTED = "vented_span_share"  # of a gauge's span error that shows at ambient pressure
BESIDE = 4  # samples either side over which the swing of the pulses is taken
SLOWEST = 1.0  # rad/s; below it the swing is not taken to grow


@dataclass(frozen=True)
class Prediction:
    """What the model says at a point.

    Attributes
    ----------
    flow, speed : ndarray, shape (n,)
        Readings expected of the plateaus [m3/s], [rad/s].
    flow_slope, speed_slope : ndarray, shape (n,)
        With the true pressure [m3/s/Pa], [rad/s/Pa].
    runs : tuple of ndarray
        Speed readings expected of each run in time [rad/s].
    vented : ndarray, shape (k,)
        Gauge readings expected with the line vented [Pa].
    state : State
        Of the plateaus.
    """

    flow: np.ndarray
    speed: np.ndarray
    flow_slope: np.ndarray
    speed_slope: np.ndarray
    runs: tuple[np.ndarray, ...]
    vented: np.ndarray
    state: State


class Problem:
    """A recording, its motor, and every nuisance.

    Parameters
    ----------
    recording : Recording
        The recording.
    motor : Motor or None
        The motor that it names, when left out.
    """

    def __init__(self, recording: Recording, motor: Motor | None = None) -> None:
        if motor is None:
            if not isinstance(recording.motor, str):
                raise RecordingError(
                    "this recording's motor is written out in it; diagnose takes a motor of configs/motors"
                )
            motor = read_motor(str(recording.motor))
        self.motor = at_ambient(motor, recording)
        self.recording = recording
        self.blocks: Blocks = blocks_of(recording)
        everything = unknowns(self.motor, recording)
        self.nuisances: list[Unknown] = [u for u in everything if not u.name.endswith("_noise_scale")]
        for run in self.blocks.runs:
            self.nuisances.append(Unknown(f"{run.file}.supply", "Pa", "normal", 0.0, max(run.supply_sd, 1.0), "noise"))
            self.nuisances.append(Unknown(f"{run.file}.angle", "rad", "normal", 0.0, ANGLE_SD, "nobody set it"))
        if self.blocks.vented.pressure.size:
            self.nuisances.append(Unknown(VENTED, "-", "normal", 0.5, 0.5, "where a gauge's span begins is not stated"))
        self._base = self.motor.vector()
        self._readings = self.motor.readings.vector()
        self._share = next((i for i, u in enumerate(self.nuisances) if u.name == VENTED), None)
        self._place = {name: i for i, name in enumerate(QUANTITIES)}
        columns = {channel: column_of(recording, channel) for channel in CHANNELS}
        self.noise = {
            channel: recording.channels[column].noise_sd * SI_OF[channel] if column else 0.0
            for channel, column in columns.items()
        }
        self.resolution = {
            channel: recording.channels[column].resolution * SI_OF[channel] if column else 0.0
            for channel, column in columns.items()
        }
        P_a = self.motor.si("ambient_pressure")
        plateaus = self.blocks.plateaus
        self._gas = base_steady.gas_table(
            self.motor, np.clip(plateaus.pressure + np.where(plateaus.is_gauge, P_a, 0.0), 5e4, 8e5)
        )
        self.start_angle = {run.file: 0.0 for run in self.blocks.runs}

    def effect_unknowns(self, names: Sequence[str]) -> list[tuple[str, Unknown]]:
        """The unknowns of a set of effects, in the order of the set.

        Parameters
        ----------
        names : sequence of str
            Effect ids.

        Returns
        -------
        list of (str, Unknown)
            Effect id and unknown; its prior is that of `model.effects.EffectParameter`.
        """
        found = []
        for name in names:
            for parameter in effects()[name].parameters:
                kind, a, b = (
                    ("lognormal", parameter.scale, SHAPE_FACTOR)
                    if parameter.shape
                    else ("normal", parameter.expected, parameter.scale)
                )
                found.append((name, Unknown(parameter.name, parameter.unit, kind, a, b, "effect")))  # type: ignore[arg-type]
        return found

    def chosen(self, names: Sequence[str], z: np.ndarray) -> dict[str, dict[str, float]]:
        """Values of the effects' parameters.

        Parameters
        ----------
        names : sequence of str
            Effect ids.
        z : ndarray, shape (k,)
            The effects' share of the point [-].
        """
        found: dict[str, dict[str, float]] = {name: {} for name in names}
        for (name, unknown), at_z in zip(self.effect_unknowns(names), z, strict=True):
            found[name][unknown.name] = float(unknown.value(np.asarray(at_z)))
        return found

    def predict(
        self,
        z: np.ndarray,
        chosen: dict[str, dict[str, float]],
        like: Prediction | None = None,
        runs: Sequence[int] | None = None,
    ) -> Prediction:
        """What the instruments would read.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].
        chosen : dict
            Effects and the values of their parameters.
        like : Prediction or None
            Where runs that are not simulated anew are taken from.
        runs : sequence of int or None
            Indices of the runs to simulate; all when left out [-].
        """
        parameters, errors, supply, angle = self._split(z)
        points, state, _ = self._plateaus(parameters, errors, chosen)
        flow = readings_of(chosen, "flow", points.flow, state) * (1.0 + errors["flow"][1]) + errors["flow"][0]
        speed = readings_of(chosen, "speed", points.speed, state) * (1.0 + errors["speed"][1]) + errors["speed"][0]
        found = tuple(
            self._read_speed(
                self._run(run, parameters, errors, supply[run.file], angle[run.file], chosen), run, errors, chosen
            )
            if like is None or runs is None or i in runs
            else like.runs[i]
            for i, run in enumerate(self.blocks.runs)
        )
        vented = self._vented(float(z[self._share]) if self._share is not None else 0.0, parameters, errors, chosen)
        return Prediction(flow, speed, points.flow_slope, points.speed_slope, found, vented, state)

    def _vented(
        self,
        share_z: float,
        parameters: np.ndarray,
        errors: dict[str, tuple[float, float]],
        chosen: dict[str, dict[str, float]],
    ) -> np.ndarray:
        """The gauge at ambient pressure: its span may count from there, from vacuum, or from anywhere between [Pa]."""
        vented, offset = self.blocks.vented, errors["pressure"][0]
        if not vented.pressure.size:
            return vented.pressure
        P_a = np.full(vented.pressure.size, parameters[at.P_A])
        none, high = np.zeros_like(P_a), P_a.copy()
        at_vacuum = readings_of(chosen, "pressure", none, _no_state(none))
        span = readings_of(chosen, "pressure", high, _no_state(high)) - at_vacuum - P_a + errors["pressure"][1] * P_a
        share = float(self.nuisances[self._share].value(np.asarray(share_z))) if self._share is not None else 0.5
        found: np.ndarray = np.where(vented.is_gauge, 0.0, P_a + share * span) + at_vacuum + offset
        return found

    def _split(
        self, z: np.ndarray
    ) -> tuple[np.ndarray, dict[str, tuple[float, float]], dict[str, float], dict[str, float]]:
        parameters = self._base.copy()
        errors = {channel: [0.0, 0.0] for channel in CHANNELS}
        supply = {run.file: 0.0 for run in self.blocks.runs}
        angle = dict(self.start_angle)
        for at_z, unknown in zip(z, self.nuisances, strict=True):
            value = float(unknown.value(np.asarray(at_z)))
            if unknown.name in self._place:
                quantity = QUANTITIES[unknown.name]
                parameters[self._place[unknown.name]] = min(max(value, quantity.low), quantity.high) * quantity.to_si
            elif unknown.name == VENTED:
                continue
            elif unknown.name.endswith(".supply"):
                supply[unknown.name.removesuffix(".supply")] = value
            elif unknown.name.endswith(".angle"):
                angle[unknown.name.removesuffix(".angle")] += value
            else:
                channel, _, error = unknown.name.partition("_")
                errors[channel][error == "scale"] = value * (SI_OF[channel] if error == "offset" else 1.0)
        return parameters, {channel: (pair[0], pair[1]) for channel, pair in errors.items()}, supply, angle

    def _plateaus(
        self, parameters: np.ndarray, errors: dict[str, tuple[float, float]], chosen: dict[str, dict[str, float]]
    ) -> tuple[effect_steady.Points, State, np.ndarray]:
        plateaus = self.blocks.plateaus
        rows = np.tile(parameters, (plateaus.size, 1))
        true = self.true_pressure(plateaus.pressure, plateaus.is_gauge, parameters, errors, chosen)
        points = effect_steady.solve(
            rows, self._readings, np.clip(true, 3e4, 1.9e6), self._gas, chosen, plateaus.time, slopes=True
        )
        return points, points.state, true

    def true_pressure(
        self,
        reading: np.ndarray,
        is_gauge: np.ndarray | bool,
        parameters: np.ndarray,
        errors: dict[str, tuple[float, float]],
        chosen: dict[str, dict[str, float]],
    ) -> np.ndarray:
        """True line pressure behind a gauge's reading, its errors and the effects on it undone [Pa].

        Parameters
        ----------
        reading : ndarray, shape (n,)
            Of the gauge [Pa].
        is_gauge : ndarray of bool
            Whether it counts from the ambient.
        parameters : ndarray, shape (24,)
            For the ambient [SI].
        errors : dict
            Offset [SI] and scale [-] of each channel.
        chosen : dict
            Effects.
        """
        offset, scale = errors["pressure"]
        wanted = (reading - offset) / (1.0 + scale)
        true = wanted.copy()
        if any("pressure" in effects()[name].reads for name in chosen):
            nothing = _no_state(true)
            for _ in range(4):
                true = true + wanted - readings_of(chosen, "pressure", true, nothing)
        return true + np.where(is_gauge, parameters[at.P_A], 0.0)

    def _run(
        self,
        run: RunInTime,
        parameters: np.ndarray,
        errors: dict[str, tuple[float, float]],
        supply_error: float,
        angle: float,
        chosen: dict[str, dict[str, float]],
    ) -> effect_transient.Run:
        """The run in time; its first sample is the step before the recording's first."""
        supply = [
            Supply(
                span.start_s,
                float(
                    self.true_pressure(
                        np.array([span.pressure_pa - supply_error]), run.is_gauge, parameters, errors, chosen
                    )[0]
                )
                if span.is_open
                else span.pressure_pa,
                span.is_open,
            )
            for span in run.supply
        ]
        step = float(run.time[1] - run.time[0])
        if run.from_rest:
            start = rest_state(self.motor, angle)
            time = np.concatenate([[run.time[0] - step], run.time])
        else:
            rows = parameters[None, :]
            pressure = np.array([supply[0].pressure_pa])
            first = effect_steady.solve(
                rows,
                self._readings,
                pressure,
                base_steady.gas_table(self.motor, pressure),
                chosen,
                np.array([run.start_s]),
            )
            speed = max(float(first.speed[0]), 1.0)
            # The angle meant is that at the end of the steady part: it would otherwise turn with every parameter.
            ahead = (supply[1].start_s if len(supply) > 1 else run.time[0]) - supply[0].start_s
            start = rest_state(self.motor, (angle - speed * ahead) % at.PULSE)
            start[OMEGA] = speed
            before = np.arange(supply[0].start_s, run.time[0] - 0.5 * step, 0.02)
            time = np.concatenate([before[before < run.time[0] - step - 1e-9], [run.time[0] - step], run.time])
        stride = 1 if any(effects()[name].periodic for name in chosen) else STRIDE
        time = time[: time.size - run.size + run.wanted]
        return effect_transient.simulate(parameters, self._readings, supply, time, start, chosen, run.start_s, stride)

    def _read_speed(
        self,
        found: effect_transient.Run,
        run: RunInTime,
        errors: dict[str, tuple[float, float]],
        chosen: dict[str, dict[str, float]],
    ) -> np.ndarray:
        reading = np.full(run.size, np.nan)
        true = found.reading[-run.wanted :]
        read = readings_of(chosen, "speed", true, _no_state(true))
        reading[: run.wanted] = read * (1.0 + errors["speed"][1]) + errors["speed"][0]
        return reading

    def swing(self, z: np.ndarray, i: int) -> np.ndarray:
        """How far the pulses of the cylinders swing the shaft about its mean course in a run in time, rms.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances of the base model [-].
        i : int
            Index of the run [-].

        Returns
        -------
        ndarray, shape (n,)
            At each sample [rad].
        """
        run = self.blocks.runs[i]
        parameters, errors, supply, angle = self._split(z)
        found = self._run(run, parameters, errors, supply[run.file], angle[run.file], {})
        mean = found.reading
        between = 0.5 * (mean + np.append(mean[1:], mean[-1]))  # a reading is a mean since the sample before
        left = ((found.speed - between) ** 2)[-run.wanted :]
        width = np.ones(2 * BESIDE + 1) / (2 * BESIDE + 1)
        rms = np.sqrt(np.convolve(np.pad(left, BESIDE, "edge"), width, "valid"))
        swing = np.zeros(run.size)
        pulses = 2.0 * math.pi / at.PULSE  # a turn's, and a radian's times 2 pi
        swing[: run.wanted] = rms / (pulses * np.maximum(np.abs(mean[-run.wanted :]), SLOWEST))
        return swing

    def effects_that_could(self) -> list[Effect]:
        """The effects that this recording could show: those of a transient only where there is one."""
        found = []
        for effect in effects().values():
            if effect.id == "bad_reading" or (effect.transient_only and not self.blocks.runs):
                continue
            if "flow" in effect.reads and not np.isfinite(self.blocks.plateaus.flow).any():
                continue
            found.append(effect)
        return found


def _no_state(like: np.ndarray) -> State:
    """A state for sensors whose law looks at none."""
    nothing = np.full_like(like, np.nan)
    return State(nothing, nothing, nothing, nothing, nothing, nothing, nothing, nothing, nothing, nothing)
