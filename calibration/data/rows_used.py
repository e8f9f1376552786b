"""How many rows of each file of a recording were used, and why not the rest: by a fit, and by a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from calibration.data.runs_in_time import turns
from rig.recording import Recording, RecordingFile
from rig.recording.columns import pressure_in

if TYPE_CHECKING:
    from calibration.data.blocks import Blocks
    from calibration.data.measurement import Measurement, Rows

FEW_ROWS = 0.9  # a share of a file's rows that are used, below which it is told
MOST_FILES = 6  # that are told one by one
NOT_IN_A_FIT = "runs in time do not enter a fit to the plateaus alone"
NEVER_TURNS = "the rotor did not break away: it stands though the supply is open, and has not made a whole turn"
OUTSIDE = "outside the part of the run that is compared, or without a speed"
HELD = "the rotor is held"
NOTHING_READ = "no pressure, or neither a flow nor a turning speed on the instrument's scale"
NOTHING_AT_ZERO = "nothing was read"
LEFT_OUT = "left out by --without"


class FileUse(TypedDict):
    """How many rows of a file are used, and why not the rest: an entry of `files`."""

    file: str
    rows: int
    rows_used: int
    why: str


def by_fit(recording: Recording, measured: Measurement) -> list[FileUse]:
    """Of a fit, as `files` of posterior/1."""
    return _files(recording, _numbers(measured.steady, measured.zero), NOT_IN_A_FIT)


def by_diagnosis(recording: Recording, blocks: Blocks) -> list[FileUse]:
    """Of a diagnosis, as `files` of diagnosis/1."""
    used = _numbers(blocks.measured.zero)
    plateaus = blocks.plateaus
    known = np.isfinite(plateaus.flow) | np.isfinite(plateaus.speed)
    for i in np.flatnonzero(known):
        used.setdefault(plateaus.file[i], set()).add(int(plateaus.row[i]))
    for run in blocks.runs:
        first, last = np.flatnonzero(run.used)[[0, -1]]
        used[run.file] = set(range(int(run.row[first - 1]) + 1 if first else 1, int(run.row[last]) + 1))
    for file in recording.files:
        if file.kind == "steady" and file.file in blocks.standing.file:
            flow = file.columns["flow_l_min"]
            there = _held(file) & _has_pressure(file) & np.isfinite(flow.values) & (flow.censor == 0)
            used.setdefault(file.file, set()).update((np.flatnonzero(there) + 1).tolist())
    return _files(recording, used, OUTSIDE)


def use_of(file: RecordingFile, not_used: int, why: str) -> FileUse:
    """What is used of a file. `not_used`: rows of it that are not [-]."""
    return {"file": file.file, "rows": file.rows, "rows_used": file.rows - not_used, "why": why}


def few_used(files: Sequence[FileUse]) -> list[str]:
    """A warning for each file of which less than nine tenths of the rows are used."""
    return [
        f"{_of(one)} are used; not used: {one['why']}" for one in files if one["rows_used"] < FEW_ROWS * one["rows"]
    ]


def in_words(files: Sequence[FileUse]) -> str:
    """What a fit or a diagnosis rests on, by its `files`."""
    said = [_of(one) for one in files if one["rows_used"]]
    rest = len(said) - MOST_FILES
    return f"{'; '.join(said[:MOST_FILES])}{f'; and {rest} files more' if rest > 0 else ''}"


def in_words_of(recordings: Sequence[Recording], files: Sequence[FileUse]) -> str:
    """The same, with what the recordings of a motor have no reading of."""
    columns = {name for one in recordings for file in one.files for name in file.columns}
    lacks = [what for what, name in (("speed", "speed_rpm"), ("flow", "flow_l_min")) if name not in columns]
    return f"{in_words(files)}{f'. No {lacks[0]} was read' if lacks else ''}"


def _of(one: FileUse) -> str:
    return f"{one['file']}: {one['rows_used']} of {one['rows']} rows"


def _files(recording: Recording, used: Mapping[str, set[int]], in_time: str) -> list[FileUse]:
    """An entry a file; ``used`` has the numbers of the rows used by file, ``in_time`` why not the rest of a run."""
    found = []
    for file in recording.files:
        mine = used.get(file.file, set())
        left = np.array(sorted(set(range(1, file.rows + 1)) - mine), dtype=int) - 1
        found.append(use_of(file, left.size, _why(recording, file, left, in_time) if left.size else ""))
    return found


def _why(recording: Recording, file: RecordingFile, left: np.ndarray, in_time: str) -> str:
    if file.kind == "transient":
        return in_time if turns(recording, file) else NEVER_TURNS
    asked = np.isin(left + 1, file.left_out)
    if file.kind == "zero":
        return LEFT_OUT if asked.any() else NOTHING_AT_ZERO
    held = int(_held(file)[left[~asked]].sum())
    reasons = {LEFT_OUT: int(asked.sum()), HELD: held, NOTHING_READ: left.size - int(asked.sum()) - held}
    return "; ".join(f"{_rows(count)}: {words}" for words, count in reasons.items() if count)


def _held(file: RecordingFile) -> np.ndarray:
    locked = file.columns.get("rotor_locked")
    return np.zeros(file.rows, dtype=bool) if locked is None else locked.values > 0.5


def _has_pressure(file: RecordingFile) -> np.ndarray:
    read = file.columns[pressure_in(file.columns)[0]]
    return np.isfinite(read.values) & (read.censor == 0)


def _numbers(*parts: Rows) -> dict[str, set[int]]:
    """The numbers of rows by file."""
    found: dict[str, set[int]] = {}
    for rows in parts:
        for file, row in zip(rows.file, rows.row, strict=True):
            found.setdefault(file, set()).add(int(row))
    return found


def _rows(count: int) -> str:
    return f"{count} row{'s' * (count != 1)}"
