"""Runs that belong together are one by naming the last: a sweep and the captures that follow it."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import pytest

from calibration.data.joined import as_given
from calibration.systems.look_up import compared
from rig.bench.bench import FOLDER
from rig.recording import read_recording
from rig.runlog import read_run
from spinbench import readings
from tests.synthetic_runs import reseal, write_sweep

pytestmark = pytest.mark.long

ENOUGH_S = 600.0
TACH = "V00001"  # what the virtual edge counter calls itself
GAUGE = "G-3"  # which the gauge does not tell


def run(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "spinbench", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=ENOUGH_S,
        check=False,
        cwd=cwd,
    )


def refused(result):
    """The one line of a refusal."""
    assert result.returncode == 2, result.stderr
    assert "Traceback" not in result.stderr
    (line,) = [line for line in result.stderr.splitlines() if "spinbench: " in line or "--" in line][-1:]
    return line


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """The shipped virtual bench with three levels and short waits; gauge and tachometer are known by their numbers."""
    path = tmp_path_factory.mktemp("parents") / "short.toml"
    text = (FOLDER / "virtual.toml").read_text()
    for key, value in {
        "levels_bar_abs": "[1.30, 1.50, 1.80]\nzero_s = 2.0",
        "order": '"up"',
        "window_s": "2.0",
        "dwell_s": "2.0",
        "captures": "[]",
        "capture_level_bar_abs": "1.80",
        "rate": "10.0",
        "motor": '"ptm3600"\nmotor_serial = "A-17"',
    }.items():
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    for device, number in (("tach", TACH), ("gauge", GAUGE)):
        text = text.replace(f"[devices.{device}]\n", f'[devices.{device}]\nserial_number = "{number}"\n')
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def taken(bench):
    """A sweep, and a coast-down taken after it."""
    for words in (["sweep", bench], ["capture", bench, "--kind", "coast-down", "--after", "last"]):
        result = run(*words, cwd=bench.parent)
        assert result.returncode == 0, result.stderr
    swept, captured = sorted((bench.parent / "logs").iterdir())
    return swept, captured


def test_a_capture_keeps_the_run_that_it_was_taken_after(taken, spinbench_here):
    swept, captured = taken
    assert (read_run(captured).start.parent, read_run(captured).start.motor_serial) == (swept.name, "A-17")
    assert f"parent     {swept.name}" in spinbench_here("runs", "show", captured.name, cwd=swept.parents[1]).stdout


def test_a_capture_needs_no_plateaus_on_the_way_where_the_run_before_it_has_them(taken):
    """The guard knows the motor from them: it lets the line go to 1.8 bar at once."""
    swept, captured = taken
    assert [plateau.level_bar_abs for plateau in read_run(swept).plateaus if "guard" not in plateau.note] == [
        1.3,
        1.5,
        1.8,
    ]
    assert not read_run(captured).plateaus


def test_a_sweep_and_its_capture_are_diagnosed_together_by_naming_the_capture(taken, spinbench_here):
    swept, captured = taken
    words = ["--with-parents", "--workers", 1, "--json", "-"]
    result = spinbench_here("diagnose", captured.name, *words, cwd=swept.parents[1])
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    files = {one["file"] for one in found["files"]}
    assert {f"{swept.name}/sweep.csv", f"{captured.name}/coast_down.csv"} <= files
    assert found["verdict"] == "consistent"


def test_a_sweep_and_the_plateaus_after_it_are_fitted_together_by_naming_the_last(bench, taken, spinbench_here):
    swept, _ = taken
    more = run("capture", bench, "--kind", "plateaus", "--plateaus", 1, "--after", "last", cwd=bench.parent)
    assert more.returncode == 0, more.stderr
    last = sorted((bench.parent / "logs").iterdir())[-1]
    words = ["--with-parents", "--steady-only", "--effective-samples", 200, "--json", "-"]
    result = spinbench_here("fit", "last", *words, cwd=swept.parents[1])
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert f"{swept.name}/sweep.csv" in {one["file"] for one in found["files"]}
    assert found["parameters"]["f_overall"]["sd"] < 0.01
    own = {f"{swept.name}: ambient_pressure", f"{last.name}: ambient_pressure"}
    assert own | {f"{GAUGE}: pressure_offset", f"{TACH}: speed_scale"} <= set(found["parameters"])
    assert not any(name.endswith(f"{swept.name}: pressure_offset") for name in found["parameters"])


def test_two_exported_sweeps_of_a_bench_share_the_errors_of_what_has_a_number(bench, taken, tmp_path, spinbench_here):
    """From the bench file through the run log and recording.toml to the unknowns of both."""
    once = bench.parent / "once.toml"
    gauge = (FOLDER.parent / "instruments" / "keller_30x_abs.toml").read_text()
    drifting = gauge.replace("[channels.pressure_bar_abs]", "[channels.pressure_bar_abs]\ndrift_sd = 0.002\n")
    (bench.parent / "drifting.toml").write_text(drifting)
    levels = bench.read_text().replace("[1.30, 1.50, 1.80]", "[1.30]")
    once.write_text(levels.replace('"keller_30x_abs"', '"drifting"'))
    again = run("sweep", once, "--no-page", "--logs", tmp_path / "logs", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    for number, (name, logs) in enumerate(((taken[0], taken[0].parent), ("last", tmp_path / "logs"))):
        words = ["runs", "export", name, "--logs", logs, "-o", tmp_path / f"day{number}"]
        exported = spinbench_here(*words, cwd=tmp_path)
        assert exported.returncode == 0, exported.stderr
        assert f'serial = "{GAUGE}"' in (tmp_path / f"day{number}" / "recording.toml").read_text()
    days = [read_recording(tmp_path / f"day{number}") for number in (0, 1)]
    assert [one.channels["pressure_bar_abs"].drift_sd for one in days] == [0.0, 0.002]
    names = [one.name for one in compared(as_given(days)).problem.nuisances]
    shared = (f"{GAUGE}: pressure_offset", f"{TACH}: speed_scale")
    assert [names.count(name) for name in shared] == [1, 1]
    assert {"day0: flow_offset", "day1: flow_offset"} <= set(names)  # the flow meter has no number
    assert not any("drift" in name for name in names)  # on one day nothing drifts
    tomorrow = replace(days[1], origin={**days[1].origin, "date": "2099-01-01"})
    names = [one.name for one in compared(as_given([days[0], tomorrow])).problem.nuisances]
    assert names.count(f"{GAUGE}: pressure_offset") == names.count("day1: pressure_offset_drift") == 1


# Which recordings go together, without a fit.


def together(*names, cwd):
    return [one.folder.name for one in readings.all_named([cwd / name for name in names], cwd, parents=True)]


@pytest.fixture
def line(tmp_path):
    """Three runs, each after the one before."""
    names = []
    for _ in range(3):
        names.append(write_sweep(tmp_path, parent=names[-1] if names else None).name)
    return names


def test_parents_of_parents_come_first_and_none_comes_twice(line, tmp_path):
    assert together(line[2], cwd=tmp_path) == line
    assert together(line[2], line[1], cwd=tmp_path) == line
    assert together(line[1], line[2], cwd=tmp_path) == line


def test_an_exported_recording_finds_the_run_that_it_goes_on_from(line, tmp_path, spinbench_here):
    result = spinbench_here(
        "runs", "export", line[1], "--logs", tmp_path, "-o", tmp_path / "elsewhere" / "monday", cwd=tmp_path
    )
    assert result.returncode == 0, result.stderr
    found = readings.all_named([tmp_path / "elsewhere" / "monday"], tmp_path, parents=True)
    assert [one.folder.name for one in found] == [line[0], "monday"]


def test_a_parent_that_holds_nothing_is_passed_over_and_its_own_parent_is_not(line, tmp_path, capsys):
    rows = (tmp_path / line[1] / "plateaus.csv").read_text().splitlines(keepends=True)
    (tmp_path / line[1] / "plateaus.csv").write_text(rows[0])
    (tmp_path / line[1] / "events.jsonl").write_text("")
    reseal(tmp_path / line[1])
    assert together(line[2], cwd=tmp_path) == [line[0], line[2]]
    assert "passed over" in capsys.readouterr().err


def renamed_parent(folder, parent):
    """Let a run say that it goes on from another."""
    start = json.loads((folder / "start.json").read_text())
    (folder / "start.json").write_text(json.dumps(start | {"parent": parent}))
    reseal(folder)


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_a_parent_that_is_missing_is_told_in_a_line(line, tmp_path, spinbench_here, command):
    renamed_parent(tmp_path / line[0], "../gone")
    out = tmp_path / "out"
    result = spinbench_here(command, line[2], "--with-parents", "--logs", tmp_path, "-o", out, cwd=tmp_path)
    said = refused(result)
    assert f"{line[0]}: goes on from '../gone', which is neither in" in said and "without --with-parents" in said
    assert result.stderr.count("goes on from") == 1
    assert not out.exists()


@pytest.mark.parametrize("last", [0, 2])
def test_parents_that_go_in_a_circle_are_told_in_a_line(line, tmp_path, spinbench_here, last):
    renamed_parent(tmp_path / line[0], line[last])
    said = refused(spinbench_here("fit", line[2], "--with-parents", "--logs", tmp_path, cwd=tmp_path))
    assert "its parents go in a circle" in said and line[0] in said


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--motor-serial", "B-2"], "is of the motor ptm3600 no. A-17, not of the motor ptm3600 no. B-2, which is on"),
        (["--logs", "elsewhere"], "it is not in elsewhere, where this run is kept"),
    ],
)
def test_a_capture_after_a_run_of_another_motor_or_place_is_not_begun(bench, taken, spinbench_here, options, words):
    folder = bench.parent / ("elsewhere" if "elsewhere" in options else "logs")
    before = sorted(folder.glob("*"))
    result = spinbench_here("capture", bench, "--kind", "zero", "--after", taken[0], *options, cwd=bench.parent)
    assert result.returncode == 2
    assert words in " ".join(result.stderr.replace("│", " ").split())
    assert sorted(folder.glob("*")) == before


def test_remarks_name_their_run_where_another_is_held_out(tmp_path, spinbench_here):
    """The run is refused in the end, for it is given twice: what is said of it before has its name."""
    killed = write_sweep(tmp_path / "logs", seal=False)
    result = spinbench_here("diagnose", killed.name, "--hold-out", killed.name, cwd=tmp_path)
    assert result.returncode == 2
    *remarks, _ = result.stderr.splitlines()
    assert remarks
    assert all(line.startswith(f"spinbench: {killed.name}: ") for line in remarks)
