"""Diagnosis of other rigs: what is said where the truth is known, by integrators that the model does not use."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tests.rig_recordings as rigs
from calibration.diagnosis import as_json, diagnose
from calibration.likelihood.descent import find
from calibration.report import style
from calibration.report.machines.page import report
from calibration.report.machines.picture import picture
from calibration.report.machines.words import sentence, table
from calibration.systems.machines.comparison import Comparison
from calibration.systems.machines.problem import Problem
from calibration.systems.machines.readings import means, plateaus
from calibration.systems.machines.system import systems
from calibration.work.sources import DIAGNOSIS, imported
from rig.exchange.importing import import_files
from rig.exchange.mapping import read_mapping
from rig.recording import Column, Recording, RecordingError, read_recording, write_recording
from tests.commands import spinbench

ROOT = Path(__file__).resolve().parents[3]
RECORDINGS = Path(os.environ.get("SPINBENCH_RECORDINGS", ROOT.parent / "shared" / "recordings"))
KINDS = {"free_rotor": rigs.rotor, "driven_axis": rigs.axis, "displacement_machine": rigs.machine}


def draw(seed: int) -> np.random.Generator:
    """Random numbers of a test."""
    return np.random.default_rng(seed)


def said(recording: Recording, unseen: Recording | None = None) -> dict[str, Any]:
    """What is said of a recording."""
    return as_json(diagnose(recording, 1, hold_out=unseen))


def could_show(recording: Recording) -> list[str]:
    """Effects that a recording could show."""
    return [effect.id for effect in Problem(recording).effects_that_could()]


def ids(found: dict[str, Any]) -> list[str]:
    """Effects that a verdict rests on, in alphabetical order."""
    return sorted(effect["id"] for effect in found["effects"])


@pytest.fixture(scope="module")
def dry_axis() -> Recording:
    """A slide with 5 N of dry friction."""
    return rigs.axis(draw(3), lambda v: 5.0 + 0.0 * v)


@pytest.fixture(scope="module")
def dry(dry_axis: Recording) -> dict[str, Any]:
    """What is said of it."""
    return said(dry_axis)


@pytest.mark.parametrize("kind", KINDS)
def test_a_rig_that_lacks_nothing_is_consistent(kind: str) -> None:
    found = said(KINDS[kind](draw(1)))
    assert (found["rig"], found["verdict"]) == (kind, "consistent")
    assert found["effects"] == found["located"] == found["next_tests"] == []


def test_dry_friction_of_a_slide_is_named_with_its_size_and_nothing_beside_it(dry: dict[str, Any]) -> None:
    assert (dry["verdict"], ids(dry)) == ("named", ["coulomb_friction"])
    size = dry["effects"][0]["parameters"]["torque_nm"]
    assert abs(size["mean"] - 5.0) < 3.0 * size["sd"] < 1.0
    assert size["unit"] == "N"


def test_viscous_friction_is_told_before_and_after_an_effect(dry: dict[str, Any]) -> None:
    before, after = dry["f_overall_before"], dry["f_overall_after"]
    assert before["mean"] > 120.0
    assert abs(after["mean"] - 100.0) < 3.0 * after["sd"]


def test_a_named_set_predicts_held_out_segments_better(dry: dict[str, Any]) -> None:
    held_out = dry["improvement"]["held_out"]
    assert held_out["rmse_after"]["force_n"] < 0.8 * held_out["rmse_before"]["force_n"]
    assert held_out["elpd_gain"] > 4.0
    assert held_out["same_set_in_folds"] == held_out["folds"]


def test_a_mismatch_is_located_in_the_balance_that_does_not_close(dry: dict[str, Any]) -> None:
    assert {place["balance"] for place in dry["located"][:2]} == {"torque"}
    assert dry["located"][0]["channel"] == "force"


def test_the_same_seed_gives_the_same_document(dry_axis: Recording, dry: dict[str, Any]) -> None:
    assert said(dry_axis) == dry


def test_an_unseen_run_is_predicted_and_said_to_be_unseen(dry_axis: Recording) -> None:
    other = rigs.axis(draw(4), lambda v: 5.0 + 0.0 * v)
    held_out = said(dry_axis, other)["improvement"]["held_out"]
    assert held_out["scheme"] == "unseen run simulated"
    assert held_out["rmse_after"]["force_n"] < 0.8 * held_out["rmse_before"]["force_n"]


def test_a_run_of_another_kind_of_rig_cannot_be_held_out(dry_axis: Recording) -> None:
    with pytest.raises(RecordingError, match="of a free_rotor, not of a driven_axis"):
        said(dry_axis, rigs.rotor(draw(1)))


def test_friction_of_a_seal_that_grows_with_the_pressure_is_named_over_several_runs() -> None:
    found = said(rigs.cylinder(draw(1), 0.0, 1.5e-5))
    assert (found["verdict"], ids(found)) == ("named", ["load_friction"])
    share = found["effects"][0]["parameters"]["roller_factor"]
    assert share["mean"] == pytest.approx(1.5e-5 / 5e-4, rel=0.1)
    assert found["improvement"]["held_out"]["scheme"].startswith("whole runs")


def test_a_throttled_inlet_of_a_machine_is_named() -> None:
    found = said(rigs.machine(draw(2), loss=5e9))
    assert (found["verdict"], ids(found)) == ("named", ["inlet_throttling"])


def test_quadratic_drag_of_a_rotor_is_named() -> None:
    found = said(rigs.rotor(draw(2), lambda w: 2e-5 * w**2))
    assert (found["verdict"], ids(found)) == ("named", ["windage"])


def fast_rows(recording: Recording) -> Recording:
    """The rows of a recording that are faster than 1100 rpm."""
    file = recording.files[0]
    fast = np.flatnonzero(file.columns["speed_rpm"].values > 1100.0)
    columns = {name: Column(one.values[fast], one.censor[fast]) for name, one in file.columns.items()}
    return replace(recording, files=(replace(file, rows=fast.size, columns=columns),))


def test_what_the_flow_at_high_speed_cannot_tell_is_confounded_and_a_locked_rotor_would_tell() -> None:
    found = said(fast_rows(rigs.machine(draw(1), loss=2e9, without="torque_nm")))
    assert found["verdict"] == "confounded"
    assert ["inlet_throttling"] in [ids(found), *found["alternatives"]]
    assert found["next_tests"][0]["test"].startswith("locked rotor: flow at zero speed")


def test_words_and_table_say_what_the_document_says(dry: dict[str, Any]) -> None:
    assert sentence(dry).startswith("Missing in the model (p < 1e-06): dry friction (torque_nm 5")
    assert table(dry).row_count > 5


def test_the_picture_is_a_png(dry_axis: Recording) -> None:
    assert style.png(picture(diagnose(dry_axis, 1))).startswith(b"\x89PNG")


def test_a_once_per_turn_torque_is_not_asked_for_where_samples_are_turns_apart() -> None:
    assert "once_per_rev_torque" not in could_show(rigs.rotor(draw(1)))


def test_another_mass_is_not_asked_for_where_the_drive_is_a_weight() -> None:
    time = np.arange(0.0, 3.0, 0.1)
    speed = 8.0 * (1.0 - np.exp(-time)) + 0.5 + 0.01 * draw(1).standard_normal(time.size)
    files = [{"kind": "transient", "time_s": time, "force_n": np.full(time.size, 9.8), "velocity_m_s": speed}]
    figures = {"force_n": (0.01, 0.0, 0.0, 0.0), "velocity_m_s": (0.01, 0.0, 0.0, 0.0)}
    assert "inertia" not in could_show(rigs.recording({"kind": "driven_axis", "mass_kg": 1.0}, figures, files))
    assert "inertia" in could_show(rigs.axis(draw(1)))


def test_rows_that_follow_each_other_at_one_state_are_one_plateau() -> None:
    speed = np.repeat([100.0, 150.0, 100.0], 6) * (1.0 + 0.002 * draw(1).standard_normal(18))
    one = plateaus(speed, np.full(18, 3e5), np.zeros(18, dtype=int))
    assert one.tolist() == [0] * 6 + [1] * 6 + [2] * 6
    assert plateaus(np.linspace(10.0, 100.0, 18), np.full(18, 3e5), np.zeros(18, dtype=int)).tolist() == list(range(18))


def test_the_mean_of_rows_that_are_alike_is_not_trusted_as_if_they_were_many() -> None:
    rng = draw(5)
    group = np.repeat(np.arange(40), 25)
    _, white = means(rng.standard_normal(1000), group)
    _, slow = means(rigs.coloured(rng, 1000, 1.0, 0.7), group)
    assert white[0] == pytest.approx(0.2, rel=0.2)
    assert slow[0] > 1.7 * white[0]


def test_an_instrument_without_any_noise_is_refused_with_what_to_do() -> None:
    files = [{"kind": "transient", "time_s": np.arange(9.0), "speed_rpm": 900.0 - 50.0 * np.arange(9.0)}]
    made = rigs.recording({"kind": "free_rotor", "inertia_kg_m2": 0.02}, {"speed_rpm": (0.0, 0.0, 0.0, 0.0)}, files)
    with pytest.raises(RecordingError, match="noise_sd and resolution are both 0"):
        said(made)


def test_the_page_has_what_was_found_and_escapes_what_is_foreign(dry_axis: Recording) -> None:
    foreign = replace(
        dry_axis, folder=Path("/<b>axis"), warnings=("<script>alert(1)</script>",), origin={"note": "<b>worn"}
    )
    found = diagnose(foreign, 1)
    text = report(found, as_json(found))["report.html"].decode()
    assert "<script>" not in text and "<b>" not in text
    for words in (
        "Note: &lt;b&gt;worn",
        "dry friction",
        "N s/m",
        "held-out readings",
        "drive_offset",
        "Candidates",
        "base model: nothing left out",
    ):
        assert words in text


def test_the_command_line_diagnoses_a_rig_written_out_in_its_recording(tmp_path: Path) -> None:
    write_recording(rigs.machine(draw(1)), tmp_path / "machine")
    done = spinbench("diagnose", str(tmp_path / "machine"), "--json", str(tmp_path / "out.json"), "-o", str(tmp_path))
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out.json").read_text())
    assert (found["format"], found["verdict"]) == ("diagnosis/1", "consistent")
    assert (tmp_path / "report.png").stat().st_size > 1000
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert found["why"] in page and "data:image/png;base64," in page and "http" not in page
    assert re.search(r"base model \d+\.\d s.* s in all", done.stderr)
    assert sentence(found) in done.stderr


def test_a_run_of_a_rig_held_out_for_nothing_is_told(tmp_path: Path) -> None:
    for seed, name in ((1, "machine"), (2, "unseen")):
        write_recording(rigs.machine(draw(seed)), tmp_path / name)
    done = spinbench("diagnose", str(tmp_path / "machine"), "--hold-out", str(tmp_path / "unseen"), "--json", "-")
    assert json.loads(done.stdout)["verdict"] == "consistent"
    assert f"{tmp_path / 'unseen'} was not predicted" in done.stderr


def public(mapping: str, files: list[str], place: Path) -> Recording:
    """A public recording, imported."""
    paths = [RECORDINGS / file for file in files]
    if not all(path.exists() for path in paths):
        pytest.skip("the public recordings are not here; SPINBENCH_RECORDINGS says where they are")
    return read_recording(import_files(paths, read_mapping(Path(mapping)), place))


@pytest.mark.parametrize(
    ("mapping", "files", "wanted"),
    [
        ("emps", ["emps/DATA_EMPS.mat"], ("named", [["coulomb_friction"]])),
        ("ball_drops_baseball", ["ball_drops/Ball_drops_data.xls"], ("consistent", [[]])),
        (
            "ball_drops_whiffle",
            ["ball_drops/Ball_drops_data.xls"],
            (
                "confounded",
                [["coulomb_friction", "windage"], ["stribeck_friction", "windage"], ["coulomb_friction"]],
            ),
        ),
    ],
)
def test_public_recordings_are_diagnosed_as_the_docs_say(
    mapping: str, files: list[str], wanted: tuple[str, list[list[str]]], tmp_path: Path
) -> None:
    found = said(public(mapping, files, tmp_path / "made"))
    assert (found["verdict"], [ids(found), *found["alternatives"]]) == wanted


def test_a_vane_machine_s_flow_is_a_throttled_inlet_or_a_leak(tmp_path: Path) -> None:
    """Whether both together are listed too goes with the last digits of the arithmetic, as the docs say."""
    files = ["dexpand/RVE_air_PDLT_steady_states_designconditions.csv"]
    found = said(public("dexpand", files, tmp_path / "made"))
    both, *each = [["inlet_throttling", "leakage"], ["inlet_throttling"], ["leakage"]]
    assert found["verdict"] == "confounded"
    assert [ids(found), *found["alternatives"]] in ([both, *each], each)


def test_the_seal_of_the_public_cylinder_rubs_by_its_pressure(tmp_path: Path) -> None:
    paths = [RECORDINGS / "pneumatic_cylinder" / "friction" / f"Circle_{k}bar.csv" for k in range(1, 8)]
    if not all(path.exists() for path in paths):
        pytest.skip("the public recordings are not here; SPINBENCH_RECORDINGS says where they are")
    mapping = read_mapping(Path("pneumatic_cylinder_pressures"))
    comparison = Comparison(Problem(read_recording(import_files(paths, mapping, tmp_path / "made"))))
    gains = {name: find(comparison, (name,)).log_evidence for name in ("load_friction", "coulomb_friction")}
    assert gains["load_friction"] > gains["coulomb_friction"] + 100.0


def part_of(recording: Recording, first: int) -> Recording:
    """The first coast-down of a rotor without its first rows."""
    file = recording.files[0]
    columns = {name: Column(one.values[first:], one.censor[first:]) for name, one in file.columns.items()}
    return replace(recording, files=(replace(file, rows=file.rows - first, columns=columns),))


def test_an_unseen_coast_down_begins_at_its_own_speed_whatever_its_file_is_called() -> None:
    seen = rigs.rotor(draw(2), lambda w: 2e-5 * w**2)
    unseen = part_of(rigs.rotor(draw(5), lambda w: 2e-5 * w**2), 12)
    found = said(seen, unseen)
    assert (found["verdict"], ids(found)) == ("named", ["windage"])
    held_out = found["improvement"]["held_out"]
    assert held_out["scheme"].startswith("unseen run")
    assert held_out["rmse_after"]["speed_rad_s"] < held_out["rmse_before"]["speed_rad_s"] < 5.0


@pytest.mark.long
def test_a_run_s_own_zero_is_not_held_against_the_machine() -> None:
    """However far off it is, it is the run's own."""
    recording = rigs.cylinder(draw(1))
    file = recording.files[0]
    force = file.columns["force_n"]
    moved = replace(file, columns={**file.columns, "force_n": Column(force.values + 8.0, force.censor)})
    found = diagnose(replace(recording, files=(moved, *recording.files[1:])), 1)
    own = found.comparison.problem.place("part_1.csv.drive_offset")
    assert found.base.z[own] > 5.0  # of its prior's deviations
    assert found.detection.pulled == ""


def test_the_code_of_a_diagnosis_holds_every_kind_of_machine() -> None:
    modules = {system.__module__ for system in systems().values()}
    assert modules <= set(imported(DIAGNOSIS))


@pytest.mark.parametrize(("seen", "unseen"), [(0.0, 0.015), (0.015, 0.0)])
def test_an_axis_has_its_rotor_s_inertia_with_any_flywheel(seen: float, unseen: float) -> None:
    """A rotor that is half as heavy again, and an unseen run with another flywheel."""
    one, other = (rigs.turned_axis(draw(seed), 0.0075, own) for seed, own in ((1, seen), (2, unseen)))
    found = as_json(diagnose(one, 1, hold_out=other))
    (effect,) = found["effects"]
    share = effect["parameters"]["share"]
    assert (found["verdict"], effect["id"]) == ("named", "inertia")
    assert abs(share["mean"] - 0.5) < 3.0 * share["sd"] < 0.2
    assert found["improvement"]["held_out"]["kind"] == "unseen run"
