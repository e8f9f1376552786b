"""The demonstrations on public data, as one command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.documents import check

ROOT = Path(__file__).resolve().parents[3]
RECORDINGS = Path(os.environ.get("SPINBENCH_RECORDINGS", ROOT.parent / "shared" / "recordings"))


def demonstrate(*words: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "scripts" / "demonstrate.py"), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done


@pytest.mark.long
@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the public recordings are not here")
@pytest.mark.parametrize(
    ("name", "verdict"), [("emps", "named"), ("whiffle_ball", "confounded"), ("baseball", "consistent")]
)
def test_a_demonstration_is_repeated_by_one_command(tmp_path: Path, name: str, verdict: str) -> None:
    told = demonstrate(name, RECORDINGS, "--out", tmp_path)
    assert told.stdout.endswith(f"demonstrate: {name}: {tmp_path / name / 'result'}\n")
    found = json.loads((tmp_path / name / "result" / "diagnosis.json").read_text(encoding="utf-8"))
    check(found)
    assert found["verdict"] == verdict
    if name == "emps":  # the figures of docs/real-recordings.md
        size = found["effects"][0]["parameters"]["torque_nm"]
        assert (size["mean"], size["sd"]) == (pytest.approx(19.9, abs=0.1), pytest.approx(0.82, abs=0.05))
        assert found["f_overall_before"]["mean"] == pytest.approx(444.0, abs=1.0)
        assert found["f_overall_after"]["mean"] == pytest.approx(210.0, abs=1.0)
        assert found["improvement"]["held_out"]["scheme"] == "unseen run emps_pulses"


def test_missing_files_are_told(tmp_path: Path) -> None:
    assert "there is no DATA_EMPS.mat" in demonstrate("emps", tmp_path, code=2).stderr
    assert "none of the files is there" in demonstrate("all", tmp_path, code=2).stdout
