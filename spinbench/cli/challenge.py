"""`challenge`: sealed blind campaigns."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench.cli.options import JsonOption, SchedulerOption, WorkersOption
from spinbench.cli.show import check_places, deliver, on_terminal, remark
from spinbench.extras import need
from spinbench.progress import bars

if TYPE_CHECKING:
    from calibration.challenge.record.opening import Scored

CampaignArgument = Annotated[Path, typer.Argument(metavar="DIR", help="The campaign's folder.")]
BookOption = Annotated[
    Path | None, typer.Option("--ledger", metavar="FILE", help="The ledger; that of this repository if left out.")
]
PageOption = Annotated[
    Path | None, typer.Option("--page", metavar="DIR", help="Write the result page with its figures and tables.")
]
KeyOption = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", help="The seal's key; beside the seal if left out.")
]


def make(
    out: CampaignArgument,
    cases: Annotated[int, typer.Option(min=1, max=100_000, help="How many recordings.")] = 200,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all truths, sealed with them; drawn if left out.")
    ] = None,
    family: Annotated[str, typer.Option(help="Family of draws: proof, or that of development.")] = "proof",
    only: Annotated[str, typer.Option(metavar="CATEGORY", help="Cases of one category alone, such as none.")] = "",
    key: KeyOption = None,
    workers: WorkersOption = None,
) -> None:
    """Draw truths, seal them, and make their recordings by the second rig; goes on where it was interrupted."""
    from calibration.challenge.campaign.campaign import make as make_campaign

    need("cryptography")
    processes = workers or os.cpu_count() or 1
    with bars() as begin:
        made = make_campaign(out, cases, seed, family, only, key=key, workers=processes, tell=begin("recordings"))
    print(f"{out}: {made.cases} recordings; committed to truths with SHA-256 {made.truth_sha256}")


def run(out: CampaignArgument, workers: WorkersOption = None, scheduler: SchedulerOption = None) -> None:
    """Diagnose every recording of a campaign, its seal untouched; goes on where it was interrupted."""
    from calibration.challenge.campaign.running import VERDICTS
    from calibration.challenge.campaign.running import run as diagnose_all

    need("pyarrow")
    if scheduler is not None:
        need("distributed")
    with bars() as begin:
        ran = diagnose_all(out, workers or os.cpu_count() or 1, scheduler, begin("verdicts"))
    remark(*[f"{result.name}: {result.error}" for result in ran.results if result.error][:10])
    failed = sum(bool(one.error) for one in ran.results)
    hours = sum(one.seconds for one in ran.results) / 3600.0
    print(f"{out / VERDICTS}: {len(ran.results)} verdicts, {failed} failed, {hours:.2f} core-hours; {ran.sha256}")


def score(
    campaigns: Annotated[list[Path], typer.Argument(metavar="DIR", help="Campaigns; several are counted together.")],
    key: KeyOption = None,
    follow_ups: Annotated[
        bool,
        typer.Option("--follow-ups", help="Simulate the test recommended for confounded verdicts; diagnose again."),
    ] = False,
    oracle: Annotated[
        bool, typer.Option("--oracle", help="Compute the held-out gain of the true set, where the diagnosis offers it.")
    ] = False,
    page: PageOption = None,
    keep: Annotated[
        Path | None,
        typer.Option("--keep", metavar="DIR", help="Keep each campaign, now open, as a file for `challenge pool`."),
    ] = None,
    book: BookOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json_file: JsonOption = None,
) -> None:
    """Open the seal, count hits, misses, refusals and false alarms, and enter the campaign into the ledger."""
    from calibration.challenge.record import keeping, opening
    from rig.recording import files

    need("cryptography")
    if scheduler is not None:
        need("distributed")
    check_places(page, json_file)
    check_places(keep, None)
    place = _ledger(book)
    settings = opening.Settings(key, follow_ups, oracle, workers or os.cpu_count() or 1, scheduler)
    with bars() as begin:
        scored = opening.score(campaigns, place, settings, begin)
    if keep is not None:
        files.write_files(keep, keeping.files(scored))
    _tell_of_scores(scored, place, page, json_file)
    remark(*scored.problems[:10])
    for entry, added in zip(scored.entries, scored.added, strict=True):
        words = "entered into" if added else "already in"
        remark(f"{entry['campaign']} {words} {place}")


def pool(
    kept: Annotated[list[Path], typer.Argument(metavar="FILE", help="Campaigns that `challenge score --keep` kept.")],
    same_code: Annotated[
        bool, typer.Option("--same-code", help="Refuse campaigns that were run or scored with other code than this.")
    ] = False,
    page: PageOption = None,
    book: BookOption = None,
    json_file: JsonOption = None,
) -> None:
    """Count scored campaigns of one code together, each held against the ledger; nothing is run."""
    from calibration.challenge.record import keeping

    check_places(page, json_file)
    place = _ledger(book)
    scored = keeping.read(kept, place)
    if same_code:
        keeping.hold_against_this_code(scored)
    _tell_of_scores(scored, place, page, json_file)


def ledger(book: BookOption = None) -> None:
    """Verify the chain of the ledger, and show every campaign that was ever scored; exit code 2 if it is broken."""
    from calibration.challenge.campaign.layout import ChallengeError
    from calibration.challenge.pages import page, tables
    from calibration.challenge.record.ledger import read_ledger

    if book is not None and not book.exists():
        raise ChallengeError(f"{book}: there is no ledger; give the file that `challenge score --ledger` wrote")
    place = _ledger(book)
    lines = read_ledger(place)
    on_terminal(tables.as_rich(page.ledger_grid(lines)))
    print(f"{place}: {len(lines)} lines, the chain holds")


def _tell_of_scores(scored: Scored, book: Path, page: Path | None, json_file: Path | None) -> None:
    from calibration.challenge.pages import page as pages
    from calibration.challenge.pages import tables
    from calibration.challenge.record.ledger import read_ledger
    from rig.recording import files

    if page is not None:
        files.write_files(page, pages.files(scored, read_ledger(book)))
        remark(f"the page is {page / pages.PAGE}")
    grids = [tables.goals(scored.summary), tables.outcomes(scored.summary), tables.by_signal(scored.summary)]
    deliver(files.json_bytes(scored.summary), [tables.as_rich(grid) for grid in grids], json_file)


def _ledger(book: Path | None) -> Path:
    """The ledger that is named, or that of the repository that this program is in."""
    from calibration.challenge.campaign.layout import ChallengeError
    from calibration.challenge.record.ledger import LEDGER
    from calibration.work.sources import ROOT

    if book is None and not (ROOT / LEDGER).parent.is_dir():
        raise ChallengeError("this program is in no repository with a ledger; name yours with --ledger FILE")
    return ROOT / LEDGER if book is None else book
