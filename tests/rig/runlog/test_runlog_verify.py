"""Verifying a run that is longer than what is read at once, and what is no sealed run."""

import shutil
import tracemalloc
from pathlib import Path

import pytest

from rig.runlog import RunError, RunWriter, verify
from tests.synthetic_runs import poll, start_of


@pytest.fixture(scope="module")
def long_runs(tmp_path_factory):
    """Two sealed runs, the second with ten times the rows of the first."""
    folders = []
    for polls in (750, 7_500):
        with RunWriter.create(tmp_path_factory.mktemp("long"), start_of()) as writer:
            for n in range(polls):
                writer.exchange(poll("tach", {"speed_rpm": n / 7, "angle_rad": n / 3}, n * 1_000_000))
            writer.end("finished")
        folders.append(writer.folder)
    return folders


@pytest.fixture
def small_blocks(monkeypatch):
    """A run is longer than what is read at once."""
    monkeypatch.setattr("rig.runlog.samples.BLOCK_ROWS", 500)


def test_the_memory_of_verify_does_not_grow_with_the_run(long_runs, small_blocks):
    assert peak_of_verify(long_runs[1]) < 2.0 * peak_of_verify(long_runs[0])


def peak_of_verify(folder: Path) -> int:
    """The most that was allocated at once [bytes]; the run verifies."""
    tracemalloc.start()
    try:
        assert verify(folder) == []
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_what_does_not_fit_the_wire_is_found_anywhere_in_a_long_run(long_runs, small_blocks, tmp_path):
    folder = shutil.copytree(long_runs[0], tmp_path / "run")
    (folder / "end.json").unlink()
    lines = (folder / "samples.csv").read_bytes().splitlines(keepends=True)
    for n in (250, 600):  # the last row of one goes to the next
        lines[2 * n] = lines[2 * n].replace(b",%d," % n, b",%d," % (n + 1), 1)
    (folder / "samples.csv").write_bytes(b"".join(lines))
    said = "samples.csv: exchange {} has {} rows; wire.jsonl says 2 readings"
    assert verify(folder)[1:] == [said.format(*of) for of in ((250, 1), (251, 3), (600, 1), (601, 3))]


def test_many_rows_that_do_not_fit_the_wire_are_counted(long_runs, tmp_path):
    folder = shutil.copytree(long_runs[0], tmp_path / "run")
    lines = (folder / "wire.jsonl").read_bytes().splitlines(keepends=True)
    (folder / "wire.jsonl").write_bytes(b"".join(lines[:-30]).replace(b'"readings":2', b'"readings":1'))
    findings = verify(folder)
    assert findings[1] == "samples.csv: exchange 1 has 2 rows; wire.jsonl says 1 readings"
    assert findings[20] == "samples.csv: exchange 20 has 2 rows; wire.jsonl says 1 readings"
    assert findings[21:] == ["and 701 more", "the end record counts 750 exchanges, the files hold 720"]


def test_verify_refuses_what_is_no_run_and_what_is_being_written_and_says_what_has_no_hash(tmp_path):
    with pytest.raises(RunError, match=r"holds no start.json"):
        verify(tmp_path)
    with RunWriter.create(tmp_path, start_of(), wire=False) as writer:
        with pytest.raises(RunError, match=r"a program writes this run now; wait for its end, or stop it$"):
            verify(writer.folder)
        writer.end("finished")
    assert verify(writer.folder) == []
    (writer.folder / "wire.jsonl").write_bytes(b"")
    assert verify(writer.folder) == ["wire.jsonl: the end record has no hash of it"]


def test_a_run_that_is_being_written_is_refused_and_not_called_damaged(tmp_path, spinbench_here):
    """Its rows are ahead of its wire, or behind: that is no damage."""
    with RunWriter.create(tmp_path / "logs", start_of()) as writer:
        result = spinbench_here("runs", "verify", "last", cwd=tmp_path)
        writer.end("finished")
    told = f"spinbench: logs/{writer.folder.name}: a program writes this run now; wait for its end, or stop it\n"
    assert (result.returncode, result.stdout, result.stderr) == (2, "", told)
