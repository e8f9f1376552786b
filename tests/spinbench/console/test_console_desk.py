"""The console's own state: what became of a start, which run is shown, and what a person is told to type."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from rig.bench.bench import bench_path, read_bench
from rig.runlog import RunWriter
from spinbench.console import sweeps
from spinbench.console.access import RefusedError
from spinbench.console.desk import Desk, Showing
from spinbench.console.planned import Planned
from spinbench.console.stopping import being_written
from spinbench.next_steps import next_steps
from tests.console_lab import short_bench
from tests.synthetic_runs import made_with, start_of, write_sweep
from tests.waiting import wait_for

SWEEP = Planned("sweep")


@pytest.fixture
def desk(tmp_path):
    path = short_bench(tmp_path)
    return Desk(path, read_bench(path), tmp_path / "logs")


def refused(desk):
    """Start what cannot begin; what is told of it."""
    desk.sweeps.start(SWEEP, {"minutes_running": "soon"})
    return wait_for(lambda: desk.console("w")["start_failed"], "the refusal of a start")


@pytest.fixture
def held_starts(monkeypatch):
    """Starts a program that does nothing in place of a sweep; gives what is said when it is about to start."""
    told, made, begin = [], [], subprocess.Popen

    def hold(ask=lambda: None):
        def popen(command, **options):
            told.append(ask())
            made.append(begin(["sleep", "600"], **options))
            return made[-1]

        monkeypatch.setattr(sweeps.subprocess, "Popen", popen)
        return told

    yield hold
    for process in made:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_refusal_belongs_to_one_start_and_the_next_one_takes_it_back(desk, held_starts):
    first = refused(desk)
    again = refused(desk)
    assert first["text"] == again["text"]
    assert first["start"] != again["start"]  # the page tells it once more
    told = held_starts(desk.sweeps.failed)
    desk.sweeps.start(SWEEP, {})
    assert told == [None]  # while it begins
    assert desk.console("w")["start_failed"] is None


@pytest.mark.slow
def test_a_refusal_is_not_told_of_a_run_that_another_program_writes(desk):
    refused(desk)
    with RunWriter.create(desk.logs, start_of()):
        desk.follow()
        assert desk.console("w")["start_failed"] is None


def test_a_sweep_is_being_started_until_its_run_is_there_and_not_again_after_its_end(desk, held_starts):
    held_starts()
    desk.sweeps.start(SWEEP, {})
    assert desk.console("w")["starting"]
    with RunWriter.create(desk.logs, start_of()) as writer:
        writer.end("aborted", "stopped by the operator", vented=True, stopped_by="operator")
    assert not desk.console("w")["starting"]
    assert not desk.console("w")["running"]  # its page is all that its program still makes


def test_stop_after_the_end_of_a_run_does_not_say_that_the_regulator_was_never_raised(desk, held_starts):
    held_starts()
    desk.sweeps.start(SWEEP, {})
    with RunWriter.create(desk.logs, start_of()) as writer:
        writer.end("finished", vented=True)
    assert desk.stop("a test")["word"] == "NOT DELIVERED"


def test_the_run_shown_is_the_newest_of_a_bench_and_never_an_import_by_itself(desk):
    imported = start_of("coast-down", imported={"title": "a table"}), start_of("import")
    for start in imported:
        with RunWriter.create(desk.logs, start) as writer:
            writer.end("finished")
    desk.follow()
    assert desk.showing is None
    with RunWriter.create(desk.logs, start_of("coast-down")) as writer:
        writer.end("finished", vented=True)
    with RunWriter.create(desk.logs, start_of("import")) as later:  # its name sorts after the others'
        later.end("finished")
    assert later.folder.name > writer.folder.name
    wait_for(lambda: desk.follow() or desk.showing, "the run of the bench")
    assert desk.showing.tail.folder == writer.folder
    offered = {row["name"]: row["imported"] for row in desk.runs()}
    assert [offered[one.folder.name] for one in (writer, later)] == [False, True]


def test_runs_that_were_renamed_do_not_hide_the_one_that_goes_on(desk):
    """STOP finds it too."""
    with RunWriter.create(desk.logs, start_of(utc_start="2026-05-27T09:00:00Z")) as writer:
        writer.end("finished", vented=True)
    for n in range(60):
        shutil.copytree(writer.folder, desk.logs / f"seal_test_{n}")
    with RunWriter.create(desk.logs, start_of()) as going_on:
        desk.follow()
        assert desk.showing.tail.folder == going_on.folder
        assert [row["name"] for row in desk.runs()][:2] == [going_on.name, "seal_test_9"]
        assert being_written(desk.logs) == [going_on.folder]


def test_a_run_whose_clock_was_set_back_is_stopped_and_bars_another_start(desk, held_starts, monkeypatch):
    """A computer without a battery begins in 1970; STOP, and the one run at a time, are about what is written now."""
    with RunWriter.create(desk.logs, start_of()) as writer:
        writer.end("finished", vented=True)
    for n in range(50):
        shutil.copytree(writer.folder, desk.logs / f"sealed_{n}")
    held_starts()
    desk.sweeps.start(SWEEP, {})
    told = []
    monkeypatch.setattr("spinbench.console.stopping.ask_to_stop", lambda pid: told.append(pid) or "")
    with RunWriter.create(desk.logs, start_of(utc_start="1971-01-01T00:00:00Z")) as going_on:
        assert not desk.console("w")["starting"]
        assert (desk.stop("a test")["word"], told) == ("asked", [os.getpid()])
        with pytest.raises(RefusedError, match="a run is going on"):
            Desk(desk.sweeps.path, desk.bench, desk.logs).sweeps.start(SWEEP, {})
        going_on.end("aborted", "stopped by the operator", vented=True, stopped_by="operator")
    assert not desk.console("w")["running"]
    assert "No run is being written" in desk.stop("a test")["text"]  # and not that its regulator was never raised


def test_stop_reaches_a_run_that_begins_while_it_is_looked_for(desk, held_starts, monkeypatch):
    held_starts()
    desk.sweeps.start(SWEEP, {})
    begun = []

    def begins(logs):
        open_ones = being_written(logs)
        begun.append(RunWriter.create(logs, start_of()))
        return open_ones

    monkeypatch.setattr("spinbench.console.stopping.being_written", begins)
    word = desk.stop("a test")["word"]
    begun[0].close()
    assert word == "DELIVERED"
    wait_for(lambda: not desk.sweeps.running, "the end of the program that was started")


def test_figures_of_a_replay_are_marked_as_past(tmp_path):
    replay = Showing(write_sweep(tmp_path), replay=1e5)
    replay.follow()
    figure = replay.facts(0.0, [])["figures"][0]
    assert (figure["mark"], figure["quality"][:9]) == ("past", "replayed:")


def test_what_is_to_be_typed_after_a_stop_names_the_bench_file_that_the_console_was_given(desk):
    with RunWriter.create(desk.logs, start_of(**made_with(desk.sweeps.path))) as writer:
        writer.end("aborted", "stopped by the operator", vented=True, stopped_by="operator")
    desk.follow()
    (alarm,) = desk.facts(desk.showing, 0.0)["alarms"]
    assert f"spinbench sweep {desk.sweeps.path} --continue {writer.folder.name}" in alarm["guidance"]


@pytest.mark.slow
def test_a_refusal_is_a_sentence_without_the_usage_of_the_command(desk):
    text = refused(desk)["text"]
    assert text.startswith("Invalid value for '--minutes-running': ")
    assert not set("│╭─╰\n") & set(text) and "Error: " not in text
    assert "Usage" not in text
    desk.sweeps.start(SWEEP, {"relative_humidity": "3"})
    told = wait_for(lambda: desk.console("w")["start_failed"], "the refusal of a start")["text"]
    assert told == "--relative-humidity 3: expected 0 to 1; 3 % is 0.03"


def test_the_page_is_told_the_range_of_every_number_that_it_asks_for(desk):
    assert desk.console("w")["bench"]["ranges"] == {
        "minutes_running": (0.0, 1440.0),
        "ambient_pressure_bar_abs": (0.5, 1.2),
        "ambient_temperature_c": (-20.0, 60.0),
        "relative_humidity": (0.0, 1.0),
    }


def test_every_file_that_the_next_steps_name_is_there_outside_a_checkout_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    steps = [command.split() for _, command in next_steps(tmp_path)[1]]
    benches = [words[2] for words in steps if words[1] in ("sweep", "doctor", "console")]
    assert len(benches) == 3
    assert all(bench_path(Path(bench)).is_file() for bench in benches)
