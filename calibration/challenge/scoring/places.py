"""Whether a diagnosis found the place: balance, channel, and the coordinate with its range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Located:
    """One place against the truth.

    `balance`, `channel`, `coordinate`: whether each is right; the coordinate also when it is in the group of those that
        cannot be told apart.
    `group`: size of that group, 1 where the diagnosis can tell the coordinate from all others; 0 where it is wrong [-].
    `overlaps`: whether the ranges meet; None where they are along different coordinates, or the truth has none.
    """

    balance: bool
    channel: bool
    coordinate: bool
    group: int
    overlaps: bool | None

    @property
    def right(self) -> bool:
        """All of it."""
        return self.balance and self.channel and self.coordinate and self.overlaps is not False


NOWHERE = Located(False, False, False, 0, None)


def first_place(truth: Mapping[str, Any], located: Sequence[Mapping[str, Any]]) -> Located:
    """The place that the diagnosis puts first.

    `truth`: ``balance``, ``channel``, ``coordinate`` (each a word, or a list of those that are right) and ``where``; of
        several effects ``any_of``, a place each.
    """
    return compare(truth, located[0]) if located else NOWHERE


def any_place(truth: Mapping[str, Any], located: Sequence[Mapping[str, Any]]) -> Located:
    """The first of all places that is right; else the first."""
    compared = [compare(truth, place) for place in located]
    return next((one for one in compared if one.right), compared[0] if compared else NOWHERE)


def compare(truth: Mapping[str, Any], place: Mapping[str, Any]) -> Located:
    """One place against the truth; of several that are true, against the one that is nearest to it."""
    compared = [_compare(one, place) for one in truth.get("any_of", [truth])]
    return max(compared, key=lambda one: (one.right, one.balance + one.channel + one.coordinate))


def _compare(truth: Mapping[str, Any], place: Mapping[str, Any]) -> Located:
    group = [place["coordinate"], *place["same_as"]]
    wanted = _words(truth.get("coordinate"))
    said = not wanted or place["coordinate"] in wanted
    right = said or any(one in wanted for one in group)
    where = truth.get("where")
    overlaps = None
    if said and wanted and where is not None:
        overlaps = place["where"][0] <= where[1] and where[0] <= place["where"][1]
    return Located(
        _among(truth.get("balance"), place["balance"]),
        _among(truth.get("channel"), place["channel"]),
        right,
        len(group) if right else 0,
        overlaps,
    )


def _words(wanted: Any) -> list[str]:
    if wanted is None:
        return []
    return [wanted] if isinstance(wanted, str) else list(wanted)


def _among(wanted: Any, said: str) -> bool:
    """Whether a word is right; any is where the truth has none."""
    words = _words(wanted)
    return not words or said in words
