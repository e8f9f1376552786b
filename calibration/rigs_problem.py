"""A recording of another rig (a motor table in the recording) as readings, predictions and unknowns, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.priors import KELVIN_AT_0_C, PASCAL_PER_BAR, Unknown
from calibration.rigs_readings import TO_SI, Flat, Readings, means, noise_sd, plateaus
from model.effects import effects
from model.effects.laws import Chosen, readings_of
from model.layout import RPM
from model.rigs.displacement_machine import rows
from model.rigs.driven_axis import LOAD_AREA, Blocks, blocks_of, drive
from model.rigs.free_rotor import coast
from model.rigs.state import AMBIENT_PA, ROOM_K, Sizes, scaled, state_of
from rig.recording import Recording, RecordingError, RecordingFile

MOST_BLOCKS = 600  # a file of a driven axis is cut into at most so many
LEAST_ROWS = 5  # of a block, in a file that has enough of them
FEW_BLOCKS = 40  # ... and in one that has not, as many blocks as that
CONSTANT = 0.05  # a drive that varies by less than this share is constant
AT_REST = 4.0  # a speed within so many of its own deviations of 0 may be standstill
SHAPE_FACTOR = 2.0
VOLUME_FACTOR = 1.3  # an inline motor tells no tolerance, and a cut-off takes in less than the geometric volume
SERIES = 40  # steady rows from which on their order in time says something of the noise
EVERYWHERE = ("coulomb_friction", "stribeck_friction", "windage", "friction_warm_up")
OF_KIND = {
    "free_rotor": ("once_per_rev_torque", "speed_lag"),
    "driven_axis": ("inertia",),
    "displacement_machine": (
        "load_friction",
        "leakage",
        "inlet_throttling",
        "exhaust_back_pressure",
        "flow_offset",
        "flow_scale",
        "flow_density_correction",
        "pressure_gauge_offset",
        "pressure_gauge_scale",
    ),
}


class RigProblem:
    """A recording of another rig.

    Parameters
    ----------
    recording : Recording
        With an inline motor of another kind than the radial piston motor.

    Raises
    ------
    RecordingError
        When the columns that its kind needs are missing.
    """

    def __init__(self, recording: Recording) -> None:
        if isinstance(recording.motor, str) or recording.motor.get("kind") not in OF_KIND:
            raise RecordingError(f"[motor]: not a rig of another kind; expected one of {', '.join(OF_KIND)}")
        self.recording = recording
        self.motor: Mapping[str, Any] = recording.motor
        self.kind = str(self.motor["kind"])
        ambient = recording.ambient
        self.ambient = AMBIENT_PA if ambient.pressure_bar_abs is None else ambient.pressure_bar_abs * PASCAL_PER_BAR
        self.room = ROOM_K if ambient.temperature_c is None else ambient.temperature_c + KELVIN_AT_0_C
        self.slides = "mass_kg" in self.motor
        self.inertia = float(self.motor.get("mass_kg") or self.motor.get("inertia_kg_m2") or 0.0)
        self.inertia += recording.added_inertia_kg_m2 if not self.slides else 0.0
        self.unknowns: list[Unknown] = []
        self.flats: list[Flat] = []
        self.readings: list[Readings] = []
        self.blocks: list[tuple[RecordingFile, Blocks]] = []  # of a driven axis
        self.weight: float | None = None  # ... its drive where that is constant: a weight
        self.coasts: list[tuple[RecordingFile, np.ndarray]] = []  # of a free rotor: times
        self.rows: tuple[np.ndarray, ...] = ()  # of a machine: speed, pressure, temperature, time
        self.seen: list[np.ndarray] = []  # ... and which of them have the readings
        {"free_rotor": self._see_coasts, "driven_axis": self._see_axis, "displacement_machine": self._see_machine}[
            self.kind
        ]()
        if not any(one.value.size for one in self.readings):
            raise RecordingError(f"{self.kind}: no reading is left to compare; is the axis ever in motion?")
        for one in self.readings:
            if one.value.size and not np.all(one.sd > 0.0):
                raise RecordingError(
                    f"{one.label}: noise_sd and resolution are both 0, and nothing can be weighed; state noise_sd > 0"
                )
        self._friction_prior()

    @property
    def could_show(self) -> list[str]:
        """The effects that this rig could show."""
        found = [*EVERYWHERE, *OF_KIND[self.kind]]
        if self.kind == "driven_axis" and any(np.isfinite(b.pressure).any() for _, b in self.blocks):
            found.append("load_friction")
        if self.kind == "free_rotor" and not self._sees_turns():
            found.remove("once_per_rev_torque")
        if self.weight is not None:  # then less inertia and a constant drag explain any noise in the speed
            found.remove("inertia")
        if not any(one.channel in ("drive", "speed") for one in self.readings):
            found = [name for name in found if effects()[name].torque is None]
        if not any(one.channel == "flow" for one in self.readings):
            found = [name for name in found if "flow" not in effects()[name].reads and name != "leakage"]
        return sorted(found)

    def effect_unknowns(self, names: Sequence[str]) -> list[tuple[str, Unknown, float, float]]:
        """Effect id, unknown, and bounds of its value, for the parameters of a set of effects.

        Parameters
        ----------
        names : sequence of str
            Effect ids.
        """
        found = []
        for name in names:
            for parameter in (scaled(one, self.sizes) for one in effects()[name].parameters):
                kind, a, b = (
                    ("lognormal", parameter.scale, SHAPE_FACTOR)
                    if parameter.shape
                    else ("normal", parameter.expected, parameter.scale)
                )
                unknown = Unknown(parameter.name, parameter.unit, kind, a, b, "effect")  # type: ignore[arg-type]
                found.append((name, unknown, parameter.low, parameter.high))
        return found

    def predict(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        """What the instruments would read, an array for each of ``readings``.

        Parameters
        ----------
        values : mapping of str to float
            Of flats and unknowns by their names [SI].
        chosen : mapping
            Effect id to the values of its parameters.
        """
        f = values.get("viscous_friction", 0.0)
        if self.kind == "free_rotor":
            scale, offset = 1.0 + values.get("speed_scale", 0.0), values.get("speed_offset", 0.0)
            return [
                coast(self.inertia, f, time, values[f"{file.file}.first_speed"], chosen, file.start_s).reading * scale
                + offset
                for file, time in self.coasts
            ]
        if self.kind == "driven_axis":
            return self._axis(values, chosen)
        return self._machine(values, chosen)

    def loaded(self, values: Mapping[str, float], chosen: Chosen) -> Chosen:
        """A set of effects for `drive`: friction grows with the gas force on the piston that is fitted.

        Parameters
        ----------
        values : mapping of str to float
            Of flats and unknowns by their names [SI].
        chosen : mapping
            Effect id to the values of its parameters.
        """
        if "load_friction" not in chosen:
            return chosen
        share = chosen["load_friction"]["roller_factor"] * abs(values.get("piston_area", 0.0)) / LOAD_AREA
        return {**chosen, "load_friction": {"roller_factor": share}}

    def _axis(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        area, chosen = values.get("piston_area", 0.0), self.loaded(values, chosen)
        found = []
        for file, blocks in self.blocks:
            one = drive(self.inertia, values["viscous_friction"], blocks, chosen, file.start_s, self.ambient)
            if area:
                one = one - area * blocks.mean(np.nan_to_num(blocks.pressure - self.ambient))
            offset = values.get("drive_offset", 0.0) + values.get(f"{file.file}.drive_offset", 0.0)
            one = one[blocks.used]
            whole = self.weight if self.weight is not None else one
            found.append(one + values.get("drive_scale", 0.0) * whole + offset)
        return found

    def slope(self, name: str, values: Mapping[str, float], predicted: Sequence[np.ndarray]) -> list[np.ndarray] | None:
        """What an instrument's offset or scale does to the predictions, which needs no model [SI]; None for the rest.

        Parameters
        ----------
        name : str
            Of an unknown.
        values : mapping of str to float
            Of flats and unknowns by their names [SI].
        predicted : sequence of ndarray
            At them, of `predict` [SI].
        """
        place, _, error = name.rpartition("." if name.endswith(".drive_offset") else "_")
        found = []
        for one, true in zip(self.readings, predicted, strict=True):
            own = one.label.partition(" ")[2]
            offset = values.get(f"{one.channel}_offset", 0.0) + values.get(f"{own}.drive_offset", 0.0)
            if error == "drive_offset":
                found.append(np.full_like(true, 1.0 if own == place else 0.0))
            elif place in ("drive", "flow", "speed") and error in ("offset", "scale"):
                scale = 1.0 + values.get(f"{place}_scale", 0.0)
                part = np.ones_like(true) if error == "offset" else (true - offset) / scale
                if error == "scale" and self.weight is not None:
                    part = np.full_like(true, self.weight)
                found.append(part if one.channel == place else np.zeros_like(true))
            else:
                return None
        return found

    def _sees_turns(self) -> bool:
        """Whether samples follow each other within half a turn, for nine in ten of them."""
        turned = [one.value[1:] * np.diff(time) for one, (_, time) in zip(self.readings, self.coasts, strict=True)]
        return bool(np.quantile(np.concatenate(turned), 0.9) < np.pi)

    def _see_coasts(self) -> None:
        for file in self._transients("time_s", "speed_rpm"):
            time, speed = (file.columns[name].values for name in ("time_s", "speed_rpm"))
            speed = speed * TO_SI["speed_rpm"]
            known = np.isfinite(speed) & (speed > 0.0)
            stopped = np.flatnonzero(speed <= 0.0)
            known[stopped[0] if stopped.size else speed.size :] = False
            time, speed = time[known], speed[known]
            if time.size < 4:
                continue
            self.coasts.append((file, time))
            self.flats.append(Flat(f"{file.file}.first_speed", "rad/s", float(speed[0]), float(speed[0]), 0.0))
            sd = noise_sd(self.recording, "speed_rpm", file) * np.ones(time.size)
            self.readings.append(Readings("speed", speed, sd, True, f"speed {file.file}"))
        if not self.coasts:
            raise RecordingError("free_rotor: no transient file with a coast-down in it")
        self._instrument("speed", "speed_rpm")
        spans = [
            (one.value[0] - one.value[-1]) / (t[-1] - t[0])
            for one, (_, t) in zip(self.readings, self.coasts, strict=True)
        ]
        self.sizes = Sizes(self.inertia * max(max(spans), 1e-12), float(np.median(self.readings[0].value)))

    def _see_axis(self) -> None:
        of_drive, of_speed = ("force_n", "velocity_m_s") if self.slides else ("torque_nm", "speed_rpm")
        for file in self._transients("time_s", of_drive, of_speed):
            columns = {name: column.values * TO_SI.get(name, 1.0) for name, column in file.columns.items()}
            known = np.isfinite(columns["time_s"]) & np.isfinite(columns[of_drive]) & np.isfinite(columns[of_speed])
            columns = {name: values[known] for name, values in columns.items()}
            n = columns["time_s"].size
            size = max(min(LEAST_ROWS, n // FEW_BLOCKS), n // MOST_BLOCKS, 1)
            speed_sd = noise_sd(self.recording, of_speed, file)
            pressure = columns.get("pressure_bar_abs")
            if "pressure_bar_gauge" in columns:
                pressure = columns["pressure_bar_gauge"] + self.ambient
            blocks = blocks_of(
                columns["time_s"],
                columns[of_drive],
                columns[of_speed],
                size,
                AT_REST * speed_sd,
                None if self.slides else columns.get("angle_rad"),
                pressure,
            )
            self.blocks.append((file, blocks))
            covariance = self._covariance(blocks, noise_sd(self.recording, of_drive, file), speed_sd)
            sd = np.sqrt(np.diag(covariance))
            whitener = np.linalg.inv(np.linalg.cholesky(covariance)) if np.all(sd > 0.0) else None
            force = blocks.mean(blocks.drive)[blocks.used]
            self.readings.append(Readings("drive", force, sd, True, f"drive {file.file}", whitener))
        if not self.blocks:
            raise RecordingError(f"driven_axis: no transient file with time_s, {of_drive} and {of_speed}")
        self._instrument("drive", of_drive)
        force = np.concatenate([one.value for one in self.readings])
        if force.size and float(np.std(force)) < CONSTANT * abs(float(np.mean(force))):
            self.weight = float(np.mean(force))
        area = self._area()
        if area is not None:
            self.flats.append(Flat("piston_area", "m2", area, max(abs(area), 1e-6), -np.inf))
        if len(self.blocks) > 1:  # zeros wander from run to run, as much as they may be off
            zero = self.recording.channels[of_drive].bias_sd * TO_SI[of_drive]
            gauge = next((c for c in self.recording.channels if c.startswith("pressure_")), None)
            if gauge is not None and area is not None:
                zero = float(np.hypot(zero, area * self.recording.channels[gauge].bias_sd * PASCAL_PER_BAR))
            for file, _ in self.blocks if zero > 0.0 else ():
                why = "the zeros of a run, beside those of the recording"
                self.unknowns.append(Unknown(f"{file.file}.drive_offset", "SI", "normal", 0.0, zero, why))
        used = [
            (one.value, blocks.mean(blocks.speed)[blocks.used])
            for one, (_, blocks) in zip(self.readings, self.blocks, strict=True)
        ]
        force, speed = (np.concatenate([pair[i] for pair in used]) for i in (0, 1))
        self.sizes = (
            Sizes(float(np.sqrt(np.mean(force**2))), float(np.sqrt(np.mean(speed**2))))
            if force.size
            else Sizes(1.0, 1.0)
        )

    def _area(self) -> float | None:
        """Piston area by which the drive follows the pressure [m2], roughly; None where no pressure varies."""
        seen = [
            (one.value, blocks.mean(np.nan_to_num(blocks.pressure - self.ambient))[blocks.used])
            for one, (_, blocks) in zip(self.readings, self.blocks, strict=True)
            if np.isfinite(blocks.pressure).any()
        ]
        if not seen:
            return None
        force, gauge = (np.concatenate([pair[i] for pair in seen]) for i in (0, 1))
        return -float(force @ gauge / max(float(gauge @ gauge), 1e-12))

    def _covariance(self, blocks: Blocks, drive_sd: float, speed_sd: float) -> np.ndarray:
        """Noise of the blocks that are used: neighbours share the reading of speed between them, with opposite sign."""
        span = np.diff(blocks.time[blocks.ends])
        per_end = self.inertia * speed_sd / span
        covariance = np.diag(drive_sd**2 / np.diff(blocks.ends) + 2.0 * per_end**2)
        shared = -per_end[1:] * per_end[:-1]
        covariance += np.diag(shared, 1) + np.diag(shared, -1)
        return np.asarray(covariance[np.ix_(blocks.used, blocks.used)])

    def _see_machine(self) -> None:
        gauge = "pressure_bar_gauge" in self.recording.channels
        name = "pressure_bar_gauge" if gauge else "pressure_bar_abs"
        files = [f for f in self.recording.files if f.kind == "steady" and {name, "speed_rpm"} <= set(f.columns)]
        if not files:
            raise RecordingError(f"displacement_machine: no steady file with speed_rpm and {name}")

        def all_of(column: str, missing: float = np.nan) -> np.ndarray:
            return np.concatenate(
                [f.columns[column].values if column in f.columns else np.full(f.rows, missing) for f in files]
            )

        P = all_of(name) * PASCAL_PER_BAR + (self.ambient if gauge else 0.0)
        speed = all_of("speed_rpm") / RPM
        known = np.isfinite(P) & np.isfinite(speed)
        time = np.concatenate(
            [f.start_s + (f.columns["time_s"].values if "time_s" in f.columns else np.arange(f.rows)) for f in files]
        )
        T = all_of("inlet_temperature_c", self.room - KELVIN_AT_0_C) + KELVIN_AT_0_C
        T = np.where(np.isfinite(T), T, self.room)
        group = plateaus(speed[known], P[known], np.repeat(np.arange(len(files)), [f.rows for f in files])[known])
        if not group.size:
            raise RecordingError(f"displacement_machine: no row has both speed_rpm and {name}")
        self.rows = tuple(means(values[known], group)[0] for values in (speed, P, T, time))
        V = float(self.motor["displacement_m3_per_rev"])
        P_sd, first = noise_sd(self.recording, name, files[0]), files[0].noise_scale
        scale = means(np.concatenate([np.full(f.rows, f.noise_scale / first) for f in files])[known], group)[0]
        for column, channel, slope in (("torque_nm", "drive", V / (2.0 * np.pi)), ("flow_l_min", "flow", 0.0)):
            value, share = means(all_of(column)[known] * TO_SI[column], group)
            has = np.isfinite(value)
            if has.any():
                sd = (np.hypot(noise_sd(self.recording, column, files[0]) * share, slope * P_sd) * scale)[has]
                self.seen.append(has)
                self.readings.append(Readings(channel, value[has], sd, int(has.sum()) >= SERIES, channel))
                self._instrument(channel, column)
        self._instrument("pressure", name)
        self.unknowns.append(Unknown("displacement", "1", "lognormal", 1.0, VOLUME_FACTOR, "inline motor"))
        gauge_pa = float(np.median(self.rows[1])) - self.ambient
        median = float(np.median(self.rows[0]))
        self.sizes = Sizes(V * gauge_pa / (2.0 * np.pi), median, V * median / (2.0 * np.pi), gauge_pa)

    def _machine(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        speed, reading, T, time = self.rows
        V = float(self.motor["displacement_m3_per_rev"]) * values["displacement"]
        wanted = (reading - values.get("pressure_offset", 0.0)) / (1.0 + values.get("pressure_scale", 0.0))
        P = wanted.copy()
        state = state_of(speed, 0.0)
        for _ in range(4):
            P = P + wanted - readings_of(chosen, "pressure", P, state)
        found = rows(V, values.get("viscous_friction", 0.0), speed, P, T, self.ambient, time, chosen)
        flow = readings_of(chosen, "flow", found.flow, found.state)
        read = []
        for one, has in zip(self.readings, self.seen, strict=True):
            true = found.torque if one.channel == "drive" else flow
            error = (values.get(f"{one.channel}_{what}", 0.0) for what in ("offset", "scale"))
            read.append((next(error) + true * (1.0 + next(error)))[has])
        return read

    def _friction_prior(self) -> None:
        if self.kind == "displacement_machine" and all(one.channel != "drive" for one in self.readings):
            return  # a flow tells nothing of friction
        mean, sd = self.motor.get("viscous_friction"), self.motor.get("viscous_friction_sd")
        unit = "N s/m" if self.slides else "N m s"
        if mean is not None and sd is not None:
            self.unknowns.insert(0, Unknown("viscous_friction", unit, "normal", float(mean), float(sd), "recording"))
            return
        size = self.sizes.torque / self.sizes.speed
        self.flats.insert(0, Flat("viscous_friction", unit, float(mean) if mean else 0.5 * size, size, 0.0))

    def _instrument(self, channel: str, column: str) -> None:
        figures = self.recording.channels[column]
        for what, sd, unit in (("offset", figures.bias_sd * TO_SI[column], "SI"), ("scale", figures.scale_sd, "1")):
            if sd > 0.0:
                why = f"recording, channels.{column}"
                self.unknowns.append(Unknown(f"{channel}_{what}", unit, "normal", 0.0, sd, why))

    def _transients(self, *columns: str) -> list[RecordingFile]:
        return [f for f in self.recording.files if f.kind == "transient" and set(columns) <= set(f.columns)]
