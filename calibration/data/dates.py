"""When recordings were taken: `date` in their [origin], where somebody noted it."""

from __future__ import annotations

from datetime import UTC, datetime

from rig.recording import Recording


def date_of(recording: Recording) -> datetime | None:
    """When a recording was taken; None where that is not noted as an ISO date."""
    return parsed(recording.origin.get("date"))


def day_of(recording: Recording) -> str:
    """The day on which a recording was taken, by its date; where it has none, one of its own."""
    return recording.origin.get("date", "")[: len("2026-05-28")] or str(recording.folder)


def parsed(text: str | None) -> datetime | None:
    """An ISO date, in UTC where no other zone is said; None of what is none."""
    try:
        taken = datetime.fromisoformat(text or "")
    except ValueError:
        return None
    return taken if taken.tzinfo else taken.replace(tzinfo=UTC)


def as_text(taken: datetime | None) -> str | None:
    """A date as ISO has it, without a time of day where there is none."""
    if taken is None:
        return None
    is_day = taken.timetz() == datetime.min.replace(tzinfo=UTC).timetz()
    return taken.date().isoformat() if is_day else taken.isoformat()
