"""The test that a diagnosis asks for is taken and given back to it, by the command line."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

import tests.diagnosis_recordings as recordings
from calibration.challenge.second_rig import another_day, draw, make_recording
from calibration.data.joined import as_given
from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.next_test.promised import Kept, Promise, Rival, asked_for, captures_of, kept, why_not
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.verdict import VerdictKind
from calibration.likelihood.expected import Capture
from calibration.studies.follow_ups import dry_friction_alone
from rig.recording import read_recording, write_recording
from tests.calibration.diagnosis.test_several_recordings import FRICTION, on_another_day
from tests.documents import check

OF_NOTHING = ("--without", "nothing")  # refused, with the files that there are
MADE_OF = {"folder": "../swept", "sha256": "", "without": []}


def of_diagnosis(recordings: object, **keys: object) -> str:
    """What is read of a diagnosis that is gone on with."""
    return json.dumps({"format": "diagnosis/1", "recordings": recordings, "next_tests": []} | keys)


@pytest.fixture(scope="module")
def asked(tmp_path_factory) -> Path:
    """A recording that hides dry friction, and the run with a flywheel that its diagnosis asks for, of another day."""
    folder = tmp_path_factory.mktemp("asked")
    recordings.sweep(folder / "swept", 3, FRICTION)
    recordings.add_coast_down(folder / "swept", 3, FRICTION)
    with pytest.MonkeyPatch.context() as day:
        heavy = on_another_day(folder / "whole", 8, FRICTION, day, True, level_bar=1.7, samples=240)
    channels = {name: one for name, one in heavy.channels.items() if name != "flow_l_min"}
    write_recording(replace(heavy, files=heavy.files[1:], channels=channels), folder / "flywheel")
    return folder


@pytest.mark.long
def test_a_line_that_is_not_vented_hides_dry_friction_and_a_valve_that_vents_shows_it(tmp_path):
    """A litre of air behind a shut valve drives the motor while it coasts down."""
    shut = dry_friction_alone(draw("development", 430014, "follow-ups"), (0.2, 0.5))
    assert shut.supply["vent_area_mm2"] == 0.0
    make_recording(shut, tmp_path / "first")
    first = read_recording(tmp_path / "first")
    tests = diagnose(first, 1).next_tests
    (vented,) = [one for one in tests if "the line vented within 0.1 s" in one.test]
    same = next(one for one in tests if one.capture and vented.test.startswith(one.test))
    assert vented.needs and vented.information_nats > 5.0 * same.information_nats
    another_day(
        replace(shut, supply=shut.supply | {"vent_area_mm2": 30.0}), asdict(same.capture), 1, tmp_path / "valve"
    )
    verdict = diagnose(as_given([first, read_recording(tmp_path / "valve")]), 1).verdict
    assert (verdict.kind, verdict.chosen.names) == (VerdictKind.NAMED, ("coulomb_friction",))


@pytest.mark.long
def test_a_diagnosis_goes_on_with_the_test_that_it_asked_for(asked, spinbench_here):
    done = spinbench_here("diagnose", "swept", "-o", "first", cwd=asked)
    assert done.returncode == 0, done.stderr
    first = json.loads((asked / "first" / "diagnosis.json").read_text())
    assert first["verdict"] == "consistent"
    wanted = first["next_tests"][0]
    least_nats, dry_nats = wanted["range_nats"]  # the latter where dry friction is true
    assert "flywheel" in wanted["test"] and dry_nats > 5.0
    assert least_nats <= wanted["information_nats"] <= dry_nats  # the median: of two as likely, either
    assert wanted["command"].startswith("spinbench capture BENCH --kind coast-down --level-bar-abs 1.")
    assert wanted["command"].endswith(" --added-inertia-kg-m2 0.015")
    assert {"effects": ["coulomb_friction"]}.items() <= first["rivals"][1].items()

    done = spinbench_here("diagnose", "--continue", "first", "flywheel", "-o", "second", cwd=asked)
    assert done.returncode == 0, done.stderr
    second = json.loads((asked / "second" / "diagnosis.json").read_text())
    check(second)
    assert [one["folder"] for one in second["recordings"]] == ["../swept", "../flywheel"]
    assert ["coulomb_friction"] in [[one["id"] for one in second["effects"]], *second["alternatives"]]
    assert len(second["promised"]) == 1, done.stderr
    promised = second["promised"][0]
    assert promised["test"] == wanted["test"]
    assert promised["information_nats"] == wanted["information_nats"]
    assert 0.5 < promised["delivered_nats"] / dry_nats < 2.0
    assert f"gave {promised['delivered_nats']:.1f}" in done.stdout
    page = next((asked / "second").glob("report.html")).read_text()
    assert "What the tests that were asked for have given" in page
    assert f">{promised['delivered_nats']:.1f}</td>" in page
    unfolded = page[: page.index("<details>")]
    assert '<a href="report_flywheel.html">flywheel</a>: 1 run in time, with a flywheel of 0.015 kg m²' in unfolded
    assert (asked / "second" / "report_flywheel.html").is_file()

    alone = spinbench_here("diagnose", "flywheel", cwd=asked)
    assert alone.returncode == 2
    assert "no steady row" in alone.stderr

    moved = asked / "elsewhere"
    shutil.copytree(asked / "first", moved / "first")
    refused = spinbench_here("diagnose", "--continue", "elsewhere/first", "flywheel", "-o", "third", cwd=asked)
    assert refused.returncode == 2
    assert "elsewhere/swept is not there any more" in refused.stderr
    shutil.copytree(asked / "swept", moved / "swept")
    sheet = moved / "swept" / "sweep.csv"
    sheet.write_text(sheet.read_text().replace("up", "down", 1))
    refused = spinbench_here("diagnose", "--continue", "elsewhere/first", "flywheel", "-o", "third", cwd=asked)
    assert refused.returncode == 2
    assert "it was changed" in refused.stderr
    assert not (asked / "third").exists()


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (None, "(No such file or directory)"),
        ("{", "(it is no JSON, or was cut off)"),
        ('{"format": "diagnosis/1"}', "does not say what was diagnosed"),
        ('{"format": "diagnosis/99", "recordings": [1]}', "of format diagnosis/99"),
        ('["diagnosis/1"]', "does not say what was diagnosed"),
        ("[" * 100_000, "(it is no JSON, or was cut off)"),
        (of_diagnosis("abc"), "'recordings' should be a valid list (given: 'abc'); it was damaged: diagnose anew"),
        (of_diagnosis([1]), "value 1 of 'recordings' should be a table"),
        (of_diagnosis([{}]), "the key 'folder' in [[recordings]] entry 1 is missing"),
        (of_diagnosis([MADE_OF], next_tests=None), "'next_tests' should be a valid list"),
        (of_diagnosis([MADE_OF], next_tests=[{}]), "the key 'test' in [[next_tests]] entry 1 is missing"),
        (of_diagnosis([MADE_OF], rivals=[1]), "value 1 of 'rivals' should be a table"),
        (of_diagnosis([MADE_OF], promised=[{}]), "the key 'test' in [[promised]] entry 1 is missing"),
    ],
)
def test_what_is_no_diagnosis_is_not_gone_on_with(content, why, asked, tmp_path, spinbench_here):
    if content is not None:
        (tmp_path / "diagnosis.json").write_text(content)
    done = spinbench_here("diagnose", "--continue", tmp_path, "flywheel", "-o", tmp_path / "out", cwd=asked)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr and str(tmp_path / "diagnosis.json") in done.stderr
    assert why in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def gone_on_with(tmp_path, spinbench_here, *words: str, left_out: Sequence[str] = ()) -> list[str]:
    """What is said where a diagnosis of RS, which is in out, is gone on with and that is refused."""
    made_of = {"folder": "../RS", "sha256": read_recording(tmp_path / "RS").sha256, "without": left_out}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "diagnosis.json").write_text(of_diagnosis([made_of]))
    done = spinbench_here("diagnose", "--continue", *words, cwd=tmp_path)
    assert done.returncode == 2
    return done.stderr.splitlines()


@pytest.fixture
def taken_after(asked, tmp_path):
    """The sweep as RS, and RC that was taken after it."""
    shutil.copytree(asked / "swept", tmp_path / "RS")
    shutil.copytree(asked / "flywheel", tmp_path / "RC")
    with (tmp_path / "RC" / "recording.toml").open("a") as file:
        file.write('\n[origin]\nparent = "RS"\n')
    return tmp_path


def test_a_copy_of_what_rows_were_left_out_of_is_given_twice(taken_after, spinbench_here):
    shutil.copytree(taken_after / "RS", taken_after / "copy")
    left_out = ["sweep.csv:3", "coast_down.csv"]
    (said,) = gone_on_with(taken_after, spinbench_here, "out", "copy", left_out=left_out)
    assert "a recording is given twice: copy, which is RS or a copy" in said


def test_a_parent_that_was_diagnosed_already_is_not_taken_in_again(taken_after, spinbench_here):
    (said,) = gone_on_with(taken_after, spinbench_here, "out", "RC", "--with-parents", *OF_NOTHING)
    assert "there are RS/sweep.csv, RS/coast_down.csv, RC/" in said and said.count("RS/sweep.csv") == 1


def test_what_was_diagnosed_already_is_refused_where_it_is_named_itself(taken_after, spinbench_here):
    (said,) = gone_on_with(taken_after, spinbench_here, "out", "RS", "--with-parents")
    assert "a recording is given twice: RS;" in said


def test_recordings_are_found_from_a_folder_that_is_named_by_a_link(taken_after, spinbench_here):
    (taken_after / "deep" / "er").mkdir(parents=True)
    (taken_after / "deep" / "er" / "link").symlink_to(taken_after / "out")
    (said,) = gone_on_with(taken_after, spinbench_here, "deep/er/link", "RC", *OF_NOTHING)
    assert "there are RS/sweep.csv" in said


def test_a_recording_of_another_motor_is_refused_before_anything_is_said_of_it(taken_after, spinbench_here):
    with (taken_after / "RS" / "recording.toml").open("a") as file:
        file.write('\n[origin]\nmotor_serial = "7"\n')
    after = taken_after / "RC" / "recording.toml"
    after.write_text(after.read_text().replace('parent = "RS"', 'motor_serial = "8"'))
    (said,) = gone_on_with(taken_after, spinbench_here, "out", "RC")
    assert "no. 8, not of the motor" in said


def test_a_diagnosis_that_asked_for_no_test_is_said_to_have_asked_for_none(taken_after, spinbench_here):
    at_rest = taken_after / "RC" / "coast_down.csv"  # refused once that is said
    at_rest.write_text(re.sub(r"(?m)[\d.]+$", "0", at_rest.read_text()))
    said = gone_on_with(taken_after, spinbench_here, "out", "RC")[0]
    assert said == "spinbench: out asked for no test, so nothing was promised of what is given now"


def test_what_a_recording_holds_is_told_as_it_is_asked_for(asked):
    (run,) = captures_of(read_recording(asked / "flywheel"))
    assert run.kind == "coast-down"
    assert run.added_inertia_kg_m2 == pytest.approx(0.015, rel=0.05)
    sweep = captures_of(read_recording(asked / "swept"))
    assert [one.kind for one in sweep] == ["coast-down"]  # a sweep of many levels is none that is asked for


def test_a_run_that_was_not_asked_for_is_told_with_what_it_holds_and_what_was_asked_for(asked):
    flywheel = read_recording(asked / "flywheel")
    wanted = [Capture("coast-down", 2.39), Capture("zero")]
    said = why_not(wanted, flywheel)
    assert "holds a coast-down from 1.70 bar abs with 0.015 kg m2 added. Asked for: a coast-down from 2.39 bar" in said
    run = flywheel.files[0]
    silent = run.columns["pressure_bar_abs"]
    silent = replace(silent, values=np.full_like(silent.values, np.nan))
    unread = replace(flywheel, files=(replace(run, columns={**run.columns, "pressure_bar_abs": silent}),))
    assert f"holds no test by itself; {run.file} has no reading of the pressure. Asked for: " in why_not(wanted, unread)
    columns = {name: one for name, one in run.columns.items() if name != "supply_open"}
    untold = replace(flywheel, files=(replace(run, columns=columns),))
    assert f"holds no test by itself; {run.file} has no column supply_open. Asked for: " in why_not(wanted, untold)


def test_a_test_that_was_taken_more_than_once_was_promised_of_one(asked):
    flywheel = read_recording(asked / "flywheel")
    wanted = [("coast-down with a flywheel", 4.0, Capture("coast-down", 1.7, 0.015)), ("zero", 1.0, Capture("zero"))]
    for taken, said in (([flywheel], ""), ([flywheel] * 3, ", 3 times (promised of one)")):
        assert asked_for(wanted, {}, taken) == Promise(f"coast-down with a flywheel{said}", 4.0, {})


def test_a_gauge_pressure_is_above_the_room_of_the_motor_where_none_is_told(asked):
    flywheel = read_recording(asked / "flywheel")
    room, run = flywheel.ambient.pressure_bar_abs, flywheel.files[0]
    columns = dict(run.columns)
    read = columns.pop("pressure_bar_abs")
    columns["pressure_bar_gauge"] = replace(read, values=read.values - room)
    untold = replace(flywheel.ambient, pressure_bar_abs=None)
    (taken,) = captures_of(replace(flywheel, ambient=untold, files=(replace(run, columns=columns),)))
    assert taken.level_bar_abs == pytest.approx(1.7 - room + 1.01325, abs=0.02)


def test_a_spin_up_is_one_where_its_last_row_does_not_tell_of_the_supply(asked):
    flywheel = read_recording(asked / "flywheel")
    run = flywheel.files[0]
    supply = run.columns["supply_open"]
    values = np.ones_like(supply.values)
    values[-1] = np.nan
    files = (replace(run, columns={**run.columns, "supply_open": replace(supply, values=values)}),)
    (taken,) = captures_of(replace(flywheel, files=files))
    assert taken.kind == "spin-up"


def test_what_a_test_gave_is_what_it_moved_the_odds_of_the_likelier_by():
    def candidate(names: tuple[str, ...], log_evidence: float) -> Candidate:
        return Candidate(names, None, log_evidence, math.log(0.5))

    before = {(): Rival(-10.0, 0.5), ("windage",): Rival(-12.0, 0.25), ("leakage",): Rival(-11.0, 0.1)}
    promise = Promise("a test", 12.0, before)
    now = [candidate((), -60.0), candidate(("windage",), -50.0), candidate(("leakage",), -60.5)]
    moved = [10.0 + 2.0, 0.5 - 1.0, 10.5 + 1.0]  # windage and nothing, nothing and leakage, windage and leakage
    both = [0.5 * 0.25, 0.5 * 0.1, 0.25 * 0.1]
    assert kept(promise, now) == Kept("a test", 12.0, round(float(np.average(moved, weights=both)), 2))
    assert kept(promise, now[:1]) is None
    four = replace(promise, rivals={**before, ("inertia",): Rival(-9.0, 0.2)})  # its test was weighed for three alone
    assert kept(four, [*now, candidate(("inertia",), 0.0)]) == kept(promise, now)
