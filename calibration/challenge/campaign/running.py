"""run: a verdict a recording. The seal is never opened here; nothing below reads its folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.challenge.campaign import freezing, layout
from calibration.challenge.campaign.layout import FROZEN, HASHES, VERDICTS, Campaign, ChallengeError
from calibration.work import many_table
from calibration.work.many import Item, Result, Task, Tell, read_results, run_many
from calibration.work.sources import diagnosis_sha256
from rig.recording.files import json_bytes, write_file

RESULTS = "verdicts"
HELD = ("truth_sha256", "diagnosis_sha256")  # what has to be the same from the first verdict to the last


@dataclass(frozen=True)
class Ran:
    """The verdicts of a campaign.

    `results`: a case each; without a value where the diagnosis failed.
    `sha256`: of the verdicts, times left out.
    """

    results: list[Result]
    sha256: str


def run(
    out: Path,
    workers: int = 1,
    scheduler: str | None = None,
    tell: Tell = lambda done, total, name: None,
    task: Task | None = None,
) -> Ran:
    """Diagnose every recording that has no verdict yet.

    `scheduler`: a Dask scheduler, whose workers see the folder under the same path.
    Raises ChallengeError when the recordings or the code are not those that the campaign began with.
    """
    campaign = layout.read_campaign(out)
    freeze(campaign)
    done = run_many(task or diagnose_case, items_of(campaign), out / RESULTS, workers, scheduler, tell)
    other_code = [one for one in done if one.failed_by(ChallengeError)]
    if other_code:
        raise ChallengeError(
            f"{len(other_code)} of {len(done)} cases, first {other_code[0].name}: {other_code[0].error}"
        )
    ran = Ran(done, verdicts_sha256(done))
    rows = [many_table.diagnosis_row(one) | {"seed": campaign.seed(i)} for i, one in enumerate(done)]
    write_file(out / VERDICTS, many_table.as_parquet(rows, many_table.DIAGNOSIS_COLUMNS | {"seed": many_table.WHOLE}))
    return ran


def freeze(campaign: Campaign) -> dict[str, Any]:
    """Write frozen.json, or hold what is there against what is now."""
    now = freezing.frozen() | {"truth_sha256": campaign.truth_sha256}
    place = campaign.folder / FROZEN
    if not place.exists():
        write_file(place, json_bytes(now))
        return now
    then: dict[str, Any] = read_frozen(campaign)
    if any(then.get(key) != now[key] for key in HELD):
        raise ChallengeError(
            f"{place}: the verdicts were begun with other code or other truths (code {str(then.get(HELD[1]))[:12]}, "
            f"now {now[HELD[1]][:12]}); go back to that code, or make a new campaign"
        )
    return then


def read_frozen(campaign: Campaign) -> dict[str, Any]:
    """What was frozen."""
    try:
        found: dict[str, Any] = json.loads((campaign.folder / FROZEN).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise ChallengeError(f"{campaign.folder}: nothing was frozen; `spinbench challenge run` it first") from None
    if not isinstance(found, dict) or any(not isinstance(found.get(key), str) for key in HELD):
        raise ChallengeError(f"{campaign.folder / FROZEN}: it was changed after it was written")
    return found


def read_verdicts(campaign: Campaign) -> Ran:
    """The verdicts, all of them."""
    items = items_of(campaign, str(read_frozen(campaign)["diagnosis_sha256"]))
    found = read_results(items, campaign.folder / RESULTS)
    done = [result for result in found if result is not None and not result.failed_by(ChallengeError)]
    if len(done) < len(found):
        raise ChallengeError(
            f"{campaign.folder}: {len(found) - len(done)} of {len(found)} cases have no verdict yet; "
            "`spinbench challenge run` goes on"
        )
    return Ran(done, verdicts_sha256(done))


def items_of(campaign: Campaign, code: str | None = None) -> list[Item]:
    """A case each: recording, seed, and the code that its verdict hangs on.

    `code`: hash of the diagnosis' sources; of those here when left out.
    """
    code = diagnosis_sha256() if code is None else code
    told = _told(campaign.folder / HASHES)
    items = []
    for index, name in enumerate(campaign.names):
        folder = campaign.recordings / name
        if not folder.is_dir():
            raise ChallengeError(
                f"{folder} is missing; `spinbench challenge make` with the same arguments makes it anew"
            )
        if layout.recording_sha256(folder) != told.get(name):
            raise ChallengeError(f"{folder} was changed after it was made")
        seed = campaign.seed(index)
        argument = {"folder": str(folder.resolve()), "seed": seed, "code": code}
        items.append(Item(name, argument, f"{told[name]}/{seed}/{code}"))
    return items


def _told(place: Path) -> dict[str, str]:
    """The hash of each recording by its name, as they were written when all were made."""
    try:
        lines = place.read_text(encoding="utf-8").splitlines()
        return {name: digest for digest, name in (line.split("  ", 1) for line in lines)}
    except (OSError, ValueError):
        raise ChallengeError(
            f"{place} is missing or damaged; `spinbench challenge make` with the same arguments writes it anew"
        ) from None


def diagnose_case(argument: dict[str, Any]) -> dict[str, Any]:
    """The diagnosis of one recording, times apart from what has to be the same every time."""
    from calibration.diagnosis import as_json, diagnose
    from rig.recording import read_recording

    if diagnosis_sha256() != argument["code"]:
        raise ChallengeError("this worker has other code than the campaign; restart it")
    found = diagnose(read_recording(Path(argument["folder"])), seed=argument["seed"])
    return {"diagnosis": as_json(found), "seconds": found.seconds}


def verdicts_sha256(results: Sequence[Result]) -> str:
    """Of what was said, times left out."""
    return layout.sha256(layout.canonical([(r.name, (r.value or {}).get("diagnosis")) for r in results]))
