"""The trend of many recordings: a weighed line along their dates, its table, picture and sentence."""

from __future__ import annotations

import csv
import itertools
import json
import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import tests.diagnosis_recordings as recordings
from calibration import fleet
from calibration.report import along_dates
from calibration.report.comparison import history, trend
from calibration.work.trend import line_through
from model.motor import Motor, read_motor
from rig.recording import read_recording
from rig.runlog import RunWriter
from tests.synthetic_runs import start_of

ROOT = Path(__file__).resolve().parents[2]
TRUE = read_motor("ptm3600")["f_overall"].value


def test_the_slopes_sd_is_that_of_many_draws() -> None:
    rng, at, sd = np.random.default_rng(3), np.array([0.0, 1.0, 2.5, 4.0, 7.0]), np.array([0.1, 0.3, 0.1, 0.2, 0.15])
    lines = [line_through(at, 2.0 + 0.05 * at + sd * rng.standard_normal(5), sd) for _ in range(4000)]
    sound = [one for one in lines if one is not None and not one.is_scattered]
    assert len(sound) == pytest.approx(0.99 * len(lines), abs=25)  # the test of the scatter has its level
    slopes = np.array([one.slope for one in lines if one is not None])
    assert slopes.mean() == pytest.approx(0.05, abs=0.003)
    assert slopes.std() == pytest.approx(sound[0].slope_sd, rel=0.05)


def test_a_scatter_beyond_the_uncertainties_is_told_and_widens_the_slope() -> None:
    at, sd = np.arange(6.0), np.full(6, 0.01)
    jumps = np.array([0.0, 0.2, -0.1, 0.25, -0.2, 0.1])
    line, sound = line_through(at, jumps, sd), line_through(at, 0.01 * np.sin(at), sd)
    assert line is not None and sound is not None
    assert line.is_scattered and not sound.is_scattered
    assert line.slope_sd == pytest.approx(line.scatter * sound.slope_sd)


@pytest.mark.parametrize("at", [[1.0], [2.0, 2.0, 2.0]])
def test_no_line_goes_through_a_single_date(at: list[float]) -> None:
    assert line_through(at, [0.1] * len(at), [0.01] * len(at)) is None


def diagnosed(name: str, date: str | None, f_overall: float, leak: float | None, verdict: str = "") -> dict:
    """A row of the table of diagnoses, with a leak that is named or none."""
    size = {"conductance_kg_s_pa2": {"mean": leak, "sd": 2e-15, "q05": 0.0, "q95": 1.0}}
    effects = [] if leak is None else [{"id": "leakage", "parameters": size}]
    return {
        "recording": name,
        "date": date,
        "error": "",
        "verdict": verdict or ("consistent" if leak is None else "named"),
        "f_overall_after_mean": f_overall,
        "f_overall_after_sd": 0.001,
        "diagnosis": json.dumps({"effects": effects}),
    }


def test_effects_that_are_named_have_their_trend_and_what_is_unresolved_has_none() -> None:
    rows = [
        diagnosed("runs/march", "2026-03-01", 0.070, 2e-14),
        diagnosed("runs/january", "2026-01-01", 0.064, None),
        diagnosed("runs/may", "2026-05-01", 0.076, 4e-14),
        diagnosed("runs/june", "2026-06-01", 0.200, None, "unresolved"),
    ]
    found = {one.parameter: one for one in trend.trends(rows)}
    assert [len(one.figures) for one in found.values()] == [3, 2]
    line = found["f_overall"].line
    assert line is not None and line.slope == pytest.approx(0.012 / 120.0 * 30.4375, rel=0.02)
    assert re.search(r" N m s \(\+\d+\.\d %\) a month, over 3 recordings", trend.sentence(found["f_overall"]))
    table = list(csv.DictReader(trend.table(rows).decode().splitlines()))
    assert [row["date"] for row in table] == ["2026-01-01", "2026-03-01", "2026-05-01", "2026-06-01"]
    assert [row["leakage.conductance_kg_s_pa2_mean"] for row in table] == ["", "2e-14", "4e-14", ""]
    assert [row["leakage.conductance_kg_s_pa2_unit"] for row in table] == ["", "kg/(s Pa2)", "kg/(s Pa2)", ""]
    assert [row["f_overall_unit"] for row in table] == ["N m s"] * 4
    assert [row["reliable"] for row in table] == ["True", "True", "True", "False"]


def test_the_friction_of_a_slide_has_its_own_unit() -> None:
    turns = [diagnosed(f"motor/{month}", f"2026-0{month}-01", 0.06 + 0.002 * month, None) for month in (1, 2, 3)]
    slides = [diagnosed(f"axis/{month}", f"2026-0{month}-01", 20.0 + month, None) for month in (1, 2, 3)]
    rows = [one | {"motor": "ptm3600"} for one in turns]
    rows += [one | {"motor": "driven_axis", "f_overall_unit": "N s/m"} for one in slides]
    assert {one.motor: one.unit for one in trend.trends(rows)} == {"ptm3600": "N m s", "driven_axis": "N s/m"}
    table = list(csv.DictReader(trend.table(rows).decode().splitlines()))
    assert {row["motor"]: row["f_overall_unit"] for row in table} == {"ptm3600": "N m s", "driven_axis": "N s/m"}


def test_fits_have_the_trend_of_f_overall_where_the_model_fits() -> None:
    rows = [
        {"recording": f"r{i}", "date": f"2026-0{i}-01", "error": "", "model_fits": i != 3}
        | {"f_overall_mean": 0.06 + 0.001 * i, "f_overall_sd": 0.001}
        for i in (1, 2, 3, 4)
    ]
    (found,) = trend.trends(rows)
    assert [one.recording for one in found.figures] == ["r1", "r2", "r4"]


def test_without_a_date_recordings_stand_in_the_order_given(tmp_path: Path) -> None:
    rows = [diagnosed("b", "2026-03-01", 0.070, None), diagnosed("a", None, 0.072, None)]
    (words,) = fleet.write_trend(tmp_path, rows)
    assert "a recording" in words and "in the order given" in words
    names = [row["recording"] for row in csv.DictReader((tmp_path / "trend.csv").read_text().splitlines())]
    assert names == ["b", "a"]
    assert (tmp_path / "trend.png").read_bytes().startswith(b"\x89PNG")


def of_a_motor(serial: str, *figures: float) -> list[dict]:
    """Rows of the table of diagnoses, a month apart."""
    return [
        diagnosed(f"runs/{serial}{i}", f"2026-0{i}-01", one, None) | {"motor_serial": serial}
        for i, one in enumerate(figures, start=1)
    ]


def test_each_motor_has_a_trend_of_its_own_and_an_alarm_where_it_changed() -> None:
    rows = of_a_motor("A", 0.064, 0.068, 0.072) + of_a_motor("B", 0.080, 0.0805, 0.0798)
    found = trend.trends(rows)
    assert [(one.motor, len(one.figures)) for one in found] == [("motor no. A", 3), ("motor no. B", 3)]
    (alarm,) = trend.alarms(found)
    assert alarm.startswith("f_overall of motor no. A changed (p ")
    assert alarm.endswith("0.0640 ± 0.0010 N m s in A1, 0.0720 ± 0.0010 N m s in A3.")
    assert trend.alarms(trend.trends(of_a_motor("B", 0.080, 0.0805, 0.0798))) == []


@pytest.mark.parametrize("key", ["motor", "motor_sha256"])
def test_another_motor_is_no_change_of_one_whatever_its_serial_number(key: str) -> None:
    rows = of_a_motor("A", 0.064, 0.0641) + of_a_motor("A", 0.080, 0.0801)
    for i, row in enumerate(rows):
        row |= {"recording": f"{row['recording']}{i}", "motor": "the motor PTM", "motor_sha256": "1"}
        row |= {key: f"the motor no {i // 2}"} if i > 1 else {}
    found = trend.trends(rows)
    assert [len(one.figures) for one in found] == [2, 2]
    assert len({one.motor for one in found}) == 2
    assert trend.alarms(found) == []


def test_what_failed_stands_last_and_is_no_motor_of_its_own() -> None:
    failed = dict.fromkeys(diagnosed("", "", 0.0, None)) | {"recording": "a", "error": "RecordingError: no flow"}
    rows = [failed | {"verdict": "failed"}, *reversed(of_a_motor("A", 0.064, 0.0641))]
    names = [row["recording"] for row in csv.DictReader(trend.table(rows).decode().splitlines())]
    assert names == ["runs/A1", "runs/A2", "a"]
    page = history.report(rows, {})["report.html"].decode()
    assert "History of 1 motor<" in page
    assert "without a serial number" not in page
    assert "RecordingError: no flow" in page


def test_a_jump_and_back_is_a_change_without_a_slope() -> None:
    (alarm,) = trend.alarms(trend.trends(of_a_motor("A", 0.064, 0.072, 0.064, 0.0641)))
    assert alarm.endswith("0.0640 ± 0.0010 N m s in A1, 0.0720 ± 0.0010 N m s in A2, 0.0641 ± 0.0010 N m s in A4.")


def test_what_was_first_is_told_by_the_moment_not_by_the_time_of_day() -> None:
    rows = of_a_motor("A", 0.064, 0.080)
    rows[0]["date"], rows[1]["date"] = "2026-06-01T09:00:00+00:00", "2026-06-01T10:00:00+02:00"
    (alarm,) = trend.alarms(trend.trends(rows))
    assert alarm.endswith("0.0800 ± 0.0010 N m s in A2, 0.0640 ± 0.0010 N m s in A1.")


def test_alarms_of_what_does_not_change_are_as_rare_as_said() -> None:
    rng, at, sd = np.random.default_rng(5), np.arange(5.0), np.full(5, 0.1)
    p = [one.change_p for _ in range(4000) if (one := line_through(at, sd * rng.standard_normal(5), sd))]
    assert np.mean(np.array(p) < 0.05) < 0.06
    assert np.mean(np.array(p) < 0.05) > 0.03


def test_the_page_shows_each_motor_with_its_sweeps_on_top_of_each_other(tmp_path: Path) -> None:
    rows = of_a_motor("<i>A", 0.064, 0.072)
    read = {}
    for seed, row in enumerate(rows, start=3):
        recordings.sweep(tmp_path / row["recording"], seed, {})
        read[row["recording"]] = read_recording(tmp_path / row["recording"])
    page = history.report(rows, read)["report.html"].decode()
    assert page.count('src="data:image/png;base64,') == 2
    assert "Motor no. &lt;i&gt;A" in page and "<i>" not in page
    assert 'class="verdict">f_overall of motor no. &lt;i&gt;A changed' in page
    alone = history.report(rows[:1], read)["report.html"].decode()
    assert "Nothing can be compared" in alone and "data:image" not in alone


@pytest.mark.long
def test_trend_ends_with_6_where_a_motor_changed(tmp_path: Path, monkeypatch, spinbench_here) -> None:
    for seed, (name, factor) in enumerate((("january", 1.0), ("may", 1.3)), start=3):
        motor = read_motor("ptm3600")
        worn = motor.with_values({"f_overall": factor * motor["f_overall"].value})
        monkeypatch.setattr(recordings, "read_motor", lambda _, worn=worn: worn)
        recordings.sweep(tmp_path / "runs" / name, seed, {})
        recordings.every_second_row(tmp_path / "runs" / name)
        with (tmp_path / "runs" / name / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\ndate = "2026-0{seed}-01"\nmotor_serial = "A-17"\n')
    monkeypatch.undo()
    write_zero = RunWriter.create(tmp_path / "runs", start_of("zero"))
    write_zero.end("finished")
    done = spinbench_here("trend", "runs", "-o", "out", "--workers", 2, cwd=tmp_path)
    assert done.returncode == 6, done.stderr
    assert "ALARM: f_overall of motor no. A-17 changed" in done.stderr
    assert "passed over: 1 runs that are no sweeps" in done.stderr
    assert {"report.html", "trend.csv", "trend.png", "table.csv"} <= {one.name for one in (tmp_path / "out").iterdir()}
    alone = spinbench_here("trend", "runs/may", "-o", "alone", "--workers", 1, cwd=tmp_path)
    assert alone.returncode == 2
    assert "no two recordings of one motor can be compared" in alone.stderr


@pytest.mark.long
def test_a_motor_that_wears_is_told_along_the_dates_of_its_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spinbench_here
) -> None:
    for seed, (date, factor) in enumerate((("2026-05-01", 1.2), ("2026-01-01", 1.0), ("2026-03-01", 1.1)), start=3):

        def worn(name: str, factor: float = factor) -> Motor:
            motor = read_motor(name)
            return motor.with_values({"f_overall": factor * motor["f_overall"].value})

        monkeypatch.setattr(recordings, "read_motor", worn)
        recordings.sweep(tmp_path / "runs" / date, seed, {})
        recordings.every_second_row(tmp_path / "runs" / date)
        with (tmp_path / "runs" / date / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\ndate = "{date}"\n')
    monkeypatch.undo()  # what diagnoses them knows nothing of it
    done = spinbench_here("many", "diagnose", "runs", "-o", "out", "--workers", 2, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / "out" / "trend.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["date"] for row in rows] == ["2026-01-01", "2026-03-01", "2026-05-01"]
    for row, factor in zip(rows, (1.0, 1.1, 1.2), strict=True):
        assert abs(float(row["f_overall_mean"]) - factor * TRUE) < 3.0 * float(row["f_overall_sd"])
    assert "f_overall: " in done.stderr and "a month" in done.stderr
    assert (tmp_path / "out" / "trend.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("count", "name"), [(2, "a"), (5, "may"), (60, "2026-05-25T08-00-00_virtual_sweep")])
def test_the_names_of_recordings_side_by_side_do_not_overlap(count: int, name: str) -> None:
    points = [
        along_dates.Point(f"{name}{i}", datetime(2026, 5, 1, tzinfo=UTC) if i else None, 0.06, 0.05, 0.07)
        for i in range(count)
    ]
    figure = along_dates.drawn([along_dates.Panel("f_overall", "f_overall", "N m s", points)])
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in figure.axes[0].get_xticklabels()]
    assert len(boxes) > 1
    assert all(one.x1 <= other.x0 for one, other in itertools.pairwise(boxes))
