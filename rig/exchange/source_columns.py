"""One column of a source: its cells as numbers in the column's unit, with what is refused and told of them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rig.exchange.cells import DAY_S, Cell, iso
from rig.exchange.doubts import in_thousands, numbers_in_doubt
from rig.exchange.mapping import ColumnTable
from rig.exchange.tables import Table
from rig.exchange.units import unit_of
from rig.recording import Column
from rig.recording.columns import FLAGS, MEASURED
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError

_TIME = re.compile(r"[0-9]:[0-9]{2}", re.ASCII)
_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+\s*", re.ASCII)
Where = Callable[[int], str]  # of a row that is taken, from 0: file, line and column


def cells_of(source: ColumnTable, table: Table, rows: list[int]) -> Sequence[str | float | None]:
    """The cells that a column is made of; a date and a time of two columns as one text."""
    if source.column is None:
        return [source.constant] * len(rows)
    if isinstance(source.column, list):
        date, time = (table.column(key) for key in source.column)
        return [f"{date[row]} {time[row]}" for row in rows]
    cells = table.column(source.column)
    return [cells[row] for row in rows]


def keys_of(source: ColumnTable) -> list[str | int]:
    """The columns of the table that a column is made of."""
    return source.column if isinstance(source.column, list) else [] if source.column is None else [source.column]


def heading_of(source: ColumnTable) -> str:
    """The headings or places that a column is made of, for an error."""
    return shown("' and '".join(map(str, keys_of(source))))


def read_column(
    name: str, source: ColumnTable, table: Table, rows: list[int], reads: Cell, notes: list[str]
) -> tuple[Column, Sequence[str | float | None]]:
    """A column in its unit, before any averaging, and its cells; a length or an angle stays one.

    `notes`: what is to be told is added to them.
    Raises RunError: file, line and column of the first cell that cannot be used.
    """
    if name == "time_s":
        _refuse_other_times(source, table)
    cells, unit = cells_of(source, table, rows), unit_of(name, source.unit, source.differentiate)
    place = f"{table.place}, column '{heading_of(source)}'"

    def where(index: int) -> str:
        return f"{table.place}, line {table.lines[rows[index]]}, column '{heading_of(source)}'"

    of_day = unit.quantity == "time of day"
    if not of_day:
        _refuse_dates(source, table, rows, cells, where)
    values, censor = _values(name, source, cells, reads, where, of_day)
    if name in MEASURED:
        notes += [f"{place}: {words}" for words in numbers_in_doubt(cells, values, reads.decimal)]
    marked = [str(cell).strip() for cell, value in zip(cells, values, strict=True) if value != value]
    over = np.isinf(values)
    _refuse_above(source, cells, values, where)
    values[over] = math.nan if source.highest is None else source.highest
    censor[over & np.isnan(values)] = 0
    marked = [mark for mark in marked if mark and not (mark == "nan" and table.clocks)]
    _note(notes, place, over, source, name, marked)
    if of_day:
        _refuse_mixed(cells, where, source.unit == "ISO")
        values = _from_the_first(values, source.unit, where)
    if source.drop_repeats:
        repeats = np.append(False, (np.diff(values) == 0.0) & (np.diff(censor) == 0))
        values[repeats], censor[repeats] = math.nan, 0
    values = values * source.factor * unit.factor / (source.pulses_per_rev or 1.0) + unit.offset
    return Column(values, censor if source.factor > 0.0 else -censor), cells


def _values(
    name: str,
    source: ColumnTable,
    cells: Sequence[str | float | None],
    reads: Cell,
    where: Where,
    of_day: bool,
) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    """The numbers of cells, infinite where the range ended, and whether each is off scale."""
    numbers = reads.reading if name in MEASURED else reads.flag if name in FLAGS else reads.number
    read = reads.time(source.unit) if of_day else numbers
    values, censor = np.empty(len(cells)), np.zeros(len(cells), dtype=np.int8)
    for index, cell in enumerate(cells):
        found = read(cell if cell is not None else "")
        if found is None or (found[1] and name not in MEASURED):
            raise RunError(f"{where(index)}: '{shown(str(cell))}' {_why_not(str(cell), reads, of_day, source.unit)}")
        values[index], censor[index] = found
    return values, censor


def _why_not(cell: str, reads: Cell, of_day: bool, unit: str) -> str:
    """Why a cell cannot be read, and what to do."""
    what = f"is not a time ({unit})" if of_day else f"is not a number, decimals with '{reads.decimal}'"
    if not of_day and in_thousands(cell, reads.decimal):
        return f"{what}: its other marks part thousands; take them out, in a copy of the file"
    if not of_day and reads.decimal == "." and _COMMA.fullmatch(cell):
        return f'{what}: it has a decimal comma; say decimal = "," or, in a workbook, turn such cells into numbers'
    if not of_day and _TIME.search(cell):
        return f'{what}; where it is the time, say how it is written: unit = "hh:mm:ss", "ISO" or another with a date'
    if not any(letter.isdigit() for letter in cell):
        is_mark = "" if of_day else '; where it stands for no reading, name it in [table] invalid = ["..."]'
        return f"{what}; where its row is no reading, take the others with rows = [first, last] in [[files]]{is_mark}"
    return what


def _refuse_dates(
    source: ColumnTable,
    table: Table,
    rows: list[int],
    cells: Sequence[str | float | None],
    where: Where,
) -> None:
    """Refuse numbers that a workbook shows as dates."""
    dated = {line for key in keys_of(source) for line in table.lines_with_dates(key)}
    for index, row in enumerate(rows if dated else []):
        if table.lines[row] in dated:
            raise RunError(
                f"{where(index)}: the workbook shows '{shown(str(cells[index]))}' as a date or a time: unit = \"Excel "
                'days", or was a number taken for a date?'
            )


def _refuse_above(
    source: ColumnTable, cells: Sequence[str | float | None], values: NDArray[np.float64], where: Where
) -> None:
    """Refuse readings above what the instrument shows at most; infinite is what is over its range."""
    known = np.where(np.isfinite(values), values, -np.inf)
    at = int(known.argmax())
    if source.highest is not None and known[at] > source.highest:
        raise RunError(
            f"{where(at)}: '{shown(str(cells[at]))}' is above highest = {source.highest:g} {source.unit}, which the "
            "instrument cannot show"
        )


def _note(notes: list[str], place: str, over: np.ndarray, source: ColumnTable, name: str, marked: list[str]) -> None:
    """Say how many cells were no plain numbers, and what was made of them."""
    if over.any() and source.highest is None:
        notes.append(
            f"{place}: over range {over.sum()} times, taken as missing; with [columns.{name}] highest = .. they count "
            "as more than that"
        )
    elif over.any():
        notes.append(f"{place}: over range {over.sum()} times, taken as more than {source.highest:g} {source.unit}")
    if marked:
        told = ", ".join(f"'{shown(mark)}'" for mark in sorted(set(marked))[:5])
        notes.append(f"{place}: no reading {len(marked)} times ({told}), taken as missing")


def _from_the_first(values: NDArray[np.float64], unit: str, where: Where) -> NDArray[np.float64]:
    """Times counted from the first row; a time of day that falls back by half a day has passed midnight."""
    if unit == "hh:mm:ss":
        values = values + DAY_S * np.cumsum(np.diff(values, prepend=values[0]) < -DAY_S / 2.0)
    back = np.diff(values) < 0.0
    if back.any():
        at = int(back.argmax())
        raise RunError(
            f"{where(at + 1)}: the clock goes back by {values[at] - values[at + 1]:g} s; was it set, as "
            "for the end of summer time, or was the logger started again? Take the rows before and after as two of "
            "[[files]]"
        )
    return values - values[0]


def _refuse_mixed(cells: Sequence[str | float | None], where: Where, is_iso: bool) -> None:
    """Refuse times of which some tell their offset from UTC, or AM and PM, and others do not."""
    if is_iso:
        told = [(time := iso(cell or "")) is not None and time.tzinfo is not None for cell in cells]
    else:
        told = [str(cell).strip().rstrip(".").endswith(("m", "M")) for cell in cells]
    if len(set(told)) > 1:
        other = told.index(not told[0])
        raise RunError(
            f"{where(other)}: '{shown(str(cells[other]))}' and '{shown(str(cells[0]))}' before it: one tells "
            f"{'its offset from UTC' if is_iso else 'AM or PM'}, and the other does not"
        )


def _refuse_other_times(source: ColumnTable, table: Table) -> None:
    """Refuse the time of one channel where others have their own under the same heading, as in LabVIEW's tables."""
    keys = keys_of(source)
    heading = table.heading(keys[0]) if len(keys) == 1 else ""
    places = [at for at, other in enumerate(table.headings) if heading and other == heading]
    if len({tuple(table.columns[at]) for at in places}) > 1:
        listed = ", ".join(str(at + 1) for at in places[:9])
        raise RunError(
            f"{table.place}: columns {listed} are all called '{shown(heading)}' and differ, as where each channel has "
            "its own times; save the channels on one clock"
        )
