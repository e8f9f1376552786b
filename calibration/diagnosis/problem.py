"""What the instruments would read at a point: the unknowns of a recording, and the model's predictions of its readings.

The unknowns are standard normal numbers z, as in the fit: every nuisance first (f_overall, lap, roller friction,
inertia, ambient, offsets and scales of the instruments; for each run in time the error of its supply, the moments at
which air enters and leaves, and where the shaft stood), then the parameters of the effects in question. How far
readings are from predictions, in units of their noise, is for `calibration.diagnosis.linear` to say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from calibration.diagnosis import gauge, in_time
from calibration.diagnosis.blocks import Blocks, blocks_of
from calibration.diagnosis.standing import standing_flow
from calibration.priors import PASCAL_PER_BAR, SHAPE_FACTOR, Unknown, at_ambient, column_of, unknowns
from model import layout as at
from model import steady as base_steady
from model.effects import effects
from model.effects import steady as effect_steady
from model.effects.effect import Effect, State, unknown_state
from model.effects.laws import readings_of
from model.effects.neighbourhood import Neighbourhood
from model.layout import L_MIN, RPM
from model.motor import QUANTITIES, Motor, read_motor
from model.transient import Supply
from rig.recording import Recording, RecordingError

SI_OF = {"pressure": PASCAL_PER_BAR, "flow": 1.0 / L_MIN, "speed": 1.0 / RPM}
CHANNELS = ("pressure", "flow", "speed")
ANGLE_SD = at.PULSE / math.sqrt(12.0)  # of a starting angle that may be anywhere within a pulse [rad]
TURN_SD = 2.0 * math.pi / math.sqrt(12.0)  # of an angle that may be anywhere in a turn [rad]
REST_ANGLES = 16  # at which it may have stood, for what its pulses do
UNSETTLED = 0.005  # of the line's pressure: by so much a coast-down may begin off its steady speed
LATE_SD = 0.003  # s; by so much the air leaves or enters a line later than its valve moves, or the samples say
VENTED = "vented_span_share"  # of a gauge's span error that shows at ambient pressure

# The motor's parameters, each channel's offset and scale, and by file: error of the supply, angle, start, vent, turn.
ByFile = dict[str, float]
Split = tuple[np.ndarray, dict[str, tuple[float, float]], ByFile, ByFile, dict[str, np.ndarray], ByFile, ByFile]


def in_si(nuisance: str) -> float:
    """What a nuisance's value is multiplied by to be SI: an instrument's offset is in the channel's own unit [-].

    Parameters
    ----------
    nuisance : str
        Its name.
    """
    return SI_OF[nuisance.partition("_")[0]] if nuisance.endswith("_offset") else 1.0


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
    standing : ndarray, shape (l,)
        Flow readings expected while the rotor stands [m3/s].
    state : State
        Of the plateaus.
    """

    flow: np.ndarray
    speed: np.ndarray
    flow_slope: np.ndarray
    speed_slope: np.ndarray
    runs: tuple[np.ndarray, ...]
    vented: np.ndarray
    standing: np.ndarray
    state: State


class Problem:
    """A recording, its motor, and every nuisance.

    Parameters
    ----------
    recording : Recording
        The recording.
    motor : Motor or None
        The motor that it names, when left out.
    any_turn : bool
        Whether it is held against effects that another recording showed: how the shaft stood in that one is not known
        here, of no run.

    Attributes
    ----------
    given : dict
        Values of effects' parameters that are no unknowns, by (effect, parameter) [own unit].
    """

    def __init__(self, recording: Recording, motor: Motor | None = None, any_turn: bool = False) -> None:
        self.given: dict[tuple[str, str], float] = {}
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
            sd = max(run.supply_sd, 1.0)
            if not run.from_rest and len(run.supply) > 1:
                sd = math.hypot(sd, UNSETTLED * run.supply[0].pressure_pa)
            self.nuisances.append(
                Unknown(f"{run.file}.supply", "Pa", "normal", 0.0, sd, "noise, and what had not settled")
            )
            if run.from_rest:
                self.nuisances.append(Unknown(f"{run.file}.opening", "s", "normal", 0.0, LATE_SD, "a valve's time"))
                for k in range(in_time.STARTS):
                    self.nuisances.append(Unknown(f"{run.file}.start_{k}", "-", "normal", 0.0, 1.0, "nobody set it"))
            else:
                self.nuisances.append(Unknown(f"{run.file}.angle", "rad", "normal", 0.0, ANGLE_SD, "nobody set it"))
                if len(run.supply) > 1:
                    self.nuisances.append(Unknown(f"{run.file}.vent", "s", "normal", 0.0, LATE_SD, "a valve's time"))
        # A torque that follows the shaft is told from where that stood in the first run.
        for run in self.blocks.runs[0 if any_turn else 1 :]:
            self.nuisances.append(Unknown(f"{run.file}.turn", "rad", "normal", 0.0, TURN_SD, "nobody noted it"))
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
        standing = self.blocks.standing
        line = np.nan_to_num(standing.pressure + np.where(standing.is_gauge, P_a, 0.0), nan=P_a)
        gas = [base_steady.gas_table(self.motor, P)[0, at.GAS_R] for P in np.clip(line, 5e4, 8e5)]
        self._standing_gas = np.array(gas)
        self.starts: dict[str, in_time.Start] = {}
        self.start_angle = {run.file: 0.0 for run in self.blocks.runs}

    def giving(self, given: Mapping[tuple[str, str], float]) -> Problem:
        """The same recording and nuisances, with other parameters of effects given.

        Parameters
        ----------
        given : mapping
            Values by (effect, parameter) [own unit].
        """
        other = copy(self)
        other.given = dict(given)
        return other

    def place(self, name: str) -> int | None:
        """Where a nuisance stands among the unknowns; None where it is none of this recording.

        Parameters
        ----------
        name : str
            Of the nuisance.
        """
        return next((i for i, unknown in enumerate(self.nuisances) if unknown.name == name), None)

    def run_of(self, i: int) -> int | None:
        """The run in time that a nuisance belongs to alone; None where it is of the motor or of an instrument [-].

        Parameters
        ----------
        i : int
            Its place among the unknowns [-].
        """
        file = self.nuisances[i].name.rpartition(".")[0]
        return next((k for k, run in enumerate(self.blocks.runs) if run.file == file), None)

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
                if (name, parameter.name) in self.given:
                    continue
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
        for (name, parameter), value in self.given.items():
            if name in found:
                found[name][parameter] = value
        for (name, unknown), at_z in zip(self.effect_unknowns(names), z, strict=True):
            found[name][unknown.name] = float(unknown.value(np.asarray(at_z)))
        return found

    def predict(
        self,
        z: np.ndarray,
        chosen: dict[str, dict[str, float]],
        like: Prediction | None = None,
        runs: Sequence[int] | None = None,
        pulses: Sequence[in_time.Pulses | None] | None = None,
        smooth: bool = False,
        around: Neighbourhood | None = None,
    ) -> Prediction:
        """What the instruments would read.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].
        chosen : dict
            Effects and the values of their parameters.
        like : Prediction or None
            Where the rest is taken from when ``runs`` is given.
        runs : sequence of int or None
            Indices of the runs to simulate, and nothing else; the plateaus alone where there is none in it; everything
            when left out [-].
        pulses : sequence of Pulses or None
            Those of each run, to be added to its course by the mean torque: a twentieth of the time, and smooth in
            every unknown. They are simulated where they are not given.
        smooth : bool
            Whether runs are to be without pulses.
        around : Neighbourhood or None
            Of plateaus close by, where those to first order will do; solved in full where it is not given.
        """
        split = self.split(z)
        parameters, errors = split[:2]
        found = tuple(
            self._read_speed(i, split, chosen, pulses[i] if pulses else None, smooth)
            if like is None or runs is None or i in runs
            else like.runs[i]
            for i in range(len(self.blocks.runs))
        )
        if like is not None and runs:
            return replace(like, runs=found)
        rows, true = self._plateaus(parameters, errors, chosen)
        if around is None:
            time = self.blocks.plateaus.time
            points = effect_steady.solve(rows, self._readings, true, self._gas, chosen, time, slopes=True)
        else:
            points = around.points(rows, true, chosen)
        state = points.state
        flow = readings_of(chosen, "flow", points.flow, state) * (1.0 + errors["flow"][1]) + errors["flow"][0]
        speed = readings_of(chosen, "speed", points.speed, state) * (1.0 + errors["speed"][1]) + errors["speed"][0]
        share = 0.5 if self._share is None else float(self.nuisances[self._share].value(z[self._share]))
        vented = gauge.vented_readings(self.blocks.vented, share, parameters[at.P_A], errors["pressure"], chosen)
        standing = self._standing(parameters, errors, chosen)
        return Prediction(flow, speed, points.flow_slope, points.speed_slope, found, vented, standing, state)

    def neighbourhood(self, z: np.ndarray, chosen: dict[str, dict[str, float]], here: Prediction) -> Neighbourhood:
        """The plateaus close to a point.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].
        chosen : dict
            Effects and the values of their parameters.
        here : Prediction
            At the point, its plateaus solved in full.
        """
        rows, true = self._plateaus(*self.split(z)[:2], chosen)
        return Neighbourhood(here.state, rows, self._readings, true, self._gas, chosen, self.blocks.plateaus.time)

    def split(self, z: np.ndarray) -> Split:
        """The nuisances' values: the motor's parameters, each channel's errors, and what is each run's own.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].

        Returns
        -------
        parameters : ndarray, shape (24,)
            Of the motor [SI].
        errors : dict
            Offset [SI] and scale [-] of each channel.
        supply, angle, start : dict
            By file: error of the gauge's mean over the open spans [Pa], angle of the shaft [rad], and how much there is
            of each course that starts from rest are made of [-].
        vent : dict
            By file: how late the line follows its valve, on the average [s].
        turn : dict
            By file: how far the shaft is turned on from where it stood in the first run [rad].
        """
        parameters = self._base.copy()
        errors = {channel: [0.0, 0.0] for channel in CHANNELS}
        supply = {run.file: 0.0 for run in self.blocks.runs}
        angle = dict(self.start_angle)
        start = {run.file: np.zeros(in_time.STARTS) for run in self.blocks.runs}
        turn = {run.file: 0.0 for run in self.blocks.runs}
        vent = {run.file: 0.0 for run in self.blocks.runs}
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
            elif unknown.name.endswith((".vent", ".opening")):
                vent[unknown.name.rpartition(".")[0]] = value
            elif unknown.name.endswith(".turn"):
                turn[unknown.name.removesuffix(".turn")] = value
            elif ".start_" in unknown.name:
                file, _, course = unknown.name.rpartition(".start_")
                start[file][int(course)] = value
            else:
                channel, _, error = unknown.name.partition("_")
                errors[channel][error == "scale"] = value * (SI_OF[channel] if error == "offset" else 1.0)
        of_channels = {channel: (pair[0], pair[1]) for channel, pair in errors.items()}
        return parameters, of_channels, supply, angle, start, vent, turn

    def _plateaus(
        self, parameters: np.ndarray, errors: dict[str, tuple[float, float]], chosen: dict[str, dict[str, float]]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameters and true pressure [Pa] of each plateau."""
        plateaus = self.blocks.plateaus
        rows = np.tile(parameters, (plateaus.size, 1))
        true = gauge.true_pressure(plateaus.pressure, plateaus.is_gauge, parameters[at.P_A], errors["pressure"], chosen)
        return rows, np.clip(true, 3e4, 1.9e6)

    def _standing(
        self, parameters: np.ndarray, errors: dict[str, tuple[float, float]], chosen: dict[str, dict[str, float]]
    ) -> np.ndarray:
        """Flow readings while the rotor stands [m3/s]."""
        standing, P_a = self.blocks.standing, parameters[at.P_A]
        if not standing.flow.size:
            return standing.flow
        true = gauge.true_pressure(standing.pressure, standing.is_gauge, P_a, errors["pressure"], chosen)
        true = np.where(np.isfinite(true), true, P_a)
        return standing_flow(true, standing.time, self._standing_gas, parameters, errors["flow"], chosen)

    def _plan(self, i: int, split: Split, chosen: dict[str, dict[str, float]]) -> in_time.Plan:
        """A run in time at a point: its line is the gauge's reading, freed of the gauge's errors."""
        parameters, errors, wrong_by, angle, _, vent, turn = split
        run = self.blocks.runs[i]
        supply: list[Supply] = []
        for span in run.supply:
            pressure = span.pressure_pa
            if span.is_open:
                reading = np.array([pressure - wrong_by[run.file]])
                found = gauge.true_pressure(reading, run.is_gauge, parameters[at.P_A], errors["pressure"], chosen)
                pressure = float(found[0])
            late = vent[run.file] if supply or run.from_rest else 0.0
            supply.append(Supply(span.start_s + late, pressure, span.is_open))
        turned = dict(chosen)
        for name in chosen:
            turn_on = effects()[name].turned
            if turn_on is not None:
                turned[name] = dict(turn_on(chosen[name], turn[run.file]))
        return in_time.plan(self.motor, run, parameters, supply, angle[run.file], turned)

    def _read_speed(
        self,
        i: int,
        split: Split,
        chosen: dict[str, dict[str, float]],
        pulses: in_time.Pulses | None,
        smooth: bool,
    ) -> np.ndarray:
        run, (offset, scale) = self.blocks.runs[i], split[1]["speed"]
        planned = self._plan(i, split, chosen)
        if run.file in self.starts:
            start = self.starts[run.file]
            true = planned.read(planned.mean_speed()) + start.added(split[4][run.file], split[5][run.file])
        elif smooth:
            true = planned.read(planned.mean_speed())
        elif pulses is not None:
            true = planned.read(pulses.beside(planned))
        else:
            true = planned.with_pulses().reading[-run.wanted :]
        reading = np.full(run.size, np.nan)
        reading[: run.wanted] = readings_of(chosen, "speed", true, unknown_state(true)) * (1.0 + scale) + offset
        return reading

    def swing(self, z: np.ndarray, i: int) -> np.ndarray:
        """How far the pulses of the cylinders swing the shaft in a run in time [rad], shape (n,).

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances of the base model [-].
        i : int
            Index of the run [-].
        """
        run, split = self.blocks.runs[i], self.split(z)
        if run.from_rest:
            return self.starts[run.file].swing
        return in_time.swing(self._plan(i, split, {}), run)

    def see_starts(self, z: np.ndarray) -> None:
        """Take anew what the pulses do to the runs from rest; predictions hold it from then on.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances of the base model [-].
        """
        for i, run in enumerate(self.blocks.runs):
            if run.from_rest:
                split, plans = self.split(z), []
                split[5][run.file] = 0.0  # its courses are moved with it
                for angle in np.arange(REST_ANGLES) * at.PULSE / REST_ANGLES:
                    split[3][run.file] = float(angle)
                    plans.append(self._plan(i, split, {}))
                self.starts[run.file] = in_time.Start(plans, run)

    def pulses(self, z: np.ndarray, chosen: dict[str, dict[str, float]]) -> tuple[in_time.Pulses | None, ...]:
        """What the pulses of the cylinders add to each run in time at a point.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].
        chosen : dict
            Effects and the values of their parameters.
        """
        split = self.split(z)
        return tuple(
            None if run.from_rest else in_time.Pulses(self._plan(i, split, chosen))
            for i, run in enumerate(self.blocks.runs)
        )

    def effects_that_could(self) -> list[Effect]:
        """The listed effects that this recording could show: those of a transient only where there is one."""
        found = []
        for effect in effects().values():
            if effect.id == "bad_reading" or not effect.listed or (effect.transient_only and not self.blocks.runs):
                continue
            if "flow" in effect.reads and not np.isfinite(self.blocks.plateaus.flow).any():
                continue
            found.append(effect)
        return found
