"""A rig as the motor table of its recording describes it, and what the files of its kind hold; SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.data.rows_used import FileUse, use_of
from calibration.data.runs_in_time import why_left
from calibration.unknowns.priors import Unknown, off
from configs.units import BAR, ZERO_C
from model.rigs.state import AMBIENT_PA, ROOM_K
from rig.recording import Recording, RecordingFile
from rig.recording.columns import NUMERIC


@dataclass(frozen=True)
class MachineTable:
    """A rig as its recording describes it.

    `ambient`: pressure around it [Pa].
    `room`: temperature around it [K].
    `slides`: whether it moves along a line and does not turn.
    `inertia`: flywheels included [kg m2]; a slide's mass [kg].
    `flywheel`: of it, what is mounted on the shaft [kg m2].
    """

    recording: Recording
    motor: Mapping[str, Any]
    ambient: float
    room: float
    slides: bool
    inertia: float
    flywheel: float


def table_of(recording: Recording, motor: Mapping[str, Any]) -> MachineTable:
    """The rig of a recording."""
    ambient, flywheel = recording.ambient, recording.added_inertia_kg_m2
    return MachineTable(
        recording,
        motor,
        AMBIENT_PA if ambient.pressure_bar_abs is None else ambient.pressure_bar_abs * BAR,
        ROOM_K if ambient.temperature_c is None else ambient.temperature_c + ZERO_C,
        "mass_kg" in motor,
        float(motor.get("mass_kg") or motor.get("inertia_kg_m2") or 0.0) + flywheel,
        flywheel,
    )


def transients(recording: Recording, *columns: str) -> list[RecordingFile]:
    """Files of runs in time that have certain columns."""
    return [f for f in recording.files if f.kind == "transient" and set(columns) <= set(f.columns)]


def rows_used(file: RecordingFile, left: Mapping[str, np.ndarray]) -> FileUse:
    """What is used of a file, as an entry of ``files`` of diagnosis/1.

    `left`, shape (rows,): rows that are not used, by the reason.
    """
    not_used = int(np.sum(np.any([*left.values()], axis=0))) if left else 0
    return use_of(file, not_used, why_left(left))


def instrument(recording: Recording, channel: str, column: str) -> list[Unknown]:
    """Offset and scale of an instrument, where its recording declares that they may be off."""
    figures, known = recording.channels[column], NUMERIC[column]
    return off(channel, column, figures.bias_sd * known.to_si, known.si, figures.scale_sd)
