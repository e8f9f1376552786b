"""Several recordings of one motor, of different days: one posterior of the motor and the effects."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import tests.diagnosis_recordings as recordings
from calibration.data.joined import as_given
from calibration.diagnosis import as_json, diagnose, mismatch
from calibration.report.fit.words import next_command
from calibration.report.origin import name_of
from calibration.systems.look_up import compared
from calibration.systems.radial_piston.next_tests.planned import planned
from calibration.systems.radial_piston.next_tests.readings import line_of
from calibration.systems.several.comparison import Several
from model import layout as at
from model.motor import read_motor
from rig.recording import Recording, RecordingError, read_recording, write_recording
from spinbench.published import published_sweep
from tests import browser
from tests.documents import check
from tests.synthetic_runs import write_sweep

FRICTION = {"coulomb_friction": {"torque_nm": 0.08}}
ROTOR = read_motor("ptm3600").si("inertia")
ANOTHER_DAY = (
    recordings.HEAD.replace("pressure_bar_abs = 1.01325", "pressure_bar_abs = 0.995")
    .replace("temperature_c = 20.0", "temperature_c = 26.0")
    .replace("noise_sd = 0.4", "noise_sd = 0.45")
)


def on_another_day(
    folder: Path, seed: int, chosen: dict, monkeypatch: pytest.MonkeyPatch, heavy: bool, **run: float
) -> Recording:
    """A sweep in another ambient, with other noise figures; with a flywheel also a coast-down."""
    flywheel = f"[rig]\nadded_inertia_kg_m2 = {3.0 * ROTOR:.6f}\n" if heavy else ""
    with monkeypatch.context() as day:
        day.setattr(recordings, "HEAD", ANOTHER_DAY + flywheel)
        found = recordings.sweep(folder, seed, chosen)
        return recordings.add_coast_down(folder, seed, chosen, **run) if heavy else found


@pytest.mark.long
def test_one_recording_among_several_is_that_recording(tmp_path: Path) -> None:
    alone = recordings.sweep(tmp_path / "alone", 3, {"windage": {"drag_nm_s2": 2e-4}})
    one, other = as_json(diagnose(alone, 1)), as_json(diagnose([alone], 1))
    assert (one["verdict"], [e["id"] for e in one["effects"]]) == (
        other["verdict"],
        [e["id"] for e in other["effects"]],
    )
    assert other["f_overall_after"]["mean"] == pytest.approx(one["f_overall_after"]["mean"], rel=1e-3)
    assert np.log(other["mismatch"]["p_value"]) == pytest.approx(np.log(one["mismatch"]["p_value"]), rel=0.05)


@pytest.fixture(scope="module")
def two_days(tmp_path_factory: pytest.TempPathFactory, spinbench_anywhere) -> Path:
    """A folder with the recordings `first` and `second`, of two days, and what the command says of both in `out`."""
    folder = tmp_path_factory.mktemp("two_days")
    recordings.sweep(folder / "first", 3, {})
    with pytest.MonkeyPatch.context() as monkeypatch:
        on_another_day(folder / "second", 8, {}, monkeypatch, False)
    for name in ("first", "first", "second"):  # the first is the shorter one
        recordings.every_second_row(folder / name)
    done = spinbench_anywhere("diagnose", "first", "second", "-o", "out", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.long
def test_two_days_together_know_f_overall_better_than_each_alone(two_days: Path) -> None:
    both = json.loads((two_days / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    check(both)
    assert both["verdict"] == "consistent"
    assert both["f_overall_after"]["q05"] < read_motor("ptm3600").si("f_overall") < both["f_overall_after"]["q95"]
    days = [read_recording(two_days / name) for name in ("first", "second")]
    alone = [as_json(diagnose(one, 1))["f_overall_before"]["sd"] for one in days]
    assert both["f_overall_before"]["sd"] < min(alone)
    assert {one["file"] for one in both["files"]} == {"first/sweep.csv", "second/sweep.csv"}


@pytest.mark.long
def test_the_command_writes_a_page_for_each_of_two_days(two_days: Path) -> None:
    for name in ("first", "second"):
        assert name in (two_days / "out" / f"report_{name}.html").read_text(encoding="utf-8")
    longer = (two_days / "out" / "report_second.html").read_bytes()
    assert (two_days / "out" / "report.html").read_bytes() == longer


@pytest.mark.long
def test_the_report_of_two_days_leads_to_the_page_of_each(two_days: Path) -> None:
    path = browser.installed()
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with api.sync_playwright() as made:
        window = made.chromium.launch(executable_path=path, args=["--no-sandbox"]).new_page()
        window.goto((two_days / "out" / "report.html").as_uri())
        assert window.inner_text("ul >> nth=0") == "first: 7 plateaus\nsecond: 13 plateaus"
        for name, other in (("first", "second"), ("second", "first")):
            window.click(f"a:text-is('{name}')", timeout=10_000)  # it is seen without anything being unfolded
            assert window.url == (two_days / "out" / f"report_{name}.html").as_uri()
            assert "Diagnosis of “first and second”" in window.inner_text("h1")
            assert window.inner_text("ul b") == name
            assert f"Rows used of {name}: " in window.inner_text("body")
            assert window.locator("a").all_inner_texts() == [other]


def test_recordings_that_are_one_are_all_named(tmp_path: Path) -> None:
    (joined,) = as_given([recordings.sweep(tmp_path / name, seed, {}) for name, seed in (("one", 3), ("other", 8))])
    assert name_of([joined]) == "one and other"
    command = next_command(SimpleNamespace(recordings=[joined]))
    assert command == f"spinbench diagnose {tmp_path / 'one'} {tmp_path / 'other'}"


def test_the_next_command_names_a_recording_with_a_flywheel_in_one_run_once() -> None:
    two = [read_recording(published_sweep())] * 2  # as `by_flywheel` has it
    assert next_command(SimpleNamespace(recordings=two)).split()[2:] == [str(two[0].folder)]


def test_a_zero_of_another_day_counts_beside_a_sweep_and_is_nothing_by_itself(tmp_path: Path) -> None:
    first = recordings.sweep(tmp_path / "first", 3, {})
    head, _, _ = (tmp_path / "first" / "recording.toml").read_text(encoding="utf-8").partition("[channels.flow_l_min]")
    files = '[[files]]\nfile = "zero.csv"\nkind = "zero"\n'
    lines = [line for line in head.splitlines() if not line.startswith("files")]
    (tmp_path / "zero").mkdir()
    (tmp_path / "zero" / "recording.toml").write_text("\n".join([*lines, files]), encoding="utf-8")
    rows = "".join(f"{pressure}\n" for pressure in (1.015, 1.016, 1.014))
    (tmp_path / "zero" / "zero.csv").write_text(f"pressure_bar_abs\n{rows}", encoding="utf-8")
    zero = read_recording(tmp_path / "zero")
    alone, several = compared(first), compared([first, zero])
    assert several.size > alone.size
    assert np.isfinite(several.base().log_evidence)
    with pytest.raises(RecordingError, match="no steady row"):
        compared(zero)


def test_unknowns_of_a_day_are_its_own_and_the_motor_is_shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = recordings.sweep(tmp_path / "first", 3, {})
    heavy = on_another_day(tmp_path / "heavy", 8, {}, monkeypatch, True)
    several = compared([first, heavy])
    assert isinstance(several, Several)
    names = [one.name for one in several.problem.nuisances]
    assert names.count("f_overall") == names.count("inertia") == 1
    assert {"first: pressure_offset", "heavy: pressure_offset", "heavy: ambient_pressure"} <= set(names)
    z = np.zeros(len(names))
    z[names.index("inertia")] = 1.0
    rotor = float(several.problem.nuisances[names.index("inertia")].value(np.asarray(1.0)))
    part = several.parts[1].problem
    assert part.split(several.problem.of_part(1, z))[0][at.J] == pytest.approx(rotor + 3.0 * ROTOR)


def test_a_recording_that_an_unknown_leaves_alone_is_not_predicted_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = [recordings.sweep(tmp_path / name, seed, {}) for name, seed in (("first", 3), ("second", 8))]
    problem = compared(read).problem
    middle = np.zeros(len(problem.nuisances))
    own = next(i for i in problem.at[1] if i not in problem.at[0])
    asked: list[int] = []
    for k, part in enumerate(problem.parts):
        predict = part.predict

        def counted(*given, k=k, predict=predict, **named):
            asked.append(k)
            return predict(*given, **named)

        monkeypatch.setattr(part, "predict", counted)
    for moved in (0.0, 0.3, -0.2, 0.0):
        z = middle.copy()
        z[own] = moved
        found = problem.predict(z, {})
        fresh = compared(read).problem.predict(z, {})
        assert all(np.array_equal(one.flow, other.flow) for one, other in zip(found, fresh, strict=True))
    assert asked == [0, 1, 1, 1, 1]


def with_a_flywheel_in_the_coast_down_alone(folder: Path, seed: int) -> Recording:
    """A sweep, and a coast-down with a flywheel that stands at its file."""
    recordings.sweep(folder, seed, {})
    place = folder / "recording.toml"
    plain = place.read_text(encoding="utf-8")
    flywheel = f"added_inertia_kg_m2 = {2.0 * ROTOR:.6f}"
    place.write_text(f"{plain}[rig]\n{flywheel}\n", encoding="utf-8")
    recordings.add_coast_down(folder, seed, {})
    text = place.read_text(encoding="utf-8").replace(f"[rig]\n{flywheel}\n", "")
    place.write_text(text.replace("noise_scale = 2.0 }", f"noise_scale = 2.0, {flywheel} }}"), encoding="utf-8")
    return read_recording(folder)


@pytest.mark.long
def test_a_flywheel_at_a_file_is_on_the_shaft_in_that_run_alone(tmp_path: Path) -> None:
    seen = with_a_flywheel_in_the_coast_down_alone(tmp_path / "bench", 3)
    several = compared(seen)
    assert isinstance(several, Several)
    assert [part.recording.added_inertia_kg_m2 for part in several.problem.parts] == pytest.approx(
        [0.0, 2.0 * ROTOR], rel=1e-3
    )
    names = [one.name for one in several.problem.nuisances]
    assert names.count("bench: pressure_offset") == names.count("bench: ambient_pressure") == 1
    told = as_json(diagnose(seen, 1))
    assert told["verdict"] == "consistent"
    assert told["f_overall_after"]["q05"] < read_motor("ptm3600").si("f_overall") < told["f_overall_after"]["q95"]
    files = tuple(replace(file, added_inertia_kg_m2=0.0) for file in seen.files)
    comparison, base = mismatch.fit_base(replace(seen, files=files), lambda _: None)
    forgotten = mismatch.test_base(comparison, base, np.random.default_rng(1)).detection
    assert forgotten.p_value < 1e-9  # of such a mismatch no verdict is "consistent"


def test_a_next_test_is_promised_with_the_line_and_the_gauge_of_the_runs_of_another_recording(tmp_path: Path) -> None:
    """The sweep has none: a quick line and a gauge of 10 Hz would be supposed."""
    seen = with_a_flywheel_in_the_coast_down_alone(tmp_path / "bench", 3)
    several = compared(seen)
    assert isinstance(several, Several)
    sweep, run = several.parts
    assert sweep.n and not run.n
    base = several.base()
    found = list(several.tests([base]))
    lines = [test.expected.args[0].expected.keywords["line"] for test in found if test.capture]
    shown = line_of(run, several.of_part(1, base))
    assert {"venting_time", "venting_valve", "venting_bend"} <= set(shown)
    assert lines and all(line == shown for line in lines)
    (run_file,) = run.problem.recording.files
    gauge = run_file.columns["pressure_bar_abs"].values
    coast_down = next(plan for plan in planned(sweep, run) if plan.words.startswith("coast-down"))
    there = coast_down.recording.files[0].columns["pressure_bar_abs"].values
    assert np.mean(np.isfinite(there)) == pytest.approx(np.mean(np.isfinite(gauge)), abs=0.02)


def test_a_flywheel_at_a_file_is_written_and_read_again(tmp_path: Path) -> None:
    seen = with_a_flywheel_in_the_coast_down_alone(tmp_path / "bench", 3)
    write_recording(seen, tmp_path / "again")
    again = read_recording(tmp_path / "again")
    assert [file.added_inertia_kg_m2 for file in again.files] == [file.added_inertia_kg_m2 for file in seen.files]
    assert again.files[1].added_inertia_kg_m2 > 0.0


def named_by_serial(folder: Path, column: str, serial: str) -> None:
    """Give an instrument of a recording its serial number."""
    place = folder / "recording.toml"
    head = f"[channels.{column}]\n"
    text = place.read_text(encoding="utf-8").replace(head, f'{head}serial = "{serial}"\n')
    place.write_text(text, encoding="utf-8")


def test_one_instrument_in_two_recordings_has_its_errors_once(tmp_path: Path) -> None:
    for name in ("first", "second"):
        recordings.sweep(tmp_path / name, 3, {})
    apart = compared([read_recording(tmp_path / name) for name in ("first", "second")])
    for name in ("first", "second"):
        named_by_serial(tmp_path / name, "flow_l_min", "FM-7")
    several = compared([read_recording(tmp_path / name) for name in ("first", "second")])
    names = [one.name for one in several.problem.nuisances]
    assert names.count("FM-7: flow_scale") == names.count("FM-7: flow_offset") == 1
    assert {"first: pressure_offset", "second: pressure_offset"} <= set(names)
    base, loose = several.base(), apart.base()
    column = base.D[:, names.index("FM-7: flow_scale")]
    assert all(np.any(column[at] != 0.0) for at in several.at)
    of_f = [
        mode.covariance[k, k]
        for mode, k in ((base, names.index("f_overall")), (loose, apart.problem.place("f_overall")))
    ]
    assert of_f[0] >= 0.99 * of_f[1]  # two meters would average their errors out, one does not


BAD = {
    "serial_of_two_kinds": ("serial P-1 is of the instrument of speed_rpm, but of pressure_bar_abs in"),
    "serial_with_two_offsets": "bias_sd is 0.6, but 0.5 in",
    "flywheel_lighter_than_nothing": "added_inertia_kg_m2",
    "two_motors_of_a_kind": "of the motor ptm3600 no. B2, not of the motor ptm3600 no. A1",
    "the_same_twice": "given twice",
    "the_same_in_other_bytes": "given twice",
    "the_same_under_two_dates": "given twice under two dates (2026-05-01 and 2026-05-02): ",
}


@pytest.mark.parametrize("command", ["diagnose", "fit"])
@pytest.mark.parametrize("name", BAD)
def test_what_cannot_go_together_is_refused_in_a_line(tmp_path: Path, spinbench_here, name: str, command: str) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    for folder, seed, serial in ((one, 3, "A1"), (other, 8, "B2" if name == "two_motors_of_a_kind" else "A1")):
        recordings.sweep(folder, seed, {})
        with (folder / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\nmotor_serial = "{serial}"\n')
    if name == "serial_of_two_kinds":
        named_by_serial(one, "pressure_bar_abs", "P-1")
        named_by_serial(other, "speed_rpm", "P-1")
    if name == "serial_with_two_offsets":
        for folder, sd in ((one, 0.5), (other, 0.6)):
            named_by_serial(folder, "flow_l_min", "FM-7\\n")
            place = folder / "recording.toml"
            place.write_text(place.read_text(encoding="utf-8").replace("bias_sd = 0.5", f"bias_sd = {sd}"), "utf-8")
    if name == "flywheel_lighter_than_nothing":
        place = other / "recording.toml"
        text = place.read_text(encoding="utf-8")
        place.write_text(
            text.replace('kind = "steady"', 'kind = "steady", added_inertia_kg_m2 = -0.01'), encoding="utf-8"
        )
    if name == "the_same_under_two_dates":
        shutil.copy(one / "sweep.csv", other / "sweep.csv")
        for day, folder in enumerate((one, other), start=1):
            with (folder / "recording.toml").open("a", encoding="utf-8") as file:
                file.write(f'date = "2026-05-{day:02d}"\n')
    if name == "the_same_in_other_bytes":
        (other / "sweep.csv").unlink()
        lines = (one / "sweep.csv").read_text(encoding="utf-8").splitlines()
        (other / "renamed.csv").write_bytes("\r\n".join([*lines, ""]).encode())
        place = other / "recording.toml"
        place.write_text(place.read_text(encoding="utf-8").replace("sweep.csv", "renamed.csv"), encoding="utf-8")
    second = one / ".." / "one" if name == "the_same_twice" else other
    done = spinbench_here(command, one, second, "-o", "out", "--json", "out.json", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert BAD[name] in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists() and not (tmp_path / "out.json").exists()


def test_a_run_beside_its_own_export_is_refused(tmp_path: Path, spinbench_here) -> None:
    swept = write_sweep(tmp_path / "logs")
    assert spinbench_here("runs", "export", swept, "-o", "exported", cwd=tmp_path).returncode == 0
    done = spinbench_here("diagnose", swept, "exported", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "a recording is given twice" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_a_run_is_not_predicted_from_several_recordings_of_different_days(two_days: Path, spinbench_here) -> None:
    recordings.sweep(two_days / "unseen", 9, {})
    done = spinbench_here("diagnose", "first", "second", "--hold-out", "unseen", cwd=two_days)
    assert done.returncode == 2, done.stderr
    assert "a run is predicted from one recording" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_run_is_not_held_out_that_an_instrument_read_beside_another(tmp_path: Path, spinbench_here) -> None:
    for name, seed, minute in (("first", 3, "00"), ("unseen", 9, "05")):
        recordings.sweep(tmp_path / name, seed, {})
        named_by_serial(tmp_path / name, "speed_rpm", "T-1")
        with (tmp_path / name / "recording.toml").open("a", encoding="utf-8") as file:
            file.write(f'[origin]\ndate = "2026-05-28T08:{minute}:00Z"\n')
    done = spinbench_here("diagnose", "first", "--hold-out", "unseen", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "one instrument (speed_rpm, serial T-1) cannot have read both" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_recordings_of_two_motors_are_refused_in_a_line(tmp_path: Path, spinbench_here) -> None:
    recordings.sweep(tmp_path / "first", 3, {})
    recordings.sweep(tmp_path / "second", 8, {})
    place = tmp_path / "second" / "recording.toml"
    text = place.read_text(encoding="utf-8").replace(
        'motor = "ptm3600"', '[motor]\nkind = "free_rotor"\ninertia_kg_m2 = 1.0'
    )
    lines = text.splitlines()
    head = [line for line in lines if not line.startswith(("[motor]", "kind = ", "inertia_kg"))]
    place.write_text("\n".join([*head, "[motor]", 'kind = "free_rotor"', "inertia_kg_m2 = 1.0", ""]), encoding="utf-8")
    assert isinstance(read_recording(tmp_path / "second").motor, dict)
    done = spinbench_here("diagnose", "first", "second", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr and "of a free_rotor, not of the motor ptm3600" in done.stderr
    assert not (tmp_path / "out").exists()
