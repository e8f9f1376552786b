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

from calibration.challenge.campaign import layout, running
from calibration.challenge.campaign.layout import ChallengeError
from calibration.challenge.record import ledger, opening
from calibration.challenge.record.opening import Opened, Scored
from calibration.challenge.scoring.judging import Case
from calibration.work.many import Result
from calibration.work.sources import diagnosis_sha256, scorer_sha256

FORMAT = "challenge-opened/1"
SUFFIX = ".json.gz"
# The truths are in what was sealed; whether a case stands apart follows from its campaign.
OF_A_CASE = tuple(field.name for field in fields(Case) if field.name not in ("truth", "apart"))
SAME_CODE = ("diagnosis_sha256", "scorer_sha256", "family", "follow_ups", "oracle")  # other ones are another record


def files(scored: Scored) -> dict[str, bytes]:
    """Each campaign as a file, by name; the same campaign gives the same bytes but for the time it was scored."""
    return {one.entry["campaign"] + SUFFIX: _as_bytes(one) for one in scored.opened}


def _as_bytes(opened: Opened) -> bytes:
    data = {
        "format": FORMAT,
        "entry": opened.entry,
        "sealed": opened.sealed,
        "frozen": opened.frozen,
        "cases": [{name: getattr(case, name) for name in OF_A_CASE} for case in opened.cases],
    }
    return gzip.compress(layout.canonical(data), mtime=0)


def read(places: Sequence[Path], book: Path) -> Scored:
    """Count campaigns together that were kept.

    Raises ChallengeError when a file is damaged, is not what the ledger says, is there twice, or was run with other
    code than the first.
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
        opening.refuse_twice(one.entry, [other.entry for other in opened if other is not one], place)
    return opening.together(opened, [False] * len(opened), [])


def hold_against_this_code(scored: Scored) -> None:
    """Refuse campaigns that were run or scored with other code than this: what it adds could not be counted with them.

    Raises ChallengeError when a hash differs.
    """
    for key, here in (("diagnosis_sha256", diagnosis_sha256()), ("scorer_sha256", scorer_sha256())):
        for entry in scored.entries:
            if entry[key] != here:
                raise ChallengeError(
                    f"{entry['campaign']} has {key} {str(entry[key])[:12]}, and this code {here[:12]}; go back to the "
                    f"commit {str(entry['commit'])[:8]}, or begin another record in another folder"
                )


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
    try:
        entry, sealed, frozen = data["entry"], data["sealed"], data["frozen"]
        if any(set(one) != set(OF_A_CASE) for one in data["cases"]):
            raise ValueError("a case has other fields")
        cases = [
            Case(truth=truth, apart=bool(entry["only"]), **one)
            for truth, one in zip(sealed["truths"], data["cases"], strict=True)
        ]
        hashes = {
            "truth_sha256": layout.sha256(layout.canonical(sealed)),
            "verdicts_sha256": running.verdicts_sha256(
                [Result(c.name, {"diagnosis": c.diagnosis}, c.error, c.seconds) for c in cases]
            ),
            "frozen_sha256": opening.frozen_sha256(frozen),
            "scoring_sha256": opening.scoring_sha256(cases),
        }
        other = [key.removesuffix("_sha256") for key, value in hashes.items() if value != entry[key]]
        if not other and layout.plain(opening.result_of(cases)) != entry["result"]:
            other = ["result"]  # errors and times are in no hash
    except (KeyError, TypeError, ValueError) as problem:
        raise ChallengeError(f"{place}: damaged ({problem!r}); restore it from its history") from None
    if other:
        raise ChallengeError(f"{place}: its {' and '.join(other)} are not as they were hashed; restore it")
    line = ledger.line_of(lines, entry)
    if line is None:
        raise ChallengeError(f"{place}: the campaign {entry['campaign']} is not in {book}; score it there first")
    if changed := [key for key in entry if line.get(key) != entry[key]]:
        raise ChallengeError(f"{place}: its {', '.join(changed)} are not what {book} says; restore it")
    return Opened(entry, sealed, frozen, cases)
