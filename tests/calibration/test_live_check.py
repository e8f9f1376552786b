"""The check beside a sweep: what it says of plateaus, the process it runs in, and whole sweeps on a virtual bench."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import multiprocessing
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import rig.run.running
from calibration import live_checks as beside
from calibration.diagnosis.live_check import FEWEST, check
from calibration.live_checks import Beside
from rig.bench.bench import FOLDER
from rig.recording import Column, Recording, RecordingFile, read_recording, write_recording
from rig.runlog import read_run, verify
from spinbench.cli import app
from tests.diagnosis_recordings import sweep

pytestmark = pytest.mark.long

PROGRAM = [sys.executable, "-m", "spinbench"]
DAY = ["--lubrication", "none", "--minutes-running", "0"]
ENOUGH_S = 120.0
LEAK = {"leakage": {"conductance_kg_s_pa2": 5e-14}}


def first(recording: Recording, count: int) -> Recording:
    """The sweep after so many plateaus."""
    (file,) = recording.files
    columns = {name: Column(column.values[:count], column.censor[:count]) for name, column in file.columns.items()}
    cut = dataclasses.replace(file, rows=count, columns=columns, direction=file.direction[:count])
    return dataclasses.replace(recording, files=(cut,))


@pytest.fixture(scope="module")
def leaking(tmp_path_factory):
    return sweep(tmp_path_factory.mktemp("leaking"), 3, LEAK)


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    return sweep(tmp_path_factory.mktemp("clean"), 3, {})


# What it says of plateaus.


def test_fewer_than_six_plateaus_are_too_early_to_say(leaking):
    found = check(first(leaking, FEWEST - 1))
    assert (found.p_value, found.places, found.plateaus) == (None, [], 5)
    assert found.sentence.startswith("too early: 5 settled plateaus")
    assert not found.differs


def test_six_plateaus_are_enough_for_a_plain_leak(leaking):
    found = check(first(leaking, FEWEST))
    assert found.differs
    assert found.p_value < 1e-3


def test_a_leak_is_said_to_be_in_the_flow_balance(leaking):
    found = check(first(leaking, 10))
    assert found.places[0].balance == "mass"
    assert found.sentence.startswith("the model does not explain 10 plateaus (p = ")
    assert found.places and "cannot be told" not in found.sentence


def test_plateaus_of_the_model_itself_are_explained(clean):
    found = check(first(clean, 10))
    assert found.p_value > 0.05
    assert found.places == []
    assert found.sentence.startswith("the model explains 10 plateaus")


def test_runs_in_time_are_left_aside(clean):
    (swept,) = clean.files
    columns = {"time_s": Column(np.arange(3.0), np.zeros(3, np.int8))}
    transient = RecordingFile("coast_down.csv", "transient", 0.0, 1.0, 3, columns)  # a diagnosis would refuse it
    both = dataclasses.replace(first(clean, 8), files=(*first(clean, 8).files, transient))
    assert check(both) == check(first(clean, 8))
    assert swept.kind == "steady"


# The process.


@dataclasses.dataclass(frozen=True)
class Taken:
    settled: bool = True


class Heard:
    """What a check wrote as events and told the person."""

    def __init__(self) -> None:
        self.events: list[tuple[str, dict[str, object]]] = []
        self.said: list[str] = []

    def note(self, kind: str, **details: object) -> None:
        json.dumps(details)  # or no run log could hold it
        self.events.append((kind, details))

    def beside(self, folder, read):
        return Beside(folder, read, self.note, self.said.append)

    def wait_for(self, count: int) -> None:
        end_s = time.monotonic() + ENOUGH_S
        while len(self.events) < count:
            assert time.monotonic() < end_s, self.events
            time.sleep(0.01)


def refuse(folder: Path) -> Recording:
    raise ValueError(f"{folder.name} cannot be read")


def die(folder: Path) -> Recording:
    os._exit(3)


def hang(folder: Path) -> Recording:
    (folder / "reached").touch()
    time.sleep(ENOUGH_S)
    raise AssertionError


def plateaus(tell, count: int) -> None:
    for _ in range(count):
        tell(Taken())


def test_a_difference_is_told_of_at_the_second_check_in_a_row_and_not_again(leaking, tmp_path):
    heard = Heard()
    write_recording(first(leaking, 8), tmp_path / "so_far")
    with heard.beside(tmp_path / "so_far", read_recording) as tell:
        plateaus(tell, beside.BEGINS_AT)
        heard.wait_for(1)
        assert heard.said == []
        tell(Taken())
        heard.wait_for(3)
        assert len(heard.said) == 1
        tell(Taken())
        heard.wait_for(4)
    assert [kind for kind, _ in heard.events] == ["model check", "model check", "warning", "model check"]
    assert heard.said[0].startswith("model check, 2 times in a row: the model does not explain 8 plateaus")
    assert re.search(r"The .* error depends on \w+, largest between .* (rpm|L/min|bar|s)[.;]", heard.said[0])
    details = heard.events[0][1]
    assert details["p_value"] < 0.01
    assert {"flow", "speed"} >= {place["channel"] for place in details["places"]} > set()


def test_what_the_check_cannot_read_is_an_event_and_the_next_plateau_is_checked_again(tmp_path):
    heard = Heard()
    with heard.beside(tmp_path, refuse) as tell:
        plateaus(tell, beside.BEGINS_AT)
        heard.wait_for(1)
        tell(Taken())
        heard.wait_for(2)
    assert heard.events == 2 * [("model check failed", {"error": f"ValueError: {tmp_path.name} cannot be read"})]
    assert heard.said == []


def test_a_check_whose_process_dies_is_an_event_and_plateaus_go_on(tmp_path):
    heard = Heard()
    with heard.beside(tmp_path, die) as tell:
        plateaus(tell, beside.BEGINS_AT)
        heard.wait_for(1)
        plateaus(tell, 2)
    assert heard.events == [
        ("model check failed", {"error": "its process has ended; there are no more checks"}),
    ]


def test_a_check_that_hangs_is_ended_with_the_sweep(tmp_path, monkeypatch):
    monkeypatch.setattr(beside, "TELL_AFTER_S", 0.02)
    monkeypatch.setattr(beside, "PATIENCE_S", 0.05)
    heard = Heard()
    with heard.beside(tmp_path, hang) as tell:
        plateaus(tell, beside.BEGINS_AT)
        end_s = time.monotonic() + ENOUGH_S
        while not (tmp_path / "reached").exists():
            assert time.monotonic() < end_s
            time.sleep(0.01)
    assert heard.events == [("model check failed", {"error": "the run ended first"})]
    assert heard.said == ["the last plateaus are held against the model: at most 0.05 s"]
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("taken", [[True] * (beside.BEGINS_AT - 1), [False] * 20])
def test_a_run_of_few_settled_plateaus_starts_no_process(taken, tmp_path):
    heard = Heard()
    with heard.beside(tmp_path, refuse) as tell:
        for settled in taken:
            tell(Taken(settled))
        assert multiprocessing.active_children() == []
    assert heard.events == []


# Whole sweeps, from the command line.


@pytest.mark.parametrize(("option", "wanted"), [([], True), (["--no-check"], False)])
def test_the_check_can_be_switched_off(option, wanted, tmp_path, monkeypatch):
    asked = []

    def take(path, given, plan, what):
        asked.append(what.beside is not rig.run.running.alone)
        raise rig.run.running.RunError("not today")

    monkeypatch.setattr(rig.run.running, "take", take)
    with contextlib.suppress(rig.run.running.RunError):
        CliRunner().invoke(app, ["sweep", "virtual", "--logs", str(tmp_path), *option], catch_exceptions=False)
    assert asked == [wanted]


def swept(folder: Path, truth: str):
    """A sweep over nine levels on the shipped virtual bench, and what the command said."""
    text = (FOLDER / "virtual.toml").read_text()
    for key, value in {
        "levels_bar_abs": "[1.3, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9, 2.0, 2.1]\nzero_s = 1.0",
        "order": '"up"',
        "window_s": "1.5",
        "dwell_s": "2.0",
        "captures": "[]",
        "rate": "10.0",
    }.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    bench = folder / "bench.toml"
    bench.write_text(f"{text}\n[virtual.truth]\n{truth}\n")
    result = subprocess.run(
        [*PROGRAM, "sweep", str(bench), "--no-page", "--logs", str(folder / "logs"), *DAY],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=ENOUGH_S,
        check=False,
        env={**os.environ, "COLUMNS": "1000"},
    )
    assert result.returncode == 0, result.stderr
    (made,) = (folder / "logs").iterdir()
    return result, made


def checks(folder: Path) -> list[dict[str, object]]:
    return [event.details for event in read_run(folder).events if event.event == "model check"]


@pytest.fixture(scope="module")
def on_a_mountain(tmp_path_factory):
    """The room is at 0.88 bar; the bench file says 1.013, as a weather report does, which is reduced to sea level."""
    return swept(tmp_path_factory.mktemp("mountain"), "ambient_pressure = 88000.0")


def test_a_sweep_in_another_room_than_was_said_is_warned_of_while_it_runs(on_a_mountain):
    result, folder = on_a_mountain
    assert result.stderr.count("model check, 2 times in a row: the model does not explain") == 1
    found = [one for one in checks(folder) if one["p_value"] is not None]
    assert len(found) >= 2
    assert any(one["differs"] and other["differs"] for one, other in itertools.pairwise(found))
    assert "model check" in {event.details["text"].partition(",")[0] for event in warnings(folder)}


def warnings(folder: Path):
    return [event for event in read_run(folder).events if event.event == "warning"]


def test_a_run_with_checks_verifies_and_replays_bit_for_bit(on_a_mountain, spinbench_here):
    _, folder = on_a_mountain
    assert checks(folder)
    assert verify(folder) == []
    replay = spinbench_here("replay", "last", "--logs", folder.parent, cwd=folder)
    assert replay.returncode == 0, replay.stderr
    assert "the same, bit for bit" in replay.stdout


def test_a_sweep_of_the_model_s_own_motor_is_checked_in_silence(tmp_path):
    result, folder = swept(tmp_path, "")
    found = [one for one in checks(folder) if one["p_value"] is not None]
    assert found
    assert not any(one["differs"] for one in found)
    assert "model check" not in result.stderr
    assert not any("model check" in event.details["text"] for event in warnings(folder))
