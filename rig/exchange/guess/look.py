"""What a source holds, as far as a look tells: how it is read, and its columns with their first cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rig.exchange.binary.apart import listed_apart
from rig.exchange.binary.columns import MAX_BYTES, Listed
from rig.exchange.cells import Cell
from rig.exchange.guess.layout import Layout, layout_of
from rig.exchange.guess.text import LOOKED_LINES, look_at_text
from rig.exchange.mapping import TableTable
from rig.exchange.workbook import rows_of, sheet_names
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain

Key = str | int


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
    magic = {b"TDSm": "tdms", b"MDF ": "mdf", b"UnFi": "mdf", b"PK\x03\x04": "xlsx", b"MATL": "mat"}
    return magic.get(start[:4], "csv")


def _text(path: Path) -> Source:
    found = look_at_text(path)
    layout, several = found.layout, "fits as well as another; which is it?"
    table = [
        Said("delimiter", found.delimiters, several if len(found.delimiters) > 1 else ""),
        Said("decimal", found.decimals, "no number here has one" if len(found.decimals) > 1 else ""),
    ]
    table += [Said("encoding", [found.encoding])] * (found.encoding != "utf-8")
    reads = Cell(TableTable(reader="csv", delimiter=found.delimiters[0], decimal=found.decimals[0]))  # type: ignore[arg-type]
    remarks = [] if found.whole else [f"only the first {LOOKED_LINES} lines were looked at"]
    return Source("csv", [*table, *_lines(layout)], _columns(layout, reads), reads, remarks + _odd(layout))


def _workbook(path: Path) -> Source:
    reads = Cell(TableTable(reader="xlsx"))
    layouts: dict[str, Layout] = {}
    for name in sheet_names(path):
        rows = list(enumerate(rows_of(path, name)[:LOOKED_LINES], start=1))
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
        table.append(Said("group", groups, "one file has one group; the columns below are of all"))
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
