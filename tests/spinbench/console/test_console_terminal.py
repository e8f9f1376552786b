"""The console in the terminal: a pseudo-terminal as ssh gives one, and what a person would see on it."""

import contextlib
import fcntl
import os
import pty
import re
import struct
import subprocess
import termios
import threading

import pytest

from rig.runlog import RunWriter, read_run
from tests.console_lab import PROGRAM, only_run, short_bench
from tests.synthetic_runs import PRESSURE, SPEED, poll, start_of
from tests.waiting import ENOUGH_S, wait_for

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


@contextlib.contextmanager
def terminal(bench, logs):
    """The command on a terminal of 120 by 45; gives a function that types, and one that waits for a text."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 45, 120, 0, 0))
    environment = os.environ | {"TERM": "xterm-256color"}
    command = [*PROGRAM, "console", str(bench), "--terminal", "--logs", str(logs)]
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    said = bytearray()

    def drain():  # as a terminal does, or the program would wait for it
        with contextlib.suppress(OSError):
            while block := os.read(ours, 65536):
                said.extend(block)

    def shows(text):
        def plain():
            return ESCAPES.sub("", said.decode("utf-8", "replace"))

        found = wait_for(lambda: plain() if text in plain() else "", f"'{text}' on the terminal")
        said.clear()
        return found

    threading.Thread(target=drain, daemon=True).start()
    try:
        yield lambda text: os.write(ours, text.encode()), shows, process
    finally:
        process.kill()
        process.wait()


def test_it_shows_figures_the_running_step_and_alarms_and_q_ends_it(tmp_path):
    logs = tmp_path / "logs"
    with (
        RunWriter.create(logs, start_of()) as writer,
        terminal(short_bench(tmp_path), logs) as (types, shows, process),
    ):
        writer.event("course", 0, steps=[[1.25, "up", 1], [1.35, "up", 1]], captures=[])
        writer.event("state", 1, state="dwell", settled=True)
        writer.exchange(poll("gauge", {PRESSURE: 1.2504}, 1_000_000_000))
        writer.exchange(poll("tach", {SPEED: 71.5}, 1_000_000_000))
        writer.event("warning", 2, text="the \x1b[31mgauge drifts")
        told = shows("DWELL")
        for words in ("1.250", "bar abs", "71.5", "rpm", "▶ 1.25↑", "· 1.35↑", "gauge drifts", "what to do"):
            assert words in told or shows(words), words
        types("a")
        shows("0 of 2 plateaus")
        writer.end("aborted", "speed 700 rpm", vented=True, stopped_by="interlock")
        shows("TRIPPED")
        types("q")
        assert process.wait(60.0) == 0


@pytest.mark.slow
@pytest.mark.parametrize("piped", ["stdin", "stdout"])
def test_without_a_terminal_it_is_refused_in_a_line(tmp_path, piped):
    ours, theirs = pty.openpty()
    pipes = {"stdin": subprocess.DEVNULL} if piped == "stdin" else {"stdout": subprocess.DEVNULL}
    command = [*PROGRAM, "console", short_bench(tmp_path), "--terminal", "--logs", tmp_path / "logs"]
    streams = {"stdin": theirs, "stdout": theirs, "stderr": subprocess.PIPE} | pipes
    process = subprocess.Popen(command, **streams, text=True)
    try:
        _, said = process.communicate(timeout=ENOUGH_S)
    finally:
        process.kill()
        os.close(ours)
        os.close(theirs)
    assert process.returncode == 2
    assert said.startswith("spinbench: --terminal needs a terminal")
    assert said.count("\n") == 1


@pytest.mark.long
def test_s_stops_a_sweep_and_the_terminal_says_delivered(tmp_path):
    logs, bench = tmp_path / "logs", short_bench(tmp_path, "[1.25, 1.35]", dwell_s=600.0)
    with (
        subprocess.Popen([*PROGRAM, "sweep", bench, "--logs", logs], stdin=subprocess.DEVNULL) as sweep,
        terminal(bench, logs) as (types, shows, process),
    ):
        shows("DWELL")
        types("s")
        shows("STOP DELIVERED")
        shows("STOPPED")
        assert sweep.wait(ENOUGH_S) == 4
        types("q")
        assert process.wait(60.0) == 0
    folder = only_run(logs)
    wait_for((folder / "end.json").exists, "the run sealed")
    assert read_run(folder).end.stopped_by == "operator"
