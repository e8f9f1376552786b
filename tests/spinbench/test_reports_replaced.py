"""A report that replaces one of other recordings says so; the same command again does not."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from spinbench.cli.show import recordings_in, write_report

ROOT = Path(__file__).resolve().parents[2]
OLD = {"recordings": [{"folder": "../march", "recording": "march"}]}


@pytest.fixture
def bench(tmp_path):
    """Two recordings, and reports of another one where theirs are to be written."""
    for name, date, rpm in (("may", "2026-05-01", "394.8"), ("june", "2026-06-01", "394.9")):
        shutil.copytree(ROOT / "logs" / "published_sweep", tmp_path / name)
        table = tmp_path / name / "sweep.csv"
        table.write_text(table.read_text(encoding="utf-8").replace("394.8", rpm), encoding="utf-8")
        with (tmp_path / name / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'\n[origin]\ndate = "{date}"\n')
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "diagnosis.json").write_text(json.dumps(OLD), encoding="utf-8")
    (tmp_path / "out" / "comparison.json").write_text(json.dumps(OLD), encoding="utf-8")
    (tmp_path / "out" / "table.csv").write_text("recording,date\nmarch,\n", encoding="utf-8")
    return tmp_path


@pytest.mark.long
@pytest.mark.parametrize(
    "command", [("diagnose", "may", "--workers", 1), ("compare", "june", "may"), ("trend", "may", "june")]
)
def test_a_report_of_another_recording_is_replaced_in_words(bench, spinbench_here, command):
    done = spinbench_here(*command, "-o", "out", cwd=bench)
    assert done.returncode == 0, done.stderr
    assert "spinbench: replaced: the report in out, which was of march\n" in done.stderr
    assert ("may is the earlier one by its date" in done.stderr) == (command[0] == "compare")


def test_only_what_is_not_of_the_same_recordings_is_told(bench, capsys):
    def write(*folders):
        document = json.dumps({"recordings": [{"folder": folder} for folder in folders]})
        write_report(bench / "out", {"diagnosis.json": document.encode()}, "diagnosis.json")
        return capsys.readouterr().err

    assert write("../may").endswith("which was of march\n")
    assert write("../may") == ""
    assert write("../may", "../june") == ""  # gone on with
    assert write("../june").endswith("which was of may\n")


def written(out, *names):
    """Write a diagnosis of recordings, of several with a page each, as the command does."""
    ahead = [f"{name}/" * (len(names) > 1) for name in names]
    document = {
        "format": "diagnosis/1",
        "recordings": [{"folder": f"../{name}"} for name in names],
        "files": [{"file": f"{one}sweep.csv"} for one in ahead],
    }
    stems = ["report", *(f"report_{one[:-1]}" for one in ahead if one)]
    pages = {f"{stem}{end}": b"<title>Diagnosis of it</title>" for stem in stems for end in (".html", ".png")}
    write_report(out, {"diagnosis.json": json.dumps(document).encode()} | pages, "diagnosis.json")


def test_pages_that_a_diagnosis_no_longer_has_are_removed_and_nothing_else(bench):
    written(bench / "out", "may", "june")
    (bench / "out" / "report_mine.html").write_text("<title>Diagnosis of it</title>", encoding="utf-8")
    written(bench / "out", "may", "july")
    own = {path.name for path in (bench / "out").glob("report_*")}
    assert own == {f"report_{name}" for name in ("may.html", "may.png", "july.html", "july.png", "mine.html")}
    written(bench / "out", "may")
    assert [path.name for path in (bench / "out").glob("report_*")] == ["report_mine.html"]


def test_a_page_of_another_command_is_replaced_in_words(bench, capsys):
    written(bench / "out", "march")
    assert capsys.readouterr().err == ""
    (bench / "out" / "report.html").write_text("<head>\n<title>Fit of a &amp; b: f_overall</title>", encoding="utf-8")
    written(bench / "out", "march")
    assert capsys.readouterr().err.endswith(
        "replaced: the page in {}, which was 'Fit of a & b: f_overall'\n".format(bench / "out")
    )
    written(bench / "out", "march")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"[]", b'{"recordings": 3}', b'{"format": "diagnosis/1", "files": [1]}', b"\xff", b"a,b\n1,2\n"],
)
def test_what_says_of_nothing_is_replaced_without_a_word(bench, capsys, content):
    (bench / "out" / "diagnosis.json").write_bytes(content)
    write_report(bench / "out", {"diagnosis.json": b'{"recordings": [{"folder": "../may"}]}'}, "diagnosis.json")
    assert capsys.readouterr().err == ""


def test_the_recordings_of_a_table_are_read(bench):
    assert recordings_in((bench / "out" / "table.csv").read_bytes()) == ["march"]
