"""Every scored campaign, a line each, appended and never changed: each line carries the hash of the line before.

A line is written before a seal is opened too: a campaign that was opened and not scored to the end shows.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from calibration.challenge.campaign.layout import ChallengeError, canonical, sha256

LEDGER = Path("docs") / "challenge" / "ledger.jsonl"
FIRST = "0" * 64
# A campaign that agrees in these is in the ledger already: scored by the same code in the same way.
SAME = ("truth_sha256", "verdicts_sha256", "follow_ups", "oracle", "scorer_sha256", "scoring_sha256")
OPENING = ("truth_sha256", "verdicts_sha256")  # ... of the same verdicts
# What is told of every scored campaign, whatever else is.
TOLD = ("campaign", "cases", "commit", "diagnosis_sha256", "dirty", "family", "follow_ups", "scored_utc", "seed")
DRAWN_FROM = ("family", "seed")  # the same truths, whatever salt their hash has and whichever of them were kept


class LedgerError(ChallengeError):
    """The ledger's chain is broken: a line was changed, removed or moved."""


def read_ledger(place: Path) -> list[dict[str, Any]]:
    """All lines, their chain verified.

    `place`: the ledger; one that does not exist is empty.
    Raises LedgerError when a line does not carry the hash of the one before, or is no JSON object.
    """
    return [entry for entry, _ in _chain(place, place.read_bytes() if place.exists() else b"")]


def append(place: Path, entry: Mapping[str, Any]) -> dict[str, Any] | None:
    """Add a scored campaign; None when it is there already.

    `entry`: what is told of the campaign, with the keys of SAME.
    Returns the line as written: with its number, the hash of the line before, and whether the ledger had seen these
    truths before, or others drawn from the same seed, in which case nothing of it was blind any more.
    """

    def to_add(there: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
        if any(_same(line, entry, SAME) for line in there):
            return None
        return {"truths_opened_before": any(_opened(line, entry) for line in there), **entry}

    return _append(place, to_add)


def append_opening(place: Path, entry: Mapping[str, Any]) -> dict[str, Any] | None:
    """Tell that a seal is about to be opened; None when it has been told.

    `entry`: what is known of the campaign before, with its ``truth_sha256`` and ``verdicts_sha256``.
    """

    def to_add(there: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
        return None if any(_same(line, entry, OPENING) for line in there) else dict(entry)

    return _append(place, to_add)


def scored(lines: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The lines with a result."""
    return [line for line in lines if "result" in line]


def only_opened(lines: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The campaigns that were opened and have no result."""
    done = scored(lines)
    return [line for line in lines if "result" not in line and not any(_same(line, one, OPENING) for one in done)]


def _append(
    place: Path, to_add: Callable[[Sequence[Mapping[str, Any]]], dict[str, Any] | None]
) -> dict[str, Any] | None:
    place.parent.mkdir(parents=True, exist_ok=True)
    with place.open("a+b") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)  # two scorers at once would both follow the same line
        stream.seek(0)
        there = _chain(place, stream.read())
        more = to_add([line for line, _ in there])
        if more is None:
            return None
        line = {"number": len(there) + 1, "previous": there[-1][1] if there else FIRST, **more}
        stream.write(canonical(line) + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
        return line


def _opened(line: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    """Whether a line opened the truths of a campaign, but for the line that told of its own opening."""
    if "result" not in line and _same(line, entry, OPENING):
        return False
    return _same(line, entry, ("truth_sha256",)) or ("result" in line and _same(line, entry, DRAWN_FROM))


def line_of(lines: Sequence[Mapping[str, Any]], entry: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The line of a campaign that was scored in the same way; None where there is none."""
    return next((line for line in lines if _same(line, entry, SAME)), None)


def _same(line: Mapping[str, Any], entry: Mapping[str, Any], keys: Sequence[str]) -> bool:
    return all(line.get(key) == entry.get(key) for key in keys)


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
        missing = [key for key in TOLD if key not in entry] if "result" in entry else []
        if missing:
            raise LedgerError(
                f"{place}, line {number}: without {', '.join(missing)}; restore the file from its history"
            )
        previous = sha256(line)
        found.append((entry, previous))
    return found
