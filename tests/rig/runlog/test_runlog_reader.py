"""Reading, verifying and repairing runs: a torn last line is dropped and said, anything else wrong is refused."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rig.runlog import RunError, RunWriter, read_run, repair, verify
from rig.runlog.folder import Lock
from rig.runlog.lines import torn_bytes
from rig.runlog.listing import find_run, list_runs, summary
from rig.runlog.rows import harmless
from tests.synthetic_runs import Bench, poll, start_of, write_sweep

APPENDED = ("samples.csv", "events.jsonl", "wire.jsonl", "plateaus.csv")


@pytest.fixture(scope="module")
def sealed(tmp_path_factory):
    return write_sweep(tmp_path_factory.mktemp("runs"), captures=False)


@pytest.fixture
def run_folder(sealed, tmp_path):
    """A sealed run that a test may spoil."""
    return shutil.copytree(sealed, tmp_path / sealed.name)


@pytest.fixture
def killed(run_folder):
    """A run without its end record."""
    (run_folder / "end.json").unlink()
    return run_folder


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A killed run of a few rows."""
    with RunWriter.create(tmp_path_factory.mktemp("small"), start_of()) as writer:
        for row in range(3):
            writer.exchange(poll("tach", {"speed_rpm": row + 0.5, "angle_rad": 1.0}, row))
            writer.event("step", row, text="é \u2028")
            writer.plateau({"n": row + 1, "speed_rpm": row + 0.5, "note": "fine, so far"})
    return writer.folder


def spoil(path, old, new):
    data = path.read_bytes()
    assert data.count(old) >= 1
    path.write_bytes(data.replace(old, new, 1))


@pytest.mark.parametrize("name", APPENDED)
def test_a_line_torn_at_any_byte_is_left_out_and_said(small, tmp_path, name):
    folder = shutil.copytree(small, tmp_path / "run")
    whole = (folder / name).read_bytes()
    start = whole.rindex(b"\n", 0, -1) + 1
    full = read_run(folder)
    for cut in range(start, len(whole)):
        (folder / name).write_bytes(whole[:cut])
        run = read_run(folder)
        assert run.torn == ({name: cut - start} if cut > start else {})
        assert len(run.samples) == len(full.samples) - (name == "samples.csv")
        assert len(run.events) == 3 - (name == "events.jsonl")
        assert len(run.plateaus) == 3 - (name == "plateaus.csv")
        assert sum(1 for _ in run.exchanges()) == 3 - (name == "wire.jsonl")


def test_a_torn_line_of_more_than_a_megabyte_is_one(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"whole\n" + b"x" * 2_500_000)
    assert torn_bytes(path) == 2_500_000


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ("lines.MAX_LINE_BYTES", "samples.csv, line 1: longer than 2 bytes"),
        ("samples.MAX_SAMPLES", "samples.csv: more than 2 rows"),
        ("reader.MAX_EVENTS", "events.jsonl: more than 2 events"),
        ("plateaus.MAX_PLATEAUS", "plateaus.csv, line 3: more than 2 plateaus"),
    ],
)
def test_a_file_beyond_its_bound_is_refused(small, monkeypatch, limit, words):
    monkeypatch.setattr(f"rig.runlog.{limit}", 2)
    with pytest.raises(RunError, match=words):
        read_run(small)


@given(st.binary(max_size=400))
def test_what_is_torn_ends_after_the_last_line_feed_that_is_not_followed_by_zeros_alone(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("torn") / "file"
    path.write_bytes(data)
    kept = data.rstrip(b"\0")
    assert torn_bytes(path) == len(data) - (kept.rfind(b"\n") + 1)


def test_zeros_that_a_power_cut_left_at_the_end_count_as_torn(killed):
    with (killed / "samples.csv").open("ab") as stream:
        stream.write(b"1681,5" + b"\0" * 4000)
    assert read_run(killed).torn == {"samples.csv": 4006}


@pytest.mark.parametrize("name", APPENDED)
def test_repair_drops_the_torn_line_and_nothing_else(killed, name):
    before = {entry.name: entry.read_bytes() for entry in killed.iterdir()}
    with (killed / name).open("ab") as stream:
        stream.write(b'{"n": 17, "ha')
    said = repair(killed)
    assert said[0] == f"{name}: dropped a torn last line of 13 bytes"
    after = {entry.name: entry.read_bytes() for entry in killed.iterdir()}
    end = json.loads(after.pop("end.json"))
    assert after == before
    assert (end["outcome"], end["reason"]) == ("failed", "killed; repaired")
    assert end["repair"]["dropped"] == {name: {"bytes": 13, "text": '{"n": 17, "ha'}}
    assert verify(killed) == []
    assert read_run(killed).state == "failed"


def test_repair_of_a_repaired_run_changes_nothing(killed):
    repair(killed)
    before = {entry.name: (entry.read_bytes(), entry.stat().st_mtime_ns) for entry in killed.iterdir()}
    assert repair(killed) == ["the run has an end record; nothing to repair"]
    assert {entry.name: (entry.read_bytes(), entry.stat().st_mtime_ns) for entry in killed.iterdir()} == before


def test_a_run_that_is_being_written_is_not_repaired(tmp_path):
    with (
        RunWriter.create(tmp_path, start_of()) as writer,
        pytest.raises(RunError, match="another program writes this run"),
    ):
        repair(writer.folder)
    assert not (writer.folder / "end.json").exists()


def test_a_run_that_ends_as_its_repair_begins_is_left_as_it_is(tmp_path, monkeypatch):
    with RunWriter.create(tmp_path, start_of()) as writer:

        def ended_meanwhile(folder):
            writer.end("finished")
            return Lock(folder)

        monkeypatch.setattr(sys.modules["rig.runlog.verify"], "Lock", ended_meanwhile)
        assert repair(writer.folder) == ["the run has an end record; nothing to repair"]
    run = read_run(writer.folder)
    assert (run.state, run.sealed) == ("finished", True)


def test_a_run_that_is_damaged_inside_is_not_repaired(killed):
    spoil(killed / "samples.csv", b"\n100,", b"\n1x0,")
    before = (killed / "samples.csv").read_bytes()
    with pytest.raises(RunError, match=r"samples.csv, line 101, column n: '1x0'"):
        repair(killed)
    assert (killed / "samples.csv").read_bytes() == before


@pytest.mark.parametrize("torn", [0, 5])
@pytest.mark.parametrize("written", [0, 1])
def test_repair_drops_an_exchange_that_was_killed_between_its_wire_and_its_rows(small, tmp_path, written, torn):
    folder = shutil.copytree(small, tmp_path / "run")
    before = {name: (folder / name).read_bytes().splitlines(keepends=True) for name in ("samples.csv", "wire.jsonl")}
    rows = before["samples.csv"][-2:]  # of the last exchange
    left = [*rows[:written], *([rows[written][:torn]] if torn else [])]
    (folder / "samples.csv").write_bytes(b"".join([*before["samples.csv"][:-2], *left]))
    assert f"dropped exchange 3: {written} of its 2 rows had been written" in repair(folder)
    assert verify(folder) == []
    assert (folder / "samples.csv").read_bytes() == b"".join(before["samples.csv"][:-2])
    assert (folder / "wire.jsonl").read_bytes() == b"".join(before["wire.jsonl"][:-1])
    dropped = json.loads((folder / "end.json").read_text())["repair"]["dropped"]
    assert dropped["wire.jsonl"]["text"] == harmless(before["wire.jsonl"][-1].decode())
    assert dropped.get("samples.csv", {"text": ""})["text"] == harmless(b"".join(left).decode())


def test_repair_says_when_the_wire_is_ahead_of_the_samples_by_more_than_an_exchange(killed):
    lines = (killed / "samples.csv").read_bytes().splitlines(keepends=True)
    (killed / "samples.csv").write_bytes(b"".join(lines[:-2]))
    assert any("has 0 rows; wire.jsonl says 1 readings" in said for said in repair(killed))


def test_verify_finds_a_flipped_bit_in_any_file(run_folder):
    for name in (*APPENDED, "start.json"):
        path = run_folder / name
        data = bytearray(path.read_bytes())
        place = data.index(b"gauge") if b"gauge" in data else data.index(b"set-point")
        data[place] ^= 1
        path.write_bytes(data)
        assert f"{name}: changed since the run was sealed (its SHA-256 differs)" in verify(run_folder)
        data[place] ^= 1
        path.write_bytes(data)
    assert verify(run_folder) == []


def test_verify_finds_files_missing_added_and_cut(run_folder):
    (run_folder / "wire.jsonl").unlink()
    (run_folder / "extra.txt").write_text("x")
    lines = (run_folder / "samples.csv").read_bytes().splitlines(keepends=True)
    (run_folder / "samples.csv").write_bytes(b"".join(lines[:-2]))
    findings = "\n".join(verify(run_folder))
    assert "wire.jsonl: missing" in findings
    assert "extra.txt: this file is no part of a run" in findings
    assert f"the end record counts {len(lines) - 1} samples, the files hold {len(lines) - 3}" in findings


def test_verify_finds_rows_that_do_not_fit_the_wire(run_folder):
    spoil(run_folder / "wire.jsonl", b'"readings":2', b'"readings":3')
    assert "samples.csv: exchange 1 has 2 rows; wire.jsonl says 3 readings" in verify(run_folder)


def test_verify_says_that_a_run_was_killed(killed):
    assert verify(killed) == ["no end record: the run was killed; `spinbench runs repair` seals what there is"]


def test_verify_names_the_damaged_line_of_the_wire_after_that_of_any_other_file(killed):
    spoil(killed / "wire.jsonl", b'"n":2', b'"n":3')
    wire = f"{killed / 'wire.jsonl'}, line 2: its number is 3; lines are missing or not in order"
    assert verify(killed) == [wire]
    with pytest.raises(RunError, match=re.escape(wire)):
        repair(killed)
    spoil(killed / "plateaus.csv", b",up,", b",sideways,")
    assert verify(killed) == [
        f"{killed / 'plateaus.csv'}, line 2, column direction: 'sideways': expected up, down or an empty cell"
    ]


def test_verify_finds_rows_beyond_the_wire(killed):
    lines = (killed / "wire.jsonl").read_bytes().splitlines(keepends=True)
    (killed / "wire.jsonl").write_bytes(b"".join(lines[:-1]))
    assert verify(killed)[1] == f"samples.csv: rows of exchange {len(lines)}, but wire.jsonl ends with {len(lines) - 1}"


def test_verify_finds_a_source_whose_text_is_not_that_of_its_hash(tmp_path):
    text = "levels = [1, 2]"
    source = {"sha256": hashlib.sha256(text.encode()).hexdigest(), "text": text}
    with RunWriter.create(tmp_path, start_of(sources={"lab.toml": source})) as writer:
        writer.end("finished")
    assert verify(writer.folder) == []
    spoil(writer.folder / "start.json", b"levels = [1, 2]", b"levels = [1, 3]")
    assert any("the text of the source lab.toml" in finding for finding in verify(writer.folder))


WRONG = [
    ("start.json", b'"run/1"', b'"run/2"', "start.json: 'format': input should be 'run/1'"),
    ("start.json", b'"simulated": true', b'"simulated": "yes"', "start.json: 'simulated'"),
    ("start.json", b"{", b"[", "start.json: not a JSON object"),
    ("end.json", b'"finished"', b'"splendid"', "end.json: 'outcome'"),
    ("events.jsonl", b'"n":2', b'"n":3', "events.jsonl, line 2: its number is 3"),
    ("events.jsonl", b'"time_s":', b'"time":', "events.jsonl, line 1: the key 'time_s' is missing"),
    ("samples.csv", b"n,exchange", b"m,exchange", "samples.csv, line 1: not the header"),
    ("samples.csv", b"\n2,1,", b"\n3,1,", "samples.csv, line 3: number 3, expected 2"),
    ("samples.csv", b",simulated,", b",splendid,", "samples.csv, line 2, column quality: 'splendid'"),
    ("samples.csv", b",0.100000000,", b",0.1,", "samples.csv, line 2, column time_s: '0.1'"),
    ("samples.csv", b",bar,", b",", "samples.csv, line 2: 14 cells, expected 15"),
    ("samples.csv", b"gauge", b"g\0uge", "samples.csv, line 2: holds zero bytes"),
    ("samples.csv", b"gauge", b"g\xffuge", "samples.csv, line 2: not a row of CSV in UTF-8"),
    ("plateaus.csv", b",up,", b",sideways,", "plateaus.csv, line 2, column direction: 'sideways'"),
    ("plateaus.csv", b"n,level", b"m,level", "plateaus.csv, line 1: not the header"),
    ("plateaus.csv", b"\n1,", b"\none,", "'one' is not a whole number"),
    ("plateaus.csv", b",up,", b",up,up,", "plateaus.csv, line 2: "),
    ("plateaus.csv", b"\n1,", b"\n1,x", "plateaus.csv, line 2, column level_bar_abs: 'x1"),
    ("plateaus.csv", b"\n1,", b"\n1,<", "plateaus.csv, line 2, column level_bar_abs: '<1"),
    ("plateaus.csv", b",up,", b",\xff,", "plateaus.csv, line 2: not a row of CSV in UTF-8"),
]


@pytest.mark.parametrize(("name", "old", "new", "words"), WRONG)
def test_what_is_no_run_is_refused_with_file_and_line(run_folder, name, old, new, words):
    spoil(run_folder / name, old, new)
    with pytest.raises(RunError) as caught:
        read_run(run_folder)
    assert words in str(caught.value)


@pytest.mark.parametrize("value", [b"nan", b"inf", b"1e999", b"0x10", b"1_000"])
def test_a_value_that_no_run_writes_is_refused(tmp_path, value):
    with RunWriter.create(tmp_path, start_of()) as writer:
        writer.exchange(poll("tach", {"speed_rpm": 123.25}, 1))
    spoil(writer.folder / "samples.csv", b"123.25", value)
    with pytest.raises(RunError, match="line 2, column value"):
        read_run(writer.folder)


@given(st.binary(max_size=200), st.sampled_from(["start.json", "end.json", *APPENDED]))
def test_garbage_is_an_error_in_words_or_nothing_at_all(small, tmp_path_factory, data, name):
    folder = shutil.copytree(small, tmp_path_factory.mktemp("garbage") / "run")
    (folder / name).write_bytes(data)
    try:
        run = read_run(folder)
        list(run.exchanges())
        verify(folder)
    except RunError as error:
        assert str(folder) in str(error)


def test_a_wire_line_is_checked_when_it_is_reached(run_folder):
    spoil(run_folder / "wire.jsonl", b'"0103"', b'"0x03"')
    with pytest.raises(RunError, match=r"wire.jsonl, line 1: its bytes are not hexadecimal"):
        next(read_run(run_folder).exchanges())


def test_a_sealed_run_without_its_samples_is_refused(run_folder):
    (run_folder / "samples.csv").unlink()
    with pytest.raises(RunError, match=r"samples.csv: missing; the end record has the hash"):
        read_run(run_folder)


def test_a_line_of_the_wire_that_is_missing_is_told(run_folder):
    spoil(run_folder / "wire.jsonl", b'{"n":1,', b'{"n":2,')
    with pytest.raises(RunError, match=r"wire.jsonl, line 1: its number is 2"):
        next(read_run(run_folder).wire_lines())


@pytest.mark.parametrize("name", ["start.json", "end.json", *APPENDED])
def test_links_and_pipes_are_refused(run_folder, name):
    real = run_folder / name
    elsewhere = run_folder.parent / "elsewhere"
    real.rename(elsewhere)
    real.symlink_to(elsewhere)
    with pytest.raises(RunError, match=f"{name}: a symbolic link, which is refused"):
        read_run(run_folder)
    real.unlink()
    os.mkfifo(real)
    with pytest.raises(RunError, match=f"{name}: is not a plain file"):
        read_run(run_folder)


def test_a_linked_folder_and_a_missing_one_are_refused(run_folder, tmp_path):
    (tmp_path / "link").symlink_to(run_folder)
    with pytest.raises(RunError, match="a symbolic link"):
        read_run(tmp_path / "link")
    with pytest.raises(RunError, match="no such folder"):
        read_run(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(RunError, match="no run"):
        read_run(tmp_path / "empty")


def test_keys_of_a_later_version_are_kept(run_folder):
    spoil(run_folder / "start.json", b'"operator":', b'"weather": "rain", "operator":')
    assert read_run(run_folder).start.model_extra == {"weather": "rain"}


def test_the_list_shows_every_run_and_passes_over_what_is_none(tmp_path):
    sealed_run = write_sweep(tmp_path, captures=False)
    with RunWriter.create(tmp_path, start_of("manual")) as writer:
        bench = Bench(writer)
        bench.plateau(1, (2.0, 55.0, 394.8), "up")
    broken = tmp_path / "20260101-000000_broken_sweep"
    broken.mkdir()
    (broken / "start.json").write_text("{")
    (tmp_path / "published").mkdir()
    rows = {row.name: row for row in list_runs(tmp_path)}
    assert set(rows) == {sealed_run.name, writer.name, broken.name}
    assert (rows[sealed_run.name].outcome, rows[sealed_run.name].plateaus) == ("finished", 14)
    assert (rows[writer.name].outcome, rows[writer.name].rows, rows[writer.name].plateaus) == ("killed", 120, 1)
    assert rows[broken.name].outcome.startswith("unreadable: ")


def test_a_run_is_found_by_the_beginning_of_its_name(tmp_path):
    names = []
    for kind in ("sweep", "zero"):
        with RunWriter.create(tmp_path, start_of(kind)) as writer:
            names.append(writer.name)
    assert find_run("20260528-202640_synthetic_z", tmp_path) == tmp_path / names[1]
    assert find_run("last", tmp_path) == tmp_path / names[1]
    assert find_run(tmp_path / names[0], tmp_path) == tmp_path / names[0]
    with pytest.raises(RunError, match=r"2 runs in .* begin with '2026'"):
        find_run("2026", tmp_path)
    with pytest.raises(RunError, match=r"no run in .* is called 'x'"):
        find_run("x", tmp_path)


def test_the_last_run_is_the_one_that_began_last_whatever_it_is_called(tmp_path, spinbench_here):
    logs = tmp_path / "logs"
    for second, name in ((1, "seal_test"), (2, ""), (2, "b_tie"), (0, "zero")):
        with RunWriter.create(logs, start_of(utc_start=f"2026-05-28T20:26:4{second}+00:00")) as writer:
            writer.end("finished")
        writer.folder.rename(logs / (name or writer.name))
    order = ["zero", "seal_test", "20260528-202642_synthetic_sweep", "b_tie"]
    assert [row.name for row in list_runs(logs)] == order
    assert spinbench_here("runs", "show", "last", cwd=tmp_path).stdout.startswith("b_tie: ")
    for name in ("zero", "b_tie"):  # where no start can be read, the name says when
        (logs / name / "start.json").write_text("{")
        (logs / name).rename(logs / f"20260528-202641_{name}")
    rows = [row.name for row in list_runs(logs)]
    assert rows == ["seal_test", "20260528-202641_b_tie", "20260528-202641_zero", order[2]]
    assert find_run("last", logs).name == order[2]


def test_the_summary_shows_plateaus_faults_and_the_end(tmp_path):
    with RunWriter.create(tmp_path, start_of(operator="\x1b[31mEve")) as writer:
        Bench(writer).plateau(1, (2.0, 55.0, 394.8), "up", settled=False, note="drifting")
        writer.event("line lost", 1, line="usb", error="unplugged")
        writer.end("aborted", "stopped by the operator", vented=False)
    text = summary(read_run(writer.folder))
    assert "\x1b" not in text
    assert re.search(r"^\d+ events; 1 out of the ordinary:$", text, re.M)
    for words in ("394.", "not settled; drifting", "line lost", "unplugged", "UTC, stopped by the operator"):
        assert words in text
    assert "NOT known to be vented" in text


def test_the_list_shows_names_as_they_are(tmp_path):
    """What looks like markup of the terminal's is text."""
    with RunWriter.create(tmp_path, start_of(bench="[/b] lab [old]")) as writer:
        writer.end("finished")
    program = "import spinbench; spinbench.main()"
    command = [sys.executable, "-c", program, "runs", "list", "--logs", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "[/b] lab" in done.stdout and "[old]" in done.stdout
