"""When recordings were taken: `date` in their [origin], where somebody noted it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

from rig.recording import Recording, RecordingError
from rig.recording.mistakes import shown
from rig.recording.origin import NOT_ISO, parsed

Item = TypeVar("Item")


def date_of(recording: Recording) -> datetime | None:
    """When a recording was taken; None where that is not noted as an ISO date."""
    return parsed(recording.origin.get("date"))


def day_of(recording: Recording) -> str:
    """The day on which a recording was taken, by its ISO date; where it has none, one of its own."""
    taken = date_of(recording)
    return str(recording.folder) if taken is None else taken.date().isoformat()


def moment_of(recording: Recording) -> datetime | None:
    """When a recording's clock showed 0, in no zone where its date says none; None where it says no time of day."""
    text = recording.origin.get("date", "")
    is_known = len(text) > len("2026-05-28") and date_of(recording) is not None
    return datetime.fromisoformat(text) if is_known else None


def refuse_other_than_iso(dates: Mapping[Path, str]) -> None:
    """Refuse dates that nothing can be ordered by.

    `dates`: of each recording, as it states it; empty where it does not.
    Raises RecordingError: which they are.
    """
    strange = [f"{folder} '{shown(text)}'" for folder, text in dates.items() if text and parsed(text) is None]
    if strange and len(dates) > 1:
        raise RecordingError(
            f"no history without the order of its dates, and [origin] date {NOT_ISO} in {', '.join(strange)}; write it "
            "so there, or take it out of all of them: they then stand in the order given"
        )


def in_order(items: Sequence[Item], taken: Callable[[Item], datetime | None]) -> list[Item]:
    """Items from the oldest to the newest; as they are given where one has no date."""
    moments = [taken(one) for one in items]
    known = [one for one in moments if one is not None]
    if len(known) < len(moments):
        return list(items)
    return [items[i] for i in sorted(range(len(items)), key=known.__getitem__)]


def as_text(taken: datetime | None) -> str | None:
    """A date as ISO has it, without a time of day where there is none."""
    if taken is None:
        return None
    is_day = taken.timetz() == datetime.min.replace(tzinfo=UTC).timetz()
    return taken.date().isoformat() if is_day else taken.isoformat()
