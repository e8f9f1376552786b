"""A driven axis, turning or sliding: its runs in short blocks, and the drive that they would need."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from calibration.systems.readings import SI_UNITS, TO_SI, Flat, Readings, noise_sd
from calibration.systems.table import RigTable, Seen, instrument, rows_used, transients
from calibration.unknowns.priors import PASCAL_PER_BAR, Unknown
from model.effects.laws import Chosen
from model.rigs.driven_axis import LOAD_AREA, Blocks, blocks_of, drive
from model.rigs.state import Sizes
from rig.recording import RecordingError, RecordingFile

MOST_BLOCKS = 600  # a file is cut into at most so many
LEAST_ROWS = 5  # of a block, in a file that has enough of them
FEW_BLOCKS = 40  # ... and in one that has not, as many blocks as that
CONSTANT = 0.05  # a drive that varies by less than this share is constant
UNREAD = "no time, drive or speed"
MAY_REST = "the axis may have stood, or turned round"
BEHIND = "behind the last whole block of rows"
AT_REST = 4.0  # a speed within so many of its own deviations of 0 may be standstill

Files = list[tuple[RecordingFile, Blocks]]


def see(table: RigTable) -> Seen:
    """The runs of a recording in blocks, without those in which the axis may have stood still.

    Raises
    ------
    RecordingError
        When there is none.
    """
    recording = table.recording
    found: Files = []
    readings: list[Readings] = []
    uses = []
    of_drive, of_speed = ("force_n", "velocity_m_s") if table.slides else ("torque_nm", "speed_rpm")
    for file in transients(recording, "time_s", of_drive, of_speed):
        columns = {name: column.values * TO_SI.get(name, 1.0) for name, column in file.columns.items()}
        known = np.isfinite(columns["time_s"]) & np.isfinite(columns[of_drive]) & np.isfinite(columns[of_speed])
        rows = np.flatnonzero(known)
        columns = {name: values[known] for name, values in columns.items()}
        n = columns["time_s"].size
        size = max(min(LEAST_ROWS, n // FEW_BLOCKS), n // MOST_BLOCKS, 1)
        speed_sd = noise_sd(recording, of_speed, file)
        pressure = columns.get("pressure_bar_abs")
        if "pressure_bar_gauge" in columns:
            pressure = columns["pressure_bar_gauge"] + table.ambient
        blocks = blocks_of(
            columns["time_s"],
            columns[of_drive],
            columns[of_speed],
            size,
            AT_REST * speed_sd,
            None if table.slides else columns.get("angle_rad"),
            pressure,
        )
        found.append((file, blocks))
        uses.append(rows_used(file, _left(known, rows, blocks)))
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
    return Seen(
        readings,
        [] if area is None else [Flat("piston_area", "m2", area, max(abs(area), 1e-6), -np.inf)],
        [*instrument(recording, "drive", of_drive), *_zeros_of_runs(table, found, of_drive, area)],
        _sizes(found, readings),
        blocks=found,
        weight=float(np.mean(force)) if constant else None,
        files=uses,
    )


def _left(known: np.ndarray, rows: np.ndarray, blocks: Blocks) -> dict[str, np.ndarray]:
    """Rows of a file that no block holds in which the axis moves, by the reason; ``rows`` are those of the blocks."""
    moves, covered = np.zeros(known.size, dtype=bool), np.zeros(known.size, dtype=bool)
    for used, (first, last) in zip(blocks.used, itertools.pairwise(blocks.ends), strict=True):
        covered[rows[first : last + 1]] = True
        if used:
            moves[rows[first : last + 1]] = True
    left = {UNREAD: ~known, MAY_REST: covered & ~moves, BEHIND: known & ~covered}
    return {why: mask for why, mask in left.items() if mask.any()}


def _zeros_of_runs(table: RigTable, files: Files, of_drive: str, area: float | None) -> list[Unknown]:
    """Zeros wander from run to run, as much as they may be off; of a single run the recording's own are enough."""
    channels = table.recording.channels
    zero = channels[of_drive].bias_sd * TO_SI[of_drive]
    gauge = next((c for c in channels if c.startswith("pressure_")), None)
    if gauge is not None and area is not None:
        zero = float(np.hypot(zero, area * channels[gauge].bias_sd * PASCAL_PER_BAR))
    if len(files) < 2 or zero <= 0.0:
        return []
    why = "the zeros of a run, beside those of the recording"
    return [Unknown(f"{file.file}.drive_offset", SI_UNITS[of_drive], "normal", 0.0, zero, why) for file, _ in files]


def _sizes(files: Files, readings: Sequence[Readings]) -> Sizes:
    """Ordinary drive and speed, as root mean squares over the blocks that are used."""
    force = np.concatenate([one.value for one in readings])
    speed = np.concatenate([blocks.mean(blocks.speed)[blocks.used] for _, blocks in files])
    if not force.size:
        return Sizes(1.0, 1.0)
    return Sizes(float(np.sqrt(np.mean(force**2))), float(np.sqrt(np.mean(speed**2))))


def _area(table: RigTable, files: Files, readings: Sequence[Readings]) -> float | None:
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

    Parameters
    ----------
    values : mapping of str to float
        Of flats and unknowns by their names [SI].
    """
    if "load_friction" not in chosen:
        return chosen
    share = chosen["load_friction"]["roller_factor"] * abs(values.get("piston_area", 0.0)) / LOAD_AREA
    return {**chosen, "load_friction": {"roller_factor": share}}


def predict(table: RigTable, seen: Seen, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
    """Mean drive of the blocks that are used [N m, N].

    Parameters
    ----------
    values : mapping of str to float
        Of flats and unknowns by their names [SI].
    """
    area, chosen = values.get("piston_area", 0.0), loaded(values, chosen)
    found = []
    for file, blocks in seen.blocks:
        one = drive(table.inertia, values["viscous_friction"], blocks, chosen, file.start_s, table.ambient)
        if area:
            one = one - area * blocks.mean(np.nan_to_num(blocks.pressure - table.ambient))
        offset = values.get("drive_offset", 0.0) + values.get(f"{file.file}.drive_offset", 0.0)
        one = one[blocks.used]
        whole = seen.weight if seen.weight is not None else one
        found.append(one + values.get("drive_scale", 0.0) * whole + offset)
    return found
