"""A free rotor: its coast-downs, and what a tachometer would read of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from calibration.data.runs_in_time import coast_down
from calibration.likelihood.shapes import first_order
from calibration.systems.machines.readings import TO_SI, Flat, Readings, noise_sd
from calibration.systems.machines.system import Coordinates, Simulate, pieces_of, segments
from calibration.systems.machines.table import MachineTable, instrument, rows_used, transients
from calibration.unknowns.priors import OfRun
from model.effects.laws import Chosen
from model.layout import RPM
from model.rigs.free_rotor import coast
from model.rigs.state import Sizes
from rig.recording import RecordingError, RecordingFile

FEWEST = 4  # readings of a coast-down
TOO_FEW = f"fewer than {FEWEST} readings of a coast-down"
DOES_NOT_FALL = "the speed does not fall: there is no coast-down in it"
SAMPLES = 60  # of a coast-down that is planned


class FreeRotor:
    """The coast-downs of a recording, each from its release until the rotor stands.

    Raises RecordingError when there is none.
    """

    kind = "free_rotor"
    effects = ("once_per_rev_torque", "speed_lag")
    balances = (("", "torque", "speed"), ("", "torque", "pressure"), ("", "torque", "time"))
    weight = None
    timed = True

    def __init__(self, table: MachineTable) -> None:
        recording = table.recording
        coasts: list[tuple[RecordingFile, np.ndarray, np.ndarray]] = []
        files = []
        flats, readings = [], []
        for file in transients(recording, "time_s", "speed_rpm"):
            columns = {name: column.values for name, column in file.columns.items()}
            time, speed = columns["time_s"], columns["speed_rpm"] * TO_SI["speed_rpm"]
            read, speed = np.isfinite(speed), np.where(file.columns["speed_rpm"].censor > 0, np.nan, speed)
            run = coast_down(time, speed, file.is_open)
            compared = run.compared
            why = "" if _falls(speed[compared]) else DOES_NOT_FALL
            if compared.sum() < FEWEST or why:
                files.append(rows_used(file, {why or TOO_FEW: np.ones(file.rows, dtype=bool)}))
                continue
            files.append(rows_used(file, run.left))
            grid = np.arange(run.begin, run.end)
            grid = grid[read[grid]]  # a mean goes back to the reading before, be that good or bad
            coasts.append((file, time[grid], compared[grid]))
            first = float(speed[run.begin])
            flats.append(Flat(f"{file.file}.first_speed", "rad/s", first, first, 0.0, OfRun(file.file, "first_speed")))
            sd = noise_sd(recording, "speed_rpm", file) * np.ones(int(compared.sum()))
            readings.append(Readings("speed", speed[compared], sd, True, f"speed {file.file}"))
        if not coasts:
            of_angle = [file.file for file in transients(recording, "angle_rad") if "speed_rpm" not in file.columns]
            angle = "angle_rad alone; add a column speed_rpm, made of the differences of the angles"
            told = "; ".join(
                [f"{one['file']}: {one['why']}" for one in files] + [f"{one}: {angle}" for one in of_angle]
            )
            told = f" ({told})" if told else ""
            raise RecordingError(f"{recording.folder}: free_rotor: no transient file with a coast-down in it{told}")
        spans = [
            (one.value[0] - one.value[-1]) / (t[-1] - t[0]) for one, (_, t, _) in zip(readings, coasts, strict=True)
        ]
        sizes = Sizes(table.inertia * max(max(spans), 1e-12), float(np.median(readings[0].value)))
        found = instrument(recording, "speed", "speed_rpm")
        self._table, self._coasts = table, coasts
        self.readings, self.flats, self.unknowns, self.sizes, self.files = readings, flats, found, sizes, files

    def could_show(self) -> list[str]:
        """Without what follows the angle, unless samples follow each other within half a turn, nine in ten of them."""
        turned = [
            one.value * np.diff(time)[compared[1:]]
            for one, (_, time, compared) in zip(self.readings, self._coasts, strict=True)
        ]
        sees_turns = bool(np.quantile(np.concatenate(turned), 0.9) < np.pi)
        return [name for name in self.effects if sees_turns or name != "once_per_rev_torque"]

    def predict(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        """Speeds along the coast-downs [rad/s], as `System.predict`."""
        f, J = values.get("viscous_friction", 0.0), self._table.inertia
        scale, offset = 1.0 + values.get("speed_scale", 0.0), values.get("speed_offset", 0.0)
        found = []
        for file, time, compared in self._coasts:
            first = values[f"{file.file}.first_speed"]
            found.append(coast(J, f, time, first, chosen, file.start_s).reading[compared] * scale + offset)
        return found

    def coordinates(self) -> list[Coordinates]:
        """Speed [rad/s] and time [s] of the readings."""
        return [
            {"speed": one.value, "time": time[compared]}
            for one, (_, time, compared) in zip(self.readings, self._coasts, strict=True)
        ]

    def answer(self, i: int, pieces: np.ndarray, balance: str, friction: float) -> np.ndarray:
        """What torques along a coast-down do to its speed: each is forgotten as viscous friction slows the rotor."""
        _, time, compared = self._coasts[i]
        clock, J = time[compared], self._table.inertia
        rate, dt = friction / J, np.diff(clock)
        keeps = np.exp(-rate * dt)
        per = (1.0 - keeps) / (rate * J) if rate > 0.0 else dt / J
        start = np.zeros((1, pieces.shape[1]))
        later = first_order(0.5 * (pieces[1:] + pieces[:-1]) * per[:, None], keeps, start[0])
        out = np.concatenate([start, later])
        return 0.5 * (out + np.concatenate([start, out[:-1]]))

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Segments of the coast-downs."""
        sizes = [one.value.size for one in self.readings]
        return segments(sizes, pieces_of(len(sizes))), "transient segments"

    def tests(self, noise: Callable[[str], float]) -> dict[str, Simulate]:
        """Coast-downs, also with a flywheel."""
        sd, time = noise("speed"), self._coasts[0][1]
        first, span = float(self.readings[0].value[0]), float(time[-1] - time[0])

        def at(share: float, inertia: float) -> Simulate:
            def simulate(values: Mapping[str, float], chosen: Chosen) -> tuple[np.ndarray, np.ndarray]:
                t = np.linspace(0.0, 2.0 * inertia * span, SAMPLES)
                f, J = values["viscous_friction"], inertia * self._table.inertia
                return coast(J, f, t, share * first, chosen).reading, np.full(SAMPLES, sd)

            return simulate

        return {
            f"coast-down from {0.3 * first * RPM:.0f} rpm to standstill": at(0.3, 1.0),
            f"coast-down from {first * RPM:.0f} rpm to standstill": at(1.0, 1.0),
            f"coast-down from {first * RPM:.0f} rpm with a flywheel of three times the inertia": at(1.0, 4.0),
        }


def _falls(speed: np.ndarray) -> bool:
    """Whether a run ends slower than it begins, by the means of its first and last third.

    `speed`, shape (n,): in any unit.
    """
    third = max(speed.size // 3, 1)
    return bool(speed.size > 1 and np.mean(speed[-third:]) < np.mean(speed[:third]))


SYSTEM = FreeRotor
