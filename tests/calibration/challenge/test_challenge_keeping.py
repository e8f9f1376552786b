"""Scored campaigns kept as files, and counted together from these."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import pytest

from calibration.challenge.campaign import freezing, layout, running
from calibration.challenge.campaign.campaign import make
from calibration.challenge.campaign.layout import ChallengeError
from calibration.challenge.record import keeping, opening
from calibration.challenge.record.opening import Settings, score
from rig.recording.files import write_files
from tests import fake_rig

PARTS = {"mixed": {"cases": 12, "seed": 5}, "nulls": {"cases": 3, "seed": 6, "only": "none"}}


@pytest.fixture
def folders(tmp_path):
    """Two campaigns with their verdicts."""
    for name, options in PARTS.items():
        make(tmp_path / name, maker=fake_rig.NAME, workers=0, **options)
        running.run(tmp_path / name, 0, task=fake_rig.diagnose)
    return [tmp_path / name for name in PARTS]


@pytest.fixture
def book(tmp_path):
    return tmp_path / "ledger.jsonl"


@pytest.fixture
def kept(folders, book, tmp_path):
    """Each scored by itself, and kept."""
    settings = Settings(workers=0, follow_ups=True, task=fake_rig.diagnose)
    for folder in folders:
        write_files(tmp_path / "kept", keeping.files(score([folder], book, settings)))
    return [tmp_path / "kept" / f"{name}.json.gz" for name in PARTS]


def changed(place, change):
    data = json.loads(gzip.decompress(place.read_bytes()))
    change(data)
    place.write_bytes(gzip.compress(layout.canonical(data)))


def test_parts_counted_together_are_what_scoring_them_at_once_gives(folders, kept, book):
    at_once = score(folders, book, Settings(workers=0, follow_ups=True, task=fake_rig.diagnose))
    from_files = keeping.read(kept, book)
    assert from_files.summary == at_once.summary
    assert from_files.cases == at_once.cases
    assert [one["campaign"] for one in from_files.entries] == list(PARTS)


def test_nulls_apart_count_among_nulls_and_not_in_the_shares_of_all(kept, book):
    mixed, both = keeping.read(kept[:1], book).summary, keeping.read(kept, book).summary
    assert both["nulls"]["all"]["false_names"]["n"] == mixed["nulls"]["all"]["false_names"]["n"] + 3
    assert both["wrong_names"]["all"] == mixed["wrong_names"]["all"]
    covered = both["coverage"]["f_overall"]
    assert covered["all"] == mixed["coverage"]["f_overall"]["all"]
    assert covered["with those of campaigns of one category"]["90"]["n"] == covered["all"]["90"]["n"] + 3


def test_one_part_keeps_its_cases_names(kept, book):
    assert [case.name for case in keeping.read(kept[1:], book).cases] == ["case0000", "case0001", "case0002"]


def one_verdict(data):
    data["cases"][0]["diagnosis"]["verdict"] = "consistent"


def one_truth(data):
    data["sealed"]["truths"][0]["ids"] = ["leakage"]


def one_case_less(data):
    del data["cases"][-1]


def what_the_scorer_found(data):
    data["cases"][0]["signatures"] = {"D": 99.0, "separable": True}


def a_threshold(data):
    data["frozen"]["thresholds"]["diagnosis.steps.verdict.NAMED"] = 0.5


def the_commit(data):
    data["entry"]["commit"] = "0" * 40


def the_code(data):
    data["entry"]["diagnosis_sha256"] = "0" * 64


def that_it_stands_apart(data):
    for case in data["cases"]:
        case["apart"] = True


def how_long_it_took(data):
    data["cases"][0]["seconds"] += 3600.0


def no_entry(data):
    del data["entry"]


def one_key_more(data):
    data["cases"][0]["more"] = 1


CHANGES = [
    *(one_verdict, one_truth, one_case_less, what_the_scorer_found, a_threshold, the_commit, the_code),
    *(that_it_stands_apart, how_long_it_took),
]


@pytest.mark.parametrize("change", [*CHANGES, no_entry, one_key_more])
def test_what_is_not_as_it_was_hashed_is_refused(kept, book, change):
    changed(kept[0], change)
    with pytest.raises(ChallengeError, match="restore it"):
        keeping.read(kept, book)


def test_a_damaged_file_is_refused(kept, book):
    kept[0].write_bytes(kept[0].read_bytes()[:-20])
    with pytest.raises(ChallengeError, match="damaged"):
        keeping.read(kept, book)
    kept[0].write_bytes(b"no gzip")
    with pytest.raises(ChallengeError, match="challenge score --keep"):
        keeping.read(kept, book)


def test_a_missing_file_is_told(kept, book, tmp_path):
    with pytest.raises(ChallengeError, match="No such file"):
        keeping.read([tmp_path / "none.json.gz"], book)


def test_a_campaign_that_the_ledger_does_not_have_is_refused(kept, tmp_path):
    with pytest.raises(ChallengeError, match="score it there first"):
        keeping.read(kept, tmp_path / "another.jsonl")


def test_a_campaign_counts_once(kept, book):
    with pytest.raises(ChallengeError, match="a case counts once"):
        keeping.read([*kept, kept[0]], book)


def test_verdicts_of_other_code_are_not_counted_with_them(kept, book, tmp_path, monkeypatch):
    for module in (freezing, running, opening):
        monkeypatch.setattr(module, "diagnosis_sha256", lambda: "0" * 64)
    make(tmp_path / "later", 3, seed=7, maker=fake_rig.NAME, workers=0)
    running.run(tmp_path / "later", 0, task=fake_rig.diagnose)
    settings = Settings(workers=0, follow_ups=True, task=fake_rig.diagnose)
    write_files(tmp_path / "kept", keeping.files(score([tmp_path / "later"], book, settings)))
    later = tmp_path / "kept" / "later.json.gz"
    with pytest.raises(ChallengeError, match="campaigns of one code"):
        keeping.read([*kept, later], book)
    with pytest.raises(ChallengeError, match="later has diagnosis_sha256 000000000000, and this code"):
        keeping.hold_against_this_code(keeping.read([later], book))
    keeping.hold_against_this_code(keeping.read(kept, book))


def test_the_page_of_this_repository_is_what_its_kept_files_give():
    """The published record, counted anew from what was kept of each part, and held against the ledger."""
    docs = Path(__file__).resolve().parents[3] / "docs" / "challenge"
    scored = keeping.read(sorted((docs / "record").glob("*.json.gz")), docs / "ledger.jsonl")
    published = json.loads((docs / "result.json").read_text())
    for name, counted in json.loads(json.dumps(scored.summary)).items():
        assert published[name] == counted, name
    assert [one["campaign"] for one in published["campaigns"]] == [one["campaign"] for one in scored.entries]
