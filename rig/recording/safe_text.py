"""What came from outside, fit for a spreadsheet or for JSON."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

_FORMULA = ("=", "+", "-", "@")  # what a spreadsheet would take for a formula


def harmless(text: str) -> str:
    """Text that no spreadsheet runs: a formula gets an apostrophe in front, a number stays."""
    if not text.lstrip().startswith(_FORMULA):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def finite(value: Any, otherwise: Callable[[float], Any] = lambda number: None) -> Any:
    """A value of plain numbers, lists and mappings, in which JSON has a word for every number.

    `otherwise`: what a number that is not finite becomes; null where it is left out.
    """
    if isinstance(value, Mapping):
        return {key: finite(one, otherwise) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, enum.Enum):
        value = value.value
    if isinstance(value, list | tuple | set | frozenset):
        return [finite(one, otherwise) for one in value]
    return otherwise(value) if isinstance(value, float) and not math.isfinite(value) else value
