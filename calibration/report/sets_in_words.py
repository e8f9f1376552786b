"""Effects and sets of effects as a person calls them."""

from __future__ import annotations

from collections.abc import Sequence

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
