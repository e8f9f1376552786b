"""What a reader of a binary file answers: columns of one length, each cell a number or text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rig.recording.mistakes import shown
from rig.runlog.folder import RunError

MAX_BYTES = 500_000_000  # of a file
MAX_SERIES = 4096
MAX_ROWS = 20_000_000
FEW = 60  # cells that a listing shows
WAVEFORM_TIME = "@time"  # the time track of channels that have clocks
# Of TDMS.
OF_A_RUN = "of a run's export one channel at a time: to import several, export it as .parquet, .h5 or .mf4"
Cells = list[str] | list[float]
Wanted = Sequence[str | int]


@dataclass(frozen=True)
class Columns:
    """Columns of one length.

    `clocks` says what there was where they come from several clocks; empty otherwise. `units`, by heading, are as the
    file states them. `remarks` are to be told to a person.
    """

    place: str
    headings: list[str]
    columns: list[Cells]
    clocks: str = ""
    units: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Listed:
    """One channel of a file: its group, its name, its unit as stated, its first cells, and whether it has a clock."""

    group: str
    name: str
    unit: str
    count: int
    cells: Cells
    clocked: bool


def by_name(wanted: Wanted) -> bool:
    """Whether the columns that are taken are all given by their headings."""
    return bool(wanted) and all(isinstance(key, str) for key in wanted)


def refuse_unknown(place: str, wanted: Wanted, names: Sequence[str]) -> None:
    """Refuse a heading that is none of the file's, with all that it has. `names`: of every column there."""
    for key in wanted:
        if isinstance(key, str) and key not in (*names, WAVEFORM_TIME):
            raise RunError(f"{place}: {no_column(key, names)}")


def no_column(key: str, names: Sequence[str]) -> str:
    """In words, that a heading is not there, and which are."""
    listed = ", ".join(f"'{shown(name)}'" for name in names[:40]) + ", .." * (len(names) > 40)
    return f"no column is called '{shown(key)}'; there are {listed or 'none: the file has no headings'}"


def cells_of(array: np.ndarray, place: str) -> Cells:
    """An array's cells. Raises RunError for what is neither numbers nor text."""
    if array.dtype.kind == "M":
        return [str(time) for time in array.astype("datetime64[us]")]
    if array.dtype.kind in "biuf":
        return [float(value) for value in array]
    if array.dtype.kind in "OUS":
        return [value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value) for value in array]
    raise RunError(f"{place}: holds {array.dtype}, neither numbers nor text")


def of_one_length(place: str, headings: list[str], columns: list[Cells], clocks: str = "") -> Columns:
    """Columns that belong together. Raises RunError where they cannot, or where there is none."""
    if not columns:
        raise RunError(f"{place}: holds no column of numbers")
    if len({len(column) for column in columns}) > 1:
        listed = ", ".join(f"'{shown(name)}' {len(cells)}" for name, cells in zip(headings, columns, strict=True))
        raise RunError(f"{place}: the columns differ in length ({listed}); save those that belong together")
    if len(columns) > MAX_SERIES:
        raise RunError(f"{place}: {len(columns)} columns; at most {MAX_SERIES} are read")
    return Columns(place, headings, columns, clocks)
