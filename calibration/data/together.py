"""Recordings that cannot be taken together: of different motors, or read by one instrument in two places at once."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from calibration.data.clock import times_of
from rig.recording import Recording, RecordingError


def refuse_unlike(recordings: Sequence[Recording]) -> None:
    """Refuse recordings of different motors, and a serial number that is of two instruments, or in two places at once.

    Raises RecordingError: with both folders.
    """
    for one in recordings[1:]:
        refuse_another(recordings[0], one)
    _refuse_unlike_serials(recordings)
    for one, other in itertools.combinations(recordings, 2):
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
                    f"{one.folder}: serial {serial} is of the instrument of {', '.join(sorted(columns))}, but of "
                    f"{', '.join(sorted(theirs))} in {other.folder}; put right [channels.*] serial in one of them"
                )


def _refuse_at_once(one: Recording, other: Recording) -> None:
    """Refuse recordings that an instrument of one serial number would have taken at the same time."""
    spans = [span for span in (_span(one), _span(other)) if span is not None]
    by = [
        f"{column}, serial {figures.serial}"
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
    text = recording.origin.get("date", "")
    times = np.concatenate([np.empty(0), *(times_of(file) for file in recording.files)])
    times = times[np.isfinite(times)]
    if not times.size or len(text) <= len("2026-05-28"):
        return None
    try:
        clock = datetime.fromisoformat(text)
        return clock + timedelta(seconds=float(times.min())), clock + timedelta(seconds=float(times.max()))
    except (ValueError, OverflowError):
        return None


def refuse_another(seen: Recording, unseen: Recording) -> None:
    """Refuse a run of another machine, of which nothing can be predicted.

    `seen`, `unseen`: the recording that is diagnosed, and the run held out.
    Raises RecordingError when their machines differ.
    """
    one, other = _machine(seen), _machine(unseen)
    serials = [recording.origin.get("motor_serial", "") for recording in (seen, unseen)]
    if one == other and all(serials):
        one, other = (f"{machine} no. {serial}" for machine, serial in zip((one, other), serials, strict=True))
    if one != other:
        raise RecordingError(f"{unseen.folder}: of {other}, not of {one}")


def _machine(recording: Recording) -> str:
    """What a recording is of, in words."""
    motor = recording.motor
    if isinstance(motor, str):
        return f"the motor {motor}"
    if recording.is_of_radial_piston:
        return f"the motor {motor.get('name')}"
    return f"a {motor.get('kind')}{' that slides' if 'mass_kg' in motor else ''}"
