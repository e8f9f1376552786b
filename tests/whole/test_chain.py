"""From bytes to a verdict: a bench that conceals nothing is swept over the wire, exported and diagnosed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rig.recording import Recording, read_recording
from tests import chain
from tests.five_on_three import five_on_three

ROOT = Path(__file__).resolve().parents[2]
TRUE_F_OVERALL = 0.0625  # of configs/motors/ptm3600.toml, which stands behind the virtual bench
LEAST_P = 1e-4  # of a hundred benches with nothing concealed one has a p below 0.01, and each run has its own noise


def spinbench(*arguments: str, folder: Path) -> None:
    command = [sys.executable, "-m", "spinbench", *arguments]
    found = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600, check=False)
    assert found.returncode == 0, found.stderr[-2000:]


@pytest.fixture
def done_here(spinbench_here) -> Callable[..., None]:
    """The same for what needs no bench, in this process."""

    def run(*arguments: str, folder: Path) -> None:
        found = spinbench_here(*arguments, cwd=folder)
        assert found.returncode == 0, found.stderr[-2000:]

    return run


@pytest.mark.long
@pytest.mark.slow
def test_what_the_virtual_bench_records_with_its_transients_is_explained(tmp_path: Path, done_here) -> None:
    """Its line fills over a second, its gauge is read ten times in one, its tachometer counts 60 teeth."""
    text = (ROOT / "configs" / "benches" / "virtual.toml").read_text(encoding="utf-8")
    for before, after in (
        ("levels_bar_abs = [1.25, 1.40, 1.60, 1.80, 2.00, 2.20]", "levels_bar_abs = [1.50, 1.80, 2.10]"),
        ('order = "up-down"', 'order = "up"'),
        ("rate = 20.0", "rate = 10.0"),
    ):
        assert before in text
        text = text.replace(before, after)
    (tmp_path / "bench.toml").write_text(text, encoding="utf-8")
    spinbench("sweep", "bench.toml", "--no-page", "--minutes-running", "0", "--operator", "test", folder=tmp_path)
    done_here("runs", "verify", "last", folder=tmp_path)
    done_here("runs", "export", "last", "-o", "recording", folder=tmp_path)
    done_here("diagnose", "recording", "--workers", "1", "--json", "verdict.json", "--seed", "1", folder=tmp_path)
    said = json.loads((tmp_path / "verdict.json").read_text(encoding="utf-8"))
    assert {Path(one["file"]).stem for one in said["files"]} >= {"sweep", "coast_down", "spin_up"}
    assert said["mismatch"]["p_value"] > LEAST_P
    assert said["effects"] == []
    after = said["f_overall_after"]
    assert abs(after["mean"] - TRUE_F_OVERALL) < 4.0 * after["sd"]
    assert after["sd"] < 0.005


@pytest.mark.long
@pytest.mark.slow
def test_a_line_that_holds_air_behind_a_gauge_with_one_value_a_second_is_explained(tmp_path: Path) -> None:
    """One bench of `make chain`, from bytes to fit and verdict."""
    found = chain.a_bench(tmp_path, 0, fastest=8.0)
    assert found["bench"]["gauge_s"] == 1.0 and found["bench"]["tachometer"] == "60 teeth"
    assert found["p_value"] > LEAST_P and found["named"] == []
    for figure in (found["fit"], found["f_overall"]):
        assert abs(figure["mean"] - TRUE_F_OVERALL) < 4.0 * figure["sd"]


@pytest.mark.long
@pytest.mark.slow
def test_a_bench_of_a_motor_with_five_pistons_on_three_lobes_is_fitted_and_explained(tmp_path: Path, done_here) -> None:
    """The motor's file stands beside the bench's; the run and the recording hold it in full."""
    five_on_three(tmp_path)
    text = (ROOT / "configs" / "benches" / "virtual.toml").read_text(encoding="utf-8")
    for before, after in (
        ('motor = "ptm3600"', 'motor = "five_on_three"'),
        ('order = "up-down"', 'order = "up"'),
        ("rate = 20.0", "rate = 8.0"),
    ):
        assert before in text
        text = text.replace(before, after)
    (tmp_path / "bench.toml").write_text(text, encoding="utf-8")
    spinbench("sweep", "bench.toml", "--minutes-running", "0", "--operator", "test", folder=tmp_path)
    done_here("runs", "export", "last", "-o", "recording", folder=tmp_path)
    (tmp_path / "five_on_three.toml").unlink()
    recording = read_recording(tmp_path / "recording")
    assert isinstance(recording.motor, dict) and recording.motor["n_pistons"] == 5
    fit = ("fit", "recording", "-o", "fit", "--seed", "1", "--effective-samples", "300", "--steady-only")
    done_here(*fit, folder=tmp_path)
    posterior = json.loads((tmp_path / "fit" / "posterior.json").read_text(encoding="utf-8"))
    done_here("diagnose", "recording", "--workers", "1", "--json", "verdict.json", "--seed", "1", folder=tmp_path)
    said = json.loads((tmp_path / "verdict.json").read_text(encoding="utf-8"))
    assert posterior["fit_quality"]["p_value"] > LEAST_P and said["mismatch"]["p_value"] > LEAST_P
    assert said["effects"] == []
    for figure in (posterior["parameters"]["f_overall"], said["f_overall_after"]):
        assert abs(figure["mean"] - TRUE_F_OVERALL) < 4.0 * figure["sd"]
        assert figure["sd"] < 0.005


@pytest.mark.long
@pytest.mark.slow
def test_a_flywheel_that_the_bench_file_states_is_on_the_shaft_and_in_the_recording(tmp_path: Path, done_here) -> None:
    text = (ROOT / "configs" / "benches" / "virtual.toml").read_text(encoding="utf-8")
    for name, more in (("bare", ""), ("heavy", "added_inertia_kg_m2 = 0.015\n")):
        (tmp_path / f"{name}.toml").write_text(text.replace("[ambient]", f"{more}[ambient]", 1), encoding="utf-8")
        spinbench("capture", f"{name}.toml", "--kind", "coast-down", "--rate", "10", folder=tmp_path)
        done_here("runs", "export", "last", "-o", name, folder=tmp_path)
    bare, heavy = (read_recording(tmp_path / name) for name in ("bare", "heavy"))
    assert (bare.added_inertia_kg_m2, heavy.added_inertia_kg_m2) == (0.0, 0.015)
    # Four times the inertia: so much longer from three quarters of the speed to a quarter.
    assert _falls_in(heavy) == pytest.approx(4.0 * _falls_in(bare), rel=0.2)


def _falls_in(recording: Recording) -> float:
    """Time from three quarters of the highest speed to a quarter [s]."""
    run = next(file for file in recording.files if file.kind == "transient")
    time, speed = run.columns["time_s"].values, run.columns["speed_rpm"].values
    last = [float(time[np.flatnonzero(speed > share * np.nanmax(speed))[-1]]) for share in (0.25, 0.75)]
    return last[0] - last[1]
