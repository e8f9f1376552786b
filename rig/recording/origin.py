"""Where a recording comes from: its date, and the run that it is an export of.

The date is in ISO 8601: it tells which recording is the earlier one. The run stands at the end of the note, where
recording/1 has no key.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Any

NOT_ISO = "is not ISO 8601 (year-month-day, such as 2026-05-28)"
_OF_RUN = re.compile(r"(?:^|; )run (\S{1,200}), bench (.{1,200}?)(?:, seal ([0-9a-f]{64}))?$")


def of_run(run: str, bench: str, seal: str = "") -> str:
    """The end of its note. `seal`: SHA-256 of what the bench conceals; empty where it conceals nothing."""
    return f"run {run}, bench {bench}" + (f", seal {seal}" if seal else "")


def run_bench_and_seal(origin: Any) -> tuple[str, str, str] | None:
    """Names of run and bench, and the seal of one that conceals something, by an [origin]; None where it has none."""
    found = _OF_RUN.search(str(origin.get("note", ""))) if isinstance(origin, dict) else None
    return None if found is None else (found[1], found[2], found[3] or "")


def parsed(text: str | None) -> datetime | None:
    """An ISO date, in UTC where no other zone is said; None of what is none."""
    try:
        taken = datetime.fromisoformat(text or "")
    except ValueError:
        return None
    return taken if taken.tzinfo else taken.replace(tzinfo=UTC)


def mistake_in(text: str) -> str:
    """What is wrong with the date of data taken by now: not ISO 8601, or still to come; empty where nothing is."""
    if parsed(text) is None:
        return NOT_ISO
    taken = datetime.fromisoformat(text)
    return "is still to come" if taken > datetime.now(taken.tzinfo) else ""
