"""samples.csv, read back: every row checked, times to the integer, values to the bit."""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rig.readings import NS, Quality, Reading
from rig.recording.mistakes import shown
from rig.runlog import rows
from rig.runlog.folder import RunError
from rig.runlog.lines import whole_lines

if TYPE_CHECKING:
    import pandas as pd

MAX_SAMPLES = 20_000_000
BLOCK_ROWS = 10_000
_DIGITS = re.compile(r"[0-9.e+-]*", re.ASCII)
_QUALITIES = {quality.value for quality in Quality}


def read_samples(path: Path) -> pd.DataFrame:
    """The samples of a run, with the columns that are told at `rig.runlog.reader.Run`.

    `path`: samples.csv; a missing one has no rows.
    Raises RunError: file, line and what is wrong.
    """
    import pandas as pd  # a fifth of a second, which commands that read no samples are spared

    blocks = [pd.DataFrame(block) for block in blocks_of(path)]
    return pd.concat(blocks, ignore_index=True) if len(blocks) > 1 else blocks[0]


def blocks_of(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """The samples of a run in blocks that follow each other, one at least, with the columns of `read_samples`.

    `path`: samples.csv; a missing one has no rows.
    Raises RunError: file, line and what is wrong.
    """
    lines, exchange, begun = whole_lines(path), 1, False
    while (several := list(itertools.islice(lines, BLOCK_ROWS))) or not begun:
        block, begun = columns_of(several, path, exchange), True
        exchange = int(block["exchange"][-1]) if len(block["exchange"]) else exchange
        yield block


def columns_of(lines: Sequence[tuple[int, bytes]], path: Path, exchange: int) -> dict[str, np.ndarray]:
    """Some lines that follow each other, by column; the header is none of the rows.

    `lines`: with their numbers, from 1.
    `exchange`: of the row before them, 1 where there is none [-].
    Raises RunError: file, line and what is wrong.
    """
    if lines and lines[0][0] == 1:
        if lines[0][1] + b"\n" != rows.HEADER:
            raise RunError(f"{path}, line 1: not the header of a run's samples; this is no run/1 file, or damaged")
        lines = lines[1:]
    if lines and lines[-1][0] > MAX_SAMPLES:
        raise RunError(f"{path}: more than {MAX_SAMPLES} rows")
    first = lines[0][0] if lines else 2
    columns = _columns([_cells(data, f"{path}, line {number}") for number, data in lines], path, first)
    _check_order(columns, path, first, exchange)
    return columns


def _cells(data: bytes, place: str) -> list[str]:
    try:
        text = data.decode("utf-8")
        cells = next(csv.reader([text], strict=True)) if '"' in text else text.split(",")
    except (UnicodeDecodeError, csv.Error):
        raise RunError(f"{place}: not a row of CSV in UTF-8; the file is damaged") from None
    if len(cells) != len(rows.COLUMNS):
        raise RunError(f"{place}: {len(cells)} cells, expected {len(rows.COLUMNS)}; the file is damaged")
    return cells


def _columns(cells: list[list[str]], path: Path, first: int) -> dict[str, np.ndarray]:
    """Some rows by column; `first` is the line of the first."""
    columns = dict(zip(rows.COLUMNS, zip(*cells, strict=True) if cells else [()] * len(rows.COLUMNS), strict=True))
    block: dict[str, np.ndarray] = {}
    for name, texts in columns.items():
        try:
            block |= _converted(name, texts)
        except (ValueError, OverflowError):
            index = next(index for index, text in enumerate(texts) if not _is_right(name, text))
            place = f"{path}, line {first + index}, column {name}"
            raise RunError(f"{place}: '{shown(texts[index])}' is not what a run holds there; damaged") from None
    return block


def _converted(name: str, texts: Iterable[str]) -> dict[str, np.ndarray]:
    """A column's cells as numbers or text; ValueError when one of them is not what it should be."""
    if name in ("n", "exchange", "retries", "censored", "value") and not _DIGITS.fullmatch("".join(texts)):
        raise ValueError  # Python reads more as a number than a run holds: 1_000, digits of other scripts
    if name in ("n", "exchange", "retries", "censored"):
        return {name: np.array([int(text) for text in texts], dtype=np.int64)}
    if name == "value":
        values = np.array([float(text) if text else np.nan for text in texts], dtype=np.float64)
        if np.isinf(values).any() or (np.isnan(values) != np.array([not text for text in texts], dtype=bool)).any():
            raise ValueError
        return {name: values}
    if name in ("time_s", "request_s", "reply_s"):
        ns = np.array([rows.nanoseconds(text) for text in texts], dtype=np.int64)
        stem = name.removesuffix("_s")
        return {f"{stem}_ns": ns} | ({"time_s": ns / NS} if name == "time_s" else {})
    if name == "quality" and not set(texts) <= _QUALITIES:
        raise ValueError
    plain = [rows.unescaped(text) for text in texts]
    return {name: np.array(plain, dtype=object)}


def _is_right(name: str, text: str) -> bool:
    try:
        _converted(name, (text,))
    except (ValueError, OverflowError):
        return False
    return True


def _check_order(columns: Mapping[str, np.ndarray], path: Path, first: int, exchange: int) -> None:
    n = columns["n"]
    wrong = np.flatnonzero((n != np.arange(len(n)) + first - 1) | (np.diff(columns["exchange"], prepend=exchange) < 0))
    if wrong.size:
        line = int(wrong[0]) + first
        raise RunError(
            f"{path}, line {line}: number {n[wrong[0]]}, expected {line - 1}; rows are missing or not in order"
        )


def reading_of(cells: Mapping[str, np.ndarray], row: int) -> Reading:
    """The reading of a row, bit for bit as it was written."""
    value = float(cells["value"][row])
    return Reading(
        device=cells["device"][row],
        channel=cells["channel"][row],
        value=None if math.isnan(value) else value,
        unit=cells["unit"][row],
        quality=Quality(cells["quality"][row]),
        time_ns=int(cells["time_ns"][row]),
        request_ns=int(cells["request_ns"][row]),
        reply_ns=int(cells["reply_ns"][row]),
        retries=int(cells["retries"][row]),
        raw=cells["raw"][row],
        detail=cells["detail"][row],
        censored=int(cells["censored"][row]),
    )
