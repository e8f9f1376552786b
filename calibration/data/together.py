"""Recordings that cannot be taken together: of different motors, or read by one instrument in two places at once."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from calibration.data.clock import times_of
from calibration.data.dates import moment_of
from model.motor import read_motor
from rig.recording import Recording, RecordingError
from rig.recording.mistakes import shown


def refuse_unlike(recordings: Sequence[Recording]) -> None:
    """Refuse recordings of different motors, and a serial number that is of two instruments or in two places at once.

    Raises RecordingError: with both folders.
    """
    pairs = list(itertools.combinations(recordings, 2))
    for one, other in pairs:
        refuse_another(one, other)
    _refuse_unlike_serials(recordings)
    for one, other in pairs:
        _refuse_unlike_figures(one, other)
        if one.folder != other.folder:
            _refuse_at_once(one, other)


def _refuse_unlike_serials(recordings: Sequence[Recording]) -> None:
    """Refuse a serial number where what it measures in one has nothing in common with what it measures in another."""
    seen: dict[str, tuple[Recording, set[str]]] = {}
    for one in recordings:
        mine: dict[str, set[str]] = {}
        for column, figures in one.channels.items():
            if figures.serial:
                mine.setdefault(figures.serial, set()).add(column)
        for serial, columns in mine.items():
            other, theirs = seen.setdefault(serial, (one, columns))
            if not columns & theirs:
                raise RecordingError(
                    f"{one.folder}: serial {shown(serial)} is of the instrument of {', '.join(sorted(columns))}, but "
                    f"of {', '.join(sorted(theirs))} in {other.folder}; put right [channels.*] serial in one of them"
                )


def _refuse_unlike_figures(one: Recording, other: Recording) -> None:
    """Refuse an instrument that would have two offsets or two scales with one serial number and calibration."""
    for column in (column for column in one.channels if column in other.channels):
        mine, its = one.channels[column], other.channels[column]
        if not mine.serial or (mine.serial, mine.calibrated) != (its.serial, its.calibrated):
            continue
        for key in ("bias_sd", "scale_sd"):
            if getattr(mine, key) != getattr(its, key):
                raise RecordingError(
                    f"{other.folder}: [channels.{column}] {key} is {getattr(its, key):g}, but {getattr(mine, key):g} "
                    f"in {one.folder}, and serial {shown(mine.serial)} has one with one calibration; put right {key}, "
                    "serial or calibrated in one of them"
                )


def _refuse_at_once(one: Recording, other: Recording) -> None:
    """Refuse recordings that an instrument of one serial number would have taken at the same time."""
    spans = [span for span in (_span(one), _span(other)) if span is not None]
    by = [
        f"{column}, serial {shown(figures.serial)}"
        for column, figures in one.channels.items()
        if figures.serial and column in other.channels and other.channels[column].serial == figures.serial
    ]
    if len(spans) < 2 or not by or len({begin.tzinfo is None for begin, _ in spans}) > 1:
        return
    overlap = min(end for _, end in spans) - max(begin for begin, _ in spans)
    if overlap > timedelta(0):
        raise RecordingError(
            f"{other.folder} and {one.folder} overlap by {overlap.total_seconds():.6g} s by [origin] date and their "
            f"times, and one instrument ({by[0]}) cannot have read both; put right date or serial in one of them"
        )


def _span(recording: Recording) -> tuple[datetime, datetime] | None:
    """When a recording was taken; None where its date says no time of day, or no row has a time."""
    clock = moment_of(recording)
    times = np.concatenate([np.empty(0), *(times_of(file) for file in recording.files)])
    times = times[np.isfinite(times)]
    if not times.size or clock is None:
        return None
    try:
        return clock + timedelta(seconds=float(times.min())), clock + timedelta(seconds=float(times.max()))
    except OverflowError:
        return None


def refuse_another(seen: Recording, unseen: Recording) -> None:
    """Refuse a run of another machine, of which nothing can be predicted.

    `seen`, `unseen`: the recording that is diagnosed, and the run held out.
    Raises RecordingError when their machines differ, and in what.
    """
    one, other = _machine(seen), _machine(unseen)
    if one == other and (key := _differs_in(seen, unseen)):
        raise RecordingError(
            f"{unseen.folder}: its motor is called as that of {seen.folder}, and is another: {key}; give one of them "
            "another name"
        )
    serials = [recording.origin.get("motor_serial", "") for recording in (seen, unseen)]
    if one == other and all(serials):
        one, other = (f"{machine} no. {shown(serial)}" for machine, serial in zip((one, other), serials, strict=True))
    if one != other:
        raise RecordingError(f"{unseen.folder}: of {other}, not of {one}")


def _differs_in(one: Recording, other: Recording) -> str:
    """The first figure in which two radial piston motors of one name differ, in words; empty where none does."""
    if one.motor == other.motor or not (one.is_of_radial_piston and other.is_of_radial_piston):
        return ""
    mine, its = (dict(_figures(read_motor(each.motor).model_dump())) for each in (one, other))
    return next((f"{key} is {its[key]}, not {mine[key]}" for key in mine if its[key] != mine[key]), "")


def motor_of(recording: Recording) -> tuple[str, str]:
    """The machine of a recording in words, and the SHA-256 of a radial piston motor's figures; empty of another."""
    if not recording.is_of_radial_piston:
        return _machine(recording), ""
    figures = dict(_figures(read_motor(recording.motor).model_dump()))
    return _machine(recording), hashlib.sha256(json.dumps(figures, sort_keys=True).encode()).hexdigest()


def _figures(table: Mapping[str, Any], ahead: str = "") -> Iterator[tuple[str, object]]:
    """The entries of nested tables, but the texts that only describe."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _figures(value, f"{ahead}{key}.")
        elif key not in ("description", "source"):
            yield f"{ahead}{key}", value


def _machine(recording: Recording) -> str:
    """What a recording is of, in words."""
    motor = recording.motor
    if isinstance(motor, str):
        return f"the motor {motor}"
    if recording.is_of_radial_piston:
        return f"the motor {motor.get('name')}"
    return f"a {motor.get('kind')}{' that slides' if 'mass_kg' in motor else ''}"
