"""`spinbench many fit` over a folder in which some runs are damaged: each is told, and the others are fitted."""

from __future__ import annotations

import csv
import os
import shutil
from pathlib import Path

import pytest

import spinbench
from calibration import fleet
from calibration.work.sources import imported
from rig.runlog import RunError
from spinbench import readings
from spinbench.cli.errors import without_class
from tests.synthetic_runs import write_sweep

ROOT = Path(__file__).resolve().parents[2]


def run_in(folder: Path, name: str) -> Path:
    """A sound run of that name."""
    return write_sweep(folder, captures=False).rename(folder / name)


def damage(path: Path, lines: slice, instead: bytes = b"") -> None:
    """Put something else in the place of lines."""
    held = path.read_bytes().splitlines(keepends=True)
    held[lines] = [instead] if instead else []
    path.chmod(0o600)
    path.write_bytes(b"".join(held))


def test_a_folder_of_any_bytes_is_an_item_like_others(tmp_path):
    folder = shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / os.fsdecode(b"M\xfcller"))
    assert fleet.item_of(folder, {}, readings.read_of_many).name.startswith("M_ller-")


def test_a_kept_result_knows_the_code_that_read_its_recording(monkeypatch):
    seen = []
    monkeypatch.setattr(fleet, "imported_sha256", lambda *roots: seen.extend(imported(*roots)) or "")
    fleet.item_of(ROOT / "logs" / "published_sweep", {}, readings.read_of_many)
    assert {"calibration.fit.whole", "calibration.diagnosis", "rig.exchange.export", "rig.recording"} <= set(seen)


@pytest.mark.long
def test_fits_and_diagnoses_in_one_folder_keep_their_results_apart(tmp_path, spinbench_here):
    swept = ROOT / "logs" / "published_sweep"
    words = [swept, "-o", "out", "--workers", 1]
    first = spinbench_here("many", "diagnose", *words, cwd=tmp_path)
    second = spinbench_here("many", "fit", "--steady-only", "--effective-samples", 400, *words, cwd=tmp_path)
    kept = sorted((tmp_path / "out" / "results").rglob("*.json"))
    assert [one.parent.name for one in kept] == ["diagnoses", "fits"], first.stderr + second.stderr
    assert "replaced: the table in out, which was of diagnoses and is of fits now" in second.stderr
    again = spinbench_here("many", "diagnose", *words, cwd=tmp_path)
    assert "which was of fits and is of diagnoses now" in again.stderr
    assert kept[0].read_bytes() == (tmp_path / "out" / "results" / "diagnoses" / kept[0].name).read_bytes()


@pytest.mark.long
def test_damaged_runs_are_told_with_all_that_is_wrong_and_the_others_are_fitted(tmp_path, spinbench_here):
    runs = tmp_path / "fleet"
    damage(run_in(runs, "cut") / "samples.csv", slice(-400, None))  # whole lines: what is left reads well
    damage(run_in(runs, "garbled") / "samples.csv", slice(-3, -2), b"\xff\n")
    (run_in(runs, "headless") / "start.json").unlink()
    (run_in(runs, "levelless") / "plateaus.csv").unlink()
    damage(run_in(runs, "no_bytes") / "wire.jsonl", slice(-1, None))
    shutil.copytree(ROOT / "logs" / "published_sweep", runs / "recording")
    damage(runs / "recording" / "sweep.csv", slice(-1, None), b"2.2,over,419.1\n")
    done = spinbench_here(
        *("many", "fit", "fleet", "-o", "out", "--workers", 1, "--max-steps", 4000, "--effective-samples", 500),
        cwd=tmp_path,
    )
    assert done.returncode == 2, done.stderr
    rows = {row["recording"]: row for row in csv.DictReader((tmp_path / "out" / "table.csv").read_text().splitlines())}
    assert {Path(one).name for one in rows} == {one.name for one in runs.iterdir()}
    fitted = [Path(one).name for one, row in rows.items() if not row["error"]]
    assert fitted == ["no_bytes"], rows["fleet/no_bytes"]["error"]
    assert float(rows["fleet/no_bytes"]["f_overall_mean"]) > 0.0
    assert [rows["fleet/no_bytes"][f"{name}_unit"] for name in ("f_overall", "port_lap")] == ["N m s", "deg"]
    lines = [line for line in done.stderr.splitlines() if line.startswith("spinbench: fleet/")]
    told = {line.split(": ")[1].removeprefix("fleet/"): line for line in lines}
    assert not any("Error: " in line for line in lines)
    assert "not as it was sealed: samples.csv: changed" in told["cut"]
    assert "the end record counts 1760 samples, the files hold 1360" in told["cut"]
    assert "take a sound copy or" in told["cut"]
    assert "samples.csv, line 1759: " in told["garbled"]
    assert "holds no start.json" in told["headless"]
    assert "plateaus.csv: missing" in told["levelless"]
    assert "sweep.csv, row 7" in told["recording"] and "'over'" in told["recording"]


@pytest.mark.parametrize("file", ["samples.csv", "events.jsonl", "plateaus.csv", "start.json"])
def test_a_run_that_lacks_a_line_at_its_end_is_not_sound(tmp_path, file):
    run = run_in(tmp_path, "cut")
    damage(run / file, slice(-1, None))
    with pytest.raises(RunError, match=rf"not as it was sealed: {file}: changed since .*; take a sound copy"):
        readings.read_of_many(run)


def test_a_changed_run_is_refused_alone_as_among_many(tmp_path, spinbench_here):
    run = run_in(tmp_path / "fleet", "cut")
    damage(run / "samples.csv", slice(-400, None))
    words = "not as it was sealed: samples.csv: changed"
    for command in (["fit", run], ["diagnose", run], ["compare", run, run], ["many", "fit", "fleet", "-o", "out"]):
        done = spinbench_here(*command, cwd=tmp_path)
        assert done.returncode == 2
        (line,) = [line for line in done.stderr.splitlines() if words in line]
        assert line.count("cut: ") == 1
    with pytest.raises(RunError, match=words):
        _ = spinbench.open(run).recording
    assert len(spinbench.open(run).readings)


def test_a_run_without_its_beginning_is_found_and_refused(tmp_path):
    run = run_in(tmp_path, "headless")
    (run / "start.json").unlink()
    assert fleet.recordings_in([tmp_path], readings.is_recording) == [run]
    with pytest.raises(RunError, match=r"holds no start\.json"):
        readings.read_of_many(run)


def test_folders_that_are_no_recordings_are_named(tmp_path, spinbench_here):
    damage(run_in(tmp_path / "fleet", "cut") / "samples.csv", slice(-400, None))
    (tmp_path / "fleet" / "month" / "day").mkdir(parents=True)
    told = spinbench_here("many", "fit", "fleet", "-o", "out", cwd=tmp_path).stderr.splitlines()
    assert "spinbench: passed over in fleet: month: no recordings or runs; name folders below them" in told


def test_remarks_on_one_of_many_name_it(tmp_path, capsys):
    """The bytes on the wire are no readings: without their end the run is read, with a remark."""
    run = run_in(tmp_path, "no_bytes")
    damage(run / "wire.jsonl", slice(-1, None))
    assert readings.read_of_many(run).files
    assert "spinbench: no_bytes: wire.jsonl was changed since the run was sealed\n" in capsys.readouterr().err


def test_a_killed_run_is_read_as_one_of_many(tmp_path, capsys):
    run = write_sweep(tmp_path, seal=False).rename(tmp_path / "killed")
    assert readings.read_of_many(run).files
    assert "spinbench: killed: the run is killed\n" in capsys.readouterr().err


def test_a_run_that_holds_the_readings_of_another_counts_once(tmp_path):
    first, again = run_in(tmp_path, "first"), tmp_path / "second"
    shutil.copytree(first, again)
    (tmp_path / "third").mkdir()
    kept, told = readings.each_once([first, again, tmp_path / "third"])
    assert kept == [first, tmp_path / "third"]  # what cannot be read is left to who reads it
    assert told == [f"passed over: {again}: it holds the readings of {first}"]


@pytest.mark.long
def test_a_copy_has_a_row_of_the_table_and_none_of_the_trend(tmp_path, spinbench_here):
    for name in ("first", "second"):
        shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / "fleet" / name)
    done = spinbench_here("many", "diagnose", "fleet", "-o", "out", "--workers", 1, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "spinbench: in the trend, passed over: fleet/second: it holds the readings of fleet/first\n" in done.stderr
    rows, history = (
        {row["recording"] for row in csv.DictReader((tmp_path / "out" / name).read_text().splitlines())}
        for name in ("table.csv", "trend.csv")
    )
    assert rows == {"fleet/first", "fleet/second"}
    assert history == {"fleet/first"}


@pytest.mark.parametrize(
    ("error", "told"),
    [("KeyError: 'x'", "KeyError: 'x'"), ("RunError: no end", "no end"), ("OSError: no", "no"), ("it died", "it died")],
)
def test_an_error_of_python_alone_keeps_its_class(error, told):
    assert without_class(error) == told
