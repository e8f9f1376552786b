"""Rows, pressure levels and files that the user leaves out, by the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import tests.diagnosis_recordings as recordings
from calibration.data.left_out import without
from rig.recording import RecordingError, read_recording

SLIP_RPM = 30.0


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """A sweep with three rows misread alike, which nobody would take for single slips, and a coast-down."""
    folder = tmp_path_factory.mktemp("left_out")
    recordings.sweep(folder / "bench", 3, {}, bad_row=(4, 5, 6, 7), off_rpm=SLIP_RPM)
    recordings.add_coast_down(folder / "bench", 3, {})
    return folder


def told(bench: Path, spinbench_here, *words: str) -> dict:
    done = spinbench_here("diagnose", "bench", "-o", "out", "--json", "out.json", *words, cwd=bench)
    assert done.returncode == 0, done.stderr
    return json.loads((bench / "out.json").read_text())


@pytest.mark.long
def test_rows_that_are_left_out_count_nowhere_and_the_report_says_so(bench, spinbench_here):
    with_them = told(bench, spinbench_here, "--without", "coast_down.csv")
    left_out = told(bench, spinbench_here, "--without", "coast_down.csv", "--without", "sweep.csv:4-6,7")
    assert left_out["mismatch"]["p_value"] > 0.01 > with_them["mismatch"]["p_value"]
    assert left_out["files"] == [
        {"file": "sweep.csv", "rows": 26, "rows_used": 22, "why": "4 rows: left out by --without"}
    ]
    page = (bench / "out" / "report.html").read_text()
    assert "sweep.csv:4-6,7: left out, as asked" in page
    assert "coast_down.csv: left out, as asked" in page


@pytest.mark.long
def test_a_fit_without_rows_is_another_fit(bench, spinbench_here):
    words = ("--steady-only", "--effective-samples", "200", "--without", "sweep.csv:4-23")
    done = spinbench_here("fit", "bench", "-o", "fit", "--json", "fit.json", *words, cwd=bench)
    assert done.returncode == 0, done.stderr
    assert json.loads((bench / "fit.json").read_text())["files"][0]["rows_used"] == 6
    again = spinbench_here("fit", "bench", "-o", "fit", *words[:3], cwd=bench)
    assert again.returncode == 2
    assert "chain of another recording" in again.stderr


def test_of_several_recordings_a_file_has_the_name_of_its_own_ahead(bench, tmp_path):
    recordings.sweep(tmp_path / "other", 8, {})
    both = [read_recording(bench / "bench"), read_recording(tmp_path / "other")]
    found = without(both, ["other/sweep.csv:1", "bench/coast_down.csv"])
    assert [len(one.files) for one in found] == [1, 1]
    assert [one.files[0].left_out for one in found] == [(), (1,)]
    assert found[0].sha256 != both[0].sha256 and found[1].sha256 != both[1].sha256


@pytest.mark.parametrize("asked", [["other/sweep.csv:1-26"], ["other/sweep.csv:1-13", "other/sweep.csv:14-26"]])
def test_a_recording_of_which_no_row_is_left_is_refused_beside_another_too(bench, tmp_path, asked):
    recordings.sweep(tmp_path / "other", 8, {})
    with pytest.raises(RecordingError, match=r"nothing of .*other is left"):
        without([read_recording(bench / "bench"), read_recording(tmp_path / "other")], asked)


def test_a_level_stands_for_the_rows_that_read_it_as_it_is_written(bench):
    (recording,) = without([read_recording(bench / "bench")], ["sweep.csv:1.4bar,2"])
    read = read_recording(bench / "bench").files[0].columns["pressure_bar_abs"].values
    at = [i + 1 for i, value in enumerate(read) if round(value, 1) == 1.4]
    assert len(at) >= 2  # up and down
    assert sorted(recording.files[0].left_out) == sorted({*at, 2})
    one = f"{read[4]:.2f}"  # as a person reads it off
    for levels, low, high in (
        (f"{one}bar", float(one) - 0.005, float(one) + 0.005),
        ("1.4-1.6bar", 1.35, 1.65),
        ("1.40-1.6 bar", 1.395, 1.65),
    ):
        (recording,) = without([read_recording(bench / "bench")], [f"sweep.csv:{levels}"])
        assert list(recording.files[0].left_out) == [i + 1 for i, value in enumerate(read) if low <= value <= high]


def test_a_level_is_that_of_the_column_as_it_stands(put_recording):
    gauge = "pressure_bar_gauge,speed_rpm\n0.3,90\n0.5,180\n0.45,150\n"
    folder = put_recording(("sweep.csv", "steady", gauge), ("none.csv", "zero", "speed_rpm\n0\n"))
    (found,) = without([read_recording(folder)], ["sweep.csv:0.5bar"])
    assert found.files[0].left_out == (2, 3)
    with pytest.raises(RecordingError, match=r"none\.csv has no pressure; name its rows by their numbers"):
        without([read_recording(folder)], ["none.csv:0.5bar"])


@pytest.mark.long
def test_a_diagnosis_without_a_level_says_so(bench, spinbench_here):
    left_out = told(bench, spinbench_here, "--without", "coast_down.csv", "--without", "sweep.csv:1.4bar,4-7")
    (file,) = left_out["files"]
    assert file["rows"] - file["rows_used"] >= 5 and file["why"].endswith("rows: left out by --without")
    assert "sweep.csv:1.4bar,4-7: left out, as asked" in (bench / "out" / "report.html").read_text()


BAD = {
    "no_such_file": ("swep.csv", "there is no such file; there are sweep.csv, coast_down.csv"),
    "no_such_row": ("sweep.csv:27", "from 1 to 26"),
    "row_0": ("sweep.csv:0", "from 1 to 26"),
    "backwards": ("sweep.csv:5-3", "'5-3' is no row of it"),
    "no_number": ("sweep.csv:x", "'x' is no row of it"),
    "no_such_level": ("sweep.csv:3.7bar", "no row is at that level; pressure_bar_abs reads 1."),
    "no_level": ("sweep.csv:-2bar", "or levels as 2.0bar or 1.2-1.4bar"),
    "levels_backwards": ("sweep.csv:1.6-1.4bar", "no row is at that level"),
    "level_of_a_run": ("coast_down.csv:2.0bar", "name the file alone"),
    "rows_of_a_run": ("coast_down.csv:3", "name the file alone"),
    "everything": ("sweep.csv:1-26", "no steady row"),
}


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_left_out_is_refused_in_a_line(bench, spinbench_here, name, command):
    asked, words = BAD[name]
    done = spinbench_here(command, "bench", "--without", asked, "-o", "refused", "--json", "refused.json", cwd=bench)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr and "Traceback" not in done.stderr
    assert not (bench / "refused").exists() and not (bench / "refused.json").exists()
