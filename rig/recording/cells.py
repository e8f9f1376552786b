"""The cells of one column, text to numbers. Text is matched against a pattern, never evaluated."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.recording.mistakes import shown

_PLAIN = re.compile(r"[0-9.eE+\-, ]*")
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_CELL = re.compile(rf"\s*([<>]?)\s*({_NUMBER})\s*", re.ASCII)
_COMMA = re.compile(r"\s*[<>]?\s*[+-]?[0-9]*,[0-9]+\s*", re.ASCII)
_TIME_OF_DAY = re.compile(r".*[0-9]:[0-9]{2}", re.ASCII)
_NOT_SAMPLED = {"nan", "na", "n/a", "null", "none", "-", "--"}
_INFINITE = {"inf", "infinity"}
_SIGN = {"": 0, "<": -1, ">": 1}


@dataclass
class Numbers:
    """The numbers of one column's cells, and what is wrong with any of them (index, sentence)."""

    values: NDArray[np.float64]
    censor: NDArray[np.int8]
    wrong: list[tuple[int, str]] = field(default_factory=list)


def numbers(cells: Sequence[str]) -> Numbers:
    """Read the cells of one column.

    `cells`: their text; an empty one was not sampled, `<10` and `>100` are off the instrument's scale.
    Returns arrays of shape (n,); a wrong cell counts as not sampled.
    """
    if _PLAIN.fullmatch(",".join(cells)):
        try:
            values = np.array([float(cell) if cell else math.nan for cell in cells], dtype=np.float64)
        except ValueError:
            return _one_by_one(cells)
        if not np.isinf(values).any():
            return Numbers(values, np.zeros(len(cells), dtype=np.int8))
    return _one_by_one(cells)


def words(cells: Sequence[str], allowed: tuple[str, ...]) -> tuple[NDArray[np.str_], list[tuple[int, str]]]:
    """Read cells that hold one of a few words, or nothing."""
    stripped = [cell.strip() for cell in cells]
    wrong = [
        (index, f"'{shown(cell)}': expected {' or '.join(allowed)}, or an empty cell")
        for index, cell in enumerate(stripped)
        if cell and cell not in allowed
    ]
    for index, _ in wrong:
        stripped[index] = ""
    width = max(len(word) for word in allowed)
    return np.array(stripped, dtype=f"<U{width}"), wrong


def _one_by_one(cells: Sequence[str]) -> Numbers:
    """The same for cells of which some are not plain numbers."""
    found = Numbers(np.full(len(cells), np.nan), np.zeros(len(cells), dtype=np.int8))
    for index, cell, match in _matched(cells):
        value = float(match[2]) if match else math.inf
        if math.isinf(value):
            found.wrong.append((index, _why(cell)))
        elif match:
            found.values[index] = value
            found.censor[index] = _SIGN[match[1]]
    return found


def _matched(cells: Sequence[str]) -> Iterator[tuple[int, str, re.Match[str] | None]]:
    return ((index, cell, _CELL.fullmatch(cell)) for index, cell in enumerate(cells) if cell and not cell.isspace())


def _why(cell: str) -> str:
    """What is wrong with a cell, and what to write instead."""
    text = cell.strip()
    bare = text.lstrip("+-").lower()
    given = f"'{shown(text)}'"
    if _COMMA.fullmatch(text):
        return f"{given} has a decimal comma; write a decimal point"
    if bare in _INFINITE:
        return f"{given} is no reading; write >LIMIT for a value above the instrument's scale"
    if text.lower() in _NOT_SAMPLED or bare == "nan":
        return f"{given} is no number; leave the cell empty where nothing was sampled"
    if _CELL.fullmatch(text):
        return f"{given} is too large to be a reading; correct it"
    if _TIME_OF_DAY.match(text):
        return f"{given} is not a number but a time of day; write seconds, or bring it in with spinbench runs import"
    return f"{given} is not a number; write digits with a decimal point, or leave the cell empty"
