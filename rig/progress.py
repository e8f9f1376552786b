"""How far something is: the bar on standard error that every command, run and reading takes."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn as Bar
from rich.progress import MofNCompleteColumn as Count
from rich.progress import Progress, ProgressColumn, TextColumn
from rich.progress import TimeElapsedColumn as Elapsed
from rich.progress import TimeRemainingColumn as Left

__all__ = ["DONE", "TASK", "Bar", "Count", "Elapsed", "Left", "Progress", "bar_of"]

TASK = "{task.description}"
DONE = "{task.completed:.0f}/{task.total:.0f}"


def bar_of(
    *parts: str | type[ProgressColumn], passing: bool = False, seen_by_a_person: bool = False, pace_s: float = 30.0
) -> Progress:
    """A bar on standard error, not yet started.

    `*parts`: from left to right: words, which may name fields of the task, and columns of rich; rich's own if left out.
    `pace_s`: the time left is estimated from so many of the last seconds [s].
    """
    console = Console(stderr=True)
    columns = [TextColumn(part) if isinstance(part, str) else part() for part in parts]
    hidden = seen_by_a_person and not console.is_terminal
    return Progress(*columns, console=console, transient=passing, disable=hidden, speed_estimate_period=pace_s)
