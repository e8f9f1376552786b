"""The command of a recommended test, of the bench and the run that it is for."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from calibration.diagnosis.next_test.recommend import NextTest
from calibration.likelihood.expected import Capture
from rig.runlog import RunWriter
from spinbench.cli import diagnose, options
from tests.synthetic_runs import start_of

TEST = NextTest("a coast-down", (("windage",),), 3.0, capture=Capture("coast-down", 1.7, 0.015))
COMMAND = "--kind coast-down --level-bar-abs 1.7 --added-inertia-kg-m2 0.015"


@dataclass
class Told:
    next_tests: list[NextTest] = field(default_factory=lambda: [TEST, replace(TEST, capture=None)])


def commands_of(folder, logs):
    return [one.capture and one.capture.command for one in diagnose._on_its_bench(Told(), folder, logs).next_tests]


@pytest.mark.parametrize(("bench", "word"), [("virtual", "virtual"), ("somebody's own", "BENCH")])
def test_of_a_run_it_names_the_bench_where_that_is_found_and_the_run_and_its_folder(tmp_path, bench, word):
    with RunWriter.create(tmp_path / "lo gs", start_of(bench=bench)) as writer:
        writer.end("finished")
    run = writer.folder
    assert commands_of(run, tmp_path / "lo gs") == [
        f"spinbench capture {word} {COMMAND} --after {run.name} --logs '{tmp_path / 'lo gs'}'",
        None,
    ]
    assert commands_of(run, options.LOGS)[0].endswith(f"--after {run.name}")


def test_of_a_recording_or_an_import_the_bench_is_not_known(tmp_path):
    with RunWriter.create(tmp_path, start_of("import", imported={"title": "a table"})) as writer:
        writer.end("finished")
    for folder in (writer.folder, Path("recording")):
        assert commands_of(folder, options.LOGS)[0] == f"spinbench capture BENCH {COMMAND}"
