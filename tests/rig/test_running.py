"""A bench from the command line, end to end: what a person types, in a process of its own, on a virtual bench."""

import contextlib
import csv
import json
import os
import pty
import re
import select
import shlex
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from rig.acquisition.opening import port_of
from rig.bench.bench import FOLDER, bench_path
from rig.clock import Clock
from rig.exchange.export import recording_of
from rig.recording import read_recording
from rig.run import running
from rig.run.place import Place
from rig.run.terminal import why_failed
from rig.runlog import read_run, verify
from rig.sweep.ambient import Given
from rig.virtual.launch import ask
from tests.waiting import wait_for

PROGRAM = [sys.executable, "-m", "spinbench"]
ENOUGH_S = 90.0
ROOM = ["--ambient-pressure-bar-abs", "1.013", "--ambient-temperature-c", "20", "--relative-humidity", "0.5"]
DAY = ["--lubrication", "none", "--minutes-running", "0"]
NOTE = '<b>"new seals"</b>\n=1+1 \u20ac'  # markup, a line of its own, what a spreadsheet would run
MOTOR = ["--motor-serial", "A-17", "--note", NOTE]
LOW, HIGH = 1.25, 1.35  # the guard allows the first from rest, and the second from there


def run(*arguments, **options):
    return subprocess.run(
        [*PROGRAM, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=ENOUGH_S,
        check=False,
        **options,
    )


def told(result):
    """The lines in which a command says what is wrong; that it says so in words."""
    assert "Traceback" not in result.stderr
    return [line for line in result.stderr.splitlines() if line.startswith("spinbench: ")]


def only_run(logs):
    (folder,) = logs.iterdir()
    return folder


def event_lines(folder):
    with contextlib.suppress(OSError):
        return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines() if line.endswith("}")]
    return []


def short(text):
    """The shipped virtual bench with two levels and short waits."""
    for key, value in {
        "levels_bar_abs": f"[{LOW}, {HIGH}]\nzero_s = 2.0",
        "order": '"up"',
        "window_s": "2.0",
        "dwell_s": "2.0",
        "captures": "[]",
        "rate": "10.0",
    }.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    return text


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    path = tmp_path_factory.mktemp("benches") / "short.toml"
    path.write_text(short((FOLDER / "virtual.toml").read_text()))
    return path


# A sweep that ends by itself.


@pytest.fixture(scope="module")
def finished(bench, tmp_path_factory):
    """A sweep, and what the command said."""
    logs = tmp_path_factory.mktemp("finished") / "logs"
    result = run("sweep", bench, "--logs", logs, "--operator", "tester", *DAY, *MOTOR)
    return result, only_run(logs)


def test_a_sweep_finishes_and_is_sealed_with_the_line_vented(finished):
    result, folder = finished
    assert result.returncode == 0, result.stderr
    assert result.stdout == f"{folder}: finished\n"
    found = read_run(folder)
    assert (found.end.outcome, found.end.vented, found.start.operator) == ("finished", True, "tester")
    assert [plateau.level_bar_abs for plateau in found.plateaus] == [LOW, HIGH]
    assert all(plateau.settled for plateau in found.plateaus)
    assert [event.details["which"] for event in found.events if event.event == "zero"] == ["start", "end"]


def test_a_finished_run_tells_what_was_planned_and_what_the_guard_expected(finished):
    _, folder = finished
    run = read_run(folder)
    assert run.end.stopped_by is None
    (course,) = [event.details for event in run.events if event.event == "course"]
    assert course["steps"] == [[LOW, "up", 1], [HIGH, "up", 1]]
    told = [event.details for event in run.events if event.event == "expected"]
    assert [(one["plateaus"], one["turning"]) for one in told] == [(0, 0), (1, 0), (2, 1)]
    assert 0.0 < told[-1]["f_overall"]["sd"] < told[0]["f_overall"]["sd"]
    pressures = [level for level, *_ in told[-1]["band"]]
    assert pressures == sorted(pressures)
    assert pressures[-1] == HIGH
    assert all(low <= mean <= high for _, low, mean, high in told[-1]["band"])


def test_a_finished_run_verifies_until_a_figure_is_changed(finished, spinbench_anywhere):
    _, folder = finished
    assert verify(folder) == []
    samples = (folder / "samples.csv").read_bytes()
    try:
        (folder / "samples.csv").write_bytes(samples.replace(b",simulated,", b",ok,", 1))
        result = spinbench_anywhere("runs", "verify", "last", "--logs", folder.parent, cwd=FOLDER)
    finally:
        (folder / "samples.csv").write_bytes(samples)
    assert result.returncode == 4
    assert "samples.csv: changed since the run was sealed" in result.stdout


def test_a_finished_run_replays_bit_for_bit(finished, spinbench_anywhere):
    _, folder = finished
    result = spinbench_anywhere("replay", "last", "--logs", folder.parent, cwd=FOLDER)
    assert result.returncode == 0, result.stderr
    rows = (folder / "samples.csv").read_bytes().count(b"\n") - 1
    assert f"{rows} samples of {rows}: the same, bit for bit" in result.stdout


def test_a_finished_run_exports_to_a_recording_that_can_be_read(finished, tmp_path, spinbench_anywhere):
    _, folder = finished
    result = spinbench_anywhere(
        "runs", "export", "last", "--logs", folder.parent, "-o", tmp_path / "recording", cwd=FOLDER
    )
    assert result.returncode == 0, result.stderr
    read = read_recording(tmp_path / "recording")
    steady = next(file for file in read.files if file.kind == "steady")
    turning = [row for row in read_run(folder).plateaus if row.means["speed_rpm"].mean > 0.0]
    assert steady.columns["speed_rpm"].values.tolist() == [row.means["speed_rpm"].mean for row in turning]
    assert {file.kind for file in read.files} == {"steady", "zero"}
    assert read.ambient.pressure_bar_abs == 1.01325
    assert read.origin == {
        "date": read_run(folder).start.utc_start[:10],  # ten of its seconds pass in one of the wall's
        "operator": "tester",
        "motor_serial": "A-17",
        "oil": "none",
        "note": f"{NOTE}; run {folder.name}, bench short",
    }


def test_a_run_is_shown_with_its_motors_number_and_its_note(finished, spinbench_anywhere):
    _, folder = finished
    shown = spinbench_anywhere("runs", "show", folder, cwd=FOLDER).stdout
    assert "motor      ptm3600 no. A-17, lubrication none" in shown
    assert 'note       <b>"new seals"</b>\\n=1+1' in shown


@pytest.mark.long
def test_a_sweep_whose_output_is_closed_says_so(bench, tmp_path):
    logs = tmp_path / "logs"
    command = [*PROGRAM, "sweep", str(bench), "--logs", str(logs), *DAY]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert process.stdout.readline()
    process.stdout.close()
    process.wait(ENOUGH_S)
    assert read_run(only_run(logs)).end.reason == "its output was closed"


def test_a_program_that_is_ended_is_not_told_as_a_closed_output():
    assert why_failed(BrokenPipeError()) == "its output was closed"
    assert why_failed(SystemExit(3)) == "SystemExit: 3"


def test_a_pressure_limit_above_the_model_s_end_is_refused(bench, tmp_path, spinbench_anywhere):
    path = tmp_path / "slip.toml"
    path.write_text(bench.read_text().replace("highest_pressure_bar_abs = 3.0", "highest_pressure_bar_abs = 30.0"))
    result = spinbench_anywhere("sweep", path, "--logs", tmp_path / "logs", *DAY, cwd=tmp_path)
    assert result.returncode == 2
    (line,) = told(result)
    assert "safety.highest_pressure_bar_abs = 30 is above 8 bar abs, where the model that predicts speeds ends" in line
    assert not (tmp_path / "logs").exists()


def test_the_guard_is_made_before_the_bench_is_touched(bench, tmp_path, monkeypatch):
    """Its kernels may have to be compiled first, for longer than a watchdog waits for a sign of life."""

    def guard(*arguments):
        raise LookupError("asked for")

    nowhere = Place(Clock(), port_of, None)
    monkeypatch.setattr(running, "guard_of", guard)
    monkeypatch.setattr(running, "place_of", lambda *arguments: contextlib.nullcontext(nowhere))
    given = Given(lubrication="none", minutes_running=0.0)
    with pytest.raises(LookupError, match="asked for"):
        running.take(bench, given, lambda *arguments: (None, []), running.Wanted("sweep", tmp_path / "logs"))
    assert not (tmp_path / "logs").exists()


# A sweep that is stopped, and gone on with.


@pytest.fixture(scope="module")
def stopped(bench, tmp_path_factory):
    """A sweep that got one Ctrl-C under pressure, with one plateau taken."""
    logs = tmp_path_factory.mktemp("stopped") / "logs"
    command = [
        *PROGRAM,
        "sweep",
        str(bench),
        "--no-page",
        "--logs",
        str(logs),
        *DAY,
        "--motor-serial",
        "A-17",
        "--note",
        '"new" <b>seals',
    ]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        folder = wait_for(lambda: next((path.parent for path in logs.glob("*/start.json")), None), "no run")
        wait_for(
            lambda: any(e["event"] == "set-point" and e.get("bar_abs") == HIGH for e in event_lines(folder)), "no ramp"
        )
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate(timeout=ENOUGH_S)
    finally:
        process.kill()
        process.wait()
    return process.returncode, said, folder, printed


def test_ctrl_c_once_seals_the_run_as_aborted_and_exits_with_4(stopped):
    code, said, folder, _ = stopped
    assert code == 4
    assert "Traceback" not in said
    end = read_run(folder).end
    assert (end.outcome, end.reason, end.vented) == ("aborted", "stopped by the operator", True)
    assert end.stopped_by == "operator"
    assert verify(folder) == []


def test_ctrl_c_once_leaves_the_regulator_at_zero_and_the_line_at_the_rooms_pressure(stopped):
    _, _, folder, _ = stopped
    exchanges = [json.loads(line) for line in (folder / "wire.jsonl").read_text().splitlines()]
    orders = [exchange for exchange in exchanges if exchange["action"] == "write"]
    assert max(order["argument"] for order in orders) == pytest.approx(HIGH - 1.01325)
    assert (orders[-1]["argument"], orders[-1]["outcome"]) == (0.0, "reads back 0.0 bar gauge")
    with (folder / "samples.csv").open(newline="") as stream:
        gauge = [float(row["value"]) for row in csv.DictReader(stream) if row["channel"] == "pressure_bar_abs"]
    assert max(gauge) > LOW - 0.02
    assert gauge[-1] == pytest.approx(1.01325, abs=0.05)


def test_the_watchdog_of_a_stopped_run_had_nothing_to_do(stopped):
    _, _, folder, _ = stopped
    said = [json.loads(line)["event"] for line in (folder / "watchdog.jsonl").read_text().splitlines()]
    assert said == ["watching", "released"]


def test_the_command_that_a_stopped_sweep_prints_takes_what_is_missing_and_names_its_parent(bench, stopped):
    _, _, folder, printed = stopped
    assert [plateau.level_bar_abs for plateau in read_run(folder).plateaus] == [LOW]
    (command,) = [line.partition(": ")[2] for line in printed.splitlines() if line.startswith("go on with: ")]
    name, *arguments = shlex.split(command)
    assert (name, arguments[:4]) == ("spinbench", ["sweep", str(bench), "--continue", folder.name])
    result = run(*arguments)
    assert result.returncode == 0, result.stderr
    child = read_run(Path(result.stdout.partition(": ")[0]))
    assert (child.start.parent, child.start.motor_serial, child.start.note) == (folder.name, "A-17", '"new" <b>seals')
    asked = [plateau for plateau in child.plateaus if "added on the guard's account" not in plateau.note]
    assert [plateau.level_bar_abs for plateau in asked] == [HIGH]
    assert [event.details["which"] for event in child.events if event.event == "zero"] == ["start", "end"]


# A bench that is not as its file says: one that is served, and files that are wrong about it.


@pytest.fixture(scope="module")
def serving(bench, tmp_path_factory):
    """The text of a bench file whose ports are those of a virtual bench that another process serves, and its ports."""
    state = tmp_path_factory.mktemp("served")
    process = subprocess.Popen(
        [*PROGRAM, "virtual", str(bench), "--state", str(state), "--rate", "1"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_for((state / "ports.json").exists, "no ports")
        ports = json.loads((state / "ports.json").read_text())
        lines = ports["lines"]
        text = bench.read_text().partition("[virtual]")[0]
        for name in ("bus", "usb"):
            head, mark, tail = text.partition(f"[lines.{name}]")
            text = head + mark + tail.replace('port = "virtual"', f'port = "{lines[name]["port"]}"', 1)
        yield text.replace('host = "virtual"', f'host = "127.0.0.1"\ntcp_port = {lines["net"]["tcp_port"]}'), ports
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


@pytest.fixture
def served(serving):
    """The text alone."""
    return serving[0]


@pytest.mark.long
def test_a_capture_whose_gauge_falls_silent_ends_with_4_and_says_what_is_missing(serving, tmp_path):
    """In real time; the gauge falls silent as the capture begins, and stays so."""
    text, ports = serving
    path, logs = tmp_path / "hardware.toml", tmp_path / "logs"
    path.write_text(text)
    words = [*PROGRAM, "capture", path, "--kind", "coast-down", "--level-bar-abs", "1.8", "--logs", logs, *DAY]
    with subprocess.Popen([*map(str, words)], stdin=subprocess.DEVNULL, stdout=-1, stderr=-1, text=True) as process:
        wait_for(logs.exists, "a run")
        folder = wait_for(lambda: next(logs.iterdir(), None), "a run")
        wait_for(lambda: [one for one in event_lines(folder) if one["event"] == "capture start"], "a capture")
        assert ask(ports, {"do": "fault", "kind": "dropped", "device": "gauge"})["ok"]
        try:
            printed, said = process.communicate(timeout=ENOUGH_S)
        finally:
            ask(ports, {"do": "clear"})
    assert process.returncode == 4, said
    assert "failed: the coast-down cannot be used: there is no reading of the pressure (gauge." in printed
    assert read_run(folder).end.outcome == "failed"


@pytest.mark.long
def test_a_coast_down_that_the_tachometer_does_not_see_ends_with_4_and_what_to_do_and_is_kept(tmp_path):
    """The counter hangs and tells of no tooth: each of its readings is usable, and together they show no coast-down."""
    text = bench_path(Path("virtual")).read_text()
    assert text.rstrip().endswith("seed = 1")
    (tmp_path / "blind.toml").write_text(text + 'faults = [{ kind = "frozen", device = "tach" }]\n')
    logs = tmp_path / "logs"
    result = run("capture", tmp_path / "blind.toml", "--kind", "coast-down", "--rate", 10, "--logs", logs, *DAY)
    assert result.returncode == 4, result.stderr
    said = "failed: the coast-down cannot be used: the speed (tach.speed_rpm) shows no turning rotor; look whether it"
    assert said in result.stdout
    kept = read_run(only_run(logs))
    assert kept.end.outcome == "failed" and verify(kept.folder) == []
    speeds = kept.samples[kept.samples["channel"] == "speed_rpm"]
    assert len(speeds) > 100 and (speeds["value"] == 0.0).all()


def refusal_of(text, tmp_path):
    """What a sweep says on a bench file, in lines: exit code 2, and nothing left behind."""
    path = tmp_path / "hardware.toml"
    path.write_text(text)
    result = run("sweep", path, "--logs", tmp_path / "logs", *DAY)
    assert result.returncode == 2, result.stderr
    assert result.stdout == ""
    assert not (tmp_path / "logs").exists()
    return told(result)


SILENT = {
    "missing device": ("unit_id = 2", "unit_id = 5", "dac"),
    "wrong baud rate": ("baud = 19200", "baud = 9600", "gauge"),
}


@pytest.fixture(scope="module", params=SILENT)
def silent(request, serving, tmp_path_factory):
    """What a sweep says of a device that does not answer, and the device's name."""
    right, wrong, device = SILENT[request.param]
    lines = refusal_of(serving[0].replace(right, wrong, 1), tmp_path_factory.mktemp("silent"))
    (line,) = [line for line in lines if f" {device} (" in line]  # one a device; a wrong baud rate silences every one
    return line, device


@pytest.mark.long
def test_a_silent_device_is_told_in_one_line(silent):
    line, _ = silent
    assert "nothing within 0.3 s" in line


@pytest.mark.long
def test_a_silent_device_is_named(silent):
    line, device = silent
    assert device in line


def test_a_device_that_answers_as_another_is_told_with_what_was_expected(served, tmp_path):
    (line,) = refusal_of(served.replace('"edge_counter_60"', '"edge_counter_20"'), tmp_path)
    assert "tach: the counter is set to 60 teeth" in line
    assert "its file says 20 teeth" in line


def test_a_place_where_no_run_can_be_made_is_told_in_one_line(served, tmp_path):
    (tmp_path / "logs").write_text("a file")
    path = tmp_path / "hardware.toml"
    path.write_text(served)
    result = run("sweep", path, "--logs", tmp_path / "logs", *DAY)
    assert result.returncode == 2
    (line,) = told(result)
    assert "a file, where the folder of runs is to be; name another with --logs" in line


def test_every_mistake_of_a_bench_file_is_told_at_once_before_anything_is_opened(bench, tmp_path, spinbench_anywhere):
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(bench.read_text().replace("dwell_s = 2.0", "dwel_s = 2.0").replace('order = "up"', "order = 3"))
    result = spinbench_anywhere("sweep", wrong, "--logs", tmp_path / "logs", *DAY, cwd=FOLDER)
    assert result.returncode == 2
    lines = told(result)
    assert len(lines) == 2
    assert any("'sweep.dwel_s'; did you mean 'dwell_s'?" in line for line in lines)
    assert not (tmp_path / "logs").exists()


# The bench of one person.


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory):
    text = re.sub(r"(?m)^levels_bar_abs = .*$", "levels_bar_abs = [1.24, 1.34]", (FOLDER / "manual.toml").read_text())
    path = tmp_path_factory.mktemp("by_hand") / "hand.toml"
    path.write_text(text.replace("dwell_s = 10.0", "dwell_s = 0.3").replace('order = "up-down"', 'order = "up"'))
    return path


def at_terminal(arguments, script):
    """Run a command at a pty: what is waited for on the screen, and what is then typed, or the signal sent.

    What was on the screen and the exit code; None when the command did not end by itself.
    """
    master, slave = pty.openpty()
    settings = termios.tcgetattr(slave)
    settings[3] &= ~termios.ECHO
    termios.tcsetattr(slave, termios.TCSANOW, settings)
    process = subprocess.Popen(
        [*PROGRAM, *map(str, arguments)], stdin=slave, stdout=slave, stderr=slave, start_new_session=True
    )
    os.close(slave)
    screen, at = "", 0
    steps = list(script)
    end_s = time.monotonic() + 30.0
    try:
        while time.monotonic() < end_s:
            if select.select([master], [], [], 0.05)[0]:
                try:
                    screen += os.read(master, 65536).decode(errors="replace")
                except OSError:  # the other end is closed
                    break
            while steps and (found := screen.find(steps[0][0], at)) >= 0:
                words, action = steps.pop(0)
                at = found + len(words)
                if isinstance(action, str):
                    os.write(master, f"{action}\n".encode())
                else:
                    process.send_signal(action)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        return screen, process.poll()
    finally:
        process.kill()
        process.wait()
        os.close(master)


def test_a_sweep_by_hand_is_walked_through_at_a_terminal(by_hand, tmp_path):
    entry = "separated by spaces: "
    script = [
        (entry, "1.01 <10 0"),
        ("set 1.240 bar abs", "1.24 14 78"),
        ("pressure now?", "1.25"),
        ("set 1.340 bar abs", ""),
        (entry, "1,34 22 120"),
        ("a comma", "1.34 22 120"),
        ("pressure now?", ""),
        ("closed, and the line vented?", "y"),
        (entry, "1.01 <10 0"),
    ]
    screen, code = at_terminal(["sweep", by_hand, "--no-page", "--logs", tmp_path / "logs", *ROOM, *DAY], script)
    assert code == 0, screen
    found = read_run(only_run(tmp_path / "logs"))
    assert (found.start.kind, found.end.outcome, found.end.vented) == ("manual", "finished", True)
    assert [row.means["pressure_bar_abs"].mean for row in found.plateaus] == pytest.approx([1.245, 1.34])
    assert [row.means["speed_rpm"].mean for row in found.plateaus] == [78.0, 120.0]
    assert set(found.samples["quality"]) == {"manual"}


def test_a_room_that_is_put_right_is_that_of_the_limits_from_then_on(tmp_path):
    text = (FOLDER / "manual.toml").read_text().replace("manual_bench", "manual_bench_gauge", 1)
    text = text.replace("person.pressure_bar_abs", "person.pressure_bar_gauge")
    text = text.replace("highest_pressure_bar_abs = 3.0", "highest_pressure_bar_abs = 1.45")
    (tmp_path / "hand.toml").write_text(re.sub(r"(?m)^levels_bar_abs = .*$", "levels_bar_abs = [1.15]", text))
    entry = "separated by spaces: "
    right = [("Ambient pressure", "1013"), ("Room temp", ""), ("humidity", ""), ("Minutes", ""), ("Lubrication", "")]
    script = [
        (entry, "0 <10 0"),
        ("set 1.150", "room"),
        *right,
        (entry, "0.45 22 78"),
        ("beyond the bench's limit", "0.45 22 78"),
        ("*** pressure 1.463 bar abs", ""),
        ("closed, and the line vented?", "y"),
    ]
    room = ["0.95" if word == "1.013" else word for word in ROOM]
    arguments = ["sweep", tmp_path / "hand.toml", "--no-page", "--logs", tmp_path / "logs", *room, *DAY]
    screen, code = at_terminal(arguments, script)
    assert code == 4, screen
    assert read_run(only_run(tmp_path / "logs")).end.outcome == "aborted"


def test_a_sweep_by_hand_that_is_stopped_counts_as_unvented_until_the_person_says_otherwise(by_hand, tmp_path):
    script = [("separated by spaces: ", "1.01 <10 0"), ("set 1.240", signal.SIGINT), ("line vented?", signal.SIGINT)]
    screen, code = at_terminal(["sweep", by_hand, "--no-page", "--logs", tmp_path / "logs", *ROOM, *DAY], script)
    assert code == 4, screen
    assert "Traceback" not in screen
    assert "close the supply" in screen
    end = read_run(only_run(tmp_path / "logs")).end
    assert (end.outcome, end.vented) == ("aborted", False)


def test_ctrl_c_at_a_question_about_the_room_ends_the_command_in_words(by_hand, tmp_path):
    script = [("Ambient pressure", signal.SIGINT)]
    screen, code = at_terminal(["sweep", by_hand, "--no-page", "--logs", tmp_path / "logs", *DAY], script)
    assert code not in (None, 0)
    assert "Traceback" not in screen
    assert not (tmp_path / "logs").exists()


BY_HAND = [
    ("Ambient pressure", "1013"),
    ("Room temperature", "20"),
    ("Relative humidity", "50"),
    ("separated by spaces: ", "1.01 <10 0"),
    ("set 1.240 bar abs", "1.24 14 78"),
    ("pressure now?", "1.25"),
    ("set 1.340 bar abs", "skip"),
    ("closed, and the line vented?", "y"),
    ("separated by spaces: ", "1.01 <10 0"),
]


@pytest.mark.long
@pytest.mark.parametrize(
    ("answers", "pressure_bar_abs", "temperature_c"),
    [
        ([("as at the start", "1014"), ("as at the start", "21"), ("as at the start", "")], 1.014, 21.0),
        ([("as at the start", "1014"), ("as at the start", signal.SIGINT)], 1.013, 20.0),
        ([("as at the start", "\x04")], 1.013, 20.0),
        ([("as at the start", "x")] * 5, 1.013, 20.0),
    ],
    ids=["answered", "Ctrl-C", "end of input", "five times unusable"],
)
def test_a_room_that_was_asked_for_is_asked_for_again_and_the_run_is_sealed_whatever_the_answer(
    by_hand, tmp_path, answers, pressure_bar_abs, temperature_c
):
    screen, code = at_terminal(["sweep", by_hand, "--no-page", "--logs", tmp_path / "logs", *DAY], [*BY_HAND, *answers])
    assert code == 0, screen
    assert "Traceback" not in screen
    found = read_run(only_run(tmp_path / "logs"))
    assert (found.state, found.end.vented, len(found.plateaus)) == ("finished", True, 1)
    room = found.end.ambient_end
    assert (room.pressure_bar_abs, room.temperature_c) == pytest.approx((pressure_bar_abs, temperature_c))


def test_ctrl_c_at_the_last_question_of_a_bench_with_a_regulator_seals_the_run(bench, tmp_path):
    path = tmp_path / "asked.toml"
    text = re.sub(r"(?m)^(pressure_bar_abs = 1|temperature_c|relative_humidity).*$", "", bench.read_text())
    path.write_text(text.replace(f"[{LOW}, {HIGH}]", f"[{LOW}]"))
    begin = [("Ambient pressure", "1013"), ("Room temperature", "20"), ("Relative humidity", "50")]
    script = [*begin, ("as at the start", "1014"), ("as at the start", signal.SIGINT)]
    screen, code = at_terminal(["sweep", path, "--no-check", "--no-page", "--logs", tmp_path / "logs", *DAY], script)
    assert code == 0, screen
    end = read_run(only_run(tmp_path / "logs")).end
    assert (end.outcome, end.vented, end.ambient_end.pressure_bar_abs) == ("finished", True, pytest.approx(1.013))


# A sheet that was filled in on paper.


@pytest.fixture(scope="module")
def sheet(by_hand, tmp_path_factory, spinbench_anywhere):
    """The text of a printed sheet."""
    path = tmp_path_factory.mktemp("sheet") / "sheet.csv"
    assert spinbench_anywhere("sheet", by_hand, "-o", path, cwd=FOLDER).returncode == 0
    return path.read_text()


def filled(sheet, path, entries):
    rows = list(csv.reader(sheet.splitlines()))
    assert [row[1] for row in rows[1:]] == ["zero", "1.24", "1.34", "zero"]
    for row, (when, *cells) in zip(rows[1:], entries, strict=True):
        row[0], row[3 : 3 + len(cells)] = when, cells
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return path


def test_a_filled_in_sheet_becomes_a_sealed_run(by_hand, sheet, tmp_path, spinbench_anywhere):
    path = filled(
        sheet,
        tmp_path / "sheet.csv",
        [
            ("14:00", "1.01", "<10", "0"),
            ("14:05", "1.24", "14", "78", "1.25", "=note"),
            ("14:08", "1.34", "22", "120"),
            ("14:12", "1.01", "<10", "0"),
        ],
    )
    who = ["--motor-serial", "A-17", "--date", "2026-05-28"]
    result = spinbench_anywhere(
        "sheet", by_hand, "--enter", path, "--logs", tmp_path / "logs", *ROOM, *DAY, *who, cwd=FOLDER
    )
    assert result.returncode == 0, result.stderr
    folder = only_run(tmp_path / "logs")
    origin = recording_of(read_run(folder)).recording.origin
    assert (origin["date"], origin["motor_serial"]) == ("2026-05-28", "A-17")
    found = read_run(folder)
    assert verify(folder) == []
    assert [row.start_s for row in found.plateaus] == [300.0, 480.0]
    assert [row.means["flow_l_min"].mean for row in found.plateaus] == [14.0, 22.0]
    assert ",'=note" in (folder / "plateaus.csv").read_text()


def test_every_mistake_on_a_sheet_is_told_with_its_row_and_there_is_no_run(
    by_hand, sheet, tmp_path, spinbench_anywhere
):
    path = filled(
        sheet,
        tmp_path / "sheet.csv",
        [
            ("14:00", "1.01", "3", "0"),
            ("13:00", "1.24", "14", "78"),
            ("14:08", "1.34", "22,5", "120"),
            ("14:12", "1.01", "<10", "0"),
        ],
    )
    result = spinbench_anywhere("sheet", by_hand, "--enter", path, "--logs", tmp_path / "logs", *ROOM, *DAY, cwd=FOLDER)
    assert result.returncode == 2
    assert [line.removeprefix(f"spinbench: {path}: ")[:6] for line in told(result)] == ["row 1:", "row 3:"]
    assert not (tmp_path / "logs").exists()


def test_a_quotation_mark_that_is_not_closed_swallows_no_rows_of_a_sheet(by_hand, sheet, tmp_path, spinbench_anywhere):
    readings = [("14:00", "1.01", "<10", "0"), ("14:05", "1.24", "14", "78"), ("14:08", "1.34", "22", "120")]
    path = filled(sheet, tmp_path / "sheet.csv", [*readings, ("14:12", "1.01", "<10", "0")])
    row = path.read_text().splitlines()[2]
    path.write_text(path.read_text().replace(row, row[: row.rindex(",")] + ',"loose belt'))
    result = spinbench_anywhere("sheet", by_hand, "--enter", path, "--logs", tmp_path / "logs", *ROOM, *DAY, cwd=FOLDER)
    assert result.returncode == 2
    assert all(str(path) in line and "quotation mark" in line for line in told(result))
    assert not (tmp_path / "logs").exists()


def test_a_sheet_is_not_held_against_a_model_that_its_few_readings_cannot_drive(
    by_hand, sheet, tmp_path, spinbench_anywhere
):
    blank = [("", ""), ("", "")]
    path = filled(sheet, tmp_path / "sheet.csv", [("14:00", "1.01", "<10", "0"), *blank, ("", "")])
    words = ("--enter", path, "--logs", tmp_path / "logs", *ROOM, *DAY)
    assert spinbench_anywhere("sheet", by_hand, *words, cwd=FOLDER).returncode == 0
    result = spinbench_anywhere("replay", "last", "--with-model", "--logs", tmp_path / "logs", cwd=FOLDER)
    assert result.returncode == 2
    assert "the pressure was read 1 times" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.long
def test_a_vented_zero_is_held_against_the_model_by_its_speed_alone(bench, tmp_path, spinbench_anywhere):
    taken = run("capture", bench, "--kind", "zero", "--logs", tmp_path / "logs", *DAY)
    assert taken.returncode == 0, taken.stderr
    words = ("--with-model", "--logs", tmp_path / "logs", "-o", tmp_path / "out")
    result = spinbench_anywhere("replay", "last", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "speed" in result.stdout and "flow" not in result.stdout
    assert (tmp_path / "out" / "replay.png").is_file()


@pytest.mark.long
def test_a_bench_without_a_flow_meter_is_swept_exported_and_compared_with_the_model(
    bench, tmp_path, spinbench_anywhere
):
    text = re.sub(r"(?ms)^\[(devices\.flowmeter|lines\.net)\].*?(?=^\[)", "", bench.read_text())
    path = tmp_path / "no_meter.toml"
    path.write_text(re.sub(r"(?m)^flow = .*\n", "", text))
    logs = ("--logs", tmp_path / "logs")
    swept = run("sweep", path, "--no-page", *logs, *DAY)
    assert swept.returncode == 0, swept.stderr
    exported = spinbench_anywhere("runs", "export", "last", *logs, "-o", tmp_path / "recording", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    read = read_recording(tmp_path / "recording")
    assert "flow_l_min" not in read.channels
    assert min(read.files[0].columns["speed_rpm"].values) > 100.0
    words = ("--with-model", *logs, "-o", tmp_path / "out")
    compared = spinbench_anywhere("replay", "last", *words, cwd=tmp_path)
    assert compared.returncode == 0, compared.stderr
    assert "speed" in compared.stdout and "flow" not in compared.stdout


@pytest.mark.long
def test_plateaus_at_one_level_and_a_flywheel_of_the_command_line_are_in_the_recording(
    bench, tmp_path, spinbench_anywhere
):
    """The flywheel turns on the virtual shaft too: a run in time with it takes longer."""
    logs = ("--logs", tmp_path / "logs", *DAY)
    taken = run("capture", bench, "--kind", "plateaus", "--level-bar-abs", "1.25", "--plateaus", "3", *logs)
    assert taken.returncode == 0, taken.stderr
    exported = spinbench_anywhere("runs", "export", "last", *logs[:2], "-o", tmp_path / "plateaus", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    rows = list(csv.DictReader((tmp_path / "plateaus" / "sweep.csv").read_text().splitlines()))
    assert [float(row["pressure_bar_abs"]) for row in rows][-3:] == pytest.approx([1.25] * 3, abs=0.01)
    assert all(float(row["speed_rpm"]) > 10.0 for row in rows)
    asked = ("capture", bench, "--kind", "coast-down", "--level-bar-abs", "1.5", "--added-inertia-kg-m2")
    assert run(*asked, "0.05", *logs).returncode == 0
    exported = spinbench_anywhere("runs", "export", "last", *logs[:2], "-o", tmp_path / "heavy", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    assert "added_inertia_kg_m2 = 0.05\n" in (tmp_path / "heavy" / "recording.toml").read_text()
    coasted = list(csv.DictReader((tmp_path / "heavy" / "coast_down.csv").read_text().splitlines()))
    turning = [
        float(row["time_s"]) for row in coasted if row["supply_open"] == "0" and float(row["speed_rpm"] or 0) > 9
    ]
    assert max(turning) - min(turning) > 0.8  # 0.15 s without it
    refused = spinbench_anywhere(*asked, "-1", "--logs", tmp_path / "none", *DAY, cwd=tmp_path)
    assert refused.returncode == 2
    assert "added_inertia_kg_m2" in refused.stderr and "Traceback" not in refused.stderr
    assert not (tmp_path / "none").exists()


@pytest.mark.long
def test_a_log_that_cannot_be_written_ends_with_what_is_known_of_the_line(bench, tmp_path):
    """The kernel's limit on a file's size stands in for a full disk."""
    limit = 60_000
    program = (
        f"import resource, spinbench; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit})); spinbench.main()"
    )
    result = subprocess.run(
        [
            sys.executable,
            "-c",
            program,
            "sweep",
            str(bench),
            "--no-check",
            "--no-page",
            "--logs",
            str(tmp_path / "logs"),
            *DAY,
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        cwd=Path(__file__).resolve().parents[2],
    )
    assert result.returncode == 4, result.stderr
    assert "the run log cannot be written" in result.stderr
    assert "NOT known to be without pressure: close the supply; the regulator reads back zero" in result.stderr
    end = read_run(only_run(tmp_path / "logs")).end
    assert (end.outcome, end.vented) == ("failed", False)
    assert end.reason.count("File too large") == 1


def test_all_mistakes_that_a_bench_file_makes_with_its_instruments_are_told(bench, tmp_path, spinbench_anywhere):
    path = tmp_path / "two.toml"
    text = re.sub(r"(?m)^unit_id = .*$", "", bench.read_text(), count=1)
    path.write_text(re.sub(r"(?m)^channel = .*$", "", text, count=1))
    result = spinbench_anywhere("doctor", path, cwd=FOLDER)
    assert result.returncode == 2
    lines = told(result)
    assert len(lines) == 2
    assert all(str(path) in line for line in lines)


def test_a_folder_called_as_a_bench_does_not_hide_it(tmp_path, monkeypatch):
    (tmp_path / "virtual").mkdir()
    monkeypatch.chdir(tmp_path)
    assert bench_path(Path("virtual")) == FOLDER / "virtual.toml"
