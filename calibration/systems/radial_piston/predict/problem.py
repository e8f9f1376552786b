"""What the instruments would read at a point: the unknowns of a recording, and the model's predictions of its readings.

The unknowns are standard normal numbers z, as in the fit: every nuisance first (f_overall, lap, roller friction,
inertia, ambient, offsets and scales of the instruments; for each run in time the error of its supply, the moments at
which air enters and leaves, and where the shaft stood), then the parameters of the effects in question. How far
readings are from predictions, in units of their noise, is for `calibration.systems.radial_piston.comparison` to say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from calibration.data.blocks import Blocks, Vented, blocks_of
from calibration.data.clock import needs_clock
from calibration.data.runs import RunInTime
from calibration.likelihood import compared
from calibration.systems.radial_piston.predict import gauge, in_time, wheel
from calibration.systems.radial_piston.predict.nuisances import (
    MOTOR,
    TURN,
    VENTED,
    Split,
    destination,
    nuisances_of,
)
from calibration.systems.radial_piston.predict.standing import standing_flow
from calibration.systems.radial_piston.predict.supply import Course
from calibration.unknowns.priors import CHANNELS, Error, OfInstrument, OfRun, at_ambient, column_of
from model import layout as at
from model.effects import effects
from model.effects import steady as effect_steady
from model.effects.effect import Effect, State, unknown_state
from model.effects.laws import Chosen, readings_of
from model.effects.neighbourhood import Neighbourhood
from model.geometry import pulse_angle
from model.motor import Motor, read_motor
from model.solvers import steady as base_steady
from rig.recording import Recording, RecordingError
from rig.recording.columns import OF_CHANNEL


@dataclass(frozen=True)
class Prediction:
    """What the model says at a point.

    `flow`, `speed`, shape (n,): readings expected of the plateaus [m3/s], [rad/s].
    `flow_slope`, `speed_slope`, shape (n,): with the true pressure [m3/s/Pa], [rad/s/Pa].
    `runs`: speed readings expected of each run in time [rad/s].
    `vented`, shape (k,): gauge readings expected with the line vented [Pa].
    `standing`, shape (l,): flow readings expected while the rotor stands [m3/s].
    `line`, shape (p,): gauge readings expected in the runs in time, one run after the other [Pa].
    """

    flow: np.ndarray
    speed: np.ndarray
    flow_slope: np.ndarray
    speed_slope: np.ndarray
    runs: tuple[np.ndarray, ...]
    vented: np.ndarray
    standing: np.ndarray
    line: np.ndarray
    state: State


class Problem(compared.Problem):
    """A recording, its motor, and every nuisance.

    `motor`: the motor that it names, when left out.
    `any_turn`: whether it is held against effects that another recording showed: how the shaft stood in that one is not
        known here, of no run.
    """

    friction = "f_overall"

    def __init__(self, recording: Recording, motor: Motor | None = None, any_turn: bool = False) -> None:
        self.given = {}
        if motor is None:
            if not recording.is_of_radial_piston:
                raise RecordingError(f"{recording.folder}: its motor is no radial piston motor")
            motor = read_motor(recording.motor)
        self.motor = at_ambient(motor, recording)
        self.recording = recording
        self.blocks: Blocks = blocks_of(recording, pulse_angle(self.motor.vector()))
        self.nuisances = nuisances_of(self.motor, recording, self.blocks, any_turn)
        self._base = self.motor.vector()
        self._base[at.J_ADDED] = recording.added_inertia_kg_m2
        self._readings = self.motor.readings.vector()
        self._goes_to = [destination(unknown) for unknown in self.nuisances]
        columns = {channel: column_of(recording, channel) for channel in CHANNELS}
        self.noise = {
            channel: recording.channels[column].noise_sd * OF_CHANNEL[channel].to_si if column else 0.0
            for channel, column in columns.items()
        }
        self.resolution = {
            channel: recording.channels[column].resolution * OF_CHANNEL[channel].to_si if column else 0.0
            for channel, column in columns.items()
        }
        P_a = self.motor.si("ambient_pressure")
        plateaus = self.blocks.plateaus
        line = gauge.absolute(plateaus.pressure, plateaus.is_gauge, P_a)
        self._gas = base_steady.gas_table(self.motor, np.clip(line, 5e4, 8e5))
        standing = self.blocks.standing
        line = np.nan_to_num(gauge.absolute(standing.pressure, standing.is_gauge, P_a), nan=P_a)
        gas = [base_steady.gas_table(self.motor, P)[0, at.GAS_R] for P in np.clip(line, 5e4, 8e5)]
        self._standing_gas = np.array(gas)
        self._sampled = [in_time.sampled(run) for run in self.blocks.runs]
        self.pulses: dict[str, in_time.Pulses] = {}  # of each run, on its course by the mean torque
        self.times_seen = 0  # `pulses` were taken anew
        self._lag_s = (recording.channels["speed_rpm"].lag_s or 0.0) if "speed_rpm" in recording.channels else 0.0

    def giving(self, given: Mapping[tuple[str, str], float]) -> Problem:
        """The same recording and nuisances, with other parameters of effects given.

        `given`: values by (effect, parameter) [own unit].
        """
        other = copy(self)
        other.given = dict(given)
        return other

    def in_si(self, nuisance: str) -> float:
        """What a nuisance's value is multiplied by to be SI [-]: an instrument's offset has its channel's unit."""
        place = self.place(nuisance)
        of = None if place is None else self.nuisances[place].of
        return OF_CHANNEL[of.channel].to_si if isinstance(of, OfInstrument) and of.error is Error.OFFSET else 1.0

    def run_of(self, i: int) -> int | None:
        """The run in time that a nuisance belongs to alone; None where it is of the motor or of an instrument [-]."""
        of = self.nuisances[i].of
        file = of.file if isinstance(of, OfRun) else ""
        return next((k for k, run in enumerate(self.blocks.runs) if run.file == file), None)

    def predict(
        self,
        z: np.ndarray,
        chosen: Chosen,
        like: Prediction | None = None,
        runs: Sequence[int] | None = None,
        smooth: bool = False,
        around: Neighbourhood | None = None,
    ) -> Prediction:
        """What the instruments would read."""
        split = self.split(z)
        parameters, errors = split[:2]
        found = tuple(
            self._read_speed(i, split, chosen, smooth) if like is None or runs is None or i in runs else like.runs[i]
            for i in range(len(self.blocks.runs))
        )
        if like is not None and runs:
            return replace(like, runs=found, line=self._line(split, chosen, like.line, runs))
        line = self._line(split, chosen)
        rows, true = self._plateaus(parameters, errors, chosen)
        if around is None:
            time = self.blocks.plateaus.time
            points = effect_steady.solve(rows, self._readings, true, self._gas, chosen, time, slopes=True)
        else:
            points = around.points(rows, true, chosen)
        state = points.state
        flow = readings_of(chosen, "flow", points.flow, state) * (1.0 + errors["flow"][1]) + errors["flow"][0]
        speed = readings_of(chosen, "speed", points.speed, state) * (1.0 + errors["speed"][1]) + errors["speed"][0]
        vented = self._vented(self.blocks.vented, split, chosen)
        standing = self._standing(parameters, errors, chosen)
        return Prediction(flow, speed, points.flow_slope, points.speed_slope, found, vented, standing, line, state)

    def neighbourhood(self, z: np.ndarray, chosen: Chosen, here: Prediction) -> Neighbourhood:
        """The plateaus close to a point."""
        rows, true = self._plateaus(*self.split(z)[:2], chosen)
        return Neighbourhood(here.state, rows, self._readings, true, self._gas, chosen, self.blocks.plateaus.time)

    def split(self, z: np.ndarray) -> Split:
        """The nuisances' values: the motor's parameters, each channel's errors, and what is each run's own.

        `z`, shape (n_nuisances,): nuisances [-].
        Returns `parameters`: of the motor with its flywheel [SI]; `errors`: offset [SI] and scale [-] of each channel;
        the share of the gauge's span error that shows at ambient pressure is the offset of VENTED [-]; `own`: by file
        what is the run's own, by the ends of its unknowns' names [own unit].
        """
        parameters = self._base.copy()
        errors = {channel: [0.0, 0.0] for channel in (*CHANNELS, VENTED)}
        errors[VENTED][0] = 0.5
        own: dict[str, dict[str, float]] = {run.file: {TURN: 0.0} for run in self.blocks.runs}
        for at_z, unknown, (of, place, to_si) in zip(z.tolist(), self.nuisances, self._goes_to, strict=True):
            value = float(unknown.value(at_z))
            if of == MOTOR:
                quantity = self.motor.quantity(unknown.name)
                parameters[place] = min(max(value, quantity.low), quantity.high) * to_si
            else:
                (errors if of in errors else own)[of][place] = value * to_si
        parameters[at.J] += parameters[at.J_ADDED]
        return parameters, {channel: (pair[0], pair[1]) for channel, pair in errors.items()}, own

    def _plateaus(
        self, parameters: np.ndarray, errors: dict[str, tuple[float, float]], chosen: Chosen
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameters and true pressure [Pa] of each plateau."""
        plateaus = self.blocks.plateaus
        rows = np.tile(parameters, (plateaus.size, 1))
        true = gauge.true_pressure(plateaus.pressure, plateaus.is_gauge, parameters[at.P_A], errors["pressure"], chosen)
        return rows, np.clip(true, 3e4, 1.9e6)

    def _standing(self, parameters: np.ndarray, errors: dict[str, tuple[float, float]], chosen: Chosen) -> np.ndarray:
        """Flow readings while the rotor stands [m3/s]."""
        standing, P_a = self.blocks.standing, parameters[at.P_A]
        if not standing.flow.size:
            return standing.flow
        true = gauge.true_pressure(standing.pressure, standing.is_gauge, P_a, errors["pressure"], chosen)
        true = np.where(np.isfinite(true), true, P_a)
        return standing_flow(true, standing.time, self._standing_gas, parameters, errors["flow"], chosen)

    def _vented(self, vented: Vented, split: Split, chosen: Chosen) -> np.ndarray:
        """What the gauge reads with the line vented [Pa]."""
        parameters, errors, _ = split
        return gauge.vented_readings(vented, errors[VENTED][0], parameters[at.P_A], errors["pressure"], chosen)

    def _line(
        self,
        split: Split,
        chosen: Chosen,
        like: np.ndarray | None = None,
        runs: Sequence[int] = (),
    ) -> np.ndarray:
        """What the gauge reads in the runs in time [Pa]; ``like`` has that of all but ``runs``."""
        found, begin = [np.zeros(0)], 0
        for i, run in enumerate(self.blocks.runs):
            end = begin + run.line.pressure.size
            if like is None or i in runs:
                found.append(run.line.means(self.gauge_in(run, split, chosen, run.line.time)))
            else:
                found.append(like[begin:end])
            begin = end
        return np.concatenate(found)

    def gauge_in(self, run: RunInTime, split: Split, chosen: Chosen, time: np.ndarray) -> np.ndarray:
        """What the gauge reads in a run in time [Pa], shape (n,). `time`, shape (n,): on the run's clock [s]."""
        own, nothing = split[2][run.file], np.zeros(1)
        bottom = self._vented(Vented((run.file,), nothing, nothing, np.array([run.is_gauge])), split, chosen)[0]
        bottom += own.get("floor", 0.0)
        share = Course(run.valve, own, run.over, run.turning).share(time - own["gauge_late"])
        return bottom + (self._settled(run, own) - bottom) * share

    def _settled(self, run: RunInTime, own: Mapping[str, float]) -> float:
        """What the gauge reads once the open line has settled [Pa]."""
        return next((span.pressure_pa for span in run.valve if span.is_open), math.nan) - own["supply"]

    def plan(self, i: int, split: Split, chosen: Chosen) -> in_time.Plan:
        """A run in time at a point: its line is as the gauge reads it, freed of the gauge's errors."""
        parameters, errors, own_of = split
        run = self.blocks.runs[i]
        own = own_of[run.file]
        reading, P_a = np.array([self._settled(run, own)]), parameters[at.P_A]
        settled = float(gauge.true_pressure(reading, run.is_gauge, P_a, errors["pressure"], chosen)[0])
        shut = P_a + parameters[at.DP_IN] + parameters[at.DP_OUT]
        vented = P_a + own.get("floor", 0.0)
        line = Course(run.valve, own, run.over, run.turning).staircase(max(settled, vented), vented, shut)
        turned = dict(chosen)
        for name in chosen:
            turn_on = effects()[name].turned
            if turn_on is not None:
                turned[name] = dict(turn_on(chosen[name], own[TURN]))
        return in_time.plan(self.motor, run, self._sampled[i], parameters, line, 0.0, turned, own, self._lag_s)

    def _read_speed(self, i: int, split: Split, chosen: Chosen, smooth: bool) -> np.ndarray:
        run, (offset, scale) = self.blocks.runs[i], split[1]["speed"]
        planned = self.plan(i, split, chosen)
        pulses = None if smooth else self.pulses.get(run.file)
        true = planned.read(pulses.beside(planned) if pulses else planned.mean_speed())
        reading = np.full(run.size, np.nan)
        reading[planned.at.wanted] = readings_of(chosen, "speed", true, unknown_state(true)) * (1.0 + scale) + offset
        return reading + wheel.added(run, split[2][run.file])

    def see_pulses(self, z: np.ndarray) -> list[np.ndarray]:
        """Take anew what the pulses of the cylinders add to the runs in time; predictions hold it from then on.

        `z`, shape (n_nuisances,): nuisances of the base model [-].
        Returns how far they swing the shaft in each run [rad].
        """
        plans = [self.plan(i, self.split(z), {}) for i in range(len(self.blocks.runs))]
        self.times_seen += 1
        for run, planned in zip(self.blocks.runs, plans, strict=True):
            self.pulses[run.file] = in_time.Pulses(planned, in_time.ANGLES)
        return [in_time.swing(planned, run) for run, planned in zip(self.blocks.runs, plans, strict=True)]

    def effects_that_could(self) -> list[Effect]:
        """The listed effects that this recording could show: those of a transient only where there is one."""
        found = []
        for effect in effects().values():
            if effect.id == "bad_reading" or not effect.listed or (effect.transient_only and not self.blocks.runs):
                continue
            if self.blocks.plateaus.untimed and needs_clock(effect):
                continue
            if "flow" in effect.reads and not np.isfinite(self.blocks.plateaus.flow).any():
                continue
            found.append(effect)
        return found
