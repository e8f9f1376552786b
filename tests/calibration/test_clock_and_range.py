"""Rows without a time, and pressures out of range: the fit and the diagnosis say the same of them."""

import numpy as np
import pytest

from calibration.data.refusals import refuse_unusable
from calibration.data.runs_in_time import turns
from calibration.diagnosis import as_json, diagnose
from calibration.diagnosis.mismatch import detect_mismatch
from calibration.fit import fit
from calibration.studies.nulls_draw import null_recording
from calibration.systems.machines.problem import Problem as Machine
from calibration.systems.radial_piston.batch.effects import EffectsError
from rig.recording import RecordingError, read_recording
from tests.diagnosis_recordings import sweep
from tests.rig_recordings import machine


def without_times(folder, rows):
    """The sweep's file with some of its times taken out; all of them when ``rows`` is None: then without the column."""
    path = folder / "sweep.csv"
    lines = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    place = lines[0].index("time_s")
    for number, cells in enumerate(lines):
        if rows is None:
            del cells[place]
        elif number in rows:
            cells[place] = ""
    path.write_text("\n".join(",".join(cells) for cells in lines) + "\n", encoding="utf-8")
    return read_recording(folder)


@pytest.mark.parametrize("rows", [(3,), None])
def test_without_a_time_for_each_row_nothing_is_said_along_time(tmp_path, rows):
    sweep(tmp_path, 3, {})
    recording = without_times(tmp_path, rows)
    found = as_json(diagnose(recording, seed=1))
    assert found["verdict"] == "consistent"
    assert np.isfinite(found["f_overall_after"]["mean"])
    assert "friction_warm_up" not in {one["id"] for one in found["resolves"]}
    if rows:
        assert any("sweep.csv, row 3, has none" in line for line in found["not_observable"])


def test_a_fit_with_an_effect_that_changes_with_time_names_the_row_without_one(tmp_path):
    sweep(tmp_path, 3, {})
    recording = without_times(tmp_path, (3,))
    fit.prepare(recording)
    with pytest.raises(EffectsError, match=r"friction_warm_up changes with time, .*sweep\.csv, row 3, has no time_s"):
        fit.prepare(recording, effects=["friction_warm_up"])


def test_plateaus_without_times_are_not_numbered_in_seconds():
    recording = machine(np.random.default_rng(5))
    for file in recording.files:
        file.columns.pop("time_s", None)
    assert "friction_warm_up" not in {effect.id for effect in Machine(recording).effects_that_could()}


@pytest.mark.parametrize("said_by", [fit.prepare, diagnose, refuse_unusable])
def test_a_pressure_out_of_range_is_refused_by_fit_and_diagnosis_alike(tmp_path, said_by):
    sweep(tmp_path, 3, {})
    path = tmp_path / "sweep.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    head, cells = lines[0].split(","), lines[4].split(",")
    cells[head.index("pressure_bar_abs")] = "20.0"
    lines[4] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"sweep\.csv: row 4: 20 bar absolute is outside 0\.5\.\.8 bar"):
        said_by(read_recording(tmp_path))


def test_a_run_in_which_the_tachometer_shows_noise_alone_is_left_aside(tmp_path):
    sweep(tmp_path, 3, {})
    noise = np.abs(np.random.default_rng(4).normal(0.0, 0.4, 60))
    noise[20] = 3.8  # it lurched
    rows = [f"{0.1 * i:.1f},{int(i > 15)},{2.0 if i > 15 else 1.01},{n:.1f}" for i, n in enumerate(noise)]
    (tmp_path / "spin_up.csv").write_text(
        "\n".join(["time_s,supply_open,pressure_bar_abs,speed_rpm", *rows]) + "\n", encoding="utf-8"
    )
    place = tmp_path / "recording.toml"
    both = '{ file = "sweep.csv", kind = "steady" }, { file = "spin_up.csv", kind = "transient", start_s = 2000.0 }'
    text = place.read_text(encoding="utf-8").replace('{ file = "sweep.csv", kind = "steady" }', both)
    place.write_text(text, encoding="utf-8")
    found = as_json(diagnose(read_recording(tmp_path), seed=1))
    assert found["verdict"] == "consistent"
    assert [(one["file"], one["rows_used"]) for one in found["files"]] == [("sweep.csv", 26), ("spin_up.csv", 0)]
    assert "did not break away" in found["files"][1]["why"]


@pytest.mark.long
@pytest.mark.parametrize(("seed", "fastest_rpm", "is_caught"), [(26, 15.0, True), (403, 40.0, True), (41, 80.0, False)])
def test_a_spin_up_that_is_caught_at_a_dead_point_is_left_aside(seed, fastest_rpm, is_caught):
    """With a large port lap the shaft may stand where no cylinder drives it on: it rocks there, at 2 bar too.

    The last one runs; from other angles it would have been caught.
    """
    draw, chance = (np.random.default_rng(one) for one in np.random.SeedSequence((9700000 + seed, 0, 0)).spawn(2))
    recording, _ = null_recording("declared", True, draw)
    spin_up = next(file for file in recording.files if file.file == "spin_up.csv")
    assert np.max(spin_up.columns["speed_rpm"].values) > fastest_rpm
    assert turns(recording, spin_up) is not is_caught
    assert detect_mismatch(recording, chance).detection.p_value > 0.01
