"""What the Makefile removes, and what it leaves alone."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_clean_cache_removes_kernels_at_any_depth_and_leaves_the_environment_s(tmp_path: Path) -> None:
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    kernels = [f"{place}/__pycache__/{name}" for place in ("model", "model/effects") for name in ("a.nbi", "a.1.nbc")]
    others = ["model/__pycache__/a.pyc", "model/a.nbi", ".venv/lib/__pycache__/a.nbi"]
    for name in (*kernels, *others):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    subprocess.run(["make", "-f", ROOT / "Makefile", "clean-cache"], cwd=tmp_path, check=True, capture_output=True)
    left = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == set(others)
