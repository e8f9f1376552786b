"""What a person should look at in a table that can be read: each doubt in words, told with what was left out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rig.exchange.cells import Cell
from rig.exchange.mapping import MappingFile
from rig.exchange.tables import Table
from rig.recording.columns import PRESSURE
from rig.recording.header import read_heading
from rig.recording.mistakes import shown
from rig.recording.units import unit_called

JUMP_S, JUMP = 60.0, 100.0  # of a run's clock, told when it is longer than both: seconds, usual steps
# What loggers and controllers write where there is no value.
STAND_INS = {float(one) for bits in (16, 32) for one in ((1 << bits) - 1, (1 << bits - 1) - 1, -(1 << bits - 1))}
STAND_INS |= {sign * one for sign in (1.0, -1.0) for one in (999.0, 999.9, 9999.0, 9999.9, 99999.0, 999999.0, 6999.0)}
STAND_INS |= {3276.7, -3276.8, 6553.5, -888.88, -7999.0}
FAR = 3.0  # how many times the largest of the others such a number is, or it is below 0 alone
LEAST_IN_FULL = 100.0  # beside numbers in thousands there are some of three digits
TIME_UNITS = ("s", "ms", "us", "min", "h")
TURNS_RPM = 10.0  # that no tachometer shows of a rotor at rest
SAME_SHARE = 1e-3  # of a span of time
_DIGIT = re.compile(r"\d")


def labelled(table: Table, rows: list[int], reads: Cell) -> list[str]:
    """Rows that a word among numbers seems to call something else than a reading, such as a mean below the others."""
    texts = [(at, cells) for at, cells in enumerate(table.columns) if isinstance(cells[rows[0]], str)]
    for at, cells in texts:
        plain = {row: cell for row in rows if not _DIGIT.search(cell := str(cells[row]))}
        words = {cell for cell in set(plain.values()) if reads.reading(cell) is None}
        named = [row for row, cell in plain.items() if cell in words]
        if 0 < len(named) < len(rows) - len(plain):
            lines = ", ".join(str(table.lines[row]) for row in named[:5]) + ", ..." * (len(named) > 5)
            return [
                f"{table.place}, line {lines}, column {at + 1}: '{shown(str(cells[named[0]]))}' among numbers; where "
                "such a row is no reading, leave it out with rows = [first, last] in [[files]]"
            ]
    return []


def uncounted(table: Table, rows: Sequence[int]) -> list[str]:
    """Empty lines among the rows that are taken, which a period between the rows does not count."""
    lines = np.array(table.lines[rows[0] : rows[-1] + 1])
    gaps = lines[1:][np.diff(lines) > 1]
    told = (
        f"{table.place}, line {', '.join(map(str, gaps[:5]))}{', ...' * (gaps.size > 5)}: empty lines before it are no"
    )
    return [f"{told} rows, and sample_period_s does not count them"] if gaps.size else []


def turning(speeds: NDArray[np.float64], lines: Sequence[int], place: str) -> list[str]:
    """The first row of a zero in which the rotor seems to turn, in words. `speeds`: [rpm], shape (n,)."""
    at = int(np.argmax(np.nan_to_num(speeds) > TURNS_RPM))
    if not speeds[at] > TURNS_RPM:
        return []
    return [
        f"{place}, line {lines[at]}: a zero is read with the rotor at rest, and here it turns at {speeds[at]:g} rpm"
    ]


def jumps(times: NDArray[np.float64], lines: Sequence[int], place: str) -> list[str]:
    """Where the clock of a run goes on by far more than it does from row to row, in words."""
    steps = np.diff(times)
    if steps.size < 2 or not np.nanmax(steps) > max(JUMP_S, JUMP * float(np.nanmedian(steps))):
        return []
    at = int(np.nanargmax(steps))
    return [
        f"{place}, line {lines[at + 1]}: {steps[at]:.6g} s after the row before, where {np.nanmedian(steps):.3g} s are "
        "usual; was the clock set, as for summer time?"
    ]


def numbers_in_doubt(cells: Sequence[str | float | None], values: NDArray[np.float64], decimal: str) -> list[str]:
    """Numbers of a column that may mean something else, in words.

    `values`: of the cells as they were read, shape (n,).
    """
    return [*_thousands([cell.strip() for cell in cells if isinstance(cell, str)], decimal), *_stand_ins(cells, values)]


def in_thousands(cell: str, decimal: str) -> bool:
    """Whether a cell is a number whose thousands are parted by a mark that is not the decimal one: 1,602.2."""
    mark = "[.' \u00a0\u202f\u2019]" if decimal == "," else "[,' \u00a0\u202f\u2019]"
    number = rf"\s*[<>]?\s*[+-]?[0-9]{{1,3}}(?:{mark}[0-9]{{3}})+(?:{re.escape(decimal)}[0-9]+)?\s*"
    return re.fullmatch(number, cell, re.ASCII) is not None


def _thousands(cells: Sequence[str], decimal: str) -> list[str]:
    """Where the decimal mark seems to part thousands: three digits behind it in all numbers that have one.

    The others are whole, and larger.
    """
    whole = [cell for cell in cells if cell.isdigit()]
    parted = [cell for cell in cells if decimal in cell]
    parting = re.compile(rf"[1-9][0-9]{{0,2}}{re.escape(decimal)}[0-9]{{3}}", re.ASCII)
    if not whole or not parted or not all(map(parting.fullmatch, parted)):
        return []
    most = max(map(float, whole))
    if most < max(LEAST_IN_FULL, *(float(cell.replace(decimal, ".")) for cell in parted)):
        return []
    return [f"'{shown(parted[0])}' beside '{shown(whole[0])}': does '{decimal}' part thousands? It is read as decimal"]


def _stand_ins(cells: Sequence[str | float | None], values: NDArray[np.float64]) -> list[str]:
    """Numbers that often stand where there is no value, and are far from all others."""
    known = np.isfinite(values)
    stand_in = known & np.isin(values, list(STAND_INS))
    others = values[known & ~stand_in]
    if not stand_in.any() or not others.size:
        return []
    far = stand_in & ((np.abs(values) > FAR * np.abs(others).max()) | ((values < 0.0) & (others.min() >= 0.0)))
    words = Counter(str(cells[at]).strip() for at in np.flatnonzero(far).tolist())
    return [
        f"'{shown(word)}' {count} times, far from the others: many loggers write it where there is no value; if so, "
        f"name it in [table] invalid = ['{shown(word)}']"
        for word, count in words.items()
    ]


def other_times(mapping: MappingFile, table: Table) -> list[str]:
    """Columns that are not taken and look like the times of other channels, as where each has its own."""
    source = mapping.columns.get("time_s")
    if source is None or source.column is None or isinstance(source.column, list) or source.unit not in TIME_UNITS:
        return []
    reads, taken = Cell(mapping.table), {column.column for column in mapping.columns.values()} - {None}
    own = _increasing(table.column(source.column), reads)
    notes = []
    for at, heading in enumerate(table.headings if own is not None else []):
        found = read_heading(heading)
        if heading in taken or at + 1 in taken or "time_s" not in (*found.by_unit, *found.by_words):
            continue
        other = _increasing(table.columns[at], reads)
        if other is not None and own is not None and _of_another_clock(own, other):
            notes.append(
                f"{table.place}: '{shown(heading)}' is a time too, and another than '{shown(str(source.column))}': has "
                "each channel its own? All are taken at the latter"
            )
    return notes


def _increasing(cells: Sequence[str | float], reads: Cell) -> NDArray[np.float64] | None:
    """Cells as numbers that increase from row to row; None where they are anything else."""
    found = [reads.number(cell) for cell in cells]
    values = np.array([np.nan if one is None else one[0] for one in found])
    return values if values.size > 2 and (np.diff(values) > 0.0).all() else None


def _of_another_clock(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether times are other moments, not the same in another unit or from another beginning."""
    spans = [values[-1] - values[0] for values in (one, other)]
    shares = [(values - values[0]) / span for values, span in zip((one, other), spans, strict=True)]
    if np.abs(shares[0] - shares[1]).max() > SAME_SHARE:
        return True
    same_unit = abs(spans[0] - spans[1]) < SAME_SHARE * spans[0]
    return bool(same_unit and SAME_SHARE * spans[0] / one.size < abs(one[0] - other[0]) < spans[0])


def other_units(mapping: MappingFile, table: Table) -> list[str]:
    """Where a file states another unit than the mapping; it need not say whether a pressure is absolute."""
    notes = []
    for name, column in mapping.columns.items():
        if column.column is None or isinstance(column.column, list):
            continue
        heading = table.heading(column.column)
        stated = table.units.get(heading, "") or _unit_in(heading, name)
        same = (column.unit, column.unit.removesuffix(" abs").removesuffix(" gauge"))
        known, is_absolute = unit_called(stated.partition(" since ")[0]), read_heading(heading).is_absolute
        if stated.strip() not in ("", "-", "1") and known not in same:
            notes.append(
                f"{table.place}, '{shown(heading)}': the file says '{shown(stated)}', the mapping "
                f"'{column.unit}' for {name}; the mapping's is taken"
            )
        elif name in PRESSURE and is_absolute is (name == PRESSURE[1]) and known != column.unit:
            says = "absolute" if is_absolute else "gauge"
            notes.append(
                f"{table.place}, '{shown(heading)}': the heading says {says}, the mapping {name}; is it right?"
            )
    return notes


def _unit_in(heading: str, name: str) -> str:
    """The unit that a heading states for the quantity of a column; empty where it states none."""
    found = read_heading(heading)
    return found.unit if {name, "pressure" if name in PRESSURE else name} & set(found.by_unit) else ""


def numbers_for_headings(mapping: MappingFile, table: Table) -> list[str]:
    """That numbers stand for the headings of columns that are taken by place: they may be the first reading."""
    reads, keys = Cell(mapping.table), (source.column for source in mapping.columns.values())
    taken = [heading for key in keys if isinstance(key, int) and (heading := table.heading(key))]
    if not taken or None in map(reads.number, taken):
        return []
    return [
        f"{table.place}: '{shown(taken[0])}' is taken for a heading; if the file has none, say heading_line = 0 in "
        "[table], or this row is lost"
    ]
