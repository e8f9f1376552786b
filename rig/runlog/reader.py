"""A run as it stands on disk: sealed, killed, or being written at this moment. Reading changes nothing.

The samples are read at once, the wire line by line. A torn last line is left out and named; anything else that is no
run/1 is refused with file and line.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rig.readings import Exchange, Reading
from rig.runlog import plateaus, rows
from rig.runlog.folder import (
    APPENDED,
    END,
    EVENTS,
    MAX_RECORD_BYTES,
    PLATEAUS,
    SAMPLES,
    START,
    WIRE,
    RunError,
    is_locked,
    read_bytes,
)
from rig.runlog.lines import torn_bytes, whole_lines
from rig.runlog.plateaus import PlateauRow
from rig.runlog.samples import read_samples, reading_of
from rig.runlog.schema import EndRecord, EventLine, StartRecord, WireLine, ending, parse

if TYPE_CHECKING:
    import pandas as pd

MAX_EVENTS = 1_000_000
BEING_WRITTEN, KILLED = "being written", "killed"  # states of a run without an end record; else its outcome


@dataclass(frozen=True, eq=False)
class Run:
    """One run.

    `end`: None when the run was killed, or is being written.
    `samples`: a row a reading: those of samples.csv, with ``time_ns``, ``request_ns`` and ``reply_ns`` as integers [ns]
        and ``time_s`` [s] beside them; ``value`` is NaN where there is none.
    `plateau_rows`: every row of the file, with those that were replaced or taken back.
    `torn`: files that end in a torn line, with the bytes that were left out [bytes].
    """

    folder: Path
    start: StartRecord
    end: EndRecord | None
    state: str
    samples: pd.DataFrame
    events: list[EventLine]
    plateaus: list[PlateauRow]
    plateau_rows: list[PlateauRow]
    torn: dict[str, int]

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    @property
    def sealed(self) -> bool:
        """Whether there is an end record."""
        return self.end is not None

    @property
    def has_wire(self) -> bool:
        """Whether the bytes on the wire were kept."""
        return (self.folder / WIRE).exists()

    @property
    def exchange_count(self) -> int:
        """Exchanges that the samples belong to [-]; those at the end without a reading are not counted."""
        return int(self.samples["exchange"].iloc[-1]) if len(self.samples) else 0

    @cached_property
    def _first_rows(self) -> NDArray[np.intp]:
        """Where each exchange's rows begin; one entry more than there are exchanges."""
        return np.searchsorted(self.samples["exchange"].to_numpy(), np.arange(1, self.exchange_count + 2))

    @cached_property
    def _cells(self) -> dict[str, NDArray[Any]]:
        """The columns as arrays: taking single rows out of a table is slow."""
        return {str(name): self.samples[name].to_numpy() for name in self.samples}

    def readings_of(self, exchange: int) -> tuple[Reading, ...]:
        """The readings of an exchange, bit for bit as they were written."""
        if not 1 <= exchange < len(self._first_rows):
            return ()
        first, last = self._first_rows[exchange - 1 : exchange + 1]
        return tuple(reading_of(self._cells, row) for row in range(first, last))

    def wire_lines(self) -> Iterator[WireLine]:
        """The lines of wire.jsonl. Raises RunError: file, line and what is wrong."""
        return wire_lines(self.folder / WIRE)

    def exchanges(self) -> Iterator[tuple[int, Exchange]]:
        """Every exchange with its number, its bytes and its readings, in the order of the log.

        Raises RunError: file, line and what is wrong.
        """
        for line in self.wire_lines():
            try:
                yield line.n, rows.exchange_of(line, self.readings_of(line.n))
            except ValueError:
                raise RunError(f"{self.folder / WIRE}, line {line.n}: its bytes are not hexadecimal") from None


def read_run(folder: Path) -> Run:
    """Read a run, whatever state it is in.

    Raises RunError when the folder holds no run/1, or a file of it is damaged beyond a torn last line.
    """
    folder = Path(folder)
    head = read_head(folder)
    samples = read_samples(folder / SAMPLES)
    events = list(read_events(folder / EVENTS))
    plateau_rows = plateaus.read(folder / PLATEAUS)
    in_use = plateaus.in_use(plateau_rows)
    return Run(folder, head.start, head.end, head.state, samples, events, in_use, plateau_rows, head.torn)


@dataclass(frozen=True)
class Head:
    """What is known of a run without its lines, as `Run` has it."""

    start: StartRecord
    end: EndRecord | None
    state: str
    torn: dict[str, int]


def read_head(folder: Path) -> Head:
    """The records of a run, how it stands, and which of its files end in a torn line.

    Raises RunError when the folder holds no run/1, or its samples are gone.
    """
    start = read_start(folder)
    # Asked before the files are looked at: a run that ends meanwhile is "being written", not torn and "killed".
    locked = is_locked(folder)
    end = read_end(folder)
    if end is not None and SAMPLES in end.sha256 and not (folder / SAMPLES).exists():
        raise RunError(f"{folder / SAMPLES}: missing; the end record has the hash of what was there")
    torn = {}
    for name in APPENDED:
        path = folder / name
        if (path.exists() or path.is_symlink()) and (dropped := torn_bytes(path)):
            torn[name] = dropped
    return Head(start, end, state_of(end, locked), torn)


def state_of(end: EndRecord | None, locked: bool) -> str:
    """How a run stands, in words that are shown."""
    return ending(end.outcome, end.stopped_by) if end is not None else BEING_WRITTEN if locked else KILLED


def read_start(folder: Path) -> StartRecord:
    """The start record of a run; RunError when the folder holds none."""
    if folder.is_symlink():
        raise RunError(f"{folder}: a symbolic link, which is refused; name the folder itself")
    if not folder.is_dir():
        raise RunError(f"{folder}: no such folder; `spinbench runs` lists the runs there are")
    path = folder / START
    if not path.exists() and not path.is_symlink():
        raise RunError(f"{folder}: holds no {START}, so it is no run (or one that never began)")
    return parse(StartRecord, read_bytes(path, MAX_RECORD_BYTES), str(path))


def read_end(folder: Path) -> EndRecord | None:
    """The end record of a run; None when there is none."""
    path = folder / END
    if not path.exists() and not path.is_symlink():
        return None
    return parse(EndRecord, read_bytes(path, MAX_RECORD_BYTES), str(path))


def event_of(data: bytes, number: int, path: Path) -> EventLine:
    """The event of a line of events.jsonl, which is the `number`-th.

    Raises RunError: file, line and what is wrong.
    """
    if number > MAX_EVENTS:
        raise RunError(f"{path}: more than {MAX_EVENTS} events; this is no run of spinbench")
    event = parse(EventLine, data, f"{path}, line {number}")
    if event.n != number:
        raise RunError(f"{path}, line {number}: its number is {event.n}; lines are missing or not in order")
    return event


def read_events(path: Path) -> Iterator[EventLine]:
    """The events of a run. `path`: events.jsonl; a missing one has none."""
    for number, data in whole_lines(path):
        yield event_of(data, number, path)


def wire_lines(path: Path) -> Iterator[WireLine]:
    """The lines of wire.jsonl. Raises RunError: file, line and what is wrong."""
    for number, data in whole_lines(path):
        line = parse(WireLine, data, f"{path}, line {number}")
        if line.n != number:
            raise RunError(f"{path}, line {number}: its number is {line.n}; lines are missing or not in order")
        yield line
