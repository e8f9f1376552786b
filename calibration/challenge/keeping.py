"""A scored campaign in one file, truths beside verdicts: parts of a long record are counted together from these.

Recordings are large and can be made anew from the seed; what was sealed and what was said is small. Both are held
against the hashes in the ledger whenever they are read.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from calibration.challenge import layout, ledger, opening, running
from calibration.challenge.judging import Case
from calibration.challenge.layout import ChallengeError
from calibration.challenge.opening import Opened, Scored
from calibration.many import Result

FORMAT = "challenge-opened/1"
SUFFIX = ".json.gz"
OF_A_CASE = tuple(field.name for field in fields(Case) if field.name != "truth")  # the truths are in what was sealed
SAME_CODE = ("diagnosis_sha256", "family")  # verdicts of other code, or on other draws, are another record


def files(scored: Scored) -> dict[str, bytes]:
    """Each campaign as a file, by name; the same campaign gives the same bytes but for the time it was scored.

    Parameters
    ----------
    scored : Scored
        The campaigns.
    """
    return {one.entry["campaign"] + SUFFIX: _as_bytes(one) for one in scored.opened}


def _as_bytes(opened: Opened) -> bytes:
    data = {
        "format": FORMAT,
        "entry": opened.entry,
        "sealed": opened.sealed,
        "cases": [{name: getattr(case, name) for name in OF_A_CASE} for case in opened.cases],
    }
    return gzip.compress(layout.canonical(data), mtime=0)


def read(places: Sequence[Path], book: Path) -> Scored:
    """Count campaigns together that were kept.

    Parameters
    ----------
    places : sequence of Path
        Files that `files` made.
    book : Path
        The ledger that they are in.

    Raises
    ------
    ChallengeError
        When a file is damaged, is not what the ledger says, is there twice, or was run with other code than the first.
    """
    lines = ledger.read_ledger(book)
    opened = [_read(place, lines, book) for place in places]
    for one, place in zip(opened, places, strict=True):
        for key in SAME_CODE:
            if one.entry[key] != opened[0].entry[key]:
                raise ChallengeError(
                    f"{place}: its {key} ({str(one.entry[key])[:12]}) is not that of {places[0]} "
                    f"({str(opened[0].entry[key])[:12]}); count campaigns of one code and family together"
                )
        if sum(other.entry["truth_sha256"] == one.entry["truth_sha256"] for other in opened) > 1:
            raise ChallengeError(f"{place}: this campaign is given twice; a case counts once")
    return opening.together(opened, [False] * len(opened), [])


def _read(place: Path, lines: Sequence[Mapping[str, Any]], book: Path) -> Opened:
    try:
        data = json.loads(gzip.decompress(place.read_bytes()))
    except OSError as problem:
        raise ChallengeError(
            f"{place}: {problem.strerror or problem}; give a file of `challenge score --keep`"
        ) from None
    except (ValueError, EOFError, zlib.error):
        data = None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ChallengeError(f"{place}: damaged, or not of format {FORMAT}; restore it from its history")
    entry, sealed = data["entry"], data["sealed"]
    if len(data["cases"]) != len(sealed["truths"]):
        raise ChallengeError(f"{place}: {len(data['cases'])} cases of {len(sealed['truths'])}; restore it")
    cases = [Case(truth=truth, **one) for truth, one in zip(sealed["truths"], data["cases"], strict=True)]
    said = running.verdicts_sha256([Result(c.name, {"diagnosis": c.diagnosis}, c.error, c.seconds) for c in cases])
    if layout.sha256(layout.canonical(sealed)) != entry["truth_sha256"] or said != entry["verdicts_sha256"]:
        raise ChallengeError(f"{place}: its truths or verdicts are not those that were hashed; restore it")
    if not any(all(line.get(key) == entry[key] for key in ledger.SAME) for line in lines):
        raise ChallengeError(f"{place}: the campaign {entry['campaign']} is not in {book}; score it there first")
    return Opened(entry, sealed, cases)
