"""A disk that is full: nothing is half-written, and the error says which file had no room."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WRITE = """
import resource, signal, sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from rig.recording.files import write_files
from spinbench.cli.errors import in_words
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))  # stands in for the full disk
try:
    write_files(Path(sys.argv[1]), {"small.json": b"new", "large.png": b"x" * 100_000})
except OSError as error:
    print(*in_words(error))
"""


@pytest.mark.parametrize("there", [True, False])
def test_results_that_have_no_room_leave_the_old_ones_and_no_new_folder(tmp_path, there):
    folder = tmp_path / "out"
    if there:
        folder.mkdir()
        (folder / "small.json").write_text("old")
    done = subprocess.run([sys.executable, "-c", WRITE, folder, ROOT], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"{folder / 'large.png'}: File too large"
    assert {path.name: path.read_text() for path in tmp_path.rglob("*.*")} == ({"small.json": "old"} if there else {})
    assert folder.exists() == there
