"""Which blocks of registers a device is read in, where its map has holes, or is longer than one question bears."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Table = Literal["holding", "input"]


@dataclass(frozen=True, slots=True, order=True)
class Span:
    """Registers that follow each other in one table. `first`: as on the wire."""

    table: Table
    first: int
    count: int

    @property
    def end(self) -> int:
        """The register after the last."""
        return self.first + self.count

    def holds(self, other: Span) -> bool:
        """Whether all of another's registers are among these."""
        return self.table == other.table and self.first <= other.first and other.end <= self.end

    def __str__(self) -> str:
        """In words."""
        return f"{self.table} {self.first} to {self.end - 1}" if self.count > 1 else f"{self.table} {self.first}"


def blocks_of(values: Iterable[Span], largest_gap: int | None, most: int) -> tuple[Span, ...]:
    """The blocks that hold all values, each of them whole.

    `largest_gap`: registers between two values that may be read though no value is in them; any number when None.
    `most`: registers in one question; no value is longer.
    """
    blocks: list[Span] = []
    for value in sorted(values):
        if blocks and blocks[-1].table == value.table:
            last = blocks[-1]
            count = max(last.end, value.end) - last.first
            if count <= most and (largest_gap is None or value.first - last.end <= largest_gap):
                blocks[-1] = Span(last.table, last.first, count)
                continue
        blocks.append(value)
    return tuple(blocks)
