"""A free rotor: its coast-downs, and what a tachometer would read of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calibration.rigs_readings import TO_SI, Flat, Readings, noise_sd
from calibration.rigs_table import RigTable, Seen, instrument, transients
from model.effects.laws import Chosen
from model.rigs.free_rotor import coast
from model.rigs.state import Sizes
from rig.recording import RecordingError, RecordingFile

FEWEST = 4  # readings of a coast-down


def see(table: RigTable) -> Seen:
    """The coast-downs of a recording, each until the rotor stands.

    Parameters
    ----------
    table : RigTable
        The rig.

    Raises
    ------
    RecordingError
        When there is none.
    """
    recording = table.recording
    coasts: list[tuple[RecordingFile, np.ndarray]] = []
    flats, readings = [], []
    for file in transients(recording, "time_s", "speed_rpm"):
        time, speed = (file.columns[name].values for name in ("time_s", "speed_rpm"))
        speed = speed * TO_SI["speed_rpm"]
        known = np.isfinite(speed) & (speed > 0.0)
        stopped = np.flatnonzero(speed <= 0.0)
        known[stopped[0] if stopped.size else speed.size :] = False
        time, speed = time[known], speed[known]
        if time.size < FEWEST:
            continue
        coasts.append((file, time))
        flats.append(Flat(f"{file.file}.first_speed", "rad/s", float(speed[0]), float(speed[0]), 0.0))
        sd = noise_sd(recording, "speed_rpm", file) * np.ones(time.size)
        readings.append(Readings("speed", speed, sd, True, f"speed {file.file}"))
    if not coasts:
        raise RecordingError(f"{recording.folder}: free_rotor: no transient file with a coast-down in it")
    spans = [(one.value[0] - one.value[-1]) / (t[-1] - t[0]) for one, (_, t) in zip(readings, coasts, strict=True)]
    sizes = Sizes(table.inertia * max(max(spans), 1e-12), float(np.median(readings[0].value)))
    return Seen(readings, flats, instrument(recording, "speed", "speed_rpm"), sizes, coasts=coasts)


def sees_turns(seen: Seen) -> bool:
    """Whether samples follow each other within half a turn, for nine in ten of them.

    Parameters
    ----------
    seen : Seen
        Of `see`.
    """
    turned = [one.value[1:] * np.diff(time) for one, (_, time) in zip(seen.readings, seen.coasts, strict=True)]
    return bool(np.quantile(np.concatenate(turned), 0.9) < np.pi)


def predict(table: RigTable, seen: Seen, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
    """Speeds along the coast-downs [rad/s].

    Parameters
    ----------
    table : RigTable
        The rig.
    seen : Seen
        Of `see`.
    values : mapping of str to float
        Of flats and unknowns by their names [SI].
    chosen : mapping
        Effect id to the values of its parameters.
    """
    f = values.get("viscous_friction", 0.0)
    scale, offset = 1.0 + values.get("speed_scale", 0.0), values.get("speed_offset", 0.0)
    return [
        coast(table.inertia, f, time, values[f"{file.file}.first_speed"], chosen, file.start_s).reading * scale + offset
        for file, time in seen.coasts
    ]
