"""A CSV file's rows, a megabyte at a time, so that a file of any size is read in bounded memory."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO

from rig.recording.mistakes import shown

BLOCK_BYTES = 1 << 20
MAX_LINE_BYTES = 65_536


class UnreadableError(Exception):
    """The file is no CSV text. `where` is the row, as far as it is known; the text says what to do."""

    def __init__(self, where: str, what: str) -> None:
        super().__init__(what)
        self.where = where


@dataclass
class Block:
    """Some rows in a stretch: the number of the first (0 is the header), the cells of each, and broken rows."""

    first: int
    rows: list[list[str]]
    broken: list[tuple[int, str]]


def blocks(stream: BinaryIO, seen: Callable[[bytes], None]) -> Iterator[Block]:
    """Read a CSV file in stretches of rows.

    `stream`: UTF-8 text, with or without a byte order mark; lines end in LF or CRLF.
    `seen`: called with all the bytes, in order: for a digest, for a progress bar.
    Yields the rows, the header first; a blank line is a row without cells. Raises UnreadableError when it is no text,
    not UTF-8, or has no lines.
    """
    first = 0
    for raw in _whole_lines(stream, seen):
        data = raw.removeprefix(codecs.BOM_UTF8) if first == 0 else raw
        lines = _text(data, first).removesuffix("\n").split("\n")
        rows, broken = _split(lines, first)
        yield Block(first, rows, broken)
        first += len(lines)


def row_name(number: int) -> str:
    """What a person calls a line: the header, or row 1, 2, ... under it."""
    return f"row {number}" if number else "header"


def _whole_lines(stream: BinaryIO, seen: Callable[[bytes], None]) -> Iterator[bytes]:
    rest = b""
    while chunk := stream.read(BLOCK_BYTES):
        seen(chunk)
        head, newline, rest = (rest + chunk).rpartition(b"\n")
        if newline:
            yield head + newline
        if len(rest) > MAX_LINE_BYTES:
            _refuse_binary(rest, "")
            raise UnreadableError(
                "", f"a line longer than {MAX_LINE_BYTES} bytes; is this a CSV file with LF or CRLF ends?"
            )
    if rest:
        yield rest


def _text(data: bytes, first: int) -> str:
    _refuse_binary(data, row_name(first + data.count(b"\n", 0, max(data.find(b"\0"), 0))))
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        where = row_name(first + data.count(b"\n", 0, error.start))
        raise UnreadableError(
            where, f"the byte 0x{data[error.start]:02x} is not UTF-8; save the file as UTF-8"
        ) from None


def _refuse_binary(data: bytes, where: str) -> None:
    if b"\0" in data:
        raise UnreadableError(where, "a zero byte: this is a binary file, or UTF-16; export the table as CSV in UTF-8")


def _split(lines: list[str], first: int) -> tuple[list[list[str]], list[tuple[int, str]]]:
    """The cells of each line; a line whose quotes do not close is broken, and has none."""
    try:
        rows = list(csv.reader(lines, strict=True))
        if len(rows) == len(lines):
            return rows, []
    except csv.Error:
        pass
    rows, broken = [], []
    for number, line in enumerate(lines, start=first):
        try:
            rows.append(next(csv.reader([line], strict=True)))
        except (csv.Error, StopIteration):
            rows.append([])
            broken.append((number, f"'{shown(line)}' has {_cause(line)}; write one row a line, numbers without quotes"))
    return rows, broken


def _cause(line: str) -> str:
    if len(line) > MAX_LINE_BYTES:
        return "too many characters for a row"
    if "\r" in line.rstrip("\r"):
        return "a bare carriage return"
    return "a quotation mark that does not close"
