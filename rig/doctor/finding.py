"""One result of an examination, and the table of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

MOST_CHARACTERS = 600
STYLES = {"ok": "green", "warning": "yellow", "fault": "bold red"}


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARNING = "warning"  # works, but costs rate or may bite later
    FAULT = "fault"  # a run would not start, or would miss readings


@dataclass(frozen=True)
class Finding:
    """One thing found. `fix`: what to do; empty when there is nothing."""

    level: Level
    where: str
    what: str
    fix: str = ""


def printable(text: str) -> str:
    """Text that came from a device or the system, fit for a terminal: one line, bounded, no control characters."""
    clean = "".join(character if character.isprintable() else "\N{REPLACEMENT CHARACTER}" for character in text)
    return clean if len(clean) <= MOST_CHARACTERS else clean[: MOST_CHARACTERS - 3] + "..."


def table(findings: Sequence[Finding]) -> Table:
    """The findings as a table for a terminal."""
    from rich.table import Table
    from rich.text import Text

    shown = Table("", "where", "what", "what to do", show_lines=False)
    for finding in findings:
        level = Text(finding.level.value, style=STYLES[finding.level.value])
        shown.add_row(level, *(Text(printable(text)) for text in (finding.where, finding.what, finding.fix)))
    return shown
