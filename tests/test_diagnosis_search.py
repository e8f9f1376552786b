"""The search behind a diagnosis: the valley of f_overall, runs in time, the vented gauge, unseen runs."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.diagnosis import as_json, diagnose, together
from calibration.diagnosis.base import base_of, set_angles
from calibration.diagnosis.descent import find
from calibration.diagnosis.function import Function
from calibration.diagnosis.in_time import Plan, Pulses
from calibration.diagnosis.linear import RUN, VENTED, Comparison
from calibration.diagnosis.problem import Problem
from calibration.diagnosis.unseen import predict_unseen
from calibration.nulls_draw import null_recording
from rig.recording import Recording, RecordingError, read_recording

_spec = importlib.util.spec_from_file_location(
    "diagnosis_recordings", Path(__file__).parent / "diagnosis_recordings.py"
)
assert _spec is not None and _spec.loader is not None
recordings = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(recordings)

LEAK = {"leakage": {"conductance_kg_s_pa2": 4e-14}}
DRAG = {"windage": {"drag_nm_s2": 2e-4}}


def with_zero(folder: Path, reading_bar: float) -> Recording:
    """A recording with ten readings of the vented gauge added to it."""
    (folder / "zero.csv").write_text(
        "time_s,pressure_bar_abs\n" + "".join(f"{i},{reading_bar + 0.001 * (-1) ** i:.4f}\n" for i in range(10)),
        encoding="utf-8",
    )
    text = (folder / "recording.toml").read_text(encoding="utf-8")
    both = '{ file = "sweep.csv", kind = "steady" }, { file = "zero.csv", kind = "zero" }'
    text = text.replace('{ file = "sweep.csv", kind = "steady" }', both)
    (folder / "recording.toml").write_text(text, encoding="utf-8")
    return read_recording(folder)


def test_a_step_along_the_valley_keeps_the_plateaus_speeds(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 1, {})))
    mode = find(comparison, ())
    f = Function(comparison, ())
    moved = mode.z.copy()
    moved[[u.name for u in comparison.problem.nuisances].index("port_lap")] += 0.5
    expected = mode.prediction.speed + mode.D[comparison.n : 2 * comparison.n] @ (moved - mode.z)
    straight = np.linalg.norm(f(moved).speed - expected)
    end = f.along_valley(mode.z, moved, mode.prediction, mode.D)
    assert np.linalg.norm(f(end).speed - expected) < 0.5 * straight
    changed = [u.name for u, a, b in zip(comparison.problem.nuisances, end, moved, strict=True) if a != b]
    assert set(changed) <= {"f_overall", "inertia"}


def test_near_a_point_a_run_is_what_it_is_with_every_pulse(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 2, {})
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 2, {})))
    f = Function(comparison, ())
    z = np.zeros(f.k)
    near, noise = f.near(z), comparison.problem.noise["speed"]
    used = comparison.used[0]
    assert np.max(np.abs(near(z).runs[0] - f(z).runs[0])[used]) < 0.1 * noise
    names = [u.name for u in comparison.problem.nuisances]
    for name in ("f_overall", "inertia", "coast_down.csv.angle"):
        moved = z.copy()
        moved[names.index(name)] += 0.01
        with_pulses, mean = f(moved).runs[0] - f(z).runs[0], near(moved).runs[0] - near(z).runs[0]
        left = np.linalg.norm((with_pulses - mean)[used])
        assert left < 0.5 * np.linalg.norm(with_pulses[used]), name


def test_two_starts_end_at_the_same_evidence(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 3, DRAG)))
    base = find(comparison, ())
    base = find(comparison, (), set_angles(comparison, base))
    ends = [find(comparison, ("windage",), start).log_evidence for start in (base, None)]
    assert abs(ends[0] - ends[1]) < 2.0


def test_of_a_coast_down_only_what_follows_the_closing_valve_is_compared(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 2, {})
    run = Problem(recordings.add_coast_down(tmp_path, 2, {})).blocks.runs[0]
    closed = run.supply[1].start_s
    assert not run.used[run.time <= closed].any()
    assert np.flatnonzero(run.used)[0] == np.flatnonzero(run.time > closed)[2]  # two samples for the line to empty


def test_a_run_of_a_few_samples_is_left_aside(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 2, {})
    recordings.add_coast_down(tmp_path, 2, {})
    file = tmp_path / "coast_down.csv"
    closed = Problem(read_recording(tmp_path)).blocks.runs[0].supply[1].start_s
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    kept = [row for row in rows if float(row.partition(",")[0]) <= closed + 0.022]
    file.write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")
    assert Problem(read_recording(tmp_path)).blocks.runs == ()


def test_drag_is_found_with_its_size_in_a_coast_down(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 3, DRAG)
    comparison = Comparison(Problem(recordings.add_coast_down(tmp_path, 3, DRAG)))
    base = find(comparison, ())
    base = find(comparison, (), set_angles(comparison, base))
    found = find(comparison, ("windage",))
    assert found.log_evidence > base.log_evidence + 10.0
    k = len(comparison.problem.nuisances)
    said = comparison.problem.chosen(("windage",), found.z[k:])["windage"]["drag_nm_s2"]
    sd = np.sqrt(found.covariance[k, k]) * 1e-4
    assert abs(said - 2e-4) < 4.0 * sd + 0.1 * 2e-4
    assert np.sum(found.r[comparison.kind == RUN] ** 2) < 2.0 * np.sum(comparison.kind == RUN)


def test_a_vented_gauge_that_reads_high_is_named(tmp_path: Path) -> None:
    high = {"pressure_gauge_offset": {"offset_pa": 5000.0}}
    recordings.sweep(tmp_path, 4, high)
    recording = with_zero(tmp_path, 1.01325 + 0.05)
    assert np.sum(Comparison(Problem(recording)).kind == VENTED) == 1
    found = as_json(diagnose(recording, 1))
    assert found["verdict"] in ("named", "confounded")
    assert "pressure_gauge_offset" in {e["id"] for e in found["effects"]}


def test_a_vented_gauge_that_reads_right_is_consistent(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 5, {})
    assert as_json(diagnose(with_zero(tmp_path, 1.0135), 1))["verdict"] == "consistent"


def test_an_unseen_run_speaks_for_the_effect_that_is_there(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path / "seen", 6, LEAK)))
    base, leak = find(comparison, ()), find(comparison, ("leakage",))
    unseen = recordings.sweep(tmp_path / "unseen", 7, LEAK)
    told = predict_unseen(comparison, base, leak, unseen)
    assert told.gain > 0.0 and told.scheme == "unseen run unseen"
    assert told.after["flow_m3_s"] < told.before["flow_m3_s"]
    clean = predict_unseen(comparison, base, leak, recordings.sweep(tmp_path / "clean", 8, {}))
    assert clean.gain < told.gain


def test_recordings_of_one_bench_are_diagnosed_together(tmp_path: Path) -> None:
    one, other = recordings.sweep(tmp_path / "one", 9, {}), recordings.sweep(tmp_path / "other", 10, {})
    both = together([one, other])
    assert [file.file for file in both.files] == ["one/sweep.csv", "other/sweep.csv"]
    assert both.files[1].start_s > float(one.files[0].columns["time_s"].values[-1])
    assert Problem(both).blocks.plateaus.size == 2 * Problem(one).blocks.plateaus.size


def test_recordings_of_other_weather_are_not_mixed(tmp_path: Path) -> None:
    one, other = recordings.sweep(tmp_path / "one", 9, {}), recordings.sweep(tmp_path / "other", 10, {})
    elsewhere = replace(other, ambient=replace(other.ambient, pressure_bar_abs=0.95))
    with pytest.raises(RecordingError, match=r"\[ambient\]"):
        together([one, elsewhere])


def test_a_level_that_was_seen_to_turn_is_not_given_up_as_standing() -> None:
    """Seeds whose lowest level is close to a stall, where a search once ended with it standing and its readings bad."""
    for seed in (900030, 900000):
        nothing, _ = null_recording("declared", False, np.random.default_rng(seed))
        base = base_of(Comparison(Problem(nothing)))
        assert np.all(base.bad < 0.5)
        assert np.sum(base.r**2) < 80.0  # of 52 readings


class _TurnsBack(Plan):
    """A shaft that comes to rest and turns back, as one may by which pressure is left in a cylinder."""

    def mean_speed(self) -> np.ndarray:
        return 5.0 - 2.0 * self.time

    def with_pulses(self, finer: int = 1) -> SimpleNamespace:
        time = np.linspace(self.time[0], self.time[-1], (self.time.size - 1) * finer + 1)
        return SimpleNamespace(time=time, angle=5.0 * time - time**2 + 0.01 * np.sin(30.0 * time))


def test_a_shaft_that_turns_back_has_pulses_all_the_same() -> None:
    time = np.linspace(0.0, 5.0, 101)
    planned = _TurnsBack(np.zeros(24), np.zeros(5), (), time, np.zeros(23), {}, 0.0, time.size, 0.0, 0.0)
    speeds = Pulses(planned).beside(planned)
    assert np.all(np.isfinite(speeds))
    forward = time < 2.0
    assert np.ptp((speeds - planned.mean_speed())[forward]) > 0.1  # what the pulses add
