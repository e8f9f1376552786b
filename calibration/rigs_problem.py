"""A recording of another rig (a motor table in the recording) as readings, predictions and unknowns, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.priors import KELVIN_AT_0_C, PASCAL_PER_BAR, Unknown
from model.effects import effects
from model.effects.laws import Chosen, readings_of
from model.layout import L_MIN, RPM
from model.rigs.displacement_machine import rows
from model.rigs.driven_axis import Blocks, blocks_of, drive
from model.rigs.free_rotor import coast
from model.rigs.state import AMBIENT_PA, ROOM_K, Sizes, scaled, state_of
from rig.recording import Recording, RecordingError, RecordingFile

TO_SI = {"torque_nm": 1.0, "force_n": 1.0, "velocity_m_s": 1.0, "angle_rad": 1.0, "speed_rpm": 1.0 / RPM}
TO_SI |= {"flow_l_min": 1.0 / L_MIN, "pressure_bar_abs": PASCAL_PER_BAR, "pressure_bar_gauge": PASCAL_PER_BAR}
MOST_BLOCKS = 600  # a file of a driven axis is cut into at most so many
LEAST_ROWS = 5  # of a block
AT_REST = 4.0  # a speed within so many of its own deviations of 0 may be standstill
SHAPE_FACTOR = 2.0
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


@dataclass(frozen=True)
class Readings:
    """Readings that are compared, shape (n,).

    Attributes
    ----------
    channel : str
        ``drive``, ``speed`` or ``flow``.
    value, sd : ndarray
        [SI].
    serial : bool
        Whether neighbours follow each other in time, and their noise may be correlated.
    whitener : ndarray, shape (n, n), or None
        What makes their noise independent and of deviation 1 where they share readings; else ``sd`` does.
    """

    channel: str
    value: np.ndarray
    sd: np.ndarray
    serial: bool
    whitener: np.ndarray | None = None

    def white(self, residual: np.ndarray) -> np.ndarray:
        """Residuals in units of their declared noise [-].

        Parameters
        ----------
        residual : ndarray, shape (n,)
            Readings less predictions [SI].
        """
        return residual / self.sd if self.whitener is None else self.whitener @ residual


@dataclass(frozen=True)
class Flat:
    """An unknown of which nothing is known: where a search starts, its size, and its lower bound."""

    name: str
    unit: str
    start: float
    size: float
    low: float


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
        self._blocks: list[tuple[RecordingFile, Blocks]] = []
        self._coasts: list[tuple[RecordingFile, np.ndarray]] = []
        {"free_rotor": self._see_coasts, "driven_axis": self._see_axis, "displacement_machine": self._see_machine}[
            self.kind
        ]()
        if not any(one.value.size for one in self.readings):
            raise RecordingError(f"{self.kind}: no reading is left to compare; is the axis ever in motion?")
        self._friction_prior()

    @property
    def could_show(self) -> list[str]:
        """The effects that this rig could show."""
        found = [*EVERYWHERE, *OF_KIND[self.kind]]
        if self.kind == "driven_axis" and any(np.isfinite(b.pressure).any() for _, b in self._blocks):
            found.append("load_friction")
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
                    else (
                        "normal",
                        *((1.0, 0.2) if name == "flow_density_correction" else (0.0, parameter.scale)),
                    )
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
        f = values["viscous_friction"]
        if self.kind == "free_rotor":
            return [
                coast(self.inertia, f, time, values[f"{file.file}.first_speed"], chosen, file.start_s).reading
                for file, time in self._coasts
            ]
        if self.kind == "driven_axis":
            found = [
                drive(self.inertia, f, blocks, chosen, file.start_s, self.ambient)[blocks.used]
                for file, blocks in self._blocks
            ]
            area = values.get("piston_area", 0.0)
            if area:
                found = [
                    one - area * blocks.mean(np.nan_to_num(blocks.pressure - self.ambient))[blocks.used]
                    for one, (_, blocks) in zip(found, self._blocks, strict=True)
                ]
            return [one * (1.0 + values.get("drive_scale", 0.0)) + values.get("drive_offset", 0.0) for one in found]
        return self._machine(values, chosen)

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
            self._coasts.append((file, time))
            self.flats.append(Flat(f"{file.file}.first_speed", "rad/s", float(speed[0]), float(speed[0]), 0.0))
            self.readings.append(Readings("speed", speed, self._sd("speed_rpm", file) * np.ones(time.size), True))
        if not self._coasts:
            raise RecordingError("free_rotor: no transient file with a coast-down in it")
        spans = [
            (one.value[0] - one.value[-1]) / (t[-1] - t[0])
            for one, (_, t) in zip(self.readings, self._coasts, strict=True)
        ]
        self.sizes = Sizes(self.inertia * max(max(spans), 1e-12), float(np.median(self.readings[0].value)))

    def _see_axis(self) -> None:
        of_drive, of_speed = ("force_n", "velocity_m_s") if self.slides else ("torque_nm", "speed_rpm")
        for file in self._transients("time_s", of_drive, of_speed):
            columns = {name: column.values * TO_SI.get(name, 1.0) for name, column in file.columns.items()}
            known = np.isfinite(columns["time_s"]) & np.isfinite(columns[of_drive]) & np.isfinite(columns[of_speed])
            columns = {name: values[known] for name, values in columns.items()}
            n = columns["time_s"].size
            size = max(LEAST_ROWS, n // MOST_BLOCKS)
            if n <= 4 * LEAST_ROWS:
                size = 1
            speed_sd = self._sd(of_speed, file)
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
            self._blocks.append((file, blocks))
            covariance = self._covariance(blocks, self._sd(of_drive, file), speed_sd)
            sd = np.sqrt(np.diag(covariance))
            whitener = np.linalg.inv(np.linalg.cholesky(covariance))
            self.readings.append(Readings("drive", blocks.mean(blocks.drive)[blocks.used], sd, True, whitener))
        if not self._blocks:
            raise RecordingError(f"driven_axis: no transient file with time_s, {of_drive} and {of_speed}")
        self._instrument("drive", of_drive)
        if any(np.isfinite(blocks.pressure).any() for _, blocks in self._blocks):
            self.flats.append(Flat("piston_area", "m2", 0.0, 1e-3, -np.inf))
        used = [
            (one.value, blocks.mean(blocks.speed)[blocks.used])
            for one, (_, blocks) in zip(self.readings, self._blocks, strict=True)
        ]
        force, speed = (np.concatenate([pair[i] for pair in used]) for i in (0, 1))
        self.sizes = (
            Sizes(float(np.sqrt(np.mean(force**2))), float(np.sqrt(np.mean(speed**2))))
            if force.size
            else Sizes(1.0, 1.0)
        )

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
        self._rows = (speed[known], P[known], np.where(np.isfinite(T), T, self.room)[known], time[known])
        V = float(self.motor["displacement_m3_per_rev"])
        P_sd, scale = self._sd(name, files[0]), np.concatenate([np.full(f.rows, f.noise_scale) for f in files])[known]
        self._seen: list[np.ndarray] = []
        for column, channel, slope in (("torque_nm", "drive", V / (2.0 * np.pi)), ("flow_l_min", "flow", 0.0)):
            value = all_of(column)[known] * TO_SI[column]
            has = np.isfinite(value)
            if has.any():
                sd = np.hypot(self._sd(column, files[0]), slope * P_sd) * scale[has]
                self._seen.append(has)
                self.readings.append(Readings(channel, value[has], sd, False))
                self._instrument(channel, column)
        self._instrument("pressure", name)
        self.unknowns.append(Unknown("displacement", "1", "lognormal", 1.0, 1.05, "a volume is known to 5 %"))
        gauge_pa = float(np.median(self._rows[1])) - self.ambient
        median = float(np.median(self._rows[0]))
        self.sizes = Sizes(V * gauge_pa / (2.0 * np.pi), median, V * median / (2.0 * np.pi), gauge_pa)

    def _machine(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        speed, reading, T, time = self._rows
        V = float(self.motor["displacement_m3_per_rev"]) * values["displacement"]
        wanted = (reading - values.get("pressure_offset", 0.0)) / (1.0 + values.get("pressure_scale", 0.0))
        P = wanted.copy()
        state = state_of(speed, 0.0)
        for _ in range(4):
            P = P + wanted - readings_of(chosen, "pressure", P, state)
        found = rows(V, values["viscous_friction"], speed, P, T, self.ambient, time, chosen)
        flow = readings_of(chosen, "flow", found.flow, found.state)
        read = []
        for one, has in zip(self.readings, self._seen, strict=True):
            true = found.torque if one.channel == "drive" else flow
            error = (values.get(f"{one.channel}_{what}", 0.0) for what in ("offset", "scale"))
            read.append((next(error) + true * (1.0 + next(error)))[has])
        return read

    def _friction_prior(self) -> None:
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

    def _sd(self, column: str, file: RecordingFile) -> float:
        figures = self.recording.channels[column]
        return float(np.hypot(figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0)) * TO_SI[column])
