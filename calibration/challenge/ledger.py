"""Every scored campaign, a line each, appended and never changed: each line carries the hash of the line before."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from calibration.challenge.layout import ChallengeError, canonical, sha256

LEDGER = Path("docs") / "challenge" / "ledger.jsonl"
FIRST = "0" * 64
SAME = ("truth_sha256", "verdicts_sha256", "follow_ups")  # a campaign that agrees in these is in the ledger already


class LedgerError(ChallengeError):
    """The ledger's chain is broken: a line was changed, removed or moved."""


def read_ledger(place: Path) -> list[dict[str, Any]]:
    """All lines, their chain verified.

    Parameters
    ----------
    place : Path
        The ledger; one that does not exist is empty.

    Raises
    ------
    LedgerError
        When a line does not carry the hash of the one before, or is no JSON object.
    """
    return [entry for entry, _ in _chain(place, place.read_bytes() if place.exists() else b"")]


def append(place: Path, entry: Mapping[str, Any]) -> dict[str, Any] | None:
    """Add a scored campaign; None when it is there already.

    Parameters
    ----------
    place : Path
        The ledger.
    entry : mapping
        What is told of the campaign, with the keys of SAME.

    Returns
    -------
    dict or None
        The line as written: with its number, the hash of the line before, and whether the ledger had seen these truths
        before, in which case nothing of it was blind any more.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    with place.open("a+b") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)  # two scorers at once would both follow the same line
        stream.seek(0)
        there = _chain(place, stream.read())
        if any(all(line.get(key) == entry[key] for key in SAME) for line, _ in there):
            return None
        seen = any(line["truth_sha256"] == entry["truth_sha256"] for line, _ in there)
        previous = there[-1][1] if there else FIRST
        line = {"number": len(there) + 1, "previous": previous, "truths_opened_before": seen, **entry}
        stream.write(canonical(line) + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
        return line


def _chain(place: Path, content: bytes) -> list[tuple[dict[str, Any], str]]:
    """Each line with its own hash."""
    if content and not content.endswith(b"\n"):
        raise LedgerError(f"{place}: its last line is cut short; restore the file from its history")
    found: list[tuple[dict[str, Any], str]] = []
    previous = FIRST
    for number, line in enumerate(content.splitlines(), start=1):
        try:
            entry = json.loads(line)
        except ValueError:
            entry = None
        if not isinstance(entry, dict) or entry.get("previous") != previous or entry.get("number") != number:
            raise LedgerError(
                f"{place}, line {number}: it does not follow the line before; a line was changed, removed or moved. "
                "Restore the file from its history"
            )
        previous = sha256(line)
        found.append((entry, previous))
    return found
