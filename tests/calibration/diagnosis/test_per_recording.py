"""An effect whose sizes are each recording's own: `--per-recording`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import tests.diagnosis_recordings as recordings
from calibration import fit_quality
from calibration.fit.integrated import Integrated
from calibration.systems.look_up import compared
from calibration.systems.several.sharing import Sharing, own_of_each
from rig.recording import read_recording
from tests.commands import spinbench
from tests.documents import check

LEAK = {"first": 1e-14, "second": 3e-14}  # kg/(s Pa2)
DATES = {"first": "2026-03-02", "second": "2026-01-20"}


@pytest.fixture(scope="module")
def two_days(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half of two sweeps of a motor whose leak is another on each day; the second one given is the older."""
    folder = tmp_path_factory.mktemp("days")
    for seed, (name, leak) in enumerate(LEAK.items(), start=3):
        recordings.sweep(folder / name, seed, {"leakage": {"conductance_kg_s_pa2": leak, "exponent": 0.63}})
        recordings.every_second_row(folder / name)
        with (folder / name / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\ndate = "{DATES[name]}"\n')
    return folder


@pytest.mark.long
def test_each_recording_has_its_own_size_and_one_effect_is_named(two_days: Path, tmp_path: Path) -> None:
    done = spinbench(
        "diagnose", two_days / "first", two_days / "second", "--per-recording", "leakage", "-o", tmp_path / "out"
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    check(found)
    assert [one["id"] for one in found["effects"]] == ["leakage"]
    effect = found["effects"][0]
    assert effect["parameters"] == {}
    assert [(one["recording"], one["date"]) for one in effect["recordings"]] == [
        ("second", "2026-01-20"),
        ("first", "2026-03-02"),
    ]
    for one in effect["recordings"]:
        size = one["parameters"]["conductance_kg_s_pa2"]
        assert size["q05"] < LEAK[one["recording"]] < size["q95"]
    assert "second (2026-01-20)" in done.stderr and "first (2026-03-02)" in done.stderr
    page = (tmp_path / "out" / "report_first.html").read_text(encoding="utf-8")
    assert "Along the dates" in page


def test_sizes_of_each_recording_act_in_it_alone(two_days: Path) -> None:
    read = [read_recording(two_days / name) for name in LEAK]
    several = compared(read, sharing=Sharing(frozenset({"leakage"})))
    unknowns = several.problem.effect_unknowns(["leakage"])
    assert [one.name for _, one in unknowns] == [
        "first: conductance_kg_s_pa2",
        "first: exponent",
        "second: conductance_kg_s_pa2",
        "second: exponent",
    ]
    base = several.base()
    chosen = several.problem.chosen(["leakage"], np.array([0.0, 0.0, 1.0, 0.0]))
    without, with_one = (several.raw(several.problem.predict(base.z, one)) for one in ({}, chosen))
    moved = abs(with_one - without)
    assert moved[several.at[0]].max() == 0.0
    assert moved[several.at[1]].max() > 0.0


def test_a_recording_with_a_flywheel_in_one_run_is_one_day(tmp_path: Path) -> None:
    """Its two parts share the size; another recording in a folder of the same name has its own."""
    for place, seed in (("may", 3), ("june", 8)):
        recordings.sweep(tmp_path / place / "bench", seed, {})
        recordings.add_coast_down(tmp_path / place / "bench", seed, {})
        toml = tmp_path / place / "bench" / "recording.toml"
        text = toml.read_text(encoding="utf-8")
        toml.write_text(
            text.replace("noise_scale = 2.0 }", "noise_scale = 2.0, added_inertia_kg_m2 = 0.01 }"), encoding="utf-8"
        )
    read = [read_recording(tmp_path / place / "bench") for place in ("may", "june")]
    problem = compared(read, sharing=Sharing(frozenset({"windage"}))).problem
    assert len(problem.parts) == 4
    sizes = [one.name for _, one in problem.effect_unknowns(["windage"])]
    assert len(sizes) == len(set(sizes)) == 2
    chosen = problem.chosen(["windage"], np.array([1.0, 2.0]))
    z = np.zeros(len(problem.nuisances))
    alone = [list(problem.of_part(k, np.append(z, [1.0, 2.0]), ["windage"]))[-1] for k in range(4)]
    assert alone == [1.0, 1.0, 2.0, 2.0] and len(chosen["windage"]) == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("diagnose", "first", "second", "--per-recording", "leackage"), "the nearest is leakage"),
        (("diagnose", "first", "second", "--per-recording", ""), "no effect is called ''; known: bad_reading, coulomb"),
        (("diagnose", "first", "--per-recording", "leakage"), "there is one only"),
        (("diagnose", "first", "second", "--per-recording", "inertia"), "inertia could not show in these recordings"),
        (("fit", "first", "second", "--per-recording", "leackage", "--effects", "leakage"), "the nearest is leakage"),
        (("fit", "first", "second", "--per-recording", "leakage", "--effects", "windage"), "add it to the effects"),
        (("fit", "first", "--per-recording", "leakage", "--effects", "leakage"), "there is one only"),
    ],
)
def test_what_cannot_be_of_each_recording_is_refused_in_a_line(
    two_days: Path, tmp_path: Path, spinbench_here, words: tuple[str, ...], said: str
) -> None:
    done = spinbench_here(*words, "-o", tmp_path / "out", cwd=two_days)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_fit_samples_a_size_of_each_recording(two_days: Path) -> None:
    """About the most probable point, which already has them: a whole fit of two recordings takes minutes."""
    read = [read_recording(two_days / name) for name in LEAK]
    sharing = own_of_each(["leakage"], 2, ["leakage"])
    _, start, quality = fit_quality.judge_whole(read, 1, effects=["leakage"], sharing=sharing)
    assert quality.model_fits
    target = Integrated(start.comparison, start.base)
    names = [one.name for one in target.unknowns]
    centre = target.centre()
    sd = np.sqrt(np.diag(start.base.covariance)[target.shared])
    for name, leak in LEAK.items():
        place = names.index(f"{name}: leakage.conductance_kg_s_pa2")
        unknown = target.unknowns[place]
        low, high = unknown.value(centre[place] + np.array([-2.0, 2.0]) * sd[place])
        assert low < leak < high
    assert np.isfinite(target.log_prob(centre[None, :])).all()
