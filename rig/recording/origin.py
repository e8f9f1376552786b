"""What a recording says of the run that it is an export of: at the end of its note, where recording/1 has no key."""

from __future__ import annotations

import re
from typing import Any

_OF_RUN = re.compile(r"(?:^|; )run (\S{1,200}), bench (.{1,200})$")


def of_run(run: str, bench: str) -> str:
    """The end of its note."""
    return f"run {run}, bench {bench}"


def run_and_bench(origin: Any) -> tuple[str, str] | None:
    """Names of run and bench, by an [origin]; None where it names none."""
    found = _OF_RUN.search(str(origin.get("note", ""))) if isinstance(origin, dict) else None
    return None if found is None else (found[1], found[2])
