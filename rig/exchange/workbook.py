"""Excel workbooks (.xlsx): the cells of a sheet as text. A formula is its last value."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree as Xml

from rig.exchange.binary.columns import MAX_BYTES, MAX_SERIES
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain

MAX_PART_BYTES = 200_000_000  # unpacked
MAX_CELLS = 20_000_000
Found = TypeVar("Found")
_SPAN = re.compile(r"[A-Z]\$?([0-9]+):\$?[A-Z]+\$?([0-9]+)")  # the rows from which a formula takes cells
_DATE_FORMATS = (*range(14, 23), *range(45, 48))  # that every workbook knows
_NOT_SHOWN = re.compile(r'"[^"]*"|\\.|_.|\[(?!h+\]|m+\]|s+\])[^\]]*\]', re.IGNORECASE)  # of a format: text, colours
_DATE_LETTER = re.compile(r"[dmyhs]", re.IGNORECASE)
_REFERENCE = re.compile(r"([A-Z]{1,3})([0-9]{1,7})")


def sheet_names(path: Path) -> list[str]:
    """The names of a workbook's sheets. Raises RunError where it cannot be read."""
    return list(_opened(path, _parts_by_name))


@dataclass(frozen=True)
class Sheet:
    """A sheet.

    `rows`: from the first on.
    `remarks`: what a person should look at, each with its line from 1.
    `dated`: line and column, from 1 and 0, of numbers that are shown as a date or a time.
    """

    rows: list[list[str]]
    remarks: list[tuple[int, str]]
    dated: frozenset[tuple[int, int]]


def read_sheet(path: Path, sheet: str, decimal: str = ".") -> Sheet:
    """A sheet; numbers in it get the decimal mark that its cells of text have.

    Raises RunError where the workbook cannot be read, or has no such sheet.
    """

    def read(archive: zipfile.ZipFile) -> Sheet:
        parts = _parts_by_name(archive)
        if sheet not in parts:
            listed = ", ".join(f"'{shown(name)}'" for name in parts)
            raise RunError(f"{path}: name the sheet in [table] or [[files]]: sheet = one of {listed}")
        part = _part(archive, parts[sheet])
        return Sheet(
            _grid(part, _shared(archive), decimal), list(_remarks(part)), frozenset(_dated(part, _date_styles(archive)))
        )

    return _opened(path, read)


def _opened(path: Path, read: Callable[[zipfile.ZipFile], Found]) -> Found:
    try:
        with open_plain(path, MAX_BYTES) as stream:
            if stream.read(4) == b"\xd0\xcf\x11\xe0":
                raise RunError(f"{path}: a workbook of an old Excel (.xls), or one with a password; save it as .xlsx")
            stream.seek(0)
            with zipfile.ZipFile(stream) as archive:
                if "xl/workbook.xml" not in archive.namelist():
                    raise RunError(f"{path}: an archive, but no workbook of Excel; save it as .xlsx")
                return read(archive)
    except RunError:
        raise
    except Exception as error:  # whatever a damaged archive makes its readers stumble over
        raise RunError(f"{path}: not a workbook (.xlsx) that can be read ({shown(str(error), 100)})") from None


def _part(archive: zipfile.ZipFile, name: str) -> Xml.Element:
    if archive.getinfo(name).file_size > MAX_PART_BYTES:
        raise ValueError(f"{name} is larger than {MAX_PART_BYTES} bytes")
    data = archive.read(name)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise ValueError("it declares XML entities")
    return Xml.fromstring(data)  # noqa: S314 - see the import


def _parts_by_name(archive: zipfile.ZipFile) -> dict[str, str]:
    """The sheets, each with its part of the archive."""
    relation = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id"
    targets = {one.get("Id"): one.get("Target", "") for one in _part(archive, "xl/_rels/workbook.xml.rels")}
    sheets = {
        one.get("name", ""): f"xl/{targets.get(one.get(relation), '').removeprefix('/xl/')}"
        for one in _part(archive, "xl/workbook.xml").iter(_tag("sheet"))
    }
    if not sheets:
        raise ValueError("it names no sheet; was it saved as Strict Open XML? Save it as .xlsx")
    return sheets


def _tag(name: str) -> str:
    return f"{{http://schemas.openxmlformats.org/spreadsheetml/2006/main}}{name}"


def _shared(archive: zipfile.ZipFile) -> list[str]:
    if "xl/sharedStrings.xml" not in archive.namelist():
        return []
    strings = _part(archive, "xl/sharedStrings.xml")
    return [_text(entry) for entry in strings.iter(_tag("si"))]


def _text(entry: Xml.Element) -> str:
    """A cell's own text; how it is pronounced stands beside it in Japanese workbooks."""
    runs = (entry, *entry.iter(_tag("is")), *entry.iter(_tag("r")))
    return "".join(text.text or "" for run in runs for text in run.findall(_tag("t")))


def _remarks(sheet: Xml.Element) -> Iterator[tuple[int, str]]:
    """Rows that may be no readings: hidden ones, and those in which a formula takes several rows together."""
    for at, row in enumerate(sheet.iter(_tag("row")), start=1):
        number = int(row.get("r", at))
        if row.get("hidden") in ("1", "true"):
            yield number, "a hidden row; it is read like the others"
        formulas = (cell.findtext(_tag("f")) or "" for cell in row.iter(_tag("c")))
        for text in formulas:
            if any(first != last for first, last in _SPAN.findall(text)):
                yield number, f"the formula '{shown(text)}' takes several rows; it is read like the others"
                break


def _date_styles(archive: zipfile.ZipFile) -> set[str]:
    """The styles of cells that show a number as a date or a time."""
    if "xl/styles.xml" not in archive.namelist():
        return set()
    styles = _part(archive, "xl/styles.xml")
    formats = {str(number) for number in _DATE_FORMATS}
    formats |= {
        one.get("numFmtId", "")
        for one in styles.iter(_tag("numFmt"))
        if _DATE_LETTER.search(_NOT_SHOWN.sub("", one.get("formatCode", "")).replace("General", ""))
    }
    return {
        str(at)
        for cells in styles.iter(_tag("cellXfs"))
        for at, one in enumerate(cells.iter(_tag("xf")))
        if one.get("numFmtId") in formats
    }


def _dated(sheet: Xml.Element, styles: Container[str]) -> Iterator[tuple[int, int]]:
    for cell in sheet.iter(_tag("c")):
        match = _REFERENCE.fullmatch(cell.get("r", ""))
        if match and cell.get("t", "n") == "n" and cell.get("s") in styles:
            yield int(match[2]), _letters(match[1])


def _grid(sheet: Xml.Element, shared: list[str], decimal: str) -> list[list[str]]:
    """The sheet's cells as text, row by row; a formula's last value."""
    grid: list[list[str]] = []
    count = 0
    for row in sheet.iter(_tag("row")):
        number = int(row.get("r", len(grid) + 1))
        if not len(grid) < number <= 1_048_576:
            raise ValueError(f"row {number} is out of order")
        cells: list[str] = []
        for cell in row.iter(_tag("c")):
            match = _REFERENCE.fullmatch(cell.get("r", ""))
            index = _letters(match[1]) if match else len(cells)
            value = cell.findtext(_tag("v")) or _text(cell)
            formula = cell.find(_tag("f"))
            if formula is not None and cell.find(_tag("v")) is None:  # it was never calculated: refused as a number
                value = f"={formula.text or ''}"
            elif cell.get("t", "n") == "n":  # the file has a point, whatever the workbook shows
                value = value.replace(".", decimal)
            if cell.get("t") == "b":  # kept as 0 or 1; an empty one stays empty, and a formula a formula
                value = {"0": "FALSE", "1": "TRUE"}.get(value, value)
            if index < MAX_SERIES and value:
                cells += [""] * (index + 1 - len(cells))
                cells[index] = shared[int(value)] if cell.get("t") == "s" else value
        count += len(cells)
        if count > MAX_CELLS:
            raise ValueError(f"more than {MAX_CELLS} cells")
        if any(cells):
            grid += [[]] * (number - 1 - len(grid))
            grid.append(cells)
    for merged in sheet.iter(_tag("mergeCell")):
        _mark(grid, merged.get("ref", ""))
    return grid


def _mark(grid: list[list[str]], merged: str) -> None:
    """Say so in each row that a merged cell goes down to: it is not empty there, and no reading of that row."""
    first, _, last = merged.partition(":")
    above, below = _REFERENCE.fullmatch(first), _REFERENCE.fullmatch(last)
    if above is None or below is None:
        raise ValueError(f"merged cells '{merged}'")
    index = _letters(above[1])
    for cells in grid[int(above[2]) : int(below[2])] if index < MAX_SERIES else []:
        if any(cells) and not "".join(cells[index : index + 1]):
            cells += [""] * (index + 1 - len(cells))
            cells[index] = f"merged with {first}"


def _letters(letters: str) -> int:
    """A: 0, B: 1, ..., AA: 26."""
    index = 0
    for letter in letters:
        index = 26 * index + ord(letter) - ord("A") + 1
    return index - 1
