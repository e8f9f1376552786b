"""Reading tables that were taken elsewhere: text and workbooks here, binary files apart, each to columns of cells.

A cell is text as it stood, or a float. Files are untrusted: bounded in size, parsed and never evaluated.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from rig.exchange.binary.apart import read_apart
from rig.exchange.binary.columns import MAX_BYTES, MAX_SERIES, Cells, no_column
from rig.exchange.mapping import TableTable
from rig.exchange.workbook import read_sheet
from rig.recording.mistakes import shown
from rig.recording.units import unit_called
from rig.runlog.folder import RunError, read_bytes

UTF_8_MARK = b"\xef\xbb\xbf"
_SPACED = re.compile(r'"([^"]*)"|(\S+)')
_LINE_END = re.compile(r"\r\n?|\n")
_UNIT = re.compile(r"[\[(]([^\[\]()]+(?:\([^()]*\))?)[\])]\s*")


@dataclass(frozen=True)
class Table:
    """A table's columns.

    `headings`: empty where the file has none.
    `short`: the line with the fewest cells, and their number; None where each row has all.
    `clocks`: what there was where columns of several clocks stand on one time line, with empty cells between.
    `units`: by heading, as the file states them.
    `remarks`: what a person should look at.
    `dated`: of a workbook, line from 1 and column from 0 of numbers that are shown as dates or times.
    `hint`: of text, what its delimiter seems to be where that is another than was said; begins with "; ".
    """

    place: str
    headings: list[str]
    columns: list[Cells]
    lines: Sequence[int]
    short: tuple[int, int] | None = None
    clocks: str = ""
    units: dict[str, str] = field(default_factory=dict)
    hint: str = ""
    remarks: Sequence[str] = ()
    dated: frozenset[tuple[int, int]] = frozenset()

    def column(self, key: str | int) -> Cells:
        """A column's cells.

        Raises RunError when there is no such column, a row is too short to have it, or the heading stands twice.
        """
        at = self._at(key)
        if self.short and at >= self.short[1]:
            line, cells = self.short
            raise RunError(
                f"{self.place}, line {line}: {cells} cells, and column {at + 1} ('{shown(str(key))}') is not among "
                "them; is the row cut off? If it is none of the table, leave it out with rows = [first, last] in "
                "[[files]]"
            )
        return self.columns[at]

    def lines_with_dates(self, key: str | int) -> set[int]:
        """Lines in which a workbook shows a number of a column as a date or a time."""
        at = self._at(key)
        return {line for line, column in self.dated if column == at}

    def heading(self, key: str | int) -> str:
        """A column's heading, whether it is taken by it or by its place; empty where there is none."""
        return key if isinstance(key, str) else "".join(self.headings[key - 1 : key])

    def _at(self, key: str | int) -> int:
        if isinstance(key, int):
            if key <= len(self.columns):
                return key - 1
            raise RunError(f"{self.place}: there is no column {key}; it has {len(self.columns)}{self.hint}")
        found = [index for index, heading in enumerate(self.headings) if heading == key]
        if len(found) == 1:
            return found[0]
        if found:
            places = " or ".join(str(at + 1) for at in found[:9])
            raise RunError(
                f"{self.place}: {len(found)} columns are called '{shown(key)}'; "
                f"give the place of one: column = {places}"
            )
        raise RunError(f"{self.place}: {no_column(key, self.headings)}{self.hint}")


def read_table(
    path: Path,
    table: TableTable,
    sheet: str = "",
    group: str = "",
    wanted: Sequence[str | int] = (),
    taken: Sequence[int] | None = None,
) -> Table:
    """Read a table.

    `wanted`: headings and places of the columns that are taken, of all for none. Channels that are not taken may have
        another clock.
    `taken`: first and last row from 1 that are taken; what stands before and behind may be no rows of the table.
    Raises RunError when the file is not what the mapping says.
    """
    if table.reader == "csv":
        return _csv(path, table, taken)
    if table.reader == "xlsx":
        return _xlsx(path, table, sheet or table.sheet, taken)
    found = read_apart(table.reader, path, group or table.group, wanted)
    lines = range(1, len(found.columns[0]) + 1)
    return Table(
        found.place, found.headings, found.columns, lines,
        clocks=found.clocks, units=found.units, remarks=found.remarks,
    )  # fmt: skip


def _csv(path: Path, table: TableTable, taken: Sequence[int] | None) -> Table:
    data = read_bytes(path, MAX_BYTES)
    if data.startswith(UTF_8_MARK) and table.encoding != "utf-8":
        raise RunError(f"{path}: it begins with the mark of utf-8, and the mapping says {table.encoding}")
    try:
        text = data.decode(table.encoding).removeprefix("\ufeff")
    except UnicodeError:
        raise RunError(
            f"{path}: not {table.encoding} text; say its encoding in [table] or, of a file that is no text, its reader"
        ) from None
    lines, begin = lines_of(text), table.heading_line
    rows = _records(path, lines, begin or 1, table)
    _, headings = next(rows, (0, [])) if begin else (0, [])
    if table.first_line:
        rows = _records(path, lines, table.first_line, table)
    hint = _other_delimiter(lines[max(begin, 1) - 1 :][:1], table)
    first = table.first_line or begin + 1
    found = _of_rows(str(path), headings, list(rows), first, table, hint, taken)
    delimiter = None if table.delimiter == " " else table.delimiter
    found = _with_units(found, [line.split(delimiter) for line in lines[begin : first - 1]] if begin else [])
    return found if text[-1:] in ("\r", "\n") else replace(found, remarks=_cut_off(found, table.decimal or "."))


def _with_units(found: Table, between: Sequence[Sequence[str]]) -> Table:
    """A table with the units of a row between its headings and its data, if there is one."""
    units = dict(found.units)
    for row in between:
        said = zip(found.headings, (cell.strip().strip('"') for cell in row), strict=False)
        units |= {heading: unit for heading, unit in said if unit_called(unit)}
    return replace(found, units=units)


def lines_of(text: str) -> list[str]:
    """The lines of a file. A form feed, or a line separator of Unicode, stands in a line."""
    return _LINE_END.split(text)


def _cut_off(found: Table, decimal: str) -> list[str]:
    """What shows that a last line without an end stops amid a number: fewer decimals than in any other; or nothing."""
    at = max((at for at, cells in enumerate(found.columns) if cells[-1]), default=0)
    sizes = [len(str(cell).partition(decimal)[2]) for cell in found.columns[at] if cell]
    if len(sizes) < 2 or sizes[-1] >= min(sizes[:-1]):
        return []
    cell = shown(str(found.columns[at][-1]))
    return [f"{found.place}, line {found.lines[-1]}: '{cell}' ends the file without a line's end; is it cut off?"]


def _other_delimiter(first: list[str], table: TableTable) -> str:
    """What else than the delimiter that was said seems to part the columns of a table's first line; or nothing."""
    counts = {mark: "".join(first).count(mark) for mark in ",;\t|"}
    likely = max(counts, key=lambda mark: counts[mark])
    if table.delimiter in (None, likely) or counts[likely] <= counts.get(table.delimiter or "", 0):
        return ""
    return f"; the delimiter seems to be '{shown(likely)}', and the mapping says '{shown(str(table.delimiter))}'"


def _records(path: Path, lines: list[str], first: int, table: TableTable) -> Iterator[tuple[int, list[str]]]:
    """The rows from a line on, each with the line that it begins at. What stands before is no CSV."""
    if table.delimiter == " ":  # any number of them
        for number, line in enumerate(lines[first - 1 :], start=first):
            yield number, [quoted or bare for quoted, bare in _SPACED.findall(line)]
        return
    reader = csv.reader(lines[first - 1 :], delimiter=table.delimiter or ",", strict=True)
    begin = first
    try:
        for row in reader:
            end = first + reader.line_num
            if end > begin + 1 and any(str(table.delimiter) in cell for cell in row):
                raise RunError(
                    f"{path}, line {begin}: a cell in quotation marks holds what follows down to line {end - 1}; "
                    "is a mark missing?"
                )
            yield begin, [cell.strip() for cell in row]
            begin = end
    except csv.Error as error:
        raise RunError(f"{path}, line {begin}: not a row of CSV ({error}); is heading_line right?") from None


def _of_rows(
    place: str,
    headings: list[str],
    rows: list[tuple[int, list[str]]],
    first: int,
    table: TableTable,
    hint: str = "",
    taken: Sequence[int] | None = None,
) -> Table:
    is_text = table.reader == "csv"
    data = [(number, row) for number, row in rows if any(row)]
    if not data:
        raise RunError(f"{place}: no rows from line {first} on")
    width = len(headings) or len(data[0][1])
    if width > MAX_SERIES:
        raise RunError(f"{place}: {width} columns; at most {MAX_SERIES} are read")
    begin, end = taken or (1, len(data))
    checked = data[begin - 1 : end] if is_text else []  # beside the table of a workbook there may be notes
    for number, row in checked:
        if len(row) > width and any(row[width:]):
            raise RunError(
                f"{place}, line {number}: {len(row)} cells, expected {width}{hint or '; is the delimiter right?'}"
            )
        if len(row) < width and table.delimiter == " ":
            raise RunError(
                f"{place}, line {number}: {len(row)} cells, expected {width}; where spaces part the columns, none "
                "can be empty"
            )
    least, line = min(((len(row), number) for number, row in checked), default=(width, 0))
    columns: list[Cells] = [[row[index] if index < len(row) else "" for _, row in data] for index in range(width)]
    short = (line, least) if least < width else None
    in_brackets = {heading: found[1] for heading in headings for found in _UNIT.finditer(heading)}
    units = {heading: unit for heading, unit in in_brackets.items() if unit_called(unit)}
    return Table(place, headings, columns, [number for number, _ in data], short, units=units, hint=hint)


def _xlsx(path: Path, table: TableTable, sheet: str, taken: Sequence[int] | None) -> Table:
    one, begin = read_sheet(path, sheet, table.decimal or "."), table.heading_line
    rows = one.rows
    headings = rows[begin - 1] if 0 < begin <= len(rows) else []
    first = table.first_line or begin + 1
    numbered = list(enumerate(rows, start=1))[first - 1 :]
    found = _of_rows(f"{path}, sheet '{shown(sheet)}'", headings, numbered, first, table)
    found = _with_units(found, rows[begin : first - 1] if begin else [])
    begin, end = taken or (1, len(found.lines))
    lines = set(found.lines[begin - 1 : end])
    remarks = [f"{found.place}, line {at}: {words}" for at, words in one.remarks if at in lines]
    return replace(found, remarks=remarks, dated=one.dated)
