"""`spinbench` alone: what can be done next, given what lies in the logs folder."""

import shlex
from pathlib import Path

import pytest

from rig.runlog import RunWriter
from spinbench.next_steps import next_steps, show_command
from tests.synthetic_runs import start_of, write_sweep


def commands(logs: Path) -> list[str]:
    return [command for _, command in next_steps(logs)[1]]


def test_without_runs_it_begins_with_a_bench_that_is_not_there(tmp_path, spinbench_here):
    told = spinbench_here(cwd=tmp_path)
    assert told.returncode == 0
    assert "There are no runs here yet." in told.stdout
    assert "spinbench sweep virtual" in told.stdout
    assert not (tmp_path / "logs").exists()


def test_after_a_sweep_it_asks_for_a_diagnosis(tmp_path, spinbench_here):
    run = write_sweep(tmp_path / "logs")
    told = spinbench_here(cwd=tmp_path).stdout
    assert f"{run.name}: finished" in told
    assert told.index("spinbench diagnose last") < told.index("spinbench fit last")


def test_a_run_that_is_being_written_is_watched(tmp_path):
    with RunWriter.create(tmp_path, start_of()):
        assert commands(tmp_path)[0] == "spinbench console virtual"


@pytest.mark.parametrize(("seal", "first"), [(False, "spinbench runs repair last"), (True, "spinbench diagnose last")])
def test_a_killed_run_is_sealed_first(tmp_path, seal, first):
    write_sweep(tmp_path, seal=seal)
    assert commands(tmp_path)[0].startswith(first)


@pytest.mark.parametrize("parent", ["a_sweep", None])
def test_a_capture_is_fitted_with_what_it_was_taken_after_and_not_alone(tmp_path, parent):
    with RunWriter.create(tmp_path, start_of("coast-down", parent=parent), wire=False) as writer:
        writer.end("finished")
    words = [command for command in commands(tmp_path) if "diagnose" in command or "fit" in command]
    asked = [
        f"spinbench {name} last --with-parents -o out/{to}" for name, to in (("diagnose", "diagnosis"), ("fit",) * 2)
    ]
    assert words == (asked if parent else [])
    assert not any("replay" in command for command in commands(tmp_path))  # its bytes were not kept


def test_a_stopped_sweep_is_looked_at_and_gone_on_with(tmp_path):
    with RunWriter.create(tmp_path, start_of()) as writer:
        writer.end("aborted", "stopped by the operator", vented=True, stopped_by="operator")
    assert commands(tmp_path)[:2] == ["spinbench runs show last", "spinbench sweep BENCH --continue last"]


def test_a_run_whose_name_begins_like_an_option_is_shown_by_the_command_that_is_named(tmp_path, spinbench_here):
    run = write_sweep(tmp_path / "runs")
    words = shlex.split(show_command(run.rename(run.parent / "-may")))
    shown = spinbench_here(*words[1:], cwd=tmp_path)
    assert (shown.returncode, shown.stdout.partition(":")[0]) == (0, "-may")
