"""How text is parted into cells: encoding, delimiter, decimal mark. What fits as well as another is told as such."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

from rig.exchange.binary.columns import MAX_BYTES
from rig.exchange.cells import Cell
from rig.exchange.guess.layout import Layout, Rows, is_time, layout_of
from rig.exchange.mapping import TableTable
from rig.runlog.folder import RunError, open_plain

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
    encoding, text = _decoded(data, path)
    lines = text.removeprefix("\ufeff").splitlines()
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
    most = max(fit for fit, *_ in fits)
    best = [found for found in fits if found[0] == most]
    delimiters = list(dict.fromkeys(delimiter for _, delimiter, _, _ in best))
    if delimiters != [" "]:  # which takes a tab for one, and tells no empty cell
        delimiters = [delimiter for delimiter in delimiters if delimiter != " "]
    decimals = list(dict.fromkeys(decimal for _, delimiter, decimal, _ in best if delimiter == delimiters[0]))
    return Text(encoding, delimiters, decimals, best[0][3], whole)


def _decoded(data: bytes, path: Path) -> tuple[str, str]:
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16", data.decode("utf-16", "replace")
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
