"""The console's own state: what became of a start, which run is shown, and what a person is told to type."""

import subprocess

import pytest

from rig.bench.bench import read_bench
from rig.runlog import RunWriter
from spinbench.console import sweeps
from spinbench.console.desk import Desk
from tests.console_lab import short_bench, wait_for
from tests.synthetic_runs import start_of


@pytest.fixture
def desk(tmp_path):
    path = short_bench(tmp_path)
    return Desk(path, read_bench(path), tmp_path / "logs")


def refused(desk):
    """Start what cannot begin; what is told of it."""
    desk.sweeps.start({"minutes_running": "soon"})
    return wait_for(lambda: desk.console("w")["start_failed"], "the refusal of a start")


@pytest.fixture
def held_starts(monkeypatch):
    """Starts a program that does nothing in place of a sweep; gives what is to be asked when it is about to start."""
    asked, begin = [], subprocess.Popen
    made = []

    def popen(command, **options):
        made.append([ask() for ask in asked])
        return begin(["sleep", "600"], **options)

    def hold(*asks):
        asked[:] = asks
        monkeypatch.setattr(sweeps.subprocess, "Popen", popen)
        return made

    return hold


def end_of(desk):
    process = desk.sweeps._process
    process.kill()
    process.wait()


@pytest.mark.slow
def test_a_refusal_belongs_to_one_start_and_the_next_one_takes_it_back(desk, held_starts):
    first = refused(desk)
    again = refused(desk)
    assert first["text"] == again["text"]
    assert first["start"] != again["start"]  # the page tells it once more
    told = held_starts(desk.sweeps.failed)
    desk.sweeps.start({})
    assert told == [[None]]  # while it begins
    assert desk.console("w")["start_failed"] is None
    end_of(desk)


@pytest.mark.slow
def test_a_refusal_is_not_told_of_a_run_that_another_program_writes(desk):
    refused(desk)
    with RunWriter.create(desk.logs, start_of()):
        desk.follow()
        assert desk.console("w")["start_failed"] is None


def test_a_sweep_is_being_started_until_its_run_is_there_and_not_again_after_its_end(desk, held_starts):
    held_starts()
    desk.sweeps.start({})
    assert desk.console("w")["starting"]
    with RunWriter.create(desk.logs, start_of()) as writer:
        writer.end("aborted", "stopped by the operator", vented=True, stopped_by="operator")
    assert not desk.console("w")["starting"]
    assert desk.console("w")["running"]
    end_of(desk)


def test_stop_after_the_end_of_a_run_does_not_say_that_the_regulator_was_never_raised(desk, held_starts):
    held_starts()
    desk.sweeps.start({})
    with RunWriter.create(desk.logs, start_of()) as writer:
        writer.end("finished", vented=True)
    assert desk.stop("a test")["word"] == "NOT DELIVERED"
    end_of(desk)
