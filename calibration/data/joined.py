"""Several recordings of one motor, taken with the same instruments, as one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.data.dates import day_of, moment_of
from calibration.data.together import refuse_unlike
from rig.recording import Recording, RecordingError, RecordingFile

GAP_S = 3600.0  # between two recordings on the common clock
NO_MOMENT = "no [origin] dates with a time of day, all with a zone or all without, tell it"


def together(recordings: Sequence[Recording]) -> Recording:
    """One recording with the files of all; the instruments' offsets and scales are then shared by all of them.

    Raises RecordingError when they differ in motor, ambient, inertia or in an instrument's figures: what they share
    could not be said; and where there is none. Raises TypeError for what is no Recording.
    """
    for one in recordings:
        if not isinstance(one, Recording):
            raise TypeError(f"a {type(one).__name__} is no recording; give what `read_recording` gives")
    if not recordings:
        raise RecordingError("no recording is given; name one or more")
    first = recordings[0]
    if len(recordings) == 1:
        return first
    files: list[RecordingFile] = []
    warnings: list[str] = []
    names = names_of(recordings)
    starts, lacking = _starts(recordings)
    for number, one in enumerate(recordings, start=1):
        for what, same in (
            ("motor", one.motor == first.motor),
            ("[ambient]", one.ambient == first.ambient),
            ("[rig] added_inertia_kg_m2", one.added_inertia_kg_m2 == first.added_inertia_kg_m2),
            ("[channels]", dict(one.channels) == dict(first.channels)),
            ("[supply]", one.supply == first.supply),
            ("day, from which on instruments drift,", day_of(one) == day_of(first) or not _drifts(one)),
        ):
            if not same:
                raise RecordingError(
                    f"{one.folder}: its {what} is not that of {first.folder}; recordings that are diagnosed together "
                    "share motor, ambient, instruments and supply; diagnose them one by one (spinbench many diagnose)"
                )
        name, start = names[number - 1], starts[number - 1]
        files += [replace(file, file=f"{name}/{file.file}", start_s=start + file.start_s) for file in one.files]
        warnings += [f"{name}: {words}" for words in one.warnings]
        if number > 1 and lacking:
            warnings.append(f"{name}: its time 0 is taken for {start:.0f} s on the clock of all: {lacking}")
    if first.ambient.pressure_bar_abs is None and len({day_of(one) for one in recordings}) > 1:
        warnings.append("no recording states the room's pressure, which is taken for the same in all of them")
    folders = dict.fromkeys(folder for one in recordings for folder in one.folders)
    return replace(
        first,
        files=tuple(files),
        sha256=" and ".join(one.sha256 for one in recordings) if all(one.sha256 for one in recordings) else "",
        origin=_origins(recordings),
        joined=tuple(folders),
        without=tuple(dict.fromkeys(asked for one in recordings for asked in one.without)),
        left_out=(),
        read_sha256="",
        warnings=tuple(warnings),
    )


def _starts(recordings: Sequence[Recording]) -> tuple[list[float], str]:
    """Where each recording's time 0 stands on the common clock [s], and what their dates lack to tell it.

    Where they do not tell it, each begins an hour after the one before.
    """
    moments = [moment_of(one) for one in recordings]
    known = [one for one in moments if one is not None]
    ends = [max((_end(file) for file in one.files), default=0.0) for one in recordings]
    is_known = len(known) == len(recordings) and len({one.tzinfo is None for one in known}) == 1
    if is_known:
        starts = [(one - known[0]).total_seconds() for one in known]
        if all(one + end <= after for one, end, after in zip(starts, ends, starts[1:], strict=False)):
            return starts, ""
    lacking = "by their dates they do not follow each other" if is_known else NO_MOMENT
    return np.cumsum([0.0, *(end + GAP_S for end in ends[:-1])]).tolist(), lacking


def _drifts(recording: Recording) -> bool:
    return any(figures.drift_sd > 0.0 for figures in recording.channels.values())


def _origins(recordings: Sequence[Recording]) -> dict[str, str]:
    """Where recordings come from: of each key, what they say, each once."""
    keys = dict.fromkeys(key for one in recordings for key in one.origin)
    return {key: "; ".join(dict.fromkeys(one.origin[key] for one in recordings if key in one.origin)) for key in keys}


def without_runs(recording: Recording) -> Recording:
    """A recording without its runs in time."""
    return replace(recording, files=tuple(file for file in recording.files if file.kind != "transient"))


def can_be_one(recordings: Sequence[Recording]) -> bool:
    """Whether recordings share motor, ambient, inertia and instruments, so that they are one."""
    try:
        together(recordings)
    except RecordingError:
        return False
    return True


def by_flywheel(recording: Recording) -> list[Recording]:
    """A recording as one for each flywheel that its files had on the shaft; usually it is one.

    Zero rows go with the first: no rotor turns in them.
    """
    added = list(dict.fromkeys(file.added_inertia_kg_m2 for file in recording.files if file.kind != "zero")) or [0.0]
    return [
        replace(
            recording,
            files=tuple(
                replace(file, added_inertia_kg_m2=0.0)
                for file in recording.files
                if (added[0] if file.kind == "zero" else file.added_inertia_kg_m2) == one
            ),
            added_inertia_kg_m2=recording.added_inertia_kg_m2 + one,
        )
        for one in added
    ]


def flywheel_of_plateaus(recording: Recording) -> float:
    """Inertia on the shaft while the plateaus were read [kg m2].

    Raises RecordingError when it was not the same at all of them.
    """
    parts = [one for one in by_flywheel(recording) if any(file.kind == "steady" for file in one.files)]
    if len(parts) > 1:
        raise RecordingError(
            f"{recording.folder}: plateaus were read with flywheels of "
            f"{' and '.join(f'{one.added_inertia_kg_m2:g}' for one in parts)} kg m2, and a fit to plateaus alone takes "
            "one; leave out --steady-only, or the others by --without FILE"
        )
    return parts[0].added_inertia_kg_m2 if parts else recording.added_inertia_kg_m2


def as_given(recordings: Sequence[Recording], apart: bool = False) -> list[Recording]:
    """Recordings that are diagnosed or fitted together: one wherever they can be one, unless they are to stay apart.

    Raises RecordingError when they cannot go together.
    """
    refuse_unlike(recordings)
    parts = [part for one in recordings for part in by_flywheel(one)]
    return [together(parts)] if not apart and can_be_one(parts) else parts


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """What recordings are called: by their folders, with the flywheel or a number where two have one name."""
    names = [one.folder.resolve().name for one in recordings]
    if len({one.folder for one in recordings}) < len(recordings):
        names = [f"{one.folder.resolve().name} with {one.added_inertia_kg_m2:g} kg m2" for one in recordings]
    found = [name if names.count(name) == 1 else f"{name} ({i})" for i, name in enumerate(names, start=1)]
    if len(set(found)) < len(found):  # a folder may be called "a (1)"
        found = [f"{name} ({i})" for i, name in enumerate(names, start=1)]
    return found


def _end(file: RecordingFile) -> float:
    time = file.columns.get("time_s")
    known = time.values[np.isfinite(time.values)] if time is not None else np.empty(0)
    return file.start_s + max(known.tolist(), default=0.0)
