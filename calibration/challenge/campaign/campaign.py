"""make: truths drawn and sealed, then the recordings. Resumable; a recording is there whole or not at all."""

from __future__ import annotations

import functools
import secrets
import shutil
from pathlib import Path
from typing import Any

from calibration.challenge.campaign import layout
from calibration.challenge.campaign.layout import CAMPAIGN, HASHES, SECOND_RIG, Campaign, ChallengeError
from calibration.challenge.campaign.sealing import is_sealed, open_seal, seal
from calibration.work.many import Item, Tell, run_many
from calibration.work.sources import scorer_sha256
from rig.recording.files import beside, write_file

SEED_BITS = 53  # a seed that no one chose; whole in every reader of JSON
MOST_DRAWS = 1000  # truths looked at for one of the category asked for


def make(
    out: Path,
    cases: int,
    seed: int | None = None,
    family: str = "proof",
    only: str = "",
    maker: str = SECOND_RIG,
    key: Path | None = None,
    workers: int = 1,
    tell: Tell = lambda done, total, name: None,
) -> Campaign:
    """Make a campaign, or go on making it.

    `out`: its folder; the folder's name is the campaign's.
    `seed`: of all truths; drawn by the system when left out. It is sealed with them [-].
    `family`: family of draws: what was used for development is no proof.
    `only`: category that all cases shall be of; all categories when empty.
    Raises ChallengeError when the folder holds another campaign, or the rig fails.
    """
    if is_sealed(out):
        contents, digest = _resumed(out, cases, seed, family, only, maker, key)
    else:
        if (out / CAMPAIGN).exists() or (out / "recordings").exists():
            raise ChallengeError(f"{out} holds a campaign whose seal is gone; choose another folder")
        seed = secrets.randbits(SEED_BITS) if seed is None else seed
        contents = {"name": out.resolve().name, "seed": seed, "family": family, "only": only, "maker": maker}
        contents["truths"] = _draw(maker, family, seed, cases, only)
        digest = seal(out, contents, key)
    truths = contents["truths"]
    campaign = Campaign(out, contents["name"], family, maker, only, cases, digest)
    mark, making = f"{digest}/{scorer_sha256()}", out / "making"  # of one rig, however often it was interrupted
    items = [
        Item(name, {"truth": truth, "folder": str(campaign.recordings / name)}, mark)
        for name, truth in zip(campaign.names, truths, strict=True)
    ]
    for name in campaign.names:
        if not (campaign.recordings / name).is_dir():  # lost since: not done after all
            (making / f"{name}.json").unlink(missing_ok=True)
    made = run_many(functools.partial(_make_one, maker), items, making, workers, None, tell)
    failed = [result for result in made if result.error]
    if failed:
        raise ChallengeError(
            f"{len(failed)} of {cases} recordings could not be made, first {failed[0].name}: {failed[0].error}"
        )
    lines = "".join(f"{(result.value or {})['sha256']}  {result.name}\n" for result in made)
    write_file(out / HASHES, lines.encode())
    write_file(out / CAMPAIGN, layout.canonical(campaign.public()) + b"\n")
    return campaign


def truth_of(maker: str, data: dict[str, Any]) -> Any:
    """A truth as the rig knows it, from its JSON."""
    return layout.maker_of(maker).Truth(**data)


def _draw(maker: str, family: str, seed: int, cases: int, only: str) -> list[dict[str, Any]]:
    rig, index = layout.maker_of(maker), 0
    found: list[dict[str, Any]] = []
    while len(found) < cases:
        try:
            truth = layout.plain(rig.draw(family, index, seed))
        except (ValueError, KeyError) as problem:
            raise ChallengeError(f"the rig {maker} draws no truth of family {family!r}: {problem}") from None
        index += 1
        if not only or truth["category"] == only:
            found.append(truth)
        if index >= MOST_DRAWS * (len(found) + 1):
            raise ChallengeError(f"no truth of category {only!r} in {index} draws of family {family!r}")
    return found


def _resumed(
    out: Path, cases: int, seed: int | None, family: str, only: str, maker: str, key: Path | None
) -> tuple[dict[str, Any], str]:
    contents, digest = open_seal(out, key)
    asked = {"cases": cases, "family": family, "only": only, "maker": maker} | ({} if seed is None else {"seed": seed})
    there = contents | {"cases": len(contents["truths"])}
    other = [f"{name} {there[name]!r}" for name, value in asked.items() if there[name] != value and name != "seed"]
    other += ["another seed"] if "seed" in asked and there["seed"] != seed else []
    if other:
        raise ChallengeError(f"{out} holds a campaign with {', '.join(other)}; choose another folder")
    return contents, digest


def _make_one(maker: str, argument: dict[str, Any]) -> dict[str, Any]:
    folder = Path(argument["folder"])
    folder.parent.mkdir(parents=True, exist_ok=True)
    with beside(folder.parent) as hidden:
        whole = hidden / folder.name
        whole.mkdir()
        layout.maker_of(maker).make_recording(truth_of(maker, argument["truth"]), whole)
        check_contents(whole)
        shutil.rmtree(folder, ignore_errors=True)
        whole.replace(folder)
    return {"sha256": layout.recording_sha256(folder)}


def check_contents(folder: Path) -> None:
    """Refuse a recording with anything beside its tables: it could tell the truth."""
    strange = [p.name for p in folder.iterdir() if p.suffix not in layout.RECORDING_SUFFIXES or not p.is_file()]
    if strange or not (folder / layout.RECORDING).exists():
        raise ChallengeError(f"{folder.name}: a recording is {layout.RECORDING} and CSV files, found {strange}")
