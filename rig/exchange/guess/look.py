"""What a source holds, as far as a look tells: how it is read, and its columns with their first cells."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.exchange.binary.apart import listed_apart
from rig.exchange.binary.columns import MAX_BYTES, OF_A_RUN, Listed
from rig.exchange.cells import Cell
from rig.exchange.guess.layout import Layout, Rows, is_time, layout_of
from rig.exchange.mapping import TableTable
from rig.exchange.tables import lines_of
from rig.exchange.workbook import read_sheet, sheet_names
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain

Key = str | int
LOOKED_BYTES = 2_000_000
LOOKED_LINES = 400
DELIMITERS = (";", "\t", "|", ",", " ")
_SPACED = re.compile(r'"([^"]*)"|(\S+)')
_OTHERS = re.compile(r"[;\t|]|\d\s+\d|,\S")


@dataclass(frozen=True)
class Text:
    """A table in text. `delimiters`, `decimals`: one where it is sure, and otherwise all that fit."""

    encoding: str
    delimiters: list[str]
    decimals: list[str]
    layout: Layout
    whole: bool


def look_at_text(path: Path) -> Text:
    """Look at a file's beginning. Raises RunError when it is no text, or no line of it has a number."""
    with open_plain(path, MAX_BYTES) as stream:
        data = stream.read(LOOKED_BYTES)
        cut = bool(stream.read(1))
    if not data.strip():
        raise RunError(f"{path}: an empty file; is it the one that was meant, and was it saved?")
    encoding, text = _decoded(data, path)
    lines = lines_of(text.removeprefix("\ufeff"))
    whole = not cut and len(lines) <= LOOKED_LINES
    fits: list[tuple[int, str, str, Layout]] = []
    for delimiter in DELIMITERS:
        rows = _rows(lines[:LOOKED_LINES], delimiter)
        for decimal in ".,"[: 1 if delimiter == "," else 2]:
            reads = Cell(TableTable(reader="csv", delimiter=delimiter, decimal=decimal))  # type: ignore[arg-type]
            found = layout_of(rows, reads, of_one_width=True)
            if found is not None:
                fits.append((_fit(found, reads, delimiter), delimiter, decimal, found))
    if not fits:
        raise RunError(f"{path}: no line of the first {LOOKED_LINES} has a number; is it a table?")
    # Where nothing fits, as with spaces in numbers, headings tell more.
    rank = [(max(fit, 0), found.heading_line > 0, fit) for fit, _, _, found in fits]
    best = [found for found, its in zip(fits, rank, strict=True) if its == max(rank)]
    delimiters = list(dict.fromkeys(delimiter for _, delimiter, _, _ in best))
    if delimiters != [" "]:  # which takes a tab for one, and tells no empty cell
        delimiters = [delimiter for delimiter in delimiters if delimiter != " "]
    decimals = list(dict.fromkeys(decimal for _, delimiter, decimal, _ in best if delimiter == delimiters[0]))
    return Text(encoding, delimiters, decimals, best[0][3], whole)


def _decoded(data: bytes, path: Path) -> tuple[str, str]:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16", data.decode("utf-16", "replace")
    if len(data) > 1 and not any(data[1:200:2]):
        return "utf-16", data.decode("utf-16-le", "replace")
    if b"\0" in data:
        raise RunError(f"{path}: neither a format that is known nor text; say how it was written")
    for encoding in ("utf-8", "cp1252"):
        for ending in range(4):  # the last character may have been cut
            try:
                return encoding, data[: len(data) - ending].decode(encoding)
            except UnicodeDecodeError:
                continue
    return "latin-1", data.decode("latin-1")


def _rows(lines: list[str], delimiter: str) -> Rows:
    if delimiter == " ":
        return [
            (number, [quoted or bare for quoted, bare in _SPACED.findall(line)])
            for number, line in enumerate(lines, start=1)
        ]
    rows = []
    for number, line in enumerate(lines, start=1):
        try:
            cells = next(csv.reader([line], delimiter=delimiter, strict=True), [])
        except csv.Error:
            cells = [line]
        rows.append((number, [cell.strip() for cell in cells]))
    return rows


def _fit(layout: Layout, reads: Cell, delimiter: str) -> int:
    """Cells of the data that can be read, less twice those in which another delimiter stands."""
    fit = 0
    for cells in layout.data:
        for cell in cells:
            if cell and (is_time(cell) or reads.number(cell) is not None):
                fit += 1
            if _OTHERS.search(cell) and not (is_time(cell) and delimiter != " ") and reads.number(cell) is None:
                fit -= 2
    return fit


@dataclass(frozen=True)
class Said:
    """A key of the mapping with its values: one, or several that it could be, and why it is not sure."""

    key: str
    values: Sequence[object]
    doubt: str = ""


@dataclass(frozen=True)
class Seen:
    """A column: how the mapping names it, its heading, the unit stated beside it, its first cells."""

    key: Key
    heading: str
    unit: str
    cells: list[str | float]
    clocked: bool = False


@dataclass(frozen=True)
class Source:
    """A source that was looked at. `table` is [table] below `reader`, `remarks` what a person should look at."""

    reader: str
    table: list[Said]
    columns: list[Seen]
    reads: Cell
    remarks: list[str]


def look_at(path: Path) -> Source:
    """Look at a file. Raises RunError when it is of no kind that is known, damaged, or holds no numbers."""
    reader = _reader(path)
    if reader == "csv":
        return _text(path)
    return _workbook(path) if reader == "xlsx" else _binary(path, reader)


def _reader(path: Path) -> str:
    with open_plain(path, MAX_BYTES) as stream:
        start = stream.read(4096)
    if any(start[at : at + 8] == b"\x89HDF\r\n\x1a\n" for at in (0, 512, 1024, 2048)):
        return "hdf5"
    if start.startswith(b"\xd0\xcf\x11\xe0"):
        raise RunError(f"{path}: a workbook of an old Excel (.xls); save it as .xlsx")
    magic = {b"TDSm": "tdms", b"MDF ": "mdf", b"UnFi": "mdf", b"PK\x03\x04": "xlsx", b"MATL": "mat", b"PAR1": "parquet"}
    return magic.get(start[:4], "csv")


def _text(path: Path) -> Source:
    found = look_at_text(path)
    layout, several = found.layout, "fits as well as another; which is it?"
    table = [
        Said("delimiter", found.delimiters, several if len(found.delimiters) > 1 else ""),
        Said("decimal", found.decimals, "no number here has one" if len(found.decimals) > 1 else ""),
    ]
    table += [Said("encoding", [found.encoding])] * (found.encoding != "utf-8")
    reads, other = (
        Cell(TableTable(reader="csv", delimiter=found.delimiters[0], decimal=mark))  # type: ignore[arg-type]
        for mark in (found.decimals[0], {".": ",", ",": "."}[found.decimals[0]])
    )
    columns = _columns(layout, reads)
    if len(found.decimals) == 1 and any(_reads_better(other, reads, column.cells) for column in columns):
        both = "some numbers have the one and some the other; does one part thousands?"
        table[1] = Said("decimal", [reads.decimal, other.decimal], both)
    remarks = [] if found.whole else [f"only the first {LOOKED_LINES} lines were looked at"]
    return Source("csv", [*table, *_lines(layout)], columns, reads, remarks + _odd(layout))


def _reads_better(other: Cell, reads: Cell, cells: Sequence[str | float]) -> bool:
    """Whether a column's cells are all numbers with the other decimal mark, and not with this one."""
    return None in map(reads.number, cells) and None not in map(other.number, cells)


def _workbook(path: Path) -> Source:
    reads = Cell(TableTable(reader="xlsx"))
    layouts: dict[str, Layout] = {}
    for name in sheet_names(path):
        rows = list(enumerate(read_sheet(path, name).rows[:LOOKED_LINES], start=1))
        layout = layout_of(rows, reads, of_one_width=False)
        if layout is not None:
            layouts[name] = layout
    if not layouts:
        raise RunError(f"{path}: no sheet has a number in its first {LOOKED_LINES} rows")
    name = max(layouts, key=lambda sheet: len(layouts[sheet].data))
    layout = layouts[name]
    several = "several hold tables; the columns below are of the first" if len(layouts) > 1 else ""
    sheets = Said("sheet", [name, *(other for other in layouts if other != name)], several)
    return Source("xlsx", [sheets, *_lines(layout)], _columns(layout, reads), reads, _odd(layout))


def _lines(layout: Layout) -> list[Said]:
    lines = [Said("heading_line", [layout.heading_line])] * (layout.heading_line != 1)
    return lines + [Said("first_line", [layout.first_line])] * (layout.first_line != layout.heading_line + 1)


def _odd(layout: Layout) -> list[str]:
    remarks = ["no line before the numbers looks like headings: columns are taken by place"]
    remarks = remarks * (layout.heading_line == 0)
    if layout.odd_line is not None:
        remarks.append(
            f"line {layout.odd_line} is not like the lines before it: was the logger started again, or is it a note? "
            "With [[files]] rows = [first, last] a part is taken"
        )
    return remarks


def _columns(layout: Layout, reads: Cell) -> list[Seen]:
    width = max(map(len, layout.data))
    columns: list[Seen] = []
    for at in range(width):
        cells: list[str | float] = [row[at] if at < len(row) else "" for row in layout.data]
        heading = layout.headings[at] if at < len(layout.headings) else ""
        unit = layout.units[at] if at < len(layout.units) else ""
        if any(str(cell).strip() for cell in cells):
            is_name = bool(heading) and layout.headings.count(heading) == 1
            columns.append(Seen(heading if is_name else at + 1, heading, unit, cells))
    return columns


def _binary(path: Path, reader: str) -> Source:
    found = listed_apart(reader, path)
    if not found:
        raise RunError(f"{path}: holds no column of numbers")
    groups = list(dict.fromkeys(one.group for one in found))
    names = [one.name for one in found]
    table: list[Said] = []
    if len(groups) == 1 and groups[0] and reader != "mdf":
        table.append(Said("group", groups))
    elif len(groups) > 1 and (reader == "tdms" or len(set(names)) < len(names)):
        hint = f", {OF_A_RUN}" if reader == "tdms" and "value" in names else ""
        table.append(Said("group", groups, f"one file has one group{hint}; the columns below are of all"))
    counts = sorted({one.count for one in found})
    remarks = [f"the channels have {' or '.join(map(str, counts[:6]))} samples"] * (len(counts) > 1)
    return Source(reader, table, [_seen(one, reader) for one in found], Cell(TableTable(reader=reader)), remarks)  # type: ignore[arg-type]


def _seen(one: Listed, reader: str) -> Seen:
    leaf = one.name.rpartition("/")[2]
    said = one.name.removesuffix("/value") if leaf == "value" else one.name
    heading = said.rpartition("/")[2] if reader == "hdf5" else one.name
    if leaf == "value" and reader == "tdms":  # an export of ours: the group is the channel
        heading = one.group
    return Seen(one.name, shown(heading, 100), one.unit, list(one.cells), one.clocked)
