"""The run log, written and read back: every reading to the bit, whatever happens to the program that writes it."""

import errno
import fcntl
import itertools
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from rig.bench.bench import read_bench
from rig.clock import Clock
from rig.readings import NS, Event, Exchange, Quality
from rig.runlog import RunError, RunWriter, columns_of, lines, read_run, start_record, verify
from rig.runlog.folder import Lock, is_locked
from rig.runlog.listing import list_runs
from rig.runlog.schema import ClockRecord
from tests.synthetic_runs import UTC_START_NS, Bench, poll, reading, start_of, write_sweep

ROOT = Path(__file__).resolve().parents[3]
ODD = (
    reading("tach", "speed_rpm", 0.1 + 0.2, 1_234_567_891, Quality.OK, raw="+000.30", detail='a, "b"\nc'),
    reading("tach", "speed_rpm", None, 2 * NS, Quality.TIMEOUT, retries=3, detail="no answer within 0.3 s"),
    reading("tach", "speed_rpm", 100.0, 3 * NS, Quality.OVER_RANGE, censored=1),
    reading("tach", "speed_rpm", -1e-17, -5, Quality.UNVERIFIED, raw="-1e-17"),
)


def new_writer(root, **changes):
    return RunWriter.create(root, start_of(**changes))


def test_a_finished_run_is_read_back_whole(tmp_path):
    run = read_run(write_sweep(tmp_path))
    assert (run.state, run.torn, run.end.vented) == ("finished", {}, True)
    assert run.end.counts == {
        "exchanges": sum(1 for _ in run.exchanges()),
        "samples": len(run.samples),
        "events": len(run.events),
        "plateaus": 14,
    }
    assert len(run.plateaus) == 14
    assert verify(run.folder) == []


def test_a_reading_is_read_back_to_the_bit(tmp_path):
    events = (Event("tx", 5, b"\x00\xff"), Event("silence", 6), Event("lost", 7, "weg, é".encode()))
    written = Exchange("usb", "tach", "write", 1.0 / 3.0, events, ODD, "no answer")
    with new_writer(tmp_path) as writer:
        writer.exchange(Exchange("usb", "", "open"))
        writer.exchange(written)
        writer.end("finished")
    (_, empty), (number, found) = read_run(writer.folder).exchanges()
    assert (empty, number) == (Exchange("usb", "", "open"), 2)
    harmless = ODD[0].detail.replace("\n", "\\n")
    assert found.readings[0].detail == harmless
    assert found.readings[1:] == ODD[1:]
    assert found.readings[0].value == 0.1 + 0.2
    assert (found.events, found.argument, found.outcome) == (events, 1.0 / 3.0, "no answer")


def test_the_same_exchanges_give_the_same_bytes(tmp_path):
    first, second = (write_sweep(tmp_path) for _ in range(2))
    for name in ("samples.csv", "wire.jsonl", "events.jsonl", "plateaus.csv"):
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_text_of_a_device_that_a_spreadsheet_would_run_gets_an_apostrophe(tmp_path):
    texts = ["=cmd|'/c calc'!A1", "+1+1", "@SUM(A1)", "-2+3", "'quoted", " =1+1", "-3.25"]
    with new_writer(tmp_path) as writer:
        for text in texts:
            writer.exchange(
                Exchange("usb", "tach", "poll", None, (), (reading("tach", "speed_rpm", 1.0, 1, raw=text),))
            )
        writer.end("finished")
    cells = [line.split(",")[13] for line in (writer.folder / "samples.csv").read_text().splitlines()[1:]]
    assert cells == [*(f"'{text}" for text in texts[:6]), "-3.25"]
    assert list(read_run(writer.folder).samples["raw"]) == texts


def test_text_of_a_device_is_bounded_and_stays_on_its_line(tmp_path):
    with new_writer(tmp_path) as writer:
        text = "x\r\n\x00\ud800" * 1000
        writer.exchange(Exchange("usb", "t", "poll", None, (), (reading("t", "speed_rpm", 1.0, 1, detail=text),)))
        writer.event("gap", 1, text=text)
        writer.end("finished")
    run = read_run(writer.folder)
    assert len(run.samples) == len(run.events) == 1
    assert len(run.samples["detail"][0]) < 3000


def test_a_run_without_the_wire_still_counts_its_exchanges(tmp_path):
    run = read_run(write_sweep(tmp_path, wire=False))
    assert not run.has_wire
    assert run.samples["exchange"].iloc[-1] == run.end.counts["exchanges"]
    assert verify(run.folder) == []


def test_times_are_kept_as_utc_beside_the_bench_s_own(tmp_path):
    with new_writer(tmp_path) as writer:
        writer.exchange(poll("tach", {"speed_rpm": 1.0}, 1_500_000_000))
        writer.event("set-point", 1_500_000_000, pressure_bar_abs=2.0)
    row = read_run(writer.folder).samples.iloc[0]
    assert (row.time_s, row.request_ns, row.utc) == (1.5, 1_498_000_000, "2026-05-28T20:26:41.500000Z")
    assert read_run(writer.folder).events[0].utc == row.utc


def test_a_taken_name_gets_a_number(tmp_path):
    names = []
    for _ in range(3):
        with new_writer(tmp_path) as writer:
            names.append(writer.name)
    assert names == [f"20260528-202640_synthetic_sweep{end}" for end in ("", "-2", "-3")]


def test_a_replay_keeps_the_times_of_its_parent_under_a_name_of_its_own(tmp_path):
    with new_writer(tmp_path, utc_start="2026-06-01T12:00:00Z") as writer:
        writer.exchange(poll("tach", {"speed_rpm": 1.0}, 0))
    assert writer.name.startswith("20260601-120000_")
    assert read_run(writer.folder).samples["utc"][0] == "2026-05-28T20:26:40.000000Z"


def test_a_bench_s_name_cannot_lead_out_of_the_folder(tmp_path):
    with new_writer(tmp_path / "runs", bench="../../etc/passwd") as writer:
        assert writer.folder.parent == tmp_path / "runs"
        assert "/" not in writer.name


def test_an_event_holds_what_json_can(tmp_path):
    with new_writer(tmp_path) as writer:
        writer.event("statistics", NS, n="mine", rate=float("nan"), quality=Quality.OK, many=range(3), path=Path("a"))
        writer.event("levels", NS, bar_abs=[1.5, {"too high": None}])
    event, levels = read_run(writer.folder).events
    assert levels.details == {"bar_abs": [1.5, {"too high": None}]}
    assert (event.n, event.time_s, event.event) == (1, 1.0, "statistics")
    assert event.details == {"n_": "mine", "rate": "nan", "quality": "ok", "many": "range(0, 3)", "path": "a"}


def test_a_later_row_replaces_a_plateau_or_takes_it_back(tmp_path):
    with new_writer(tmp_path) as writer:
        writer.plateau({"n": 1, "speed_rpm": 100.0, "note": "first try"})
        writer.plateau({"n": 2, "speed_rpm": "<10"})
        writer.plateau({"n": 1, "speed_rpm": 101.0})
        writer.plateau({"n": 2, "used": False})
    run = read_run(writer.folder)
    assert [(plateau.n, plateau.means["speed_rpm"].mean) for plateau in run.plateaus] == [(1, 101.0)]
    assert len(run.plateau_rows) == 4
    assert run.plateau_rows[1].means["speed_rpm"].censored == -1


def test_a_plateau_column_that_is_none_is_refused(tmp_path):
    with new_writer(tmp_path) as writer, pytest.raises(RunError, match="no column is called speed_rps"):
        writer.plateau({"n": 1, "speed_rps": 4.0})


def test_a_plateau_s_mean_is_a_number_or_none(tmp_path):
    with new_writer(tmp_path) as writer:
        writer.plateau({"n": 1, "speed_rpm": float("nan"), "flow_l_min": 72.0})
        with pytest.raises(RunError, match="plateau column speed_rpm: 'fast' is not a number"):
            writer.plateau({"n": 2, "speed_rpm": "fast"})
    (plateau,) = read_run(writer.folder).plateaus
    assert list(plateau.means) == ["flow_l_min"]


def test_the_pressure_of_a_gauge_has_a_column_of_its_own():
    columns = columns_of({"pressure": "gauge.pressure_bar_gauge", "speed": "tach.speed_rpm"})
    assert columns == {"pressure": "pressure_bar_gauge", "speed": "speed_rpm"}


@pytest.mark.parametrize(
    ("changes", "taken"),
    [
        ({}, "2026-05-28T20:26:40.000000Z"),
        ({"clock": ClockRecord(utc_start_ns=UTC_START_NS, rate=10.0)}, "2026-05-28"),
        ({"imported": {"date": "1998"}}, "1998"),
        ({"imported": {"title": "old data"}}, ""),
    ],
)
def test_a_run_was_taken_at_its_start_on_its_day_or_when_its_source_says(tmp_path, changes, taken):
    with new_writer(tmp_path, **changes) as writer:
        assert read_run(writer.folder).start.taken == taken


def test_a_closed_run_takes_nothing_more(tmp_path):
    with new_writer(tmp_path) as writer:
        writer.end("aborted", "stopped by the operator", vented=True)
        with pytest.raises(RunError, match="the run is closed"):
            writer.event("late", 0)
        with pytest.raises(RunError, match="closed already"):
            writer.end("finished")
    run = read_run(writer.folder)
    assert (run.state, run.end.reason) == ("stopped", "stopped by the operator")


def test_a_run_that_an_interlock_ended_is_told_as_tripped_and_one_of_a_person_as_stopped(tmp_path):
    for by, word in (("interlock", "tripped"), ("operator", "stopped"), (None, "stopped")):
        with RunWriter.create(tmp_path / word / str(by), start_of()) as writer:
            writer.end("aborted", "why", vented=True, stopped_by=by)
        run = read_run(writer.folder)
        assert (run.state, run.end.outcome) == (word, "aborted")  # the file's own word stays


def test_a_run_that_is_being_written_is_shown_as_that_and_readable(tmp_path):
    with new_writer(tmp_path) as writer:
        writer.exchange(poll("tach", {"speed_rpm": 1.0}, 1))
        assert read_run(writer.folder).state == list_runs(tmp_path)[0].outcome == "being written"
        assert len(read_run(writer.folder).samples) == 1
    assert read_run(writer.folder).state == "killed"


def test_two_programs_cannot_write_one_run(tmp_path):
    with new_writer(tmp_path) as writer:
        assert is_locked(writer.folder)
        with pytest.raises(RunError, match="another program writes this run"):
            Lock(writer.folder)
        second = [sys.executable, "-c", f"from rig.runlog.folder import *; Lock(Path({str(writer.folder)!r}))"]
        found = subprocess.run(second, capture_output=True, text=True, timeout=60, check=False)
        assert "another program writes this run" in found.stderr
    Lock(writer.folder).release()


def test_a_full_disk_ends_the_run_with_whole_lines(tmp_path):
    """The kernel's limit on a file's size stands in for the full disk: the write that crosses it is cut short."""
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from tests.synthetic_runs import poll, start_of
from rig.runlog import RunError, RunWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
writer = RunWriter.create(Path({str(tmp_path)!r}), start_of())
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
rows = 0
try:
    while True:
        writer.exchange(poll("tach", {{"speed_rpm": 1.0}}, rows + 1))
        rows += 1
except RunError as error:
    print(error)
writer.end("finished")
print(rows)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert found.returncode == 0, found.stderr
    *error, rows = found.stdout.splitlines()
    assert "cannot be written (File too large); the run ends here" in error[0]
    run = read_run(next(tmp_path.iterdir()))
    assert (run.state, run.torn, len(run.samples)) == ("failed", {}, int(rows))
    assert "File too large" in run.end.reason
    assert verify(run.folder) == []


def test_what_is_written_is_put_on_the_disk_without_being_asked(tmp_path, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(os.fstat(handle).st_ino) or real(handle))
    with RunWriter.create(tmp_path, start_of(), sync_s=0.02) as writer:
        wanted = {(writer.folder / name).stat().st_ino for name in ("samples.csv", "wire.jsonl", "events.jsonl")}
        Bench(writer).plateau(1, (2.0, 55.0, 394.8), "up")
        writer.event("step", 1)
        wanted.add((writer.folder / "plateaus.csv").stat().st_ino)
        for _ in range(500):
            if wanted <= set(synced):
                break
            time.sleep(0.01)
    assert wanted <= set(synced)


def write_until_killed(root, acknowledged):
    """Rows as fast as they go, each said on a pipe once it is written."""
    writer = RunWriter.create(root, start_of(), sync_s=0.01)
    for row in itertools.count(1):
        writer.exchange(poll("tach", {"speed_rpm": float(row)}, row))
        if row % 7 == 0:
            writer.event("step", row, row=row)
        os.write(acknowledged, f"{row}\n".encode())


def test_a_killed_program_loses_no_acknowledged_row(tmp_path):
    """kill -9 at ten random moments; what was acknowledged is all there, in order, with its bytes on the wire."""
    moments = random.Random(3)
    for trial in range(10):
        root = tmp_path / str(trial)
        reading_end, writing_end = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                write_until_killed(root, writing_end)
            finally:
                os._exit(1)
        os.close(writing_end)
        said = os.read(reading_end, 1)
        threading.Timer(moments.uniform(0.0, 0.2), os.kill, (child, signal.SIGKILL)).start()
        while more := os.read(reading_end, 65536):
            said += more
        os.close(reading_end)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
        acknowledged = int(said[: said.rindex(b"\n")].split(b"\n")[-1])
        run = read_run(next(root.iterdir()))
        values = run.samples["value"].tolist()
        assert run.state == "killed"
        assert len(values) >= acknowledged > 0
        assert values == [float(row) for row in range(1, len(values) + 1)]
        assert sum(1 for _ in run.exchanges()) >= acknowledged
        steps = [event.details["row"] for event in run.events]
        assert steps[: acknowledged // 7] == list(range(7, acknowledged + 1, 7))


def test_the_start_record_is_there_whole_or_not_at_all(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(RunError, match=r"start.json: cannot be written \(No space left on device\)"):
        new_writer(tmp_path)
    (folder,) = tmp_path.iterdir()
    assert not (folder / "start.json").exists()
    assert not is_locked(folder)
    assert list_runs(tmp_path) == []


def test_a_run_is_in_the_list_by_its_own_name_alone_while_its_start_record_is_written(tmp_path, monkeypatch):
    seen = []
    replace = Path.replace

    def look(self, place):
        seen.extend(row.name for row in list_runs(tmp_path))
        found = replace(self, place)
        seen.extend(row.name for row in list_runs(tmp_path))
        return found

    monkeypatch.setattr(Path, "replace", look)
    with new_writer(tmp_path) as writer:
        pass
    assert seen == [writer.name]


def test_the_start_record_says_what_the_run_was(tmp_path):
    with new_writer(tmp_path, parent="an_earlier_run", lubrication="oil mist") as writer:
        record = json.loads((writer.folder / "start.json").read_text())
    assert (record["format"], record["parent"], record["lubrication"]) == ("run/1", "an_earlier_run", "oil mist")
    assert record["clock"] == {"rate": 1.0, "utc_start_ns": UTC_START_NS}
    assert record["devices"]["gauge"]["channels"]["pressure_bar_abs"]["bias_sd"] == 0.005


def test_the_start_record_keeps_the_supply_and_how_the_speed_is_made():
    record = start_record(read_bench(Path("virtual")), "sweep", Clock(), {})
    assert (record.supply.regulator_time_s, record.supply.line_volume_l) == (0.3, None)
    speed = record.devices["tach"].channels["speed_rpm"]
    assert (speed.pulses_per_rev, speed.window_s) == (60.0, None)
    assert record.devices["gauge"].channels["pressure_bar_abs"].pulses_per_rev is None
    display = start_record(read_bench(Path("virtual_alicat")), "sweep", Clock(), {}).devices["tach"]
    assert display.channels["speed_rpm"].window_s == 1.0


def test_a_lock_ends_with_its_process(tmp_path):
    with new_writer(tmp_path) as writer:
        folder = writer.folder
    handle = os.open(folder / ".lock", os.O_RDWR)
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert is_locked(folder)
    os.close(handle)
    assert not is_locked(folder)


def test_the_end_waits_for_what_is_on_its_way_to_the_disk(tmp_path, monkeypatch):
    """A disk that fails late: the run is not sealed as finished before it is known."""
    fsync, under_way = os.fsync, threading.Event()

    def slow(handle):
        if threading.current_thread().name == "run log":
            under_way.set()
            time.sleep(0.5)
            raise OSError(errno.EIO, "Input/output error")
        fsync(handle)

    monkeypatch.setattr(os, "fsync", slow)
    with RunWriter.create(tmp_path, start_of(), sync_s=0.05) as writer:
        writer.exchange(poll("tach", {"speed_rpm": 1.0}, 1))
        assert under_way.wait(5.0)
        end = writer.end("finished")
    assert end.outcome == "failed"
    assert end.reason.count("the disk does not keep it") == 1


def test_a_run_that_is_being_written_can_be_read_at_any_moment(tmp_path, monkeypatch):
    """Between two looks at a file it may have grown, and its last line be half there."""
    with RunWriter.create(tmp_path, start_of()) as writer:
        for number in range(3):
            writer.exchange(poll("tach", {"speed_rpm": 1.0}, number + 1))
        whole = [line for _, line in lines.whole_lines(writer.folder / "samples.csv")]
        opened = lines.open_plain

        def growing(path, limit):
            stream = opened(path, limit)
            with path.open("ab") as more:
                more.write(b"a line that is half th")
            return stream

        monkeypatch.setattr(lines, "open_plain", growing)
        assert [line for _, line in lines.whole_lines(writer.folder / "samples.csv")] == whole


def test_a_full_disk_under_the_samples_takes_their_exchange_back_from_the_wire(tmp_path):
    """The file that is full is the second to be written: of the exchange, nothing is left in the first."""
    code = f"""
import resource, signal, sys
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from tests.synthetic_runs import poll, start_of
from rig.runlog import RunError, RunWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
writer = RunWriter.create(Path({str(tmp_path)!r}), start_of())
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
rows = 0
try:
    while True:
        writer.exchange(poll("tach", {{f"speed_{{i}}_rpm": 1.0 for i in range(40)}}, rows + 1))
        rows += 1
except RunError as error:
    print(error)
writer.end("finished")
print(rows)
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert found.returncode == 0, found.stderr
    *error, rows = found.stdout.splitlines()
    assert "samples.csv: cannot be written" in error[0]
    run = read_run(next(tmp_path.iterdir()))
    assert run.samples["exchange"].max() == run.exchange_count == int(rows) > 0
    assert verify(run.folder) == []


def test_the_end_record_comes_after_everything_is_on_the_disk(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, Path.replace

    def synced(handle):
        order.append(os.fstat(handle).st_ino)
        fsync(handle)

    def renamed(path, target):
        order.append(Path(target).name)
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", renamed)
    with RunWriter.create(tmp_path, start_of(), sync_s=1000.0) as writer:
        Bench(writer).plateau(1, (2.0, 55.0, 394.8), "up")
        order.clear()
        writer.end("finished")
    files = [
        (writer.folder / name).stat().st_ino for name in ("samples.csv", "wire.jsonl", "events.jsonl", "plateaus.csv")
    ]
    end = order.index("end.json")
    assert set(files) <= set(order[:end])
    assert (writer.folder / "end.json").stat().st_ino in order[:end]
    assert writer.folder.stat().st_ino in order[end:]


@pytest.mark.parametrize("how", [shutil.rmtree, lambda folder: folder.rename(folder.with_name("elsewhere"))])
def test_a_run_whose_folder_is_gone_is_not_sealed_in_silence(tmp_path, how):
    with new_writer(tmp_path) as writer:
        Bench(writer).plateau(1, (2.0, 55.0, 394.8), "up")
        how(writer.folder)
        with pytest.raises(RunError, match="was deleted or moved while it was written"):
            writer.end("finished")
    assert not writer.folder.exists()


def test_a_run_that_is_deleted_ends_within_the_next_seconds_and_not_with_the_sweep(tmp_path):
    with RunWriter.create(tmp_path, start_of(), sync_s=0.02) as writer:
        shutil.rmtree(writer.folder)
        until_s = time.monotonic() + 60.0
        with pytest.raises(RunError, match="was deleted or moved"):
            while time.monotonic() < until_s:
                writer.exchange(poll("tach", {"speed_rpm": 1.0}, 1))
                time.sleep(0.01)


def test_a_clock_that_is_set_back_an_hour_leaves_the_times_of_the_run(tmp_path, monkeypatch):
    with new_writer(tmp_path) as writer:
        bench = Bench(writer)
        bench.plateau(1, (2.0, 55.0, 394.8), "up")
        monkeypatch.setattr(time, "time_ns", lambda now=time.time_ns: now() - 3600 * NS)
        bench.plateau(2, (2.2, 60.0, 440.0), "up")
        end = writer.end("finished")
    assert verify(writer.folder) == []
    assert read_run(writer.folder).samples["utc"].iloc[-1] > "2026-05-28T20:26:45"
    assert 0.0 <= end.wall_s < 60.0
