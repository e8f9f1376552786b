"""What a command gives: tables on the terminal, JSON and files where they were asked for, remarks on standard error."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rig.recording import Recording

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


def refuse_twice(parts: Sequence[Recording], unseen: Recording | None = None) -> None:
    """Refuse readings that are given twice, whatever their path: they would count twice, or be predicted once seen."""
    from rig.recording import RecordingError

    def is_same(one: Recording, other: Recording) -> bool:
        return one.folder.resolve() == other.folder.resolve() or (one.sha256 != "" and one.sha256 == other.sha256)

    for i, one in enumerate(parts):
        if unseen is not None and is_same(one, unseen):
            also = "" if one.folder == unseen.folder else f", as {one.folder}"
            raise RecordingError(
                f"{unseen.folder} is to be held out and diagnosed{also}: name a run that is not among the others"
            )
        for other in parts[:i]:
            if is_same(one, other):
                these = one.folder if one.folder == other.folder else f"{one.folder}, which is {other.folder} or a copy"
                raise RecordingError(
                    f"a recording is given twice: {these}; its readings would count twice, so name it once"
                )
