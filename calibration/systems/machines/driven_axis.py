"""A driven axis, turning or sliding: its runs in short blocks, and the drive that they would need."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calibration.systems.machines.readings import TO_SI, Flat, Readings, noise_sd
from calibration.systems.machines.system import Coordinates, Simulate, pieces_of, segments
from calibration.systems.machines.table import MachineTable, instrument, rows_used, transients
from calibration.unknowns.priors import Error, OfInstrument, Unknown
from configs.units import BAR
from model.effects.laws import Chosen
from model.rigs.driven_axis import LOAD_AREA, Blocks, blocks_of, drive
from model.rigs.state import Sizes
from rig.recording import RecordingError, RecordingFile
from rig.recording.columns import NUMERIC

MOST_BLOCKS = 600  # a file is cut into at most so many
LEAST_ROWS = 5  # of a block, in a file that has enough of them
FEW_BLOCKS = 40  # ... and in one that has not, as many blocks as that
CONSTANT = 0.05  # a drive that varies by less than this share is constant
UNREAD = "no time, drive or speed"
MAY_REST = "the axis may have stood, or turned round"
BEHIND = "behind the last whole block of rows"
RUNS = 4  # files from which on whole runs are held out
SPEEDS = (0.1, 0.3, 1.5)  # of the ordinary speed, at which an axis is driven in a test
REPEATS = 10.0
AT_REST = 4.0  # a speed within so many of its own deviations of 0 may be standstill

Files = list[tuple[RecordingFile, Blocks]]


class DrivenAxis:
    """The runs of a recording in blocks, without those in which the axis may have stood still.

    Raises RecordingError when there is none.
    """

    kind = "driven_axis"
    effects = ("inertia",)
    balances = (("", "torque", "speed"), ("", "torque", "pressure"), ("", "torque", "time"), ("", "sensor", "time"))
    timed = True

    def __init__(self, table: MachineTable) -> None:
        recording = table.recording
        found: Files = []
        readings: list[Readings] = []
        uses = []
        of_drive, of_speed = ("force_n", "velocity_m_s") if table.slides else ("torque_nm", "speed_rpm")
        for file in transients(recording, "time_s", of_drive, of_speed):
            speed_sd = noise_sd(recording, of_speed, file)
            blocks, left = _blocks_of(table, file, of_drive, of_speed, AT_REST * speed_sd)
            found.append((file, blocks))
            uses.append(rows_used(file, left))
            covariance = _covariance(table.inertia, blocks, noise_sd(recording, of_drive, file), speed_sd)
            sd = np.sqrt(np.diag(covariance))
            whitener = np.linalg.inv(np.linalg.cholesky(covariance)) if np.all(sd > 0.0) else None
            force = blocks.mean(blocks.drive)[blocks.used]
            readings.append(Readings("drive", force, sd, True, f"drive {file.file}", whitener))
        if not found:
            raise RecordingError(
                f"{recording.folder}: driven_axis: no transient file with time_s, {of_drive} and {of_speed}"
            )
        force = np.concatenate([one.value for one in readings])
        constant = force.size and float(np.std(force)) < CONSTANT * abs(float(np.mean(force)))
        area = _area(table, found, readings)
        self._table, self._blocks = table, found
        self._means = [_means(blocks) for _, blocks in found]
        self.readings, self.files, self.sizes = readings, uses, _sizes(found, readings)
        self.flats = [] if area is None else [Flat("piston_area", "m2", area, max(abs(area), 1e-6), -np.inf)]
        self.unknowns = [*instrument(recording, "drive", of_drive), *_zeros_of_runs(table, found, of_drive, area)]
        self.weight = float(np.mean(force)) if constant else None

    def could_show(self) -> list[str]:
        """Load friction where a pressure was read; no inertia where a weight drives."""
        # With a weight less inertia and a constant drag explain any noise in the speed.
        found = [] if self.weight is not None else list(self.effects)
        return [*found, *(["load_friction"] if any(np.isfinite(b.pressure).any() for _, b in self._blocks) else [])]

    def predict(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        """Mean drive of the blocks that are used [N m, N], as `System.predict`."""
        area, chosen = values.get("piston_area", 0.0), loaded(values, chosen)
        J, flywheel, ambient = self._table.inertia, self._table.flywheel, self._table.ambient
        found = []
        for file, blocks in self._blocks:
            one = drive(J, values["viscous_friction"], blocks, chosen, file.start_s, ambient, flywheel)
            if area:
                one = one - area * blocks.mean(np.nan_to_num(blocks.pressure - ambient))
            offset = values.get("drive_offset", 0.0) + values.get(f"{file.file}.drive_offset", 0.0)
            one = one[blocks.used]
            whole = self.weight if self.weight is not None else one
            found.append(one + values.get("drive_scale", 0.0) * whole + offset)
        return found

    def coordinates(self) -> list[Coordinates]:
        """Means of the blocks: speed, time, and the pressure where it was read [SI]."""
        return self._means

    def answer(self, i: int, pieces: np.ndarray, balance: str, friction: float) -> np.ndarray:
        """A torque or force against the motion has the sign of the speed; an instrument's error has none."""
        return pieces if balance == "sensor" else pieces * np.sign(self._means[i]["speed"])[:, None]

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Whole runs where there are enough, else segments of them."""
        sizes = [one.value.size for one in self.readings]
        whole = sum(size > 0 for size in sizes) >= RUNS
        return segments(sizes, 1 if whole else pieces_of(len(sizes))), "whole runs" if whole else "transient segments"

    def tests(self, noise: Callable[[str], float]) -> dict[str, Simulate]:
        """Steady strokes there and back, never faster than the axis is known to go."""
        sd = np.array([noise("drive") / np.sqrt(REPEATS)])
        ordinary, ambient = self.sizes.speed, self._table.ambient
        used = [np.abs(blocks.mean(blocks.speed)[blocks.used]) for _, blocks in self._blocks]
        fastest = max(float(one.max(initial=0.0)) for one in used)
        gauges = [blocks.pressure - ambient for _, blocks in self._blocks if np.isfinite(blocks.pressure).any()]
        middle = float(np.nanmean(np.concatenate(gauges))) if gauges else None

        def at(speed: float, gauge: float | None) -> Simulate:
            def simulate(values: Mapping[str, float], chosen: Chosen) -> tuple[np.ndarray, np.ndarray]:
                time, friction = np.linspace(0.0, 1.0, 6), values["viscous_friction"]
                P = None if gauge is None else np.full(time.size, ambient + gauge)
                read = []
                for v in (speed, -speed):  # there and back: half the difference leaves the offset and the gas force out
                    one = blocks_of(time, np.zeros(time.size), np.full(time.size, v), 5, 0.0, None, P)
                    read.append(drive(self._table.inertia, friction, one, loaded(values, chosen), 0.0, ambient)[0])
                return np.array([0.5 * (read[0] - read[1])]), sd

            return simulate

        unit = "m/s" if self._table.slides else "rad/s"
        tests = {
            f"steady strokes there and back at {speed:.3g} {unit}": at(speed, middle)
            for speed in (min(share * ordinary, fastest) for share in SPEEDS)
        }
        if middle is not None:
            tests[f"steady strokes at {ordinary:.3g} {unit} with the pressure let off"] = at(ordinary, 0.0)
        return tests


def _means(blocks: Blocks) -> Coordinates:
    """Speed, time and pressure of the blocks that are used, where all of them are known [SI]."""
    found = {name: blocks.mean(getattr(blocks, name))[blocks.used] for name in ("speed", "time", "pressure")}
    return {name: values for name, values in found.items() if np.all(np.isfinite(values))}


def _left(known: np.ndarray, rows: np.ndarray, blocks: Blocks) -> dict[str, np.ndarray]:
    """Rows of a file that no block holds in which the axis moves, by the reason; ``rows`` are those of the blocks."""
    moves, covered = np.zeros(known.size, dtype=bool), np.zeros(known.size, dtype=bool)
    for used, (first, last) in zip(blocks.used, itertools.pairwise(blocks.ends), strict=True):
        covered[rows[first : last + 1]] = True
        if used:
            moves[rows[first : last + 1]] = True
    left = {UNREAD: ~known, MAY_REST: covered & ~moves, BEHIND: known & ~covered}
    return {why: mask for why, mask in left.items() if mask.any()}


def _blocks_of(
    table: MachineTable, file: RecordingFile, of_drive: str, of_speed: str, rest: float
) -> tuple[Blocks, dict[str, np.ndarray]]:
    """The rows of a run in blocks, and those that are left out by the reason; ``rest`` is a speed [rad/s, m/s]."""
    columns = {name: column.values * TO_SI.get(name, 1.0) for name, column in file.columns.items()}
    known = np.isfinite(columns["time_s"]) & np.isfinite(columns[of_drive]) & np.isfinite(columns[of_speed])
    columns = {name: values[known] for name, values in columns.items()}
    n = columns["time_s"].size
    size = max(min(LEAST_ROWS, n // FEW_BLOCKS), n // MOST_BLOCKS, 1)
    pressure = columns.get("pressure_bar_abs")
    if "pressure_bar_gauge" in columns:
        pressure = columns["pressure_bar_gauge"] + table.ambient
    angle = None if table.slides else columns.get("angle_rad")
    blocks = blocks_of(columns["time_s"], columns[of_drive], columns[of_speed], size, rest, angle, pressure)
    return blocks, _left(known, np.flatnonzero(known), blocks)


def _zeros_of_runs(table: MachineTable, files: Files, of_drive: str, area: float | None) -> list[Unknown]:
    """Zeros wander from run to run, as much as they may be off; of a single run the recording's own are enough."""
    channels = table.recording.channels
    zero = channels[of_drive].bias_sd * TO_SI[of_drive]
    gauge = next((c for c in channels if c.startswith("pressure_")), None)
    if gauge is not None and area is not None:
        zero = float(np.hypot(zero, area * channels[gauge].bias_sd * BAR))
    if len(files) < 2 or zero <= 0.0:
        return []
    why = "the zeros of a run, beside those of the recording"
    of = [OfInstrument("drive", Error.OFFSET, file.file) for file, _ in files]
    return [Unknown(f"{one.file}.drive_offset", NUMERIC[of_drive].si, "normal", 0.0, zero, why, one) for one in of]


def _sizes(files: Files, readings: Sequence[Readings]) -> Sizes:
    """Ordinary drive and speed, as root mean squares over the blocks that are used."""
    force = np.concatenate([one.value for one in readings])
    speed = np.concatenate([blocks.mean(blocks.speed)[blocks.used] for _, blocks in files])
    if not force.size:
        return Sizes(1.0, 1.0)
    return Sizes(float(np.sqrt(np.mean(force**2))), float(np.sqrt(np.mean(speed**2))))


def _area(table: MachineTable, files: Files, readings: Sequence[Readings]) -> float | None:
    """Piston area by which the drive follows the pressure [m2], roughly; None where no pressure varies."""
    seen = [
        (one.value, blocks.mean(np.nan_to_num(blocks.pressure - table.ambient))[blocks.used])
        for one, (_, blocks) in zip(readings, files, strict=True)
        if np.isfinite(blocks.pressure).any()
    ]
    if not seen:
        return None
    force, gauge = (np.concatenate([pair[i] for pair in seen]) for i in (0, 1))
    return -float(force @ gauge / max(float(gauge @ gauge), 1e-12))


def _covariance(inertia: float, blocks: Blocks, drive_sd: float, speed_sd: float) -> np.ndarray:
    """Noise of the blocks that are used: neighbours share the reading of speed between them, with opposite sign."""
    span = np.diff(blocks.time[blocks.ends])
    per_end = inertia * speed_sd / span
    covariance = np.diag(drive_sd**2 / np.diff(blocks.ends) + 2.0 * per_end**2)
    shared = -per_end[1:] * per_end[:-1]
    covariance += np.diag(shared, 1) + np.diag(shared, -1)
    return np.asarray(covariance[np.ix_(blocks.used, blocks.used)])


def loaded(values: Mapping[str, float], chosen: Chosen) -> Chosen:
    """A set of effects for `drive`: friction grows with the gas force on the piston that is fitted.

    `values`: of flats and unknowns by their names [SI].
    """
    if "load_friction" not in chosen:
        return chosen
    share = chosen["load_friction"]["roller_factor"] * abs(values.get("piston_area", 0.0)) / LOAD_AREA
    return {**chosen, "load_friction": {"roller_factor": share}}


SYSTEM = DrivenAxis
