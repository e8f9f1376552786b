"""What a person names, as a recording: a recording/1 folder, or a run by its name."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from spinbench import published

if TYPE_CHECKING:
    from rig.recording import Recording
    from rig.runlog import Run


def run_named(name: str, logs: Path) -> Run:
    """A run, by its folder, its name, the beginning of one, or `last`."""
    from rig.runlog import read_run
    from rig.runlog.listing import find_run

    return read_run(find_run(name, logs))


def folder_named(named: Path, logs: Path) -> Path:
    """A recording's folder; what is no path that exists may be a run, by its name, the beginning of one, or `last`.

    The sweep that comes with the program has its name too, where nothing else is called so.
    """
    from rig.recording import RecordingError
    from rig.runlog.folder import RunError
    from rig.runlog.listing import find_run

    if named.exists() or len(named.parts) != 1:
        return named
    try:
        return find_run(named, logs)
    except RunError as error:
        if named == Path(published.NAME):
            return published.published_sweep()
        raise RecordingError(f"there is no folder '{named}', and {error}") from error


def is_recording(folder: Path) -> bool:
    """Whether a folder is a recording or a run."""
    from rig.runlog.folder import START

    return (folder / "recording.toml").is_file() or (folder / START).is_file()


def read(path: Path) -> Recording:
    """A recording: a recording/1 folder, or what a run's plateaus and captures amount to, with remarks on it."""
    from rig.recording import read_recording
    from rig.runlog.folder import START

    if not (path / START).exists():
        return read_recording(path)
    from rig.exchange.export import recording_of
    from rig.runlog import read_run

    exported = recording_of(read_run(path))
    for words in exported.notes:
        print(f"spinbench: {words}", file=sys.stderr)
    return exported.recording


def so_far(folder: Path) -> Recording:
    """The plateaus of a run that is being written; the check beside a sweep calls it in its own process."""
    from rig.exchange.export import recording_of
    from rig.runlog import read_run

    return recording_of(replace(read_run(folder), state="so far")).recording  # an export is of what has ended
