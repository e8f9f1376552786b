"""Effects and sets of effects as a person calls them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from model.effects import effects


def titles(names: Sequence[str]) -> str:
    """A set of effects as people call them, each in quotes with its id.

    `names`: effect ids; what is none stands as it is.
    """
    known = effects()
    return listed([f"“{title(name)}”" if name in known else name for name in names]) or "nothing left out"


def title(name: str) -> str:
    """An effect as people call it, with its id."""
    return f"{effects()[name].title} ({name})"


def shared_and_rest(sets: Sequence[Sequence[str]]) -> tuple[list[str], list[list[str]]]:
    """The effects that every set has, and what each has beside them."""
    shared = [name for name in sets[0] if all(name in one for one in sets)]
    rest = [[name for name in one if name not in shared] for one in sets]
    return shared, [one or ["nothing more"] for one in rest] if shared else rest


def alternatives(found: Mapping[str, Any], most: int) -> list[tuple[str, str]]:
    """Rows of a diagnosis's alternatives, and one of what every explanation has.

    `most`: that are told.
    """
    shared, _ = shared_and_rest([[one["id"] for one in found["effects"]], *found["alternatives"]])
    rows = [("or", titles(names)) for names in found["alternatives"][:most]]
    return [*rows, ("in all of them", titles(shared))] if rows and shared else rows


def in_a_row(sets: Sequence[Sequence[str]], word: str) -> str:
    """Sets of effects in a row; where one has several members a comma tells where it ends."""
    *first, last = [titles(names) for names in sets]
    if not first:
        return last
    comma = "," if any(len(names) > 1 for names in sets) else ""
    return f"{', '.join(first)}{comma} {word} {last}"


def listed(words: Sequence[str]) -> str:
    """Words with commas, and an "and" before the last."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
