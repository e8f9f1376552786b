"""A date that cannot be ordered is refused where it enters, and no history is told without it."""

from __future__ import annotations

import shutil
from datetime import date, timedelta
from pathlib import Path

import pytest

from rig.recording import read_recording

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"


@pytest.fixture
def dated(tmp_path):
    """Recordings in folders by name, with the date that each states."""

    def write(**dates):
        for name, stated in dates.items():
            shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / name)
            with (tmp_path / name / "recording.toml").open("a", encoding="utf-8") as file:
                file.write(f'\n[origin]\ndate = "{stated}"\n')
        return tmp_path

    return write


def test_a_history_is_not_told_in_the_order_of_names(dated, spinbench_here):
    done = spinbench_here("trend", ".", "-o", "out", cwd=dated(Juni="10.06.2026", Mai="14.05.2026", April="2026-04-02"))
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "not ISO 8601" in line and "Juni '10.06.2026', Mai '14.05.2026'" in line and "April" not in line
    assert done.stdout == "" and not (dated() / "out").exists()


def test_a_recording_with_such_a_date_stays_readable_and_says_so(dated):
    (words,) = (one for one in read_recording(dated(Mai="14.05.2026") / "Mai").warnings if "date" in one)
    assert "'14.05.2026' is not ISO 8601" in words and "counts as not stated" in words


def test_a_recording_with_a_date_to_come_says_so(dated):
    stated = (date.today() + timedelta(days=2)).isoformat()
    assert any(f"'{stated}' is still to come" in one for one in read_recording(dated(Mai=stated) / "Mai").warnings)


@pytest.mark.parametrize(
    ("stated", "says"),
    [("28.05.2026", "not ISO 8601"), ((date.today() + timedelta(days=2)).isoformat(), "still to come")],
)
def test_a_sheet_with_such_a_date_is_not_entered(stated, says, tmp_path, spinbench_here):
    done = spinbench_here(
        "sheet", "manual", "--enter", TUTORIALS / "evening.csv", "--date", stated, "--logs", "logs", cwd=tmp_path
    )
    assert done.returncode == 2
    assert says in done.stderr
    assert not (tmp_path / "logs").exists()


def test_a_mapping_with_such_a_date_imports_nothing(tmp_path, spinbench_here):
    text = (TUTORIALS / "logger.toml").read_text(encoding="utf-8")
    (tmp_path / "m.toml").write_text(text + '\n[origin]\ndate = "28.05.2026"\n', encoding="utf-8")
    done = spinbench_here("runs", "import", TUTORIALS / "logger.csv", "--mapping", "m.toml", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert "m.toml: origin.date '28.05.2026' is not ISO 8601" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["diagnose", "fit"])
def test_a_table_of_such_recordings_is_refused_before_the_work(dated, spinbench_here, command):
    place = dated(Juni="10.06.2026", Mai="14.05.2026")
    done = spinbench_here("many", command, ".", "-o", "out", "--workers", 1, cwd=place)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "no history without the order of its dates" in line
    assert not (place / "out").exists()
