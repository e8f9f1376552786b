"""Reading tables that were taken elsewhere: CSV, TDMS, MATLAB and workbook files, each to columns of cells.

A cell is text as it stood, or a float. Files are untrusted: bounded in size, parsed and never evaluated.
"""

from __future__ import annotations

import csv
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np

from rig.exchange.mapping import TableTable
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain, read_bytes

MAX_BYTES = 500_000_000
MAX_PART_BYTES = 200_000_000  # of a workbook, unpacked
MAX_COLUMNS = 4096
WAVEFORM_TIME = "@time"  # the time track of a TDMS channel
Cells = list[str] | list[float]
_REFERENCE = re.compile(r"([A-Z]{1,3})([0-9]{1,7})")


@dataclass(frozen=True)
class Table:
    """A table's columns.

    Attributes
    ----------
    headings : list of str
        Empty where the file has none.
    """

    place: str
    headings: list[str]
    columns: list[Cells]
    lines: Sequence[int]

    def column(self, key: str | int) -> Cells:
        """A column's cells.

        Raises
        ------
        RunError
            When there is no such column, or the heading stands twice.
        """
        if isinstance(key, int):
            if key <= len(self.columns):
                return self.columns[key - 1]
            raise RunError(f"{self.place}: there is no column {key}; it has {len(self.columns)}")
        found = [index for index, heading in enumerate(self.headings) if heading == key]
        if len(found) == 1:
            return self.columns[found[0]]
        if found:
            raise RunError(f"{self.place}: {len(found)} columns are called '{shown(key)}'; give the place of one")
        listed = ", ".join(f"'{shown(heading)}'" for heading in self.headings[:40]) or "the file has no headings"
        raise RunError(f"{self.place}: no column is called '{shown(key)}'; there are {listed}")


def read_table(path: Path, table: TableTable, sheet: str = "", group: str = "") -> Table:
    """Read a table.

    Raises
    ------
    RunError
        When the file is not what the mapping says.
    """
    readers: dict[str, Callable[[], Table]] = {
        "csv": lambda: _csv(path, table),
        "tdms": lambda: _tdms(path, group or table.group),
        "mat": lambda: _mat(path),
        "xlsx": lambda: _xlsx(path, table, sheet or table.sheet),
    }
    return readers[table.reader]()


def _csv(path: Path, table: TableTable) -> Table:
    try:
        text = read_bytes(path, MAX_BYTES).decode(table.encoding).removeprefix("\ufeff")
    except UnicodeError:
        raise RunError(f"{path}: not {table.encoding} text; say its encoding in [table]") from None
    try:
        rows = list(csv.reader(text.splitlines(), delimiter=table.delimiter or ",", strict=True))
    except csv.Error as error:
        raise RunError(f"{path}: not a table of CSV ({error})") from None
    return _from_rows(str(path), [[cell.strip() for cell in row] for row in rows], table)


def _from_rows(place: str, rows: list[list[str]], table: TableTable) -> Table:
    headings = rows[table.heading_line - 1] if 0 < table.heading_line <= len(rows) else []
    first = table.first_line or table.heading_line + 1
    data = [(number, row) for number, row in enumerate(rows[first - 1 :], start=first) if any(row)]
    if not data:
        raise RunError(f"{place}: no rows from line {first} on")
    width = len(headings) or len(data[0][1])
    if width > MAX_COLUMNS:
        raise RunError(f"{place}: {width} columns; at most {MAX_COLUMNS} are read")
    for number, row in data:
        if len(row) > width and any(row[width:]):
            raise RunError(f"{place}, line {number}: {len(row)} cells, expected {width}; is the delimiter right?")
    columns: list[Cells] = [[row[index] if index < len(row) else "" for _, row in data] for index in range(width)]
    return Table(place, headings, columns, [number for number, _ in data])


def _tdms(path: Path, group: str) -> Table:
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise RunError(
            'a TDMS file needs the package npTDMS; install it with `pip install "spinbench[formats]"`'
        ) from None
    with open_plain(path, MAX_BYTES) as stream:
        try:
            file = TdmsFile.read(stream)
            groups = {found.name: found.channels() for found in file.groups()}
        except Exception as error:  # whatever a damaged file makes the package stumble over
            raise RunError(f"{path}: not a TDMS file that can be read ({shown(str(error), 100)})") from None
    name = group or (next(iter(groups)) if len(groups) == 1 else "")
    if name not in groups:
        listed = ", ".join(f"'{shown(found)}'" for found in groups)
        raise RunError(f"{path}: name the group of channels in [table]: group = one of {listed or 'none: it is empty'}")
    headings, columns = [], []
    for channel in groups[name]:
        headings.append(channel.name)
        columns.append(_numbers(np.asarray(channel[:]), f"{path}, group '{shown(name)}', '{shown(channel.name)}'"))
        if WAVEFORM_TIME not in headings and "wf_increment" in channel.properties:
            headings.append(WAVEFORM_TIME)
            columns.append(np.asarray(channel.time_track(), dtype=np.float64).tolist())
    return _of_one_length(f"{path}, group '{shown(name)}'", headings, columns)


def _mat(path: Path) -> Table:
    from scipy.io import loadmat

    with open_plain(path, MAX_BYTES) as stream:
        try:
            found: dict[str, Any] = loadmat(stream, chars_as_strings=False, struct_as_record=True)
        except NotImplementedError:
            raise RunError(f"{path}: a MATLAB 7.3 file; save it with -v7") from None
        except Exception as error:  # as above
            raise RunError(f"{path}: not a MATLAB file that can be read ({shown(str(error), 100)})") from None
    headings, columns = [], []
    for name, array in found.items():
        is_vector = isinstance(array, np.ndarray) and array.ndim == 2 and 1 in array.shape and array.size > 1
        if not name.startswith("__") and is_vector and np.issubdtype(array.dtype, np.number):
            headings.append(name)
            columns.append(_numbers(array.ravel(), f"{path}, {shown(name)}"))
    return _of_one_length(str(path), headings, columns)


def _numbers(array: np.ndarray, place: str) -> Cells:
    if np.issubdtype(array.dtype, np.datetime64):
        return [str(time) for time in array.astype("datetime64[us]")]
    if np.issubdtype(array.dtype, np.number) and not np.iscomplexobj(array):
        return [float(value) for value in array]
    if array.dtype.kind in "OUS":
        return [str(value) for value in array]
    raise RunError(f"{place}: holds {array.dtype}, neither numbers nor text")


def _of_one_length(place: str, headings: list[str], columns: list[Cells]) -> Table:
    if not columns:
        raise RunError(f"{place}: holds no column of numbers")
    if len({len(column) for column in columns}) > 1:
        listed = ", ".join(f"'{shown(name)}' {len(cells)}" for name, cells in zip(headings, columns, strict=True))
        raise RunError(f"{place}: the columns differ in length ({listed}); save those that belong together")
    return Table(place, headings, columns, range(1, len(columns[0]) + 1 if columns else 1))


def _xlsx(path: Path, table: TableTable, sheet: str) -> Table:
    try:
        with open_plain(path, MAX_BYTES) as stream, zipfile.ZipFile(stream) as archive:
            part = _sheet_part(archive, sheet, path)
            shared = _shared(archive)
            grid = _grid(archive, part, shared)
    except (
        zipfile.BadZipFile,
        KeyError,
        IndexError,
        ValueError,
        EOFError,
        NotImplementedError,
        Xml.ParseError,
    ) as error:
        if isinstance(error, RunError):
            raise
        raise RunError(f"{path}: not a workbook (.xlsx) that can be read ({shown(str(error), 100)})") from None
    return _from_rows(f"{path}, sheet '{shown(sheet)}'", grid, table)


def _part(archive: zipfile.ZipFile, name: str) -> Xml.Element:
    if archive.getinfo(name).file_size > MAX_PART_BYTES:
        raise ValueError(f"{name} is larger than {MAX_PART_BYTES} bytes")
    data = archive.read(name)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise ValueError("it declares XML entities")
    return Xml.fromstring(data)  # noqa: S314 - see the import


def _sheet_part(archive: zipfile.ZipFile, sheet: str, path: Path) -> str:
    relation = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id"
    sheets = {
        found.get("name", ""): found.get(relation) for found in _part(archive, "xl/workbook.xml").iter(_tag("sheet"))
    }
    if sheet not in sheets:
        listed = ", ".join(f"'{shown(name)}'" for name in sheets)
        raise RunError(f"{path}: name the sheet in [table] or [[files]]: sheet = one of {listed}")
    for found in _part(archive, "xl/_rels/workbook.xml.rels"):
        if found.get("Id") == sheets[sheet]:
            return f"xl/{found.get('Target', '').removeprefix('/xl/')}"
    raise ValueError(f"the sheet '{sheet}' has no part")


def _tag(name: str) -> str:
    return f"{{http://schemas.openxmlformats.org/spreadsheetml/2006/main}}{name}"


def _shared(archive: zipfile.ZipFile) -> list[str]:
    if "xl/sharedStrings.xml" not in archive.namelist():
        return []
    strings = _part(archive, "xl/sharedStrings.xml")
    return ["".join(text.text or "" for text in entry.iter(_tag("t"))) for entry in strings.iter(_tag("si"))]


def _grid(archive: zipfile.ZipFile, part: str, shared: list[str]) -> list[list[str]]:
    """The sheet's cells as text, row by row; a formula's last value."""
    grid: list[list[str]] = []
    for row in _part(archive, part).iter(_tag("row")):
        number = int(row.get("r", len(grid) + 1))
        if not len(grid) < number <= 1_048_576:
            raise ValueError(f"row {number} is out of order")
        cells: list[str] = []
        for cell in row.iter(_tag("c")):
            match = _REFERENCE.fullmatch(cell.get("r", ""))
            index = _letters(match[1]) if match else len(cells)
            value = cell.findtext(_tag("v")) or "".join(text.text or "" for text in cell.iter(_tag("t")))
            if index < MAX_COLUMNS and value:
                cells += [""] * (index + 1 - len(cells))
                cells[index] = shared[int(value)] if cell.get("t") == "s" else value
        if any(cells):
            grid += [[]] * (number - 1 - len(grid))
            grid.append(cells)
    return grid


def _letters(letters: str) -> int:
    """A: 0, B: 1, ..., AA: 26."""
    index = 0
    for letter in letters:
        index = 26 * index + ord(letter) - ord("A") + 1
    return index - 1
