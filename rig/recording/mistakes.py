"""Gathering the mistakes of a recording, so that one error names them all, bounded in number and in length."""

from __future__ import annotations

from rig.recording.contents import RecordingError

SHOWN_MISTAKES = 20
ENOUGH_MISTAKES = 1000  # reading on would tell the person nothing more


def shown(text: str, length: int = 40) -> str:
    """Text from a file, fit for an error: cut at `length` characters, control characters escaped."""
    cut = text if len(text) <= length else text[: length - 3] + "..."
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in cut)


class Mistakes:
    """The mistakes found so far."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.count = 0

    def add(self, place: str, what: str, times: int = 1) -> None:
        """Note one mistake; `times` counts further ones of the same sort that need no line of their own."""
        self.count += times
        if len(self.lines) < SHOWN_MISTAKES:
            self.lines.append(f"{place}: {what}")

    @property
    def enough(self) -> bool:
        """Whether there are so many that reading on is of no use."""
        return self.count >= ENOUGH_MISTAKES

    def raise_any(self) -> None:
        """Raise one RecordingError with all the mistakes, if there are any."""
        if self.count:
            more = self.count - len(self.lines)
            rest = [f"and {more} more" + (" (reading stopped there)" if self.enough else "")] if more else []
            raise RecordingError("\n".join(self.lines + rest))
