"""Where results go: a disk that is full, what is no plain file, and what a writer leaves that is killed."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rig.recording import read_recording
from rig.recording.files import write_file
from tests.synthetic_runs import write_sweep

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

# Writes a file, a recording, a run's samples or its start; the disk takes the first file when a line comes on
# standard input.
SLOW = """
import os, sys
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from rig.exchange.samples.export import export_samples
from rig.recording import read_recording, write_recording
from rig.recording.files import write_file
from rig.runlog import RunWriter, read_run
from tests.synthetic_runs import start_of
what, source, place = sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4])
sync = os.fsync
def slow(handle):
    print("writing", flush=True)
    sys.stdin.readline()
    os.fsync = sync
    sync(handle)
os.fsync = slow
if what == "file":
    write_file(place, source.read_bytes())
elif what == "recording":
    write_recording(read_recording(source), place)
elif what == "run":
    RunWriter.create(place, start_of())
else:
    export_samples(read_run(source), place)
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


def slow_writer(what: str, source: Path, place: Path) -> subprocess.Popen[str]:
    """A process that stands in the midst of its writing."""
    words = [sys.executable, "-c", SLOW, str(ROOT), what, str(source), str(place)]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "writing\n"
    return process


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(("what", "ending"), [("file", ".csv"), ("recording", ""), ("samples", ".h5")])
def test_the_next_writer_removes_what_a_killed_one_left_and_not_what_a_living_one_writes(tmp_path, what, ending):
    source = ROOT / "logs" / "published_sweep"
    if what == "samples":
        source = write_sweep(tmp_path / "logs", captures=False)
    elif what == "file":
        source = source / "sweep.csv"
    out = tmp_path / "out"
    out.mkdir()
    killed = slow_writer(what, source, out / f"killed{ending}")
    (of_killed,) = names(out)
    killed.kill()
    killed.communicate()
    assert names(out) == {of_killed}
    living = slow_writer(what, source, out / f"living{ending}")
    (of_living,) = names(out)
    assert of_living != of_killed
    write_file(out / "next", b"1")
    assert names(out) == {of_living, "next"}
    living.communicate("go on\n")
    assert living.returncode == 0
    assert names(out) == {f"living{ending}", "next"}
    if what == "file":
        assert (out / "living.csv").read_bytes() == source.read_bytes()
    elif what == "recording":
        assert read_recording(out / "living").files


def test_what_is_left_of_a_run_that_never_began_is_removed_with_the_next_run(tmp_path):
    killed = slow_writer("run", Path(), tmp_path)
    killed.kill()
    killed.communicate()
    write_sweep(tmp_path, captures=False)
    assert {path.name for path in tmp_path.rglob(".*")} == {".lock"}


def test_writers_of_one_folder_never_take_each_other_for_dead(tmp_path):
    def write(writer: int) -> None:
        for number in range(40):
            write_file(tmp_path / f"{writer}_{number}", b"whole")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(8)))
    assert names(tmp_path) == {f"{writer}_{number}" for writer in range(8) for number in range(40)}


def test_where_there_are_no_locks_nothing_is_taken_for_a_leftover(tmp_path, monkeypatch):
    killed = slow_writer("file", Path(__file__), tmp_path / "killed")
    killed.kill()
    killed.communicate()
    left = names(tmp_path)

    def no_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    with monkeypatch.context() as patch:
        patch.setattr(fcntl, "flock", no_locks)
        write_file(tmp_path / "next", b"1")
    assert names(tmp_path) == left | {"next"}
    write_file(tmp_path / "next", b"2")
    assert names(tmp_path) == {"next"}


def test_the_leftover_of_another_machine_stays(tmp_path):
    """Its lock may be unknown here."""
    other = tmp_path / ".spinbench-another_machine-12345678"
    other.mkdir()
    write_file(tmp_path / "next", b"1")
    assert names(tmp_path) == {"next", other.name}
