"""A free rotor: its coast-downs, and what a tachometer would read of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calibration.data.runs_in_time import coast_down
from calibration.systems.readings import TO_SI, Flat, Readings, noise_sd
from calibration.systems.table import Coasting, RigTable, Seen, instrument, rows_used, transients
from model.effects.laws import Chosen
from model.rigs.free_rotor import coast
from model.rigs.state import Sizes
from rig.recording import RecordingError

FEWEST = 4  # readings of a coast-down
TOO_FEW = f"fewer than {FEWEST} readings of a coast-down"
DOES_NOT_FALL = "the speed does not fall: there is no coast-down in it"


def see(table: RigTable) -> Seen:
    """The coast-downs of a recording, each from its release until the rotor stands.

    Raises
    ------
    RecordingError
        When there is none.
    """
    recording = table.recording
    coasts: list[Coasting] = []
    files = []
    flats, readings = [], []
    for file in transients(recording, "time_s", "speed_rpm"):
        columns = {name: column.values for name, column in file.columns.items()}
        time, speed = columns["time_s"], columns["speed_rpm"] * TO_SI["speed_rpm"]
        read, speed = np.isfinite(speed), np.where(file.columns["speed_rpm"].censor > 0, np.nan, speed)
        run = coast_down(time, speed, columns.get("supply_open"))
        compared = run.compared
        why = "" if falls(speed[compared]) else DOES_NOT_FALL
        if compared.sum() < FEWEST or why:
            files.append(rows_used(file, {why or TOO_FEW: np.ones(file.rows, dtype=bool)}))
            continue
        files.append(rows_used(file, run.left))
        grid = np.arange(run.begin, run.end)
        grid = grid[read[grid]]  # a mean goes back to the reading before, be that good or bad
        coasts.append((file, time[grid], compared[grid]))
        first = float(speed[run.begin])
        flats.append(Flat(f"{file.file}.first_speed", "rad/s", first, first, 0.0))
        sd = noise_sd(recording, "speed_rpm", file) * np.ones(int(compared.sum()))
        readings.append(Readings("speed", speed[compared], sd, True, f"speed {file.file}"))
    if not coasts:
        told = "; ".join(f"{one['file']}: {one['why']}" for one in files)
        raise RecordingError(
            f"{recording.folder}: free_rotor: no transient file with a coast-down in it{f' ({told})' if told else ''}"
        )
    spans = [(one.value[0] - one.value[-1]) / (t[-1] - t[0]) for one, (_, t, _) in zip(readings, coasts, strict=True)]
    sizes = Sizes(table.inertia * max(max(spans), 1e-12), float(np.median(readings[0].value)))
    found = instrument(recording, "speed", "speed_rpm")
    return Seen(readings, flats, found, sizes, coasts=coasts, files=files)


def falls(speed: np.ndarray) -> bool:
    """Whether a run ends slower than it begins, by the means of its first and last third.

    Parameters
    ----------
    speed : ndarray, shape (n,)
        In any unit.
    """
    third = max(speed.size // 3, 1)
    return bool(speed.size > 1 and np.mean(speed[-third:]) < np.mean(speed[:third]))


def sees_turns(seen: Seen) -> bool:
    """Whether samples follow each other within half a turn, for nine in ten of them."""
    turned = [
        one.value * np.diff(time)[compared[1:]]
        for one, (_, time, compared) in zip(seen.readings, seen.coasts, strict=True)
    ]
    return bool(np.quantile(np.concatenate(turned), 0.9) < np.pi)


def predict(table: RigTable, seen: Seen, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
    """Speeds along the coast-downs [rad/s].

    Parameters
    ----------
    values : mapping of str to float
        Of flats and unknowns by their names [SI].
    """
    f = values.get("viscous_friction", 0.0)
    scale, offset = 1.0 + values.get("speed_scale", 0.0), values.get("speed_offset", 0.0)
    found = []
    for file, time, compared in seen.coasts:
        first = values[f"{file.file}.first_speed"]
        found.append(coast(table.inertia, f, time, first, chosen, file.start_s).reading[compared] * scale + offset)
    return found
