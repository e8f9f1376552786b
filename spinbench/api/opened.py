"""A run or a recording, opened from its folder: its readings, plateaus and events as tables."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

from spinbench import readings
from spinbench.api import frames

if TYPE_CHECKING:
    import pandas as pd

    from rig.exchange.export import Exported
    from rig.recording import Recording
    from rig.runlog import Run


@dataclass(frozen=True, eq=False)
class Opened:
    """What `open` found in a folder; a notebook shows the plateaus.

    Attributes
    ----------
    run : Run or None
        The run log, where the folder is a run's.
    """

    folder: Path
    run: Run | None

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.resolve().name

    @cached_property
    def _exported(self) -> Exported:
        from rig.exchange.export import Exported, recording_of
        from rig.recording import read_recording

        return Exported(read_recording(self.folder), []) if self.run is None else recording_of(self.run)

    @property
    def recording(self) -> Recording:
        """What `fit` and `diagnose` take of it: of a run its settled plateaus, zeros and captures.

        Raises
        ------
        RunError
            When the run is being written, was changed since it was sealed, or holds nothing that a recording could.
        """
        if self.run is not None:
            readings.refuse_changed(self.run.folder)
        return self._exported.recording

    @property
    def notes(self) -> list[str]:
        """What was left out or assumed on the way to `recording`, a sentence each."""
        return [*self._exported.notes, *self.recording.warnings]

    @cached_property
    def readings(self) -> dict[str, pd.DataFrame]:
        """What was read: of a run a table for each ``device.channel``, of a recording one for each file."""
        return self.files if self.run is None else frames.of_channels(self.run)

    @cached_property
    def files(self) -> dict[str, pd.DataFrame]:
        """The files of `recording`, a table each: ``sweep.csv``, ``coast_down.csv`` and so on."""
        return {file.file: frames.of_file(file) for file in self.recording.files}

    @cached_property
    def plateaus(self) -> pd.DataFrame:
        """Of a run every plateau that counts, settled or not; of a recording the rows of its steady files."""
        return frames.of_steady(self.recording.files) if self.run is None else frames.of_plateaus(self.run.plateaus)

    @cached_property
    def events(self) -> pd.DataFrame:
        """What happened in a run; no rows of a recording, which keeps no events."""
        return frames.of_events(self.run)

    def __repr__(self) -> str:
        return f"<{self._title()}>"

    def _title(self) -> str:
        if self.run is None:
            return f"recording {self.name}: {', '.join(self.files)}"
        simulated = ", simulated" if self.run.start.simulated else ""
        return f"run {self.name}: {self.run.start.kind}, {self.run.state}{simulated}"

    def _repr_html_(self) -> str:
        return frames.as_html(self._title(), [], self.plateaus)


def open(path: str | Path, logs: str | Path = "logs") -> Opened:
    """Open the folder of a run or of a recording.

    Parameters
    ----------
    path : str or Path
        The folder; or a run in `logs` by its name, the beginning of it, or ``last``; or ``published_sweep``.

    Raises
    ------
    RecordingError
        When there is no such folder, it is neither a run nor a recording, or the recording has mistakes.
    RunError
        When the run is damaged.
    TypeError
        For what is no path.
    """
    from rig.recording import RecordingError
    from rig.runlog import read_run
    from rig.runlog.folder import START

    for name, given in (("path", path), ("logs", logs)):
        if not isinstance(given, str | os.PathLike):
            raise TypeError(f"{name}: expected a folder, as text or a Path; given {given!r:.60}")
    try:
        folder = readings.folder_named(Path(path), Path(logs))
    except RecordingError as error:
        raise RecordingError(str(error).replace("--logs", "logs=...")) from error
    if folder.is_file():
        raise RecordingError(f"{folder}: a file; name the folder that it is in")
    if not folder.is_dir():
        raise RecordingError(f"{folder}: there is no such folder; name that of a recording or of a run")
    if (folder / START).exists():
        return Opened(folder, read_run(folder))
    if not (folder / "recording.toml").exists():
        raise RecordingError(
            f"{folder}: neither a recording (it has no recording.toml) nor a run (it has no {START}); name the folder "
            "that holds one of the two"
        )
    found = Opened(folder, None)
    readings.check_written_out(found.recording)  # its mistakes are told now
    return found


Data = Opened | str | Path  # or a Recording, which is not imported here


def opened_all(data: Data | Recording | Sequence[Data | Recording]) -> tuple[list[Recording], list[str]]:
    """The recordings that are given, by path or opened, one or several; and what is to be said of them.

    Raises
    ------
    RecordingError
        When one cannot be read, or stands twice.
    TypeError
        For what is no recording.
    """
    from rig.recording import Recording, RecordingError

    several = list(data) if isinstance(data, list | tuple) else [data]
    if not several:
        raise RecordingError("no recording is given; name one or more")
    found: list[Recording] = []
    notes: list[str] = []
    for one in several:
        given = open(one) if isinstance(one, str | Path) else one
        if not isinstance(given, Opened | Recording):
            raise TypeError(f"a {type(given).__name__} is no recording; give a path, what `open` gives, or a Recording")
        found.append(given.recording if isinstance(given, Opened) else given)
        readings.check_written_out(found[-1])
        notes += given.notes if isinstance(given, Opened) else given.warnings
    readings.refuse_twice(found)
    return found, list(dict.fromkeys(notes))


def said_of(parts: Sequence[Recording], notes: Sequence[str]) -> list[str]:
    """Notes on recordings, and what is to be said of them as they go together."""
    more = [words for words in readings.warnings_in(parts) if not any(words.endswith(note) for note in notes)]
    return [*notes, *more]


def without(
    data: Data | Recording | Sequence[Data | Recording], left_out: str | Sequence[str]
) -> Recording | list[Recording]:
    """Recordings without what is left out of them; every result says what was.

    Parameters
    ----------
    data : Opened, Recording, str, Path, or a list of these
        A path is opened as `open` does. Of a list comes a list.
    left_out : str or sequence of str
        ``FILE``, ``FILE:ROWS`` (``sweep.csv:3,7-9``, 1 the first under the header) or levels (``sweep.csv:2.0bar``). Of
        several recordings as ``NAME/FILE``.

    Raises
    ------
    RecordingError
        When there is no such file, row or level.
    TypeError
        For what is no recording, or no text.
    """
    from calibration.data import left_out as leaving

    asked = listed("left_out", left_out)
    with argument("left_out", "--without"):
        kept = leaving.without(opened_all(data)[0], asked)
    return kept if isinstance(data, list | tuple) else kept[0]


def at_least(name: str, given: int, least: int) -> int:
    """A whole number of an argument; ValueError below the least, TypeError for what is none. `name`: the argument's."""
    if not isinstance(given, Integral) or isinstance(given, bool):
        raise TypeError(f"{name}: expected a whole number; given {given!r:.60}")
    if given < least:
        raise ValueError(f"{name}: expected {least} or more; given {given}")
    return int(given)


def listed(name: str, given: str | Sequence[str]) -> list[str]:
    """One text or several, as a list; TypeError for anything else. `name`: the argument's."""
    several = [given] if isinstance(given, str) else list(given) if isinstance(given, Iterable) else [given]
    if not all(isinstance(one, str) for one in several):
        raise TypeError(f"{name}: expected a text, or a list of texts; given {given!r:.60}")
    return several


@contextmanager
def argument(name: str, option: str) -> Iterator[None]:
    """Has an error that speaks of an option of the command line speak of the argument instead."""
    from configs import ConfigError
    from rig.recording import RecordingError

    try:
        yield
    except (ConfigError, RecordingError) as error:
        if not str(error).startswith(f"{option} "):
            raise
        raise type(error)(f"{name}: {str(error).removeprefix(f'{option} ')}") from None
