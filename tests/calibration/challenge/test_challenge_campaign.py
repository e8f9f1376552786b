"""Campaigns from the draw to the ledger, by a rig and a diagnosis without physics: sealing, freezing, resuming."""

from __future__ import annotations

import json
import pkgutil
import shutil
import stat

import pyarrow.parquet as pq
import pytest

from calibration import diagnosis
from calibration.challenge.campaign import freezing, layout, running
from calibration.challenge.campaign.campaign import make
from calibration.challenge.campaign.layout import ChallengeError, canonical, sha256
from calibration.challenge.campaign.sealing import SealError, open_seal
from calibration.challenge.pages import page
from calibration.challenge.record import ledger as ledgers
from calibration.challenge.record import opening
from calibration.challenge.record.opening import Settings, score
from calibration.work.sources import DIAGNOSIS, imported
from model.effects import definitions, effects
from tests import fake_rig

CASES = 12


def made_at(folder, cases=CASES, **options):
    return make(folder, cases, **{"seed": 5, "maker": fake_rig.NAME, "workers": 0} | options)


def ran(folder):
    return running.run(folder, 0, task=fake_rig.diagnose)


def scored(folder, book, **options):
    return score([folder], book, Settings(workers=0, task=fake_rig.diagnose, **options))


@pytest.fixture
def campaign(tmp_path):
    made_at(tmp_path / "blind")
    return tmp_path / "blind"


@pytest.fixture
def book(tmp_path):
    return tmp_path / "ledger.jsonl"


def files_in(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# make


def test_the_same_seed_makes_the_same_recordings(campaign, tmp_path):
    made_at(tmp_path / "other")
    assert files_in(campaign / "recordings") == files_in(tmp_path / "other" / "recordings")


def test_a_recording_that_is_lost_is_made_anew(campaign):
    ran(campaign)
    before = files_in(campaign / "recordings")
    shutil.rmtree(campaign / "recordings" / "case0001")
    (campaign / "recordings.sha256").write_text("no hash\n")
    with pytest.raises(ChallengeError, match="with the same arguments writes it anew"):
        ran(campaign)
    made_at(campaign)
    assert files_in(campaign / "recordings") == before


def test_recordings_of_another_rig_are_not_gone_on_with(campaign, monkeypatch):
    made = []
    monkeypatch.setattr("calibration.challenge.campaign.campaign.scorer_sha256", lambda: "0" * 64)
    monkeypatch.setattr(
        fake_rig, "make_recording", lambda truth, folder, make=fake_rig.make_recording: made.append(make(truth, folder))
    )
    made_at(campaign)
    made_at(campaign)
    assert len(made) == CASES


def test_another_seed_makes_others(campaign, tmp_path):
    made_at(tmp_path / "other", seed=6)
    assert files_in(campaign / "recordings") != files_in(tmp_path / "other" / "recordings")


def test_two_campaigns_without_a_seed_differ(tmp_path):
    for name in ("one", "two"):
        made_at(tmp_path / name, seed=None)
    first, second = (open_seal(tmp_path / name)[0]["seed"] for name in ("one", "two"))
    assert first != second


def test_neither_the_seed_nor_a_truth_lies_in_the_open(campaign):
    sealed = {"sealed/truths.bin"}
    for name, content in files_in(campaign).items():
        if name not in sealed and not name.startswith("recordings/"):
            assert b"seed" not in content
            assert b"coulomb" not in content
    assert b"coulomb" not in (campaign / "sealed" / "truths.bin").read_bytes()


def test_the_hash_that_is_committed_to_is_that_of_the_truths(campaign):
    contents, digest = open_seal(campaign)
    assert digest == sha256(canonical(contents)) == layout.read_campaign(campaign).truth_sha256
    assert (campaign / "sealed" / "hash").read_text(encoding="ascii").strip() == digest


def test_the_hash_cannot_be_guessed_from_likely_truths(campaign, tmp_path):
    made_at(tmp_path / "blind_again")  # the same truths
    assert open_seal(campaign)[1] != open_seal(tmp_path / "blind_again")[1]


def test_the_key_is_its_owners_alone(campaign):
    assert stat.S_IMODE((campaign / "sealed" / "key").stat().st_mode) == 0o600


def test_the_key_can_lie_elsewhere(tmp_path):
    made_at(tmp_path / "blind", key=tmp_path / "safe" / "key")
    assert not (tmp_path / "blind" / "sealed" / "key").exists()
    assert open_seal(tmp_path / "blind", tmp_path / "safe" / "key")[0]["seed"] == 5


def test_a_campaign_interrupted_while_it_was_made_goes_on(campaign):
    before = files_in(campaign)
    for name in ("recordings/case0003", "recordings/case0007"):
        shutil.rmtree(campaign / name)
    for name in ("making/case0003.json", "making/case0007.json", "campaign.json", "recordings.sha256"):
        (campaign / name).unlink()
    made_at(campaign)
    after = files_in(campaign)
    assert {n: c for n, c in after.items() if "making" not in n} == {
        n: c for n, c in before.items() if "making" not in n
    }


@pytest.mark.parametrize("change", [{"cases": 13}, {"seed": 6}, {"family": "development"}, {"only": "none"}])
def test_a_folder_that_holds_another_campaign_is_refused(campaign, change):
    with pytest.raises(ChallengeError, match="holds a campaign with"):
        made_at(campaign, **change)


def test_a_refusal_does_not_tell_the_sealed_seed(campaign):
    with pytest.raises(ChallengeError) as told:
        made_at(campaign, seed=6)
    assert "5" not in str(told.value).replace(str(campaign), "")


def test_a_family_that_the_rig_does_not_know_is_told(tmp_path):
    with pytest.raises(ChallengeError, match="families are development and proof"):
        made_at(tmp_path / "blind", family="prof")


def test_a_campaign_can_be_of_one_category_alone(tmp_path):
    made_at(tmp_path / "nulls", only="none")
    assert {truth["category"] for truth in open_seal(tmp_path / "nulls")[0]["truths"]} == {"none"}


def test_a_recording_with_anything_beside_its_tables_is_refused(tmp_path, monkeypatch):
    def telling(truth, folder):
        (folder / "recording.toml").write_text("", encoding="utf-8")
        (folder / "truth.yaml").write_text(str(truth.ids), encoding="utf-8")

    monkeypatch.setattr(fake_rig, "make_recording", telling)
    with pytest.raises(ChallengeError, match=r"truth\.yaml"):
        made_at(tmp_path / "blind")


# run


def test_without_the_seal_the_verdicts_are_the_same_to_the_bit(campaign, tmp_path):
    away = tmp_path / "elsewhere" / "blind"
    shutil.copytree(campaign, away)
    shutil.rmtree(away / "sealed")
    with_seal, without = ran(campaign), ran(away)
    assert without.sha256 == with_seal.sha256
    first, second = (pq.read_table(f / "verdicts.parquet").drop(["seconds"]) for f in (campaign, away))
    assert first.equals(second)
    assert len(with_seal.results) == CASES


def test_a_case_s_seed_hangs_on_the_campaign_s_name_and_its_index(campaign):
    found = layout.read_campaign(campaign)
    said = [one.value["diagnosis"]["seed"] for one in ran(campaign).results]
    assert said == [found.seed(i) for i in range(CASES)]
    assert len(set(said)) == CASES


@pytest.mark.long
def test_two_workers_say_what_one_says(campaign, tmp_path):
    shutil.copytree(campaign, tmp_path / "again")
    assert running.run(tmp_path / "again", 2, task=fake_rig.diagnose).sha256 == ran(campaign).sha256


def test_a_run_goes_on_where_it_was_interrupted(campaign):
    whole = ran(campaign).sha256
    (campaign / "verdicts" / "case0004.json").unlink()
    told = []
    again = running.run(campaign, 0, tell=lambda *step: told.append(step), task=fake_rig.diagnose)
    assert again.sha256 == whole
    assert [name for _, _, name in told if name] == ["case0004"]


def test_what_a_campaign_is_run_with_is_frozen_before_the_first_verdict(campaign):
    def fails(argument):
        raise RuntimeError(json.loads((campaign / "frozen.json").read_text(encoding="utf-8"))["truth_sha256"])

    told = running.run(campaign, 0, task=fails).results[0].error
    assert layout.read_campaign(campaign).truth_sha256 in told


def test_frozen_are_thresholds_versions_and_hashes():
    found = freezing.frozen()
    from calibration.diagnosis.steps import verdict

    assert found["thresholds"]["diagnosis.steps.verdict.MISMATCH_P"] == verdict.MISMATCH_P
    assert {"numpy", "scipy", "numba", "python"} <= set(found["versions"])
    assert len(found["code_sha256"]) == len(found["diagnosis_sha256"]) == 64
    assert found["commit"] is None or len(found["commit"]) == 40


def test_the_hash_of_the_diagnosis_is_of_every_effect_s_law_too():
    room = definitions.__name__
    modules = {info.name for info in pkgutil.walk_packages(definitions.__path__, f"{room}.")}
    assert len(modules) > len(effects())
    assert modules <= set(imported(DIAGNOSIS))


def test_other_code_is_refused_half_way(campaign):
    ran(campaign)
    place = campaign / "frozen.json"
    place.write_text(place.read_text(encoding="utf-8").replace('"diagnosis_sha256": "', '"diagnosis_sha256": "f'))
    with pytest.raises(ChallengeError, match="begun with other code"):
        ran(campaign)


def test_a_worker_with_other_code_gives_no_verdict(campaign, book):
    def other(argument):
        raise ChallengeError("this worker has other code than the campaign; restart it")

    with pytest.raises(ChallengeError, match=r"12 of 12 cases, first case0000: .* restart it"):
        running.run(campaign, 0, task=other)
    with pytest.raises(ChallengeError, match="12 of 12 cases have no verdict yet"):
        scored(campaign, book)
    with pytest.raises(ChallengeError, match="other code than the campaign"):
        running.diagnose_case({"folder": str(campaign), "seed": 1, "code": "another"})


def test_a_recording_that_was_changed_is_refused(campaign):
    (campaign / "recordings" / "case0001" / "sweep.csv").write_text("reading,f\n0,0.1\n", encoding="utf-8")
    with pytest.raises(ChallengeError, match="case0001 was changed"):
        ran(campaign)


def test_a_diagnosis_that_fails_is_a_failed_case_and_no_end(campaign, book):
    def fails(argument):
        if argument["folder"].endswith("case0002"):
            raise ArithmeticError("no mode")
        return fake_rig.diagnose(argument)

    running.run(campaign, 0, task=fails)
    failed = [case for case in scored(campaign, book).cases if case.outcome == "failed"]
    assert [(case.name, case.error) for case in failed] == [("case0002", "ArithmeticError: no mode")]


# score


def test_a_campaign_is_scored_only_when_every_verdict_is_there(campaign, book):
    with pytest.raises(ChallengeError, match="run` it first"):
        scored(campaign, book)
    ran(campaign)
    (campaign / "verdicts" / "case0004.json").unlink()
    with pytest.raises(ChallengeError, match="1 of 12 cases have no verdict yet"):
        scored(campaign, book)


def test_truths_that_are_not_those_committed_to_are_refused(campaign, tmp_path, book):
    ran(campaign)
    made_at(tmp_path / "other", seed=6)
    shutil.rmtree(campaign / "sealed")
    shutil.copytree(tmp_path / "other" / "sealed", campaign / "sealed")
    with pytest.raises(SealError, match="committed to before the run"):
        scored(campaign, book)


def test_a_seal_that_was_tampered_with_is_refused(campaign, book):
    ran(campaign)
    place = campaign / "sealed" / "truths.bin"
    place.write_bytes(place.read_bytes()[:-8] + b"AAAAAAA=")
    with pytest.raises(SealError, match="the key does not open it, or it was changed"):
        scored(campaign, book)


def test_scoring_counts_the_cases_as_the_truths_are(campaign, book):
    ran(campaign)
    found = scored(campaign, book)
    truths = open_seal(campaign)[0]["truths"]
    for group, count in found.summary["make_up"].items():
        assert count == sum(truth["category"] == group for truth in truths)
    other_form = found.summary["make_up"]["other_form"]
    assert other_form > 0
    assert found.summary["outcomes"]["other_form"] == {"truth listed": other_form}
    assert all(case.outcome == "right" for case in found.cases if case.group != "other_form")


def test_confounded_cases_are_resolved_by_the_test_that_was_recommended(campaign, book):
    ran(campaign)
    without, with_it = (scored(campaign, book, follow_ups=asked).summary["confounded"] for asked in (False, True))
    assert without["followed_up"] == 0
    assert with_it["followed_up"] == with_it["resolved"]["hits"] == with_it["truth_listed"] > 0


def test_the_oracle_is_asked_where_one_or_two_effects_of_the_library_are_concealed(campaign, book, monkeypatch):
    asked = []
    monkeypatch.setattr(diagnosis, "held_out_gain", lambda folder, ids: asked.append((folder.name, ids)) or 10.0)
    ran(campaign)
    found = scored(campaign, book, oracle=True)
    told = {c.name: sorted(c.truth["ids"]) for c in found.cases if c.group in ("single", "pair")}
    assert dict(asked) == told != {}
    assert found.summary["held_out"]["cases"] == len(told)
    assert found.summary["held_out"]["ratio"] == pytest.approx(0.9)  # 9 nats each by the verdict, 10 by the oracle


def test_a_case_whose_signatures_cannot_be_computed_is_told(campaign, book, monkeypatch):
    def fails(truth, folder):
        raise ArithmeticError("no signature")

    ran(campaign)
    monkeypatch.setattr(fake_rig, "separable", fails)
    found = scored(campaign, book)
    assert "blind/" in found.problems[0]
    assert found.problems[0].endswith("signatures: ArithmeticError: no signature")
    assert found.summary["separable"]["share"]["n"] == 0


def test_several_campaigns_are_counted_together_and_entered_each(campaign, tmp_path, book):
    made_at(tmp_path / "nulls", only="none", cases=3, seed=6)
    for folder in (campaign, tmp_path / "nulls"):
        ran(folder)
    found = score([campaign, tmp_path / "nulls"], book, Settings(workers=0))
    assert found.summary["cases"] == CASES + 3
    lines = ledgers.read_ledger(book)
    assert [line["campaign"] for line in ledgers.scored(lines)] == ["blind", "nulls"]
    assert ["result" in line for line in lines] == [False, True, False, True]  # opened, scored, opened, scored


def test_a_campaign_is_counted_once(campaign, tmp_path, book):
    """Nor are nulls beside the campaign whose seed they share: they are its own."""
    made_at(tmp_path / "nulls", only="none", cases=3)
    made_at(tmp_path / "more" / "blind", seed=6)
    for folder in (campaign, tmp_path / "nulls", tmp_path / "more" / "blind"):
        ran(folder)
    for other, words in (
        ("blind", "has its truth_sha256"),
        ("more/blind", "has its name"),
        ("nulls", "from the seed of blind"),
    ):
        with pytest.raises(ChallengeError, match=words):
            score([campaign, tmp_path / other], book, Settings(workers=0))


@pytest.mark.parametrize("asked", ["follow_ups", "oracle"])
def test_what_another_diagnosis_says_is_not_added(campaign, book, monkeypatch, asked):
    ran(campaign)
    monkeypatch.setattr(opening, "diagnosis_sha256", lambda: "0" * 64)
    with pytest.raises(ChallengeError, match="this is 000000000000: go back to the commit"):
        scored(campaign, book, **{asked: True})
    assert ledgers.read_ledger(book) == []  # nothing was opened
    assert scored(campaign, book).added == [True]


def test_only_tests_of_this_bench_are_made(campaign, book, monkeypatch):
    ran(campaign)
    for place in (campaign / "verdicts").glob("*.json"):
        data = json.loads(place.read_text())
        for test in data["value"]["diagnosis"]["next_tests"]:
            test["needs"] = "a drive"
        place.write_text(json.dumps(data))
    assert scored(campaign, book, follow_ups=True).summary["confounded"]["followed_up"] == 0


def test_the_page_has_every_table_figure_and_line_of_the_ledger(campaign, book):
    ran(campaign)
    found = scored(campaign, book)
    made = page.files(found, ledgers.read_ledger(book))
    text = made["result.md"].decode()
    assert {name for name in made if name.endswith(".png")} == {
        "confusion.png",
        "coverage.png",
        "reliability.png",
        "signal.png",
    }
    assert all(f"]({name})" in text for name in made if name != "result.md")
    assert all(made[name].startswith(b"\x89PNG") for name in made if name.endswith(".png"))
    for heading in ("Goals", "Outcomes", "Located", "Intervals that hold the truth", "The ledger"):
        assert f"## {heading}\n" in text
    assert made["cases.csv"].decode().count("\n") == CASES + 1
    assert json.loads(made["result.json"])["cases"] == CASES


# the ledger


def test_a_campaign_enters_the_ledger_once(campaign, book):
    ran(campaign)
    first, second = scored(campaign, book), scored(campaign, book)
    assert (first.added, second.added) == ([True], [False])
    opened, line = ledgers.read_ledger(book)
    assert (opened["campaign"], "seed" in opened) == ("blind", False)  # written before the seal was opened
    assert (line["seed"], line["family"], line["cases"]) == (5, "proof", CASES)
    assert line["truths_opened_before"] is False


def test_truths_that_were_opened_before_are_told_as_such(campaign, book):
    ran(campaign)
    scored(campaign, book)
    again = fake_rig.verdict("consistent", [])
    shutil.rmtree(campaign / "verdicts")
    running.run(campaign, 0, task=lambda argument: {"diagnosis": again})
    scored(campaign, book)
    lines = ledgers.scored(ledgers.read_ledger(book))
    assert [line["truths_opened_before"] for line in lines] == [False, True]


def test_truths_drawn_anew_from_a_seed_that_was_opened_are_told_as_such(campaign, tmp_path, book):
    made_at(tmp_path / "again")
    for folder in (campaign, tmp_path / "again"):
        ran(folder)
        scored(folder, book)
    lines = ledgers.scored(ledgers.read_ledger(book))
    assert lines[0]["truth_sha256"] != lines[1]["truth_sha256"]
    assert [line["truths_opened_before"] for line in lines] == [False, True]


def test_nulls_of_a_seed_that_was_opened_are_told_as_such(campaign, tmp_path, book):
    made_at(tmp_path / "nulls", only="none", cases=3)
    for folder in (campaign, tmp_path / "nulls"):
        ran(folder)
        scored(folder, book)
    assert [line["truths_opened_before"] for line in ledgers.scored(ledgers.read_ledger(book))] == [False, True]


def test_a_campaign_that_was_opened_and_not_scored_to_the_end_shows(campaign, book, monkeypatch):
    ran(campaign)
    with monkeypatch.context() as context:
        context.setattr(opening, "_cases", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            scored(campaign, book)
    (line,) = ledgers.only_opened(ledgers.read_ledger(book))
    assert line["campaign"] == "blind"
    assert "opened, never scored" in page.ledger_grid(ledgers.read_ledger(book)).rows[0]
    assert scored(campaign, book).entries[0]["campaign"] == "blind"
    lines = ledgers.read_ledger(book)
    assert ledgers.only_opened(lines) == [] and lines[-1]["truths_opened_before"] is False


def test_what_it_was_run_with_goes_into_the_result(campaign, book):
    ran(campaign)
    found = scored(campaign, book)
    frozen = running.read_frozen(layout.read_campaign(campaign))
    made = json.loads(page.files(found, ledgers.read_ledger(book))["result.json"])["campaigns"][0]
    assert made["thresholds"] == frozen["thresholds"] and made["commit"] == frozen["commit"]
    assert made["frozen_sha256"] == sha256(canonical(frozen))


ENTRY = {"truth_sha256": "a", "verdicts_sha256": "b", "follow_ups": False}


def entries(book, count):
    for n in range(count):
        ledgers.append(book, ENTRY | {"truth_sha256": str(n)})
    return book.read_bytes().splitlines(keepends=True)


def test_every_line_carries_the_hash_of_the_line_before(book):
    lines = entries(book, 3)
    assert [json.loads(line)["previous"] for line in lines] == ["0" * 64, *(sha256(line[:-1]) for line in lines[:2])]


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: [lines[0].replace(b'"follow_ups":false', b'"follow_ups":true'), *lines[1:]],
        lambda lines: [lines[0], lines[2]],
        lambda lines: [lines[1], lines[0], lines[2]],
        lambda lines: lines[1:],
        lambda lines: [*lines[:2], lines[2][:-10]],
    ],
    ids=["changed", "removed", "moved", "first removed", "cut short"],
)
def test_a_ledger_that_was_changed_is_refused(book, change):
    book.write_bytes(b"".join(change(entries(book, 3))))
    with pytest.raises(ledgers.LedgerError):
        ledgers.read_ledger(book)
    with pytest.raises(ledgers.LedgerError):
        ledgers.append(book, ENTRY)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("campaign.json", {"cases": "x"}, "cases: not as it was made"),
        ("campaign.json", {"more": 1}, "more: not as it was made"),
        ("frozen.json", [], "changed after it was written"),
        ("frozen.json", {"diagnosis_sha256": None}, "changed after it was written"),
    ],
)
def test_a_file_of_a_campaign_that_was_changed_is_told(campaign, name, content, words):
    ran(campaign)
    place = campaign / name
    data = json.loads(place.read_text())
    place.write_text(json.dumps({**data, **content} if isinstance(content, dict) else content))
    with pytest.raises(ChallengeError, match=words):
        ran(campaign)


def test_a_line_of_the_ledger_without_what_is_told_of_every_campaign_is_refused(tmp_path):
    place = tmp_path / "ledger.jsonl"
    place.write_bytes(canonical({"number": 1, "previous": ledgers.FIRST, "result": {}, "campaign": "x"}) + b"\n")
    with pytest.raises(ledgers.LedgerError, match="line 1: without cases, commit"):
        ledgers.read_ledger(place)
