"""`diagnose` as a person types it: which recordings it is of, and what is kept for a diagnosis that goes on with it."""

import json
import shutil
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

import spinbench as sb
from calibration.diagnosis.next_test.recommend import NextTest
from calibration.likelihood.expected import Capture
from rig.bench.bench import FOLDER
from spinbench.cli import diagnose
from spinbench.published import published_sweep
from tests.synthetic_runs import made_with, write_sweep


@dataclass
class Found:
    """What a diagnosis is asked for here."""

    next_tests: list[NextTest]
    seconds: float = 0.0


@pytest.fixture
def without_work(monkeypatch):
    """`diagnose` without the work, which is replaced by what it is called with; no report is made."""

    def of(work):
        def look(*arguments):
            work(*arguments)
            return Found([NextTest("a zero", (), 3.0, capture=Capture("zero"))])

        def as_json(found):
            told = {"format": "diagnosis/1", "promised": [], "next_tests": []}
            return told | {"commands": [one.capture.command for one in found.next_tests]}

        module = import_module("calibration.diagnosis.diagnose")  # the package has a function of that name
        monkeypatch.setattr(module, "diagnose", look)
        monkeypatch.setattr("calibration.diagnosis.document.as_json", as_json)
        words = SimpleNamespace(sentence=lambda found: "")
        monkeypatch.setattr(diagnose, "_told_by", lambda found: (None, lambda found: "", words))
        monkeypatch.setattr(diagnose, "_pages", lambda *_: {})
        for name in ("_warn", "_tell_how_it_went"):
            monkeypatch.setattr(diagnose, name, lambda *_: None)

    return of


@pytest.mark.parametrize("named", ["last", "20260528-20"])
def test_a_run_that_begins_meanwhile_is_not_the_one_that_was_diagnosed(named, tmp_path, monkeypatch, without_work):
    first, second = (
        write_sweep(tmp_path / "logs", captures=False, **made_with(FOLDER / "virtual.toml")) for _ in range(2)
    )
    later = second.rename(tmp_path / "later")
    without_work(lambda *_: later.rename(second))
    monkeypatch.chdir(tmp_path)
    diagnose.diagnose(recording=[Path(named)], out=tmp_path / "out")
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["commands"] == [f"spinbench capture virtual --kind zero --after {first.name}"]
    without_work(lambda *_: None)
    assert sb.diagnose(first).document["commands"] == found["commands"]


@pytest.mark.parametrize("words", [("--json", "b/diagnosis.json"), ("-o", "a/deep", "--json", "b/diagnosis.json")])
@pytest.mark.parametrize("earlier", ["b", "b/diagnosis.json"])
def test_each_copy_of_a_diagnosis_says_where_its_recordings_are(words, earlier, tmp_path, without_work, spinbench_here):
    shutil.copytree(published_sweep(), tmp_path / "swept")
    (tmp_path / "b").mkdir()
    without_work(lambda *_: None)
    assert spinbench_here("diagnose", "swept", *words, cwd=tmp_path).returncode == 0
    for place in [earlier, *(["a/deep"] if "-o" in words else [])]:
        again = spinbench_here("diagnose", "--continue", place, "swept", cwd=tmp_path)
        assert (again.returncode, "a recording is given twice: swept;" in again.stderr) == (2, True), again.stderr


def test_what_is_of_each_recording_stays_so_where_a_diagnosis_is_gone_on_with(tmp_path, without_work, spinbench_here):
    header, *rows = (published_sweep() / "sweep.csv").read_text().split()
    for n, name in enumerate("ABC"):  # each with readings of its own
        shutil.copytree(published_sweep(), tmp_path / name)
        changed = [
            f"{pressure},{flow},{float(speed) + n}" for pressure, flow, speed in (row.split(",") for row in rows)
        ]
        (tmp_path / name / "sweep.csv").write_text("\n".join([header, *changed]) + "\n")
    asked = []
    without_work(lambda read, *rest: asked.append((len(read), set(rest[-1].own))))
    for words in (
        ("A", "B", "--per-recording", "leakage", "-o", "out/d"),
        ("--continue", "out/d", "C", "-o", "out/e"),
        ("--continue", "out/e", "C", "--per-recording", "windage"),
    ):
        done = spinbench_here("diagnose", *words, cwd=tmp_path)
    assert "given twice: C;" in done.stderr
    assert asked == [(2, {"leakage"}), (3, {"leakage"})]
    assert json.loads((tmp_path / "out" / "e" / "diagnosis.json").read_text())["per_recording"] == ["leakage"]
    found = sb.diagnose([tmp_path / "A", tmp_path / "B"], per_recording="leakage")
    assert found.document["per_recording"] == ["leakage"]
