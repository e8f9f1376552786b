"""What a command gives: tables on the terminal, JSON and files where they were asked for, remarks on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

WIDTH, WIDTH_OF_FIGURES = 140, 120  # of a table in a pipe, where no column is cut


def remark(*lines: str) -> None:
    """A line each on standard error."""
    for words in lines:
        print(f"spinbench: {words}", file=sys.stderr)


def on_terminal(*tables: object, width: int = WIDTH) -> None:
    """Tables on standard output."""
    from rich.console import Console

    console = Console(width=None if sys.stdout.isatty() else width)
    for table in tables:
        console.print(table)


def check_places(out: Path | None, json_file: Path | None) -> None:
    """Whether results could be written, before the work that they come of."""
    from rig.recording import files

    files.check_places(out, None if json_file is None or str(json_file) == "-" else json_file)


def deliver(data: bytes, tables: Iterable[object], json_file: Path | None) -> None:
    """JSON where it was asked for, and the tables unless standard output is taken."""
    if not takes_output(data, json_file):
        on_terminal(*tables, width=WIDTH_OF_FIGURES)


def takes_output(data: bytes, json_file: Path | None) -> bool:
    """Write JSON where it was asked for; whether that was standard output."""
    from rig.recording import files

    if json_file is not None and str(json_file) == "-":
        sys.stdout.write(data.decode())
        return True
    if json_file is not None:
        files.write_file(json_file, data)
    return False
