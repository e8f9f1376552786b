"""Rows, pressure levels and files that the user leaves out of a recording: they are told of, and count nowhere."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calibration.data.joined import names_of
from rig.recording import Column, Recording, RecordingError, RecordingFile
from rig.recording.columns import MEASURED, PRESSURE

_ROWS = re.compile(r"(\d+)(?:-(\d+))?")
_LEVELS = re.compile(r"(\d+(?:\.\d+)?)(?:-(\d+(?:\.\d+)?))? ?bar")
ROUNDED = 1e-9  # bar, by which a reading may miss half a digit


def without(recordings: Sequence[Recording], left_out: Sequence[str]) -> list[Recording]:
    """Recordings without what is left out of them.

    `left_out`: ``FILE`` or ``FILE:ROWS``, rows as in ``3``, ``3-7`` or ``2,5-6``, 1 the first under the header, or by
        pressure levels, as in ``2.0bar`` or ``1.2-1.4bar``. Of several recordings a file's name has the recording's
        ahead, ``NAME/FILE``.
    Raises RecordingError when there is no such file, row or level, or rows of a run in time are named.
    """
    found = list(recordings)
    for asked in left_out:
        k, file, rows = _place(found, asked)
        kept = found[k]
        if rows is None:
            files = tuple(one for one in kept.files if one is not file)
        else:
            files = tuple(_blank(one, rows) if one is file else one for one in kept.files)
        if not any(_is_left(one) for one in files):
            raise RecordingError(f"--without {asked}: nothing of {kept.folder} is left")
        digest = hashlib.sha256(f"{kept.sha256} without {asked}".encode()).hexdigest() if kept.sha256 else ""
        said = f"{asked}: left out, as asked"
        channels = {name: one for name, one in kept.channels.items() if any(name in file.columns for file in files)}
        own = asked.removeprefix(f"{names_of(found)[k]}/") if len(found) > 1 else asked
        told = replace(kept, without=(*kept.without, asked), warnings=(*kept.warnings, said))
        told = replace(told, left_out=(*kept.left_out, own), read_sha256=kept.read_sha256 or kept.sha256)
        found[k] = replace(told, channels=channels, files=files, sha256=digest)
    return found


def _is_left(file: RecordingFile) -> bool:
    """Whether something of a file is still read."""
    return len(set(file.left_out)) < file.rows


def _place(recordings: Sequence[Recording], asked: str) -> tuple[int, RecordingFile, list[int] | None]:
    """The recording, the file, and the rows of it, none for all of it."""
    names = names_of(recordings)
    there = {
        (f"{name}/{file.file}" if len(recordings) > 1 else file.file): (k, file)
        for k, (name, one) in enumerate(zip(names, recordings, strict=True))
        for file in one.files
    }
    name, colon, rows = asked.rpartition(":")
    if asked in there:
        return (*there[asked], None)
    if not colon or name not in there:
        raise RecordingError(f"--without {asked}: there is no such file; there are {', '.join(there)}")
    k, file = there[name]
    if file.kind == "transient":
        raise RecordingError(
            f"--without {asked}: a speed of a run in time is the mean since the one before, so single rows of it "
            "cannot be left out; name the file alone"
        )
    return k, file, sorted(set(_numbers(asked, rows, file)))


def _numbers(asked: str, rows: str, file: RecordingFile) -> Iterator[int]:
    most = file.rows
    for part in rows.split(","):
        if level := _LEVELS.fullmatch(part.strip()):
            yield from _at_level(asked, level[1], level[2] or level[1], file)
            continue
        match = _ROWS.fullmatch(part.strip())
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
        if not 1 <= first <= last <= most:
            raise RecordingError(
                f"--without {asked}: '{part}' is no row of it; name rows as 3, 3-7 or 2,5-6, from 1 to {most}, "
                "or levels as 2.0bar or 1.2-1.4bar"
            )
        yield from range(first, last + 1)


def _at_level(asked: str, lowest: str, highest: str, file: RecordingFile) -> list[int]:
    """The rows whose pressure, as the file has it, is within the levels when rounded to the digits that are written."""
    name = next((name for name in file.columns if name in PRESSURE), None)
    if name is None:
        raise RecordingError(f"--without {asked}: {file.file} has no pressure; name its rows by their numbers")
    read = file.columns[name].values
    half = [0.5 * 10.0 ** -len(text.partition(".")[2]) + ROUNDED for text in (lowest, highest)]
    rows: list[int] = (
        np.flatnonzero((read >= float(lowest) - half[0]) & (read <= float(highest) + half[1])) + 1
    ).tolist()
    if not rows:
        span = f"{np.nanmin(read):g} to {np.nanmax(read):g} bar" if np.isfinite(read).any() else "nothing"
        raise RecordingError(f"--without {asked}: no row is at that level; {name} reads {span}")
    return rows


def _blank(file: RecordingFile, rows: Sequence[int]) -> RecordingFile:
    """A file with nothing read in some rows; the others keep their numbers."""
    at = np.array(rows) - 1

    def blank(column: Column) -> Column:
        values, censor = column.values.copy(), column.censor.copy()
        values[at], censor[at] = np.nan, 0
        return Column(values, censor)

    columns = {name: blank(one) if name in MEASURED else one for name, one in file.columns.items()}
    return replace(file, columns=columns, left_out=(*file.left_out, *rows))
