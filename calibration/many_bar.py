"""The progress bar of a campaign, and a whole number of its command line."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator

from calibration.many import Tell


@contextlib.contextmanager
def progress_bar(name: str) -> Iterator[Tell]:
    """A bar on the error stream with the time gone and the time left; its value is what `run_many` tells.

    Parameters
    ----------
    name : str
        What is being made.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn(name), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=3600.0) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total, item: bar.update(task, completed=done, total=total)


def whole_number(text: str) -> int:
    """A number of 0 or more of a command line [-].

    Parameters
    ----------
    text : str
        As given.

    Raises
    ------
    argparse.ArgumentTypeError
        When it is none.
    """
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of 0 or more")
    return int(text)
