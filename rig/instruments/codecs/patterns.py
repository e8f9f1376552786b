"""Regular expressions out of a file: refused where some text could keep them busy forever."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from typing import Any

_PARSER: Any = importlib.import_module("re._parser")  # the one way to look into a pattern
MOST_OPEN_REPEATS = 4  # of a pattern over so short a text as a reply
OPEN_SPAN = 16  # a repeat that may take so many characters more or less is open-ended


def groups_of(pattern: str, key: str) -> set[str]:
    """The named groups of a pattern that cannot take long.

    Raises ValueError when it is no regular expression, or could take forever on some text.
    """
    try:
        compiled = re.compile(pattern)
        opened, nested = _repeats(_PARSER.parse(pattern), inside=False)
    except (re.error, OverflowError, RecursionError) as error:
        raise ValueError(f"{key}: not a regular expression: {error}") from None
    if nested or opened > MOST_OPEN_REPEATS:
        raise ValueError(
            f"{key}: could take forever on some text; repeat nothing that repeats itself, refer to no group, and make "
            f"all open-ended repeats but {MOST_OPEN_REPEATS} possessive (\\d++ in place of \\d+)"
        )
    return set(compiled.groupindex)


def _repeats(parsed: Any, inside: bool) -> tuple[int, bool]:
    """Open-ended repeats that may give back what they took, and whether one stands in another."""
    opened, nested = 0, False
    for operation, argument in parsed:
        name, within = str(operation), inside
        if name.endswith("_REPEAT"):
            least, most, _ = argument
            variable = most - least > 1
            nested |= inside and variable
            opened += most - least > OPEN_SPAN and name != "POSSESSIVE_REPEAT"
            within |= most > 1
        nested |= name.startswith("GROUPREF")
        for inner in _inner(argument):
            more, deeper = _repeats(inner, within)
            opened, nested = opened + more, nested or deeper
    return opened, nested


def _inner(argument: Any) -> Iterator[Any]:
    """The patterns within a part of a pattern."""
    if isinstance(argument, _PARSER.SubPattern):
        yield argument
    elif isinstance(argument, (tuple, list)):
        for part in argument:
            yield from _inner(part)
