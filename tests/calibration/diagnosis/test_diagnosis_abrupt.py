"""What changed from one moment on is no listed effect, however much a listed one may look like it."""

from __future__ import annotations

from pathlib import Path

import pytest

from calibration.diagnosis import as_json, diagnose
from calibration.diagnosis.steps.abrupt import step_instead
from calibration.likelihood.descent import find
from calibration.report.diagnosis.words import place_in_words
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from model.motor import read_motor
from rig.recording import Recording, read_recording
from tests.diagnosis_recordings import sweep

WARM_UP = "friction_warm_up"
BRAKE = {"torque_step": {"torque_nm": 0.10, "moment_s": 350.0}}


def of(recording: Recording, *names: str):
    comparison = Comparison(Problem(recording))
    base = base_of(comparison)
    return comparison, find(comparison, names, base) if names else base


def test_a_torque_from_a_moment_on_beats_a_warm_up_and_the_moment_is_found(tmp_path: Path) -> None:
    comparison, mode = of(sweep(tmp_path, 21, BRAKE), WARM_UP)
    found = step_instead(comparison, mode)
    assert found is not None and found.explains
    assert (found.channel, found.balance) == ("speed", "torque")
    assert 320.0 < found.start_s < 400.0  # between the plateaus about 350 s, or the next ones
    assert not comparison.problem.given  # what was tried leaves nothing behind


def test_a_torque_that_sets_in_during_a_plateau_is_told_too(tmp_path: Path) -> None:
    """That plateau's mean shows a part of it, and belongs to what comes after."""
    for name, chosen in (("free", {}), ("braked", {"torque_step": {"torque_nm": 0.19, "moment_s": 350.0}})):
        sweep(tmp_path / name, 21, chosen)
    free, braked = ((tmp_path / name / "sweep.csv").read_text("utf-8").splitlines() for name in ("free", "braked"))
    row = next(i for i, line in enumerate(braked) if i and float(line.split(",")[0]) > 350.0)
    before, after = (line.split(",") for line in (free[row], braked[row]))
    part = [f"{0.65 * float(a) + 0.35 * float(b):.1f}" for a, b in zip(before[3:], after[3:], strict=True)]
    braked[row] = ",".join([*after[:3], *part])
    (tmp_path / "braked" / "sweep.csv").write_text("\n".join(braked) + "\n", encoding="utf-8")
    found = step_instead(*of(read_recording(tmp_path / "braked"), WARM_UP))
    assert found is not None and found.explains and found.balance == "torque"
    assert found.start_s == 340.0


def test_a_warm_up_is_not_given_up_for_a_step(tmp_path: Path) -> None:
    comparison, mode = of(sweep(tmp_path, 4, {WARM_UP: {"share_cold": 0.15, "time_s": 240.0}}), WARM_UP)
    found = step_instead(comparison, mode)
    assert found is not None and not found.explains and found.over < -5.0


@pytest.mark.parametrize(("bad_row", "slip"), [(7, 0.0), (None, 0.015)])
def test_a_slipping_tachometer_is_told_from_a_misread_row(tmp_path: Path, bad_row: int | None, slip: float) -> None:
    comparison, base = of(sweep(tmp_path, 5, {}, bad_row, slip))
    found = step_instead(comparison, base)
    assert found is not None
    assert found.explains == (slip > 0.0)
    if slip:
        assert (found.channel, found.balance, found.start_s) == ("speed", "sensor", 740.0)
        place = found.place
        assert place.coordinate == "time" and place.where == (740.0, 1000.0) and place.p_value < 1e-3


@pytest.mark.long
def test_what_a_step_explains_is_unresolved_and_located_in_time(tmp_path: Path) -> None:
    found = as_json(diagnose(sweep(tmp_path, 21, BRAKE), 1))
    assert found["verdict"] == "unresolved" and [e["id"] for e in found["effects"]] == ["unknown"]
    assert any(one["coordinate"] == "time" and one["balance"] == "torque" for one in found["located"])


def test_a_recording_of_few_plateaus_has_no_moment_to_tell(tmp_path: Path) -> None:
    sweep(tmp_path, 1, {})
    lines = (tmp_path / "sweep.csv").read_text(encoding="utf-8").splitlines()[:6]
    (tmp_path / "sweep.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    comparison, base = of(read_recording(tmp_path))
    assert step_instead(comparison, base) is None


def test_a_sweep_without_a_clock_has_no_moment_to_tell(tmp_path: Path) -> None:
    sweep(tmp_path, 5, {}, None, 0.015)
    rows = (line.partition(",")[2] for line in (tmp_path / "sweep.csv").read_text(encoding="utf-8").splitlines())
    (tmp_path / "sweep.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert step_instead(*of(read_recording(tmp_path))) is None


def test_an_unlisted_effect_is_no_candidate_but_a_value_can_be_given(tmp_path: Path) -> None:
    problem = Problem(sweep(tmp_path, 1, {}), read_motor("ptm3600"))
    assert "torque_step" not in {effect.id for effect in problem.effects_that_could()}
    problem = problem.giving({("torque_step", "moment_s"): 350.0})
    assert [unknown.name for _, unknown in problem.effect_unknowns(["torque_step"])] == ["torque_nm"]
    assert problem.chosen(["torque_step"], [1.0])["torque_step"] == {"torque_nm": 0.15, "moment_s": 350.0}


def test_a_place_says_the_moment_and_a_long_span_in_plain_figures() -> None:
    place = {
        "kind": "step", "channel": "speed", "balance": "sensor", "coordinate": "time", "unit": "s", "same_as": [],
        "recording": "",
        "where": [340.0, 1100.24], "sentence": "The tachometer's reading is off from 340 s on (seen in the speed).",
    }  # fmt: skip
    assert place_in_words(place) == place["sentence"]
    text = place_in_words(
        {**place, "kind": "balance", "balance": "torque", "sentence": "The torque error depends on time."}
    )
    assert text == "The torque error depends on time, largest between 340 and 1100 s."
    of_one = {**place, "kind": "balance", "recording": "may"}
    assert place_in_words(of_one).startswith("The error of an instrument depends on time of may, largest")
