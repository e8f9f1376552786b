"""What tests promise against what they give: the cases of other days, and what the campaign makes of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from calibration.challenge.second_rig import another_day, draw, make_recording
from calibration.diagnosis.next_test.promised import captures_of
from calibration.studies.campaigns import main
from calibration.studies.follow_ups import STUDY, dry_friction_alone, page, picture, summary
from rig.recording import read_recording

CAPTURES = [
    {"kind": "coast-down", "level_bar_abs": 1.8, "added_inertia_kg_m2": 0.015},
    {"kind": "spin-up", "level_bar_abs": 2.1, "added_inertia_kg_m2": 0.0},
    {"kind": "plateaus", "level_bar_abs": 1.6, "added_inertia_kg_m2": 0.0},
    {"kind": "zero", "level_bar_abs": None, "added_inertia_kg_m2": 0.0},
]


@pytest.mark.parametrize("capture", CAPTURES, ids=[one["kind"] for one in CAPTURES])
def test_the_test_of_another_day_is_the_one_that_was_asked_for_in_another_room(capture, tmp_path):
    truth = draw("development", 11, "days")
    make_recording(truth, tmp_path / "first")
    another_day(truth, capture, 1, tmp_path / "second")
    first, second = (read_recording(tmp_path / name) for name in ("first", "second"))
    (taken,) = captures_of(second)
    assert taken.kind == capture["kind"]
    if capture["level_bar_abs"]:
        assert taken.level_bar_abs == pytest.approx(capture["level_bar_abs"], rel=0.05)
    assert taken.added_inertia_kg_m2 == capture["added_inertia_kg_m2"]
    assert second.ambient.pressure_bar_abs != first.ambient.pressure_bar_abs


def step(outcome: str, rivals: str, *promised: float) -> dict:
    keys = ("information_nats", "delivered_nats", "nats_if_right")  # older cases lack the last
    told = [{"test": "a test"} | dict(zip(keys, promised, strict=False))] if promised else []
    return {"outcome": outcome, "rivals": [one.split("+") for one in rivals.split()], "promised": told}


def test_promises_are_held_against_what_came_of_them_and_names_are_counted():
    listed, open_ = "truth listed", "a+b windage leakage inertia"  # the fourth is weighed by no test
    cases = [
        {"ids": ["windage"], "D": 9.0, "steps": [step(listed, open_), step("right", "", 20.0, 10.0)]},
        {"ids": ["leakage"], "D": 8.0, "steps": [step(listed, open_), step(listed, open_, 30.0, 30.0, 12.0)]},
        {"ids": ["inertia"], "D": 2.0, "steps": [step("missed", open_), step("wrong name", "", 20.0, 40.0)]},
        {"ids": [], "D": 0.0, "steps": [step("right", "")]},
        {"ids": ["flow_scale"], "D": None, "steps": [step("right", "flow_scale"), step("right", "", 5.0, 1.0, 9.0)]},
    ]
    kept = [{"name": f"case-{i}", "error": "", "code": "ab"[i > 1], "sweep": i == 0} for i in range(len(cases))]
    rows = [case | one for case, one in zip(cases, kept, strict=True)]
    found = summary([*rows, {"name": "case-9", "error": "ValueError: no"}], 1, "code")
    assert (found["cases"], found["open"]) == (5, 4)
    assert found["ratios"] == {"count": 3, "median": 1.0, "quartiles": [0.75, 1.5]}
    assert found["ratios_if_right"] == {"count": 1, "median": 2.5, "quartiles": [2.5, 2.5]}
    assert (found["told_apart"], found["named_after"]) == (2, [1, 1])
    assert (found["wrong_before"], found["wrong_after"]) == (0, 1)
    words = page(found)
    assert "5 cases of the second rig, 1 of them a sweep alone at first.\n4 stayed open" in words
    assert "All promises: 4. Delivered over promised: median 0.75, quartiles 0.42 and 1.25." in words
    assert "nats: 3. Delivered over promised: median 1.00, quartiles 0.75 and 1.50." in words
    assert "weighed for: 1. Delivered over promised: median 2.50, quartiles 2.50 and 2.50." in words
    assert "| windage | 9.0 | truth listed, then right | a test |" in words
    assert "| below 3 | 1 missed |" in words and "| 7 and more | 2 truth listed |" in words
    assert "States of the code: 2, with 2 and 3 cases." in words
    assert "case-9: ValueError: no" in words and "| flow_scale |  | right, then right | a test |" in words
    assert picture(found).startswith(b"\x89PNG")


def made(argument: Mapping[str, Any]) -> dict[str, Any]:
    return {"ids": [], "D": None, "sweep": False, "steps": [step("right", "")], "seed": argument["seed"]}


def test_cases_of_an_earlier_campaign_count_once(tmp_path, capsys):
    study = replace(STUDY, task=made, roots=("calibration.studies.campaigns",))

    def campaign(out: str, first_seed: int, *more: str) -> int:
        return main(
            study, ["-o", str(tmp_path / out), *f"--cases 2 --first-seed {first_seed} --workers 0".split(), *more]
        )

    assert campaign("first", 1) == 0
    kept = tmp_path / "first" / "cases.json"
    assert campaign("second", 2, "--also", str(kept), str(kept)) == 0
    rows = json.loads((tmp_path / "second" / "cases.json").read_bytes())
    assert [one["seed"] for one in rows] == [1, 2, 3] and {one["code"] for one in rows} == {study.code()}
    kept.write_text('{"cases": 2}')
    capsys.readouterr()
    assert campaign("third", 4, "--also", str(kept)) == 2
    assert "cases.json: no rows of an earlier campaign" in capsys.readouterr().err
    assert not (tmp_path / "third" / "cases.json").exists()


@pytest.mark.parametrize("torques", ["0.2 0.06", "0 0.2", "nan 0.2", "0.1 inf"])
def test_a_range_that_holds_no_torque_is_told(torques, tmp_path, capsys):
    assert main(STUDY, ["-o", str(tmp_path / "out"), "--dry-friction", *torques.split()]) == 2
    assert capsys.readouterr().err.startswith("follow_ups: --dry-friction: two torques above 0 N m")
    assert not (tmp_path / "out").exists()


def test_dry_friction_alone_takes_the_place_of_all_that_is_concealed():
    for index in range(20):
        there = dry_friction_alone(draw("development", index, "days"), (0.06, 0.20))
        assert there.ids == ["coulomb_friction"] and there.with_transients
        (effect,) = there.rig().effects
        assert effect.id == "coulomb_friction" and 0.06 <= effect.values["torque_nm"] <= 0.20
