"""Where results go: a disk that is full, and what is no plain file."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from rig.recording.files import write_file

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


def test_what_is_no_plain_file_is_written_into_and_not_replaced(tmp_path):
    """A pipe here; /dev/null, which root would lose, is another."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_file(pipe, b"{}")
        assert os.read(reader, 10) == b"{}"
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]
