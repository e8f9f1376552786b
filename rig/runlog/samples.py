"""samples.csv, read back: every row checked, times to the integer, values to the bit."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping
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
BLOCK_ROWS = 50_000
_DIGITS = re.compile(r"[0-9.e+-]*", re.ASCII)
_QUALITIES = {quality.value for quality in Quality}


def read_samples(path: Path) -> pd.DataFrame:
    """The samples of a run, with the columns that are told at `rig.runlog.reader.Run`.

    `path`: samples.csv; a missing one has no rows.
    Raises RunError: file, line and what is wrong.
    """
    blocks: list[pd.DataFrame] = []
    cells: list[list[str]] = []
    import pandas as pd  # a fifth of a second, which commands that read no samples are spared

    for number, data in whole_lines(path):
        if number == 1:
            if data + b"\n" != rows.HEADER:
                raise RunError(f"{path}, line 1: not the header of a run's samples; this is no run/1 file, or damaged")
            continue
        if number > MAX_SAMPLES:
            raise RunError(f"{path}: more than {MAX_SAMPLES} rows")
        cells.append(_cells(data, f"{path}, line {number}"))
        if len(cells) == BLOCK_ROWS:
            blocks.append(_block(cells, path, number - len(cells) + 1))
            cells = []
    blocks.append(_block(cells, path, sum(len(block) for block in blocks) + 2))
    samples = pd.concat(blocks, ignore_index=True) if len(blocks) > 1 else blocks[0]
    _check_order(samples, path)
    return samples


def _cells(data: bytes, place: str) -> list[str]:
    try:
        text = data.decode("utf-8")
        cells = next(csv.reader([text], strict=True)) if '"' in text else text.split(",")
    except (UnicodeDecodeError, csv.Error):
        raise RunError(f"{place}: not a row of CSV in UTF-8; the file is damaged") from None
    if len(cells) != len(rows.COLUMNS):
        raise RunError(f"{place}: {len(cells)} cells, expected {len(rows.COLUMNS)}; the file is damaged")
    return cells


def _block(cells: list[list[str]], path: Path, first: int) -> pd.DataFrame:
    """Some rows as a table; `first` is the line of the first."""
    import pandas as pd

    columns = dict(zip(rows.COLUMNS, zip(*cells, strict=True) if cells else [()] * len(rows.COLUMNS), strict=True))
    block: dict[str, object] = {}
    for name, texts in columns.items():
        try:
            block |= _converted(name, texts)
        except (ValueError, OverflowError):
            index = next(index for index, text in enumerate(texts) if not _is_right(name, text))
            place = f"{path}, line {first + index}, column {name}"
            raise RunError(f"{place}: '{shown(texts[index])}' is not what a run holds there; damaged") from None
    return pd.DataFrame(block)


def _converted(name: str, texts: Iterable[str]) -> dict[str, object]:
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


def _check_order(samples: pd.DataFrame, path: Path) -> None:
    n, exchange = samples["n"].to_numpy(), samples["exchange"].to_numpy()
    wrong = np.flatnonzero((n != np.arange(1, len(n) + 1)) | (np.diff(exchange, prepend=1) < 0))
    if wrong.size:
        line = int(wrong[0]) + 2
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
