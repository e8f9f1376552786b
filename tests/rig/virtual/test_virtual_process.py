"""The virtual bench as a process: how it is started, spoken to, and how it ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import configs
from rig.acquisition.opening import line_of
from rig.bench.bench import read_bench
from rig.readings import Quality
from rig.virtual import VirtualBenchError, launch
from rig.virtual.launch import ask
from tests.waiting import wait_for

ROOT = configs.FOLDER.parent
BENCHES = ("virtual", "virtual_alicat")


@pytest.fixture(scope="module")
def running():
    with launch("virtual", rate=20.0, seed=3) as found:
        yield found


@pytest.fixture
def state_folder(tmp_path):
    """A folder for a bench that is started by hand; what is still running at the end is ended."""
    yield tmp_path / "state"
    with contextlib.suppress(OSError, ValueError, ProcessLookupError):
        os.kill(json.loads((tmp_path / "state" / "ports.json").read_text())["pid"], signal.SIGKILL)


def start(folder, *more):
    command = [sys.executable, "-m", "rig.virtual", "virtual", "--state", str(folder), *more]
    process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
    wait_for((folder / "ports.json").exists)
    return process


def lines_of(bench, running):
    return {
        name: line_of(name, table, running.port_for(name, table, running.clock), running.clock)
        for name, table in bench.file.lines.items()
    }


@pytest.mark.parametrize("name", BENCHES)
def test_the_rig_s_own_drivers_identify_and_read_every_instrument(name):
    bench = read_bench(Path(name))
    with launch(name, rate=20.0) as found:
        lines = lines_of(bench, found)
        for line in lines.values():
            line.open()
        for device, table in bench.file.devices.items():
            driver, line = bench.build(device), lines[table.line]
            driver.open(line)
            assert driver.identify(line)
            readings = driver.poll(line)
            assert {reading.channel for reading in readings} <= set(driver.channels)
            assert {reading.quality for reading in readings} <= {Quality.OK, Quality.UNVERIFIED}
        for line in lines.values():
            line.close()


def test_a_set_point_written_by_the_rig_s_driver_moves_the_motor(running):
    bench = read_bench(Path("virtual"))
    line = lines_of(bench, running)["bus"]
    line.open()
    regulator = bench.build("dac")
    regulator.open(line)
    regulator.identify(line)
    assert regulator.write(line, 0.9) == pytest.approx(0.9, abs=0.002)
    wait_for(lambda: running.control({"do": "state"})["speed_rpm"] > 300.0)
    regulator.write(line, 0.0)
    wait_for(lambda: running.control({"do": "state"})["pressure_bar_abs"] < 1.0133)
    line.close()


def test_the_ports_file_says_all_that_a_program_needs(running):
    ports = json.loads((running.folder / "ports.json").read_text())
    assert ports["pid"] == running.process.pid
    assert ports["rate"] == 20.0
    assert Path(ports["lines"]["bus"]["port"]).resolve() == Path(ports["lines"]["bus"]["terminal"])
    assert ports["lines"]["net"]["host"] == "127.0.0.1"


def test_both_sides_share_the_bench_s_clock(running):
    before = running.clock.now_ns()
    told_ns = running.control({"do": "state"})["time_s"] * 1e9
    assert before - 1e6 <= told_ns <= running.clock.now_ns() + 1e6


def test_the_state_tells_each_set_point_with_its_time_on_the_wall(running):
    before = time.monotonic_ns()
    running.control({"do": "supply", "pressure_bar_abs": 1.234})
    running.control({"do": "supply", "pressure_bar_abs": 0.0})
    ordered = running.control({"do": "state"})["setpoints"][-2]
    assert ordered["pressure_bar_abs"] == pytest.approx(1.234)
    assert before - 1e6 <= ordered["real_ns"] <= time.monotonic_ns()


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        ({"do": "explode"}, "do: 'explode' is not one of state, fault,"),
        ({"do": "unplug", "line": "x"}, "line: 'x' is not one of bus, net, usb"),
        ({"do": "power_cycle", "device": 4}, "device: 4 is not one of gauge, dac, flowmeter, tach"),
        ({"do": "supply"}, "pressure_bar_abs: a number is needed, not None"),
        ({"do": "supply", "pressure_bar_abs": 99}, "pressure_bar_abs: 99 is outside 0..8 bar"),
        ({"do": "fault", "kind": "slow", "line": "bus"}, "fault: there is no fault 'slow'"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_and_the_bench_goes_on(running, request_, said):
    with pytest.raises(VirtualBenchError, match="the virtual bench refused") as error:
        running.control(request_)
    assert said in str(error.value)
    assert running.control({"do": "state"})["ok"]


def test_what_is_not_json_is_refused(running):
    where = running.ports["control"]
    with socket.create_connection((where["host"], where["tcp_port"]), timeout=5.0) as connection:
        connection.sendall(b"hello\n")
        assert json.loads(connection.makefile("rb").readline())["error"] == "a request is one JSON object on one line"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ("rate = 20.0", 'rate = 20.0\nfaults = [{kind = "slow", line = "bus"}]'),
            "[[virtual.faults]] entry 1: there is no fault",
        ),
        (("rate = 20.0", "rate = 20.0\ntruth = {f_overal = 0.07}"), "virtual.truth.f_overal: no such parameter"),
        (("[virtual]", "[virtuel]"), "unknown key 'virtuel'"),
    ],
)
def test_a_bench_file_that_cannot_be_served_is_told_in_one_line(tmp_path, change, said):
    text = (configs.FOLDER / "benches" / "virtual.toml").read_text().replace(*change)
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(VirtualBenchError, match="did not start") as error:
        launch(tmp_path / "bad.toml")
    assert said in str(error.value)
    assert "Traceback" not in str(error.value)


def test_sigterm_ends_the_bench_and_takes_its_links_away(state_folder):
    process = start(state_folder)
    process.send_signal(signal.SIGTERM)
    assert process.wait(10.0) == 0
    assert process.stderr.read() == b""
    assert list(state_folder.iterdir()) == []


def test_the_bench_outlives_its_owner_s_kill_9_and_then_ends(state_folder):
    owner = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    process = start(state_folder, "--owner", str(owner.pid), "--linger", "2")
    ports = json.loads((state_folder / "ports.json").read_text())
    owner.kill()  # and nobody waits for it yet: a zombie is gone too
    died = time.monotonic()
    time.sleep(0.7)
    assert ask(ports, {"do": "state"})["ok"]
    assert process.wait(30.0) == 0
    assert time.monotonic() - died > 1.4
    owner.wait()
