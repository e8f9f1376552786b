"""`sweep` and `capture` as a person types them: what is refused, and what is said when the run is over."""

import contextlib
import importlib
import shlex
from pathlib import Path

import pytest

from rig.bench.bench import read_bench
from rig.plateaus.plan import Step
from rig.plateaus.plateau import Mean, Plateau
from rig.run import running
from rig.sweep.runner import Outcome
from rig.virtual.launch import VirtualBenchError
from spinbench.cli import sweep
from tests.synthetic_runs import write_sweep

HUNGRY = "a virtual bench at 20 times real time needs a machine that has time for it: try a lower --rate"


def plateau(number, settled):
    means = {"pressure": Mean(2.0, 0.001, 30), "speed": Mean(400.0, 0.1, 30)}
    return Plateau(number, Step(2.0, "up", 1), 0, 1, settled, means)


@pytest.fixture
def ending(monkeypatch):
    """Lets a run end in a way without being taken."""

    def end(outcome, *plateaus):
        ended = Outcome(outcome, "", True, list(plateaus), [])
        monkeypatch.setattr(running, "take", lambda place, given, course, wanted: (Path("the_run"), ended))

    return end


def test_a_fast_run_that_lost_plateaus_is_told_to_go_slower(ending, spinbench_here, tmp_path):
    words = ("sweep", "virtual", "--rate", "20", "--no-page", "--no-check")
    ending("finished", plateau(1, True), plateau(2, False))
    lost = spinbench_here(*words, cwd=tmp_path)
    assert (lost.returncode, HUNGRY in lost.stderr) == (0, True)
    ending("finished", plateau(1, True), plateau(2, True))
    assert HUNGRY not in spinbench_here(*words, cwd=tmp_path).stderr


def test_the_command_that_goes_on_keeps_the_switches(ending, spinbench_here, tmp_path):
    ending("aborted")
    result = spinbench_here("sweep", "virtual", "--no-page", "--no-check", "--no-wire", cwd=tmp_path)
    (line,) = [line for line in result.stdout.splitlines() if line.startswith("go on with: ")]
    words = shlex.split(line.removeprefix("go on with: "))
    assert result.returncode == 4
    assert words[:5] == ["spinbench", "sweep", "virtual", "--continue", "the_run"]
    assert set(words[5:]) == {"--no-page", "--no-check", "--no-wire"}


def test_a_sweep_of_another_motor_is_not_gone_on_with(spinbench_here, tmp_path):
    bench = read_bench("virtual")
    changes = {"bench": "virtual", "sweep": bench.file.sweep.model_dump(), "motor_serial": "A-17"}
    run = write_sweep(tmp_path / "logs", captures=False, **changes)
    result = spinbench_here("sweep", "virtual", "--continue", "last", "--motor-serial", "B-2", cwd=tmp_path)
    assert result.returncode == 2
    assert f"{run.name} is of the motor ptm3600 no. A-17, not of the motor ptm3600 no. B-2" in result.stderr
    assert list((tmp_path / "logs").iterdir()) == [run]


def test_a_sweep_goes_on_from_a_run_in_its_own_folder(spinbench_here, tmp_path):
    run = write_sweep(tmp_path / "elsewhere", captures=False)
    result = spinbench_here("sweep", "virtual", "--continue", run, cwd=tmp_path)
    assert result.returncode == 2
    said = " ".join(result.stderr.replace("│", " ").split())
    assert "it is not in logs, where this run is kept; say --logs" in said
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize(
    ("kind", "option", "words"),
    [
        ("coast-down", "--plateaus=7", "--plateaus belongs to --kind plateaus; a coast-down has none"),
        ("spin-up", "--plateaus=10", "--plateaus belongs to --kind plateaus; a spin-up has none"),
        ("zero", "--plateaus=3", "--plateaus belongs to --kind plateaus; a zero has none"),
        ("zero", "--level-bar-abs=2.5", "--level-bar-abs: a zero is taken with the line vented"),
    ],
)
def test_an_option_of_another_kind_of_capture_is_refused(spinbench_here, tmp_path, kind, option, words):
    result = spinbench_here("capture", "virtual", "--kind", kind, option, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert words in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_what_takes_long_before_a_run_is_shown_while_it_is_done(monkeypatch, tmp_path, spinbench_here):
    shown = []

    @contextlib.contextmanager
    def waiting(words):
        shown.append(words)
        yield

    def no_bench(*arguments, **more):
        assert shown == ["reading virtual", "starting the virtual bench"]
        raise VirtualBenchError("it is not there")

    monkeypatch.setattr(sweep, "waiting", waiting)
    monkeypatch.setattr(importlib.import_module("rig.virtual.launch"), "launch", no_bench)
    result = spinbench_here("sweep", "virtual", "--minutes-running", "0", "--lubrication", "none", cwd=tmp_path)
    assert (result.returncode, result.stderr) == (2, "spinbench: it is not there\n")
