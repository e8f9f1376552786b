"""The command of a recommended test, of the bench and the run that it is for."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from calibration.diagnosis.next_test.recommend import NextTest
from calibration.likelihood.expected import Capture
from rig.bench.bench import FOLDER
from rig.runlog import RunWriter
from spinbench import next_steps
from tests.synthetic_runs import made_with, start_of

TEST = NextTest("a coast-down", (("windage",),), 3.0, capture=Capture("coast-down", 1.7, 0.015))
COMMAND = "--kind coast-down --level-bar-abs 1.7 --added-inertia-kg-m2 0.015"


@dataclass
class Told:
    next_tests: list[NextTest] = field(default_factory=lambda: [TEST, replace(TEST, capture=None)])


def commands_of(folder):
    told = next_steps.tests_of_bench(Told(), *next_steps.bench_of(folder))
    return [one.capture and one.capture.command for one in told.next_tests]


@pytest.mark.parametrize("bench", ["virtual", "edited", "lost"])
def test_of_a_run_it_names_the_bench_where_its_file_is_found_and_the_run_and_its_folder(bench, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = tmp_path / f"{bench}.toml" if bench == "lost" else tmp_path / "virtual.toml"
    own.write_text((FOLDER / "virtual.toml").read_text() + "# mine\n" * (bench == "edited"))
    with RunWriter.create(tmp_path / "lo gs", start_of(**made_with(own))) as writer:
        writer.end("finished")
    word = "virtual" if bench == "virtual" else "BENCH"
    run = writer.folder
    assert commands_of(run) == [
        f"spinbench capture {word} {COMMAND} --after {run.name} --logs 'lo gs'",
        None,
    ]


def test_the_folder_of_the_runs_is_named_where_it_is_not_the_usual_one(tmp_path, monkeypatch):
    with RunWriter.create(tmp_path / "logs", start_of(**made_with(FOLDER / "virtual.toml"))) as writer:
        writer.end("finished")
    run = writer.folder.rename(writer.folder.parent / "a run")
    for here, named, option in (
        (tmp_path, run, ""),
        (tmp_path, Path("logs") / run.name, ""),
        (run.parent, Path(run.name), " --logs ."),
        (run, Path(), f" --logs {run.parent}"),
    ):
        monkeypatch.chdir(here)
        assert commands_of(named)[0].endswith(f" --after 'a run'{option}")


def test_of_a_recording_or_an_import_the_bench_is_not_known(tmp_path):
    with RunWriter.create(tmp_path, start_of("import", imported={"title": "a table"})) as writer:
        writer.end("finished")
    for folder in (writer.folder, Path("recording")):
        assert commands_of(folder)[0] == f"spinbench capture BENCH {COMMAND}"
