"""A displacement machine: its plateaus, and the torque and flow that would be read of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calibration.data.clock import times_of
from calibration.data.rows_used import FileUse
from calibration.systems.machines.readings import LEVEL, TO_SI, Flat, Readings, means, noise_sd, plateaus
from calibration.systems.machines.system import FOLDS, Coordinates, Simulate
from calibration.systems.machines.table import MachineTable, instrument, rows_used
from calibration.unknowns.priors import Unknown
from configs.units import BAR, ZERO_C
from model.effects import effects
from model.effects.laws import Chosen, readings_of
from model.layout import RPM
from model.rigs.displacement_machine import rows
from model.rigs.state import Sizes, state_of
from rig.recording import Recording, RecordingError, RecordingFile
from rig.recording.columns import pressure_in

VOLUME_FACTOR = 1.3  # an inline motor tells no tolerance, and a cut-off takes in less than the geometric volume
NOT_READ = "no speed, no pressure, or neither a torque nor a flow"
REPEATS = 10.0  # of a plateau in a test
SERIES = 40  # plateaus from which on their order in time says something of the noise


class DisplacementMachine:
    """The plateaus of a recording, from its steady files. Raises RecordingError when there is none."""

    kind = "displacement_machine"
    effects = (
        "load_friction",
        "leakage",
        "inlet_throttling",
        "exhaust_back_pressure",
        "flow_offset",
        "flow_scale",
        "flow_density_correction",
        "pressure_gauge_offset",
        "pressure_gauge_scale",
    )
    balances = tuple(
        (channel, balance, along)
        for channel, balance in (("drive", "torque"), ("flow", "mass"))
        for along in ("speed", "pressure", "time")
    )
    weight = None

    def __init__(self, table: MachineTable) -> None:
        recording = table.recording
        readings: list[Readings] = []
        of_channel: list[np.ndarray] = []
        unknowns: list[Unknown] = []
        name, gauge = pressure_in(recording.channels)
        files = _files_of(recording, name)
        P = _all_of(files, name) * BAR + (table.ambient if gauge else 0.0)
        speed = _all_of(files, "speed_rpm") / RPM
        known = np.isfinite(P) & np.isfinite(speed)
        time = np.concatenate([times_of(f) for f in files])
        timed = bool(np.all(np.isfinite(time[known])))
        T = _all_of(files, "inlet_temperature_c", table.room - ZERO_C) + ZERO_C
        T = np.where(np.isfinite(T), T, table.room)
        group = plateaus(speed[known], P[known], np.repeat(np.arange(len(files)), [f.rows for f in files])[known])
        if not group.size:
            raise RecordingError(f"{recording.folder}: displacement_machine: no row has both speed_rpm and {name}")
        rows_of = tuple(means(values[known], group)[0] for values in (speed, P, T, time if timed else 0.0 * speed))
        V = float(table.motor["displacement_m3_per_rev"])
        P_sd, first = noise_sd(recording, name, files[0]), files[0].noise_scale
        scale = means(np.concatenate([np.full(f.rows, f.noise_scale / first) for f in files])[known], group)[0]
        for column, channel, slope in (("torque_nm", "drive", V / (2.0 * np.pi)), ("flow_l_min", "flow", 0.0)):
            value, share = means(_all_of(files, column)[known] * TO_SI[column], group)
            has = np.isfinite(value)
            if has.any():
                sd = (np.hypot(noise_sd(recording, column, files[0]) * share, slope * P_sd) * scale)[has]
                of_channel.append(has)
                readings.append(Readings(channel, value[has], sd, int(has.sum()) >= SERIES, channel))
                unknowns += instrument(recording, channel, column)
        counted = np.zeros(known.size, dtype=bool)
        if of_channel:
            counted[known] = np.any(of_channel, axis=0)[group]
        volume = Unknown("displacement", "1", "lognormal", 1.0, VOLUME_FACTOR, "inline motor")
        unknowns += [*instrument(recording, "pressure", name), volume]
        median, gauge_pa = float(np.median(rows_of[0])), float(np.median(rows_of[1])) - table.ambient
        self._table, self._rows, self._has = table, rows_of, of_channel
        self.readings, self.unknowns, self.files, self.timed = readings, unknowns, _used(files, counted), timed
        self.flats: list[Flat] = []
        self.sizes = Sizes(V * gauge_pa / (2.0 * np.pi), median, V * median / (2.0 * np.pi), gauge_pa)

    def could_show(self) -> list[str]:
        """Those of its effects that what was read could show: a torque, or a flow."""
        read, found = {one.channel for one in self.readings}, list(self.effects)
        if "drive" not in read:
            found = [name for name in found if effects()[name].torque is None]
        if "flow" not in read:
            found = [name for name in found if "flow" not in effects()[name].reads and name != "leakage"]
        return found

    def predict(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        """Torque [N m] and flow [m3/s] of the plateaus, those of them that were read, as `System.predict`."""
        speed, reading, T, time = self._rows
        V = float(self._table.motor["displacement_m3_per_rev"]) * values["displacement"]
        wanted = (reading - values.get("pressure_offset", 0.0)) / (1.0 + values.get("pressure_scale", 0.0))
        P = wanted.copy()
        state = state_of(speed, 0.0)
        for _ in range(4):
            P = P + wanted - readings_of(chosen, "pressure", P, state)
        found = rows(V, values.get("viscous_friction", 0.0), speed, P, T, self._table.ambient, time, chosen)
        flow = readings_of(chosen, "flow", found.flow, found.state)
        read = []
        for one, has in zip(self.readings, self._has, strict=True):
            true = found.torque if one.channel == "drive" else flow
            error = (values.get(f"{one.channel}_{what}", 0.0) for what in ("offset", "scale"))
            read.append((next(error) + true * (1.0 + next(error)))[has])
        return read

    def coordinates(self) -> list[Coordinates]:
        """Speed, pressure and time of the plateaus with a reading [SI]."""
        speed, pressure, _, time = self._rows
        return [{"speed": speed[has], "pressure": pressure[has], "time": time[has]} for has in self._has]

    def answer(self, i: int, pieces: np.ndarray, balance: str, friction: float) -> np.ndarray:
        """The pieces themselves: torque and flow are what is read."""
        return pieces

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Pressure levels where there are some, else rows that follow each other."""
        pressure = self._rows[1]
        order = np.sort(pressure)
        cuts = order[1:][np.diff(order) > LEVEL * order[-1]]
        if cuts.size:
            group = np.searchsorted(cuts, pressure, side="right") % min(cuts.size + 1, FOLDS)
            count, scheme = min(cuts.size + 1, FOLDS), "pressure levels"
        else:
            group, count, scheme = np.zeros(pressure.size, dtype=int), FOLDS, "contiguous rows"
            for k, part in enumerate(np.array_split(np.arange(pressure.size), FOLDS)):
                group[part] = k
        return [np.concatenate([(group == k)[has] for has in self._has]) for k in range(count)], scheme

    def tests(self, noise: Callable[[str], float]) -> dict[str, Simulate]:
        """A locked rotor, and plateaus at other speeds and pressures."""
        speed, pressure, _, _ = self._rows
        top, slow, fast = float(pressure.max()), float(speed.min()), float(speed.max())
        zero = {one.name: one.b for one in self.unknowns}
        sd = [np.hypot(noise(c) / np.sqrt(REPEATS), zero.get(f"{c}_offset", 0.0)) for c in ("drive", "flow")]
        table = self._table

        def at(omega: float, P: float, flow_alone: bool = False) -> Simulate:
            def simulate(values: Mapping[str, float], chosen: Chosen) -> tuple[np.ndarray, np.ndarray]:
                one = np.ones(1)
                V = float(table.motor["displacement_m3_per_rev"]) * values["displacement"]
                friction = values.get("viscous_friction", 0.0)
                found = rows(V, friction, omega * one, P * one, table.room * one, table.ambient, 0.0 * one, chosen)
                flow = readings_of(chosen, "flow", found.flow, found.state) * (1.0 + values.get("flow_scale", 0.0))
                torque = found.torque * (1.0 + values.get("drive_scale", 0.0))
                both = np.array([torque[0], flow[0]])
                if flow_alone:  # at rest friction may be anything
                    return both[1:], np.array(sd[1:])
                return both, np.array(sd)

            return simulate

        words = f"bar abs, {REPEATS:.0f} plateaus"
        return {
            f"locked rotor: flow at zero speed and {top / BAR:.2f} {words}": at(0.0, top, True),
            f"{0.5 * slow * RPM:.0f} rpm at {top / BAR:.2f} {words}": at(0.5 * slow, top),
            f"{fast * RPM:.0f} rpm at {0.5 * top / BAR:.2f} {words}": at(fast, 0.5 * top),
        }


def _files_of(recording: Recording, pressure: str) -> list[RecordingFile]:
    files = [f for f in recording.files if f.kind == "steady" and {pressure, "speed_rpm"} <= set(f.columns)]
    if not files:
        raise RecordingError(f"{recording.folder}: displacement_machine: no steady file with speed_rpm and {pressure}")
    return files


def _all_of(files: Sequence[RecordingFile], column: str, missing: float = np.nan) -> np.ndarray:
    """A column of all files, one after the other."""
    return np.concatenate(
        [f.columns[column].values if column in f.columns else np.full(f.rows, missing) for f in files]
    )


def _used(files: Sequence[RecordingFile], counted: np.ndarray) -> list[FileUse]:
    """What is used of each file, by whether each row of all counts."""
    parts = np.split(counted, np.cumsum([f.rows for f in files])[:-1])
    return [
        rows_used(file, {NOT_READ: ~part} if not part.all() else {}) for file, part in zip(files, parts, strict=True)
    ]


SYSTEM = DisplacementMachine
