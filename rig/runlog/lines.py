"""The whole lines of a file that a killed program may have left with a torn last one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from rig.runlog.folder import MAX_FILE_BYTES, RunError, open_plain

BLOCK_BYTES = 1 << 20
MAX_LINE_BYTES = 64 << 20


def torn_bytes(path: Path) -> int:
    """How many bytes at the end of a file belong to no whole line [bytes].

    A line is whole when it ends in a line feed. A power cut may leave zero bytes where the last rows should be: a line
    of which the file holds nothing but zeros to its end is torn too.
    """
    with open_plain(path, MAX_FILE_BYTES) as stream:
        size, whole = _sizes(stream)
    return size - whole


def _sizes(stream: BinaryIO, begin: int = 0) -> tuple[int, int]:
    """What a file holds, and how much of it is whole lines [bytes]; somebody may be writing on.

    `begin`: where a line begins; what is before it is not looked at [bytes].
    """
    size = end = stream.seek(0, 2)
    only_zeros = True
    while end > begin:
        start = max(begin, end - BLOCK_BYTES)
        stream.seek(start)
        block = stream.read(end - start)
        if only_zeros:
            block = block.rstrip(b"\0")
            only_zeros = not block
        newline = block.rfind(b"\n")
        if newline >= 0:
            return size, start + newline + 1
        end = start
    return size, begin


def whole_lines(path: Path, number: int = 0, begin: int = 0) -> Iterator[tuple[int, bytes]]:
    """The lines of a file, from 1, without their line feeds; a torn last line is left out.

    `path`: the file; a missing one has no lines.
    `number`, `begin`: of the lines that are left out at its beginning: how many [-], and where they end [bytes].
    Raises RunError when it is no plain file or no text.
    """
    if not path.exists() and not path.is_symlink():
        return
    with open_plain(path, MAX_FILE_BYTES) as stream:
        left = _sizes(stream, begin)[1] - begin
        stream.seek(begin)
        while left > 0:
            line = stream.readline(min(left, MAX_LINE_BYTES))
            left -= len(line)
            number += 1
            if not line.endswith(b"\n"):
                raise RunError(f"{path}, line {number}: longer than {MAX_LINE_BYTES} bytes; this is no file of a run")
            if b"\0" in line:
                raise RunError(f"{path}, line {number}: holds zero bytes; the file is damaged")
            yield number, line[:-1]
