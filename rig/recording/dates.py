"""The date on which something was taken, in ISO 8601: what tells which recording is the earlier one."""

from __future__ import annotations

from datetime import UTC, datetime

NOT_ISO = "is not ISO 8601 (year-month-day, such as 2026-05-28)"


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
