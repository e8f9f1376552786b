"""The page that a sweep leaves behind: what it says, what it does not touch, and that its failure is no one's."""

from __future__ import annotations

import html
import re

import pytest

from rig.runlog import RunWriter, verify
from rig.runlog.folder import HASHED, sha256_of
from spinbench import run_page
from spinbench.cli import sweep
from tests.synthetic_runs import start_of, write_sweep


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished sweep of the article's readings, with the hashes that its files had, and its page."""
    folder = write_sweep(tmp_path_factory.mktemp("logs"), captures=False)
    before = {name: sha256_of(folder / name) for name in HASHED if (folder / name).exists()}
    return folder, before, run_page.write(folder)


@pytest.fixture(scope="module")
def said(run):
    """The page's text, without its pictures."""
    return html.unescape(re.sub(r'src="data:[^"]*"', "", run[2].read_text()))


def test_the_page_begins_with_f_overall_and_whether_the_model_explains_the_readings(said):
    verdict = re.search(r'class="verdict">(.*?)</p>', said)[1]
    assert re.match(r"(f_overall is about 0\.06\d* ± 0\.00\d* N m s\. The readings do not|The model does not)", verdict)
    assert "sweep on synthetic, simulated: finished" in said


def test_the_page_shows_the_plateaus_against_the_model(run, said):
    assert run[2].read_text().count('src="data:image/png;base64,') == 1
    assert re.search(r"Rows used: sweep\.csv: \d+ of 14 rows", said)
    assert said.count("<td>sweep.csv</td>") >= 10


@pytest.mark.long
def test_the_page_shows_runs_in_time_against_the_model(tmp_path):
    said = run_page.write(write_sweep(tmp_path)).read_text()
    assert said.count('src="data:image/png;base64,') == 2
    assert "<h2>Runs in time</h2>" in said and "coast_down.csv: " in said and "spin_up.csv: " in said


def test_the_page_names_the_commands_that_come_next_with_the_run(run, said):
    for command in ("diagnose", "fit", "replay", "runs show"):
        assert f"<code>spinbench {command} {run[0]}" in said


def test_the_page_leaves_the_sealed_run_as_it_was(run):
    folder, before, page = run
    assert page == folder / "report.html"
    assert verify(folder) == []
    assert {name: sha256_of(folder / name) for name in before} == before
    (folder / "other.html").write_text("")
    assert verify(folder) == ["other.html: this file is no part of a run"]
    (folder / "other.html").unlink()


def test_a_run_that_was_stopped_says_why_and_how_it_is_gone_on_with(tmp_path):
    with RunWriter.create(tmp_path, start_of()) as writer:
        for n in range(run_page.MOST_WRONG + 1):
            writer.event("warning", 1, text=f"the <b>gauge</b> fell silent{f' again {n}' * (n > 0)}")
        writer.end("aborted", "stopped by the operator", vented=False, stopped_by="operator")
    raw = run_page.write(writer.folder).read_text()
    said = html.unescape(raw)
    assert ": stopped by the operator</h1>" in said
    assert "Its readings were not held against the model." in said and "nothing to export" in said
    assert "the line is not known to be vented: close the supply" in said
    assert "the <b>gauge</b> fell silent" in said and "<b>" not in raw
    assert f"`spinbench runs show --logs {tmp_path} {writer.folder.name}` lists events" in said
    assert f"spinbench sweep BENCH --continue {writer.folder.name} --logs {tmp_path}" in said


@pytest.mark.long
def test_a_page_that_cannot_be_made_is_told_and_ends_nothing(tmp_path, capsys):
    sweep._write_page(tmp_path / "no run")
    assert "spinbench: the run's page could not be made (RunError: " in capsys.readouterr().err
    folder = write_sweep(tmp_path, captures=False)
    (folder / "report.html").mkdir()
    sweep._write_page(folder)
    assert "the run's page could not be made (IsADirectoryError" in capsys.readouterr().err
