"""Six seconds of what `make soak` does for half an hour: every line gives values, and no answer is wrong."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_all_lines_at_once_give_values_and_no_wrong_one(tmp_path):
    command = [sys.executable, "-m", "tests.soak", "-o", tmp_path, "--minutes", "0.1"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split(" | ") for line in (tmp_path / "soak.md").read_text().splitlines()[2:6]]
    assert {row[0].removeprefix("| ") for row in rows} == {"rtu", "text", "frames", "tcp"}
    assert all(int(row[1]) > 20 for row in rows)
    assert {row[4] for row in rows if "frames" not in row[0]} == {"0"}
    assert "; verified." in (tmp_path / "soak.md").read_text()
