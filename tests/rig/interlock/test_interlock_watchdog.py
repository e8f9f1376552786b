"""The watchdog, with real processes, a real kill -9, and a regulator on a pseudo-terminal."""

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from rig.bench.bench import read_bench
from rig.clock import Clock
from rig.interlock import SafetyError
from rig.interlock.watchdog import Plan, Watchdog
from tests.modbus_peer import ADAM, ModbusPeer
from tests.rig.interlock.test_interlock_failsafe import BENCH

RAISED = 1638  # counts: 2 bar gauge of a span of 5
SAFE_WITHIN_S = 2.0

CONTROLLER = """
import os, signal, sys, time
from pathlib import Path
from rig.bench.bench import read_bench
from rig.clock import Clock
from rig.interlock.watchdog import Plan, Watchdog
from rig.acquisition.opening import line_of, port_of

folder = Path(sys.argv[1])
bench, clock = read_bench(folder / "bench.toml"), Clock()
plan = Plan.of(bench, folder / "bench.toml", clock, folder / "watchdog.jsonl")
{before}
watchdog = Watchdog.start(plan{more})
table = bench.file.lines["bus"]
line = line_of("bus", table, port_of("bus", table, clock), clock)
line.open()
regulator = bench.build("regulator")
regulator.open(line)
regulator.write(line, 2.0)
print("raised", watchdog.pid, flush=True)
{after}
time.sleep(60)
"""


def is_running(pid):
    """Whether a process is there and has not ended; one that has may wait for its new parent to notice."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


class Bench:
    """A regulator that holds 2 bar, and a folder with its bench file."""

    def __init__(self, folder: Path):
        self.folder, self.registers = folder, dict(ADAM)
        self.peer = ModbusPeer({2: self.registers})
        (folder / "bench.toml").write_text(BENCH.format(port=self.peer.path, safety=""))

    def controller(self, before="", after="", more=""):
        script = CONTROLLER.format(before=textwrap.dedent(before), after=textwrap.dedent(after), more=more)
        return subprocess.Popen(
            [sys.executable, "-c", script, str(self.folder)], stdout=subprocess.PIPE, text=True, start_new_session=True
        )

    def plan(self):
        path = self.folder / "bench.toml"
        return Plan.of(read_bench(path), path, Clock(), self.folder / "watchdog.jsonl", seal=self.folder / "end.json")

    def log(self):
        path = self.folder / "watchdog.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

    def wait_for_log(self, event, wait_s=5.0):
        until_s = time.monotonic() + wait_s
        while time.monotonic() < until_s:
            for entry in self.log():
                if entry["event"] == event:
                    return entry
            time.sleep(0.02)
        raise AssertionError(f"no '{event}' in {self.log()}")

    def close(self):
        """Wait for the watchdogs to end, and unplug the regulator: the next test gets the same pseudo-terminal."""
        until_s = time.monotonic() + 15.0
        for entry in self.log():
            while "pid" in entry and is_running(entry["pid"]) and time.monotonic() < until_s:
                time.sleep(0.02)
        self.peer.close()


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.close()


@pytest.fixture
def ended():
    """Processes that are killed at the end of the test."""
    processes = []
    yield processes
    for process in processes:
        with contextlib.suppress(OSError):
            os.kill(process.pid, signal.SIGCONT)
        process.kill()
        process.wait()
        process.stdout.close()


def raised(process):
    """Wait until the controller has raised the pressure, and return the watchdog's process number."""
    said = process.stdout.readline().split()
    assert said[:1] == ["raised"]
    return int(said[1])


def test_kill_9_of_the_controller_brings_the_regulator_to_zero_within_2_s(bench, ended):
    process = bench.controller()
    ended.append(process)
    raised(process)
    assert bench.registers[0] == RAISED
    process.kill()
    assert bench.peer.wait_for_write(0, 0, SAFE_WITHIN_S) is not None
    entry = bench.wait_for_log("vented")
    assert (entry["reason"], entry["ordered"], entry["reads_back"]) == ("the controller has ended", 0.0, 0.0)


def test_a_controller_that_is_stopped_counts_as_hung_although_it_keeps_its_lock(bench, ended):
    process = bench.controller()
    ended.append(process)
    raised(process)
    os.kill(process.pid, signal.SIGSTOP)
    assert bench.peer.wait_for_write(0, 0, 1.0 + SAFE_WITHIN_S) is not None
    assert bench.wait_for_log("vented")["reason"] == "no beat for 1 s"


def test_a_controller_that_is_killed_before_the_watchdog_is_ready_is_vented_too(bench, ended):
    bench.registers[0] = RAISED
    kill = "Watchdog._wait_until_ready = lambda self: os.kill(os.getpid(), signal.SIGKILL)"
    process = bench.controller(before=kill)
    ended.append(process)
    assert process.wait(20) == -signal.SIGKILL
    assert bench.peer.wait_for_write(0, 0, 20.0) is not None  # as soon as it has read its files


def test_a_watchdog_that_starts_late_vents_and_leaves_a_run_that_was_sealed_meanwhile_alone(bench, ended):
    bench.registers[0] = RAISED
    kill = """
        plan = Plan.of(bench, folder / "bench.toml", clock, folder / "watchdog.jsonl", seal=folder / "end.json")
        (folder / "end.json").write_text("{}")
        Watchdog._wait_until_ready = lambda self: (print("raised", self.pid, flush=True), os.kill(os.getpid(), 9))
    """
    process = bench.controller(before=kill)
    ended.append(process)
    watchdog = raised(process)
    assert process.wait(20) == -signal.SIGKILL
    assert bench.peer.wait_for_write(0, 0, 20.0) is not None
    until_s = time.monotonic() + 5.0
    while is_running(watchdog) and time.monotonic() < until_s:
        time.sleep(0.02)
    assert not is_running(watchdog)
    assert not (bench.folder / "watchdog.jsonl").exists()


def test_a_controller_that_ends_without_a_release_is_vented(bench, ended):
    process = bench.controller(after="sys.exit(3)")
    ended.append(process)
    raised(process)
    assert bench.peer.wait_for_write(0, 0, SAFE_WITHIN_S + 2.0) is not None


def test_a_release_leaves_the_regulator_alone(bench, ended):
    process = bench.controller(after='watchdog.release(); print("released", flush=True)')
    ended.append(process)
    raised(process)
    assert process.stdout.readline() == "released\n"
    assert [entry["event"] for entry in bench.log()] == ["watching", "released"]
    process.kill()
    assert bench.peer.wait_for_write(0, 0, 0.3) is None
    assert bench.registers[0] == RAISED


def test_a_controller_that_cannot_vent_hands_over(bench, ended):
    process = bench.controller(after='line.close(); print("vented", watchdog.hand_over(), flush=True)')
    ended.append(process)
    raised(process)
    assert process.stdout.readline() == "vented True\n"
    assert bench.registers[0] == 0


def test_a_controller_that_computes_without_a_pause_is_alive(bench, ended):
    busy = (
        'end = time.monotonic() + 2.0\nwhile time.monotonic() < end:\n    sum(range(100000))\nprint("done", flush=True)'
    )
    process = bench.controller(after=busy)
    ended.append(process)
    raised(process)
    assert process.stdout.readline() == "done\n"
    assert bench.registers[0] == RAISED


def test_a_sweep_that_no_longer_asks_counts_as_hung_where_that_was_agreed(bench, ended):
    asks = """
    for _ in range(15):
        assert watchdog.fault() is None
        time.sleep(0.1)
    print("asked", flush=True)
    """
    process = bench.controller(after=asks, more=", attended_s=0.5")
    ended.append(process)
    raised(process)
    assert process.stdout.readline() == "asked\n"
    assert bench.registers[0] == RAISED  # 1.5 s of asking
    assert bench.peer.wait_for_write(0, 0, 1.5 + SAFE_WITHIN_S) is not None


def test_the_signals_meant_for_the_controller_do_not_end_the_watchdog(bench, ended):
    process = bench.controller()
    ended.append(process)
    watchdog = raised(process)
    assert os.getsid(watchdog) == watchdog  # Ctrl-C goes to the terminal's session
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(watchdog, number)
    process.kill()
    assert bench.peer.wait_for_write(0, 0, SAFE_WITHIN_S) is not None


def test_a_port_that_is_taken_for_a_while_is_tried_again(bench, ended):
    process = bench.controller(after='line.close(); print("closed", flush=True)')
    ended.append(process)
    raised(process)
    assert process.stdout.readline() == "closed\n"
    with open(bench.peer.path, "rb", buffering=0) as other:  # noqa: PTH123 (a second program on the port)
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        process.kill()
        assert bench.peer.wait_for_write(0, 0, 0.5) is None
    assert bench.peer.wait_for_write(0, 0, SAFE_WITHIN_S) is not None
    assert bench.wait_for_log("vented")["attempts"] > 1


def test_a_bench_file_that_cannot_be_read_is_refused_before_the_pressure_is_raised(bench):
    plan = bench.plan()
    (bench.folder / "bench.toml").write_text("format = 'bench/2'")
    with pytest.raises(SafetyError, match=r"did not start: ConfigError.*bench\.toml"):
        Watchdog.start(plan)


def test_a_watchdog_that_has_died_is_noticed(bench):
    watchdog = Watchdog.start(bench.plan())
    assert watchdog.fault() is None
    os.kill(watchdog.pid, signal.SIGKILL)
    watchdog._process.wait(5)
    assert "has ended" in watchdog.fault()
    watchdog.release()


def test_a_bench_without_a_regulator_has_nothing_to_watch(bench, tmp_path):
    path = tmp_path / "manual.toml"
    path.write_text((bench.folder / "bench.toml").read_text().replace('regulator = "regulator"', ""))
    with pytest.raises(SafetyError, match="no regulator"):
        Plan.of(read_bench(path), path, Clock())


def test_a_plan_survives_its_pipe(bench):
    assert Plan.from_json(bench.plan().to_json()) == bench.plan()
