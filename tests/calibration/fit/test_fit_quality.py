"""Whether the model explains the readings it is fitted to: the diagnosis' own test, on the rows of the fit alone."""

from __future__ import annotations

import math

import pytest

from calibration import fit_quality
from calibration.data import rows_used
from calibration.data.blocks import blocks_of
from calibration.diagnosis import as_json, diagnose
from calibration.fit import fit
from rig.recording import Recording, read_recording
from tests.diagnosis_recordings import add_coast_down, add_held_rotor, sweep

WINDAGE = {"windage": {"drag_nm_s2": 1.5e-4}}
PULSE = 2.0 * math.pi / 28  # rad
HEADER = "pressure_bar_abs,flow_l_min,speed_rpm\n"


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Recording:
    return sweep(tmp_path_factory.mktemp("clean") / "bench", 1, {})


@pytest.fixture(scope="module")
def windy(tmp_path_factory) -> Recording:
    return sweep(tmp_path_factory.mktemp("windy") / "bench", 1, WINDAGE)


@pytest.mark.long
def test_the_number_is_the_diagnosis_own_for_plateaus_and_the_same_seed(clean):
    found = as_json(diagnose(clean, seed=3))
    assert fit_quality.judge(clean, 3).p_value == found["mismatch"]["p_value"]
    assert found["files"] == [{"file": "sweep.csv", "rows": 26, "rows_used": 26, "why": ""}]


@pytest.mark.long
def test_the_same_seed_gives_the_same_bits_and_another_draws_anew(windy):
    assert fit_quality.judge(windy, 1) == fit_quality.judge(windy, 1)
    assert fit_quality.judge(windy, 1).p_value != fit_quality.judge(windy, 4).p_value


@pytest.mark.long
def test_a_run_in_time_changes_nothing(tmp_path, clean):
    sweep(tmp_path / "bench", 1, {})
    assert fit_quality.judge(add_coast_down(tmp_path / "bench", 1, WINDAGE), 1) == fit_quality.judge(clean, 1)


def test_a_held_rotor_changes_nothing_for_no_fit_uses_it(tmp_path, clean):
    sweep(tmp_path / "bench", 1, {})
    assert fit_quality.judge(add_held_rotor(tmp_path / "bench", 1, 5e-4), 1) == fit_quality.judge(clean, 1)


def test_windage_is_seen_and_told_where_and_gone_with_the_effect_in_the_model(windy):
    found = fit_quality.judge(windy, 1)
    assert not found.model_fits and 0.0 < found.p_value < 1e-6
    assert "torque error depends on" in found.why and " rpm" in found.why
    assert fit_quality.judge(windy, 1, effects=["windage"]).model_fits


def test_another_effect_does_not_stand_in_for_it(windy):
    assert not fit_quality.judge(windy, 1, effects=["leakage"]).model_fits


def test_a_single_bad_reading_is_part_of_the_model(tmp_path):
    assert fit_quality.judge(sweep(tmp_path / "bench", 1, {}, bad_row=9), 1).model_fits


def test_readings_that_would_all_be_bad_are_no_exceptions(put_recording):
    rows = "1.7,76,424\n1.83,67,375\n1.95,58,326\n2.1,51,273\n"  # upside down
    found = fit_quality.judge(read_recording(put_recording(("sweep.csv", "steady", HEADER + rows))), 1)
    assert not found.model_fits
    assert "would be bad ones" in found.why or "depends on" in found.why


def test_without_the_flow_its_errors_are_not_looked_at(tmp_path):
    recording = sweep(tmp_path / "bench", 1, {"leakage": {"conductance_kg_s_pa2": 2e-14, "exponent": 1.0}})
    assert not fit_quality.judge(recording, 1).model_fits
    assert fit_quality.judge(recording, 1, channels=("pressure", "speed")).model_fits


@pytest.mark.long
def test_a_changed_motor_is_the_one_that_is_tested(clean):
    assert not fit_quality.judge(clean, 1, ["cylinder_diameter=22"]).model_fits
    assert fit_quality.judge(clean, 1, ["f_overall=0.05"]).model_fits  # the middle of a prior


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("2.0,71.5,394.8\n", "So few rows"),
        ("1.7,51,272.9\n2.0,71.5,394.8\n", "So few rows"),
        ("1.6,<60,\n1.7,>40,\n2.0,>60,\n", "nothing could be tested"),
    ],
)
def test_what_can_hardly_be_tested_is_told_so_with_a_number(put_recording, rows, words):
    found = fit_quality.judge(read_recording(put_recording(("sweep.csv", "steady", HEADER + rows))), 1)
    assert found.model_fits and words in found.why
    assert math.isfinite(found.p_value) and 0.01 < found.p_value <= 1.0


@pytest.fixture
def mixed(put_recording) -> Recording:
    """Four plateaus, one at rest and one without a pressure, two with the rotor held; zero readings; a short run."""
    header = "pressure_bar_abs,flow_l_min,speed_rpm,rotor_locked\n"
    steady = "1.7,51,272.9,0\n1.83,58,326.1,0\n1.1,<10,0,0\n,67,374.5,0\n2.0,3,0,1\n2.0,,0,1\n"
    run = "time_s,pressure_bar_abs,speed_rpm\n0,2,390\n0.01,2,389\n"
    zero = f"{HEADER}1.013,0,0\n,,\n"
    files = (("sweep.csv", "steady", header + steady), ("zero.csv", "zero", zero), ("run.csv", "transient", run))
    return read_recording(put_recording(*files))


def test_a_fit_lists_the_rows_of_each_file_that_it_used(mixed):
    _, measured, _ = fit.prepare(mixed)
    unread = f"1 row: {rows_used.NOTHING_READ}"
    assert rows_used.by_fit(mixed, measured) == [
        {"file": "sweep.csv", "rows": 6, "rows_used": 3, "why": f"2 rows: the rotor is held; {unread}"},
        {"file": "zero.csv", "rows": 2, "rows_used": 1, "why": rows_used.NOTHING_AT_ZERO},
        {"file": "run.csv", "rows": 2, "rows_used": 0, "why": rows_used.NOT_IN_A_FIT},
    ]


def test_a_diagnosis_uses_the_flow_of_a_held_rotor_and_no_row_at_rest(mixed):
    sweep_file, zero, run = rows_used.by_diagnosis(mixed, blocks_of(mixed, PULSE))
    assert (sweep_file["rows_used"], zero["rows_used"], run["rows_used"]) == (3, 1, 0)
    assert sweep_file["why"] == f"1 row: the rotor is held; 2 rows: {rows_used.NOTHING_READ}"
    assert run["why"] == rows_used.OUTSIDE


def test_a_diagnosis_counts_the_samples_of_a_run_that_it_compares(tmp_path):
    sweep(tmp_path / "bench", 1, {})
    recording = add_coast_down(tmp_path / "bench", 1, {})
    blocks = blocks_of(recording, PULSE)
    listed = {one["file"]: one for one in rows_used.by_diagnosis(recording, blocks)}
    run = blocks.runs[0]
    read_at = recording.files[-1].columns["time_s"].values
    spanned = (read_at > run.begin[run.used][0]) & (read_at <= run.time[run.used][-1])  # a sample may join several rows
    assert listed["coast_down.csv"]["rows"] == 60
    assert listed["coast_down.csv"]["rows_used"] == int(spanned.sum()) < 60
