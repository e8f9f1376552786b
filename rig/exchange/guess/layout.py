"""Where a table begins in rows of cells: its headings, a row of units below them, its data."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from rig.exchange.cells import Cell
from rig.recording.units import unit_called

Rows = Sequence[tuple[int, list[str]]]
TIME_OF_DAY = re.compile(r"\d{1,2}:\d{2}")
DATE = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{1,4}")
_BESIDE_UNITS = ("", "-", "[-]", "1", "[1]")


@dataclass(frozen=True)
class Layout:
    """A table in rows of cells.

    `heading_line`, `first_line`: lines of the headings (0: none) and of the first data, from 1.
    `headings`, `units`: of each column; empty where there are none.
    `data`: rows of the table, as far as was looked.
    `odd_line`: the first line behind them that is not like them.
    """

    heading_line: int
    first_line: int
    headings: list[str]
    units: list[str]
    data: list[list[str]]
    odd_line: int | None


def is_time(cell: str) -> bool:
    """Whether a cell looks like a date or a time of day."""
    return bool(TIME_OF_DAY.search(cell) or DATE.fullmatch(cell.strip()))


def numbers_in(cells: Sequence[str], reads: Cell) -> tuple[int, int]:
    """How many cells are numbers or times, and how many are neither, nor empty, nor a mark of a logger."""
    numbers, words = 0, 0
    for cell in cells:
        found = reads.reading(cell)
        if is_time(cell) or (found is not None and math.isfinite(found[0])):
            numbers += 1
        elif found is None:
            words += 1
    return numbers, words


def _is_data(cells: Sequence[str], reads: Cell) -> bool:
    numbers, words = numbers_in(cells, reads)
    return numbers > 0 and 2 * numbers >= words


def layout_of(rows: Rows, reads: Cell, of_one_width: bool) -> Layout | None:
    """The longest run of rows with numbers, and the headings before it; None where no row has one."""
    filled = [(line, cells) for line, cells in rows if any(cells)]
    best, begin = (0, 0), 0
    while begin < len(filled):
        end = begin
        while end < len(filled) and _is_data(filled[end][1], reads):
            if of_one_width and len(filled[end][1]) != len(filled[begin][1]):
                break
            end += 1
        best = max(best, (begin, end), key=lambda run: run[1] - run[0])
        begin = max(end, begin + 1)
    begin, end = best
    if begin == end:
        return None
    data = [cells for _, cells in filled[begin:end]]
    names, units = _headings(filled[:begin], max(map(len, data)) if of_one_width else 1, reads)
    line, headings = names
    odd = filled[end][0] if end < len(filled) else None
    return Layout(line, filled[begin][0], headings, units, data, odd)


def _headings(before: Rows, width: int, reads: Cell) -> tuple[tuple[int, list[str]], list[str]]:
    """The row of headings with its line, and the units of a row between it and the data."""

    def is_heading(at: int) -> bool:
        return len(before) >= -at and len(before[at][1]) >= width and not _is_data(before[at][1], reads)

    if not is_heading(-1):
        return (0, []), []
    cells = before[-1][1]
    are_units = any(map(unit_called, cells)) and all(unit_called(cell) or cell in _BESIDE_UNITS for cell in cells)
    if are_units and is_heading(-2):
        line, names = before[-2]
        return (line, names), cells
    return before[-1], []
