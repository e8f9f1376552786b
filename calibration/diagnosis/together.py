"""Several recordings of one motor, taken with the same instruments, as one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rig.recording import Recording, RecordingError, RecordingFile

GAP_S = 3600.0  # between two recordings on the common clock


def together(recordings: Sequence[Recording]) -> Recording:
    """One recording with the files of all; the instruments' offsets and scales are then shared by all of them.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order of their making.

    Raises
    ------
    RecordingError
        When they differ in motor, ambient, inertia or in an instrument's figures: what they share could not be said.
    """
    first = recordings[0]
    if len(recordings) == 1:
        return first
    files: list[RecordingFile] = []
    start = 0.0
    for one in recordings:
        for what, same in (
            ("motor", one.motor == first.motor),
            ("[ambient]", one.ambient == first.ambient),
            ("[rig] added_inertia_kg_m2", one.added_inertia_kg_m2 == first.added_inertia_kg_m2),
            ("[channels]", dict(one.channels) == dict(first.channels)),
        ):
            if not same:
                raise RecordingError(
                    f"{one.folder}: its {what} is not that of {first.folder}; recordings that are diagnosed together "
                    "share motor, ambient and instruments; diagnose them one by one (spinbench many diagnose)"
                )
        files += [
            replace(file, file=f"{one.folder.name}/{file.file}", start_s=start + file.start_s) for file in one.files
        ]
        start += max((_end(file) for file in one.files), default=0.0) + GAP_S
    return replace(first, files=tuple(files), sha256="")


def _end(file: RecordingFile) -> float:
    time = file.columns.get("time_s")
    return file.start_s + (float(time.values[-1]) if time is not None and time.values.size else float(file.rows))
