"""score: the seal is opened last, once every verdict is there; the ledger has the campaign before it is shown."""

from __future__ import annotations

import datetime
import functools
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calibration.challenge.campaign import layout, running
from calibration.challenge.campaign.campaign import truth_of
from calibration.challenge.campaign.layout import Campaign
from calibration.challenge.campaign.sealing import SealError, open_seal
from calibration.challenge.record import ledger
from calibration.challenge.scoring import scoring
from calibration.challenge.scoring.judging import LISTED, LISTED_IN_LIBRARY, NONE, Case, tests_of_this_bench
from calibration.work.many import Item, Result, Task, Tell, run_many
from calibration.work.sources import code_sha256, diagnosis_sha256, scorer_sha256

FOLDER = "scoring"


@dataclass(frozen=True)
class Settings:
    """How a campaign is scored.

    `key`: the key's file; beside the seal when None.
    `follow_ups`: whether the tests recommended for confounded verdicts are simulated and diagnosed.
    `oracle`: whether the held-out gain of the true set is computed.
    """

    key: Path | None = None
    follow_ups: bool = False
    oracle: bool = False
    workers: int = 1
    scheduler: str | None = None
    task: Task | None = None


@dataclass(frozen=True)
class Opened:
    """One campaign with its truths open.

    `frozen`: what was frozen before the first verdict: commit, hashes, thresholds, versions.
    """

    entry: dict[str, Any]
    sealed: dict[str, Any]
    frozen: dict[str, Any]
    cases: list[Case]


@dataclass(frozen=True)
class Scored:
    """Campaigns with their truths open, counted together."""

    opened: list[Opened]
    cases: list[Case]
    summary: dict[str, Any]
    added: list[bool]
    problems: list[str]

    @property
    def entries(self) -> list[dict[str, Any]]:
        """What each campaign tells the ledger."""
        return [one.entry for one in self.opened]


def together(opened: Sequence[Opened], added: Sequence[bool], problems: Sequence[str]) -> Scored:
    """Campaigns counted together; of several, a case's name has the campaign's before it."""
    cases = [
        case if len(opened) == 1 else replace(case, name=f"{one.entry['campaign']}/{case.name}")
        for one in opened
        for case in one.cases
    ]
    return Scored(list(opened), cases, scoring.summary(cases), list(added), list(problems))


def score(
    folders: Sequence[Path],
    book: Path,
    settings: Settings,
    tell: Callable[[str], Tell] = lambda step: lambda done, total, name: None,
) -> Scored:
    """Score campaigns; each enters the ledger by itself, the summary is of all their cases together.

    `tell`: given a step's name, it gives what is told of the step's progress.
    Raises ChallengeError when verdicts are missing, or the truths are not those that were committed to.
    """
    ledger.read_ledger(book)  # a broken chain is refused before anything is opened
    campaigns = [layout.read_campaign(folder) for folder in folders]
    for key in ("truth_sha256", "name"):
        told = [getattr(campaign, key) for campaign in campaigns]
        if twice := [c for c in campaigns if told.count(getattr(c, key)) > 1]:
            raise layout.ChallengeError(f"{twice[-1].folder}: another of these campaigns has its {key}; give each once")
    opened: list[Opened] = []
    added: list[bool] = []
    problems: list[str] = []
    # Before any is opened, all are looked at: a campaign that cannot be scored leaves the others shut.
    whole = [(campaign, running.read_verdicts(campaign), running.read_frozen(campaign)) for campaign in campaigns]
    for campaign, _, frozen in whole:
        _hold_code(campaign, frozen, settings)
    for campaign, ran, frozen in whole:
        ledger.append_opening(book, _opening(campaign, frozen, ran.sha256))
        contents = _open(campaign, frozen, settings.key)
        cases = _cases(campaign, contents, ran.results, str(frozen["diagnosis_sha256"]), settings, tell, problems)
        entry = _entry(campaign, contents, frozen, ran.sha256, settings, cases)
        added.append(ledger.append(book, entry) is not None)
        refuse_twice(entry, [one.entry for one in opened], campaign.folder)
        line = ledger.line_of(ledger.read_ledger(book), entry) or entry
        opened.append(Opened({key: line[key] for key in entry}, contents, frozen, cases))
    return together(opened, added, problems)


def _hold_code(campaign: Campaign, frozen: Mapping[str, Any], settings: Settings) -> None:
    """Refuse to add what another diagnosis says to the verdicts of this one."""
    if (settings.follow_ups or settings.oracle) and frozen["diagnosis_sha256"] != diagnosis_sha256():
        raise layout.ChallengeError(
            f"{campaign.folder} was run with the diagnosis {str(frozen['diagnosis_sha256'])[:12]}, and this is "
            f"{diagnosis_sha256()[:12]}: go back to the commit {str(frozen['commit'])[:8]} for follow-ups and oracle, "
            "or score without them"
        )


def _open(campaign: Campaign, frozen: dict[str, Any], key: Path | None) -> dict[str, Any]:
    contents, digest = open_seal(campaign.folder, key)
    if digest != campaign.truth_sha256 or digest != frozen["truth_sha256"]:
        raise SealError(f"{campaign.folder}: the truths are not those that were committed to before the run")
    return contents


@dataclass(frozen=True)
class _Computing:
    """What is computed of the cases of an opened campaign; failures go to the problems.

    `arguments`: by a case's name, what every task is given.
    """

    campaign: Campaign
    arguments: Mapping[str, dict[str, Any]]
    settings: Settings
    tell: Callable[[str], Tell]
    problems: list[str]

    def each(
        self, step: str, task: Task, cases: Sequence[Case], mark: str, more: Callable[[Case], Any] = lambda case: None
    ) -> dict[str, Any]:
        """What a task gives for each of these cases, by name."""
        words, place = step.replace("_", " "), self.campaign.folder / FOLDER / step
        mark = f"{self.campaign.truth_sha256}/{mark}"
        items = [Item(case.name, self.arguments[case.name] | {"more": more(case)}, mark) for case in cases]
        done = run_many(task, items, place, self.settings.workers, self.settings.scheduler, self.tell(words))
        self.problems.extend(f"{self.campaign.name}/{one.name}, {words}: {one.error}" for one in done if one.error)
        return {one.name: one.value for one in done}

    def follow_ups(self, cases: Sequence[Case], code: str) -> dict[str, Any]:
        """The confounded ones diagnosed again, with the recommended test."""
        chosen = [case for case in cases if case.outcome == LISTED and tests_of_this_bench(case.diagnosis)]
        task = functools.partial(_follow_up, self.campaign.maker, self.settings.task or running.diagnose_case)
        folder = self.campaign.folder / FOLDER / "with_the_test"
        mark = f"{code}/{scorer_sha256()}"
        return self.each("follow_ups", task, chosen, mark, lambda case: _next_test(case, code, folder))

    def oracle(self, cases: Sequence[Case]) -> dict[str, Any]:
        """Held-out gains of the true sets of the library."""
        listed = [case for case in cases if case.group != NONE and case.group in LISTED_IN_LIBRARY]
        return self.each("oracle", _oracle_gain, listed, code_sha256())


def _cases(
    campaign: Campaign,
    contents: dict[str, Any],
    results: Sequence[Result],
    code: str,
    settings: Settings,
    tell: Callable[[str], Tell],
    problems: list[str],
) -> list[Case]:
    """The cases of one campaign, with what is computed once their truths are open."""
    apart = bool(campaign.only)
    plain = [
        Case(r.name, truth, (r.value or {}).get("diagnosis"), r.error, r.seconds, apart=apart)
        for r, truth in zip(results, contents["truths"], strict=True)
    ]
    arguments = {
        case.name: {"truth": case.truth, "folder": str(campaign.recordings / case.name), "seed": campaign.seed(i)}
        for i, case in enumerate(plain)
    }
    computing = _Computing(campaign, arguments, settings, tell, problems)
    concealed = [case for case in plain if case.group != NONE]
    task = functools.partial(_signatures, campaign.maker)
    signatures = computing.each("signatures", task, concealed, code_sha256())
    again = computing.follow_ups(plain, code) if settings.follow_ups else {}
    gains = computing.oracle(plain) if settings.oracle else {}
    return [
        replace(
            case,
            signatures=signatures.get(case.name),
            again=(again.get(case.name) or {}).get("diagnosis"),
            oracle_gain=(gains.get(case.name) or {}).get("gain"),
        )
        for case in plain
    ]


def _signatures(maker: str, argument: dict[str, Any]) -> dict[str, Any]:
    truth = truth_of(maker, argument["truth"])
    return layout.plain(layout.maker_of(maker).separable(truth, Path(argument["folder"])))


def _next_test(case: Case, code: str, folder: Path) -> dict[str, Any]:
    return {"test": tests_of_this_bench(case.diagnosis)[0], "code": code, "folder": str(folder / case.name)}


def _follow_up(maker: str, task: Task, argument: dict[str, Any]) -> dict[str, Any]:
    """The recommended test simulated by the second rig, and the recording diagnosed with it."""
    more, folder = argument["more"], Path(argument["more"]["folder"])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    layout.maker_of(maker).follow_up(truth_of(maker, argument["truth"]), more["test"], folder)
    return task({"folder": str(folder), "seed": argument["seed"], "code": more["code"]})


def _oracle_gain(argument: dict[str, Any]) -> dict[str, Any]:
    from calibration.diagnosis import held_out_gain

    return {"gain": float(held_out_gain(Path(argument["folder"]), sorted(argument["truth"]["ids"])))}


def frozen_sha256(frozen: Mapping[str, Any]) -> str:
    """Of what was frozen: thresholds, commit, hashes, versions."""
    return layout.sha256(layout.canonical(frozen))


def scoring_sha256(cases: Sequence[Case]) -> str:
    """Of what the scorer computed of each case, times left out."""
    computed = [(case.name, case.signatures, case.again, case.oracle_gain) for case in cases]
    return layout.sha256(layout.canonical(computed))


def _opening(campaign: Campaign, frozen: Mapping[str, Any], verdicts: str) -> dict[str, Any]:
    """What the ledger is told before the seal is opened."""
    return {
        "opened_utc": _now(),
        "campaign": campaign.name,
        "cases": campaign.cases,
        "truth_sha256": campaign.truth_sha256,
        "verdicts_sha256": verdicts,
        "frozen_sha256": frozen_sha256(frozen),
    }


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def _entry(
    campaign: Campaign,
    contents: dict[str, Any],
    frozen: dict[str, Any],
    verdicts: str,
    settings: Settings,
    cases: Sequence[Case],
) -> dict[str, Any]:
    """What the ledger keeps of a campaign."""
    return {
        "scored_utc": _now(),
        "campaign": campaign.name,
        "family": campaign.family,
        "only": campaign.only,
        "seed": contents["seed"],
        "cases": campaign.cases,
        "truth_sha256": campaign.truth_sha256,
        "verdicts_sha256": verdicts,
        "frozen_sha256": frozen_sha256(frozen),
        "scoring_sha256": scoring_sha256(cases),
        "follow_ups": settings.follow_ups,
        "oracle": settings.oracle,
        **{key: frozen[key] for key in ("commit", "dirty", "code_sha256", "diagnosis_sha256", "versions")},
        "scorer_sha256": scorer_sha256(),
        "result": result_of(cases),
    }


def result_of(cases: Sequence[Case]) -> dict[str, Any]:
    """What the ledger keeps of the counts of one campaign."""
    found = scoring.summary(cases)
    told = ("goal", "got", "ratio", "met")
    return {
        "make_up": found["make_up"],
        "outcomes": found["outcomes"],
        "goals": [{key: goal[key] for key in told if key in goal} for goal in found["goals"]],
        "core_hours": round(found["core_hours"], 3),
    }


def refuse_twice(entry: Mapping[str, Any], others: Sequence[Mapping[str, Any]], place: Path) -> None:
    """Refuse a campaign some of whose cases others have: a case counts once.

    Raises ChallengeError when another has its truths, or truths drawn from the same seed that may be the same.
    """
    for other in others:
        if entry["truth_sha256"] == other["truth_sha256"]:
            raise layout.ChallengeError(f"{place}: this campaign is given twice; a case counts once")
        overlap = entry["only"] == other["only"] or not entry["only"] or not other["only"]
        if overlap and all(entry[key] == other[key] for key in ledger.DRAWN_FROM):
            raise layout.ChallengeError(
                f"{place}: {entry['campaign']} is drawn from the seed of {other['campaign']}; a case counts once"
            )
