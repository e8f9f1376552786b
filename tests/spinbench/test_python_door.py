"""spinbench from Python, as a notebook has it: runs and recordings as tables, results that show themselves."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest

import spinbench as sb
from calibration.systems.machines.system import systems
from spinbench.api.arviz_data import arviz_module
from spinbench.api.diagnosing import not_predicted
from spinbench.api.frames import of_next_tests
from tests.diagnosis_recordings import add_coast_down, sweep
from tests.documented_python import cells_of
from tests.documents import check
from tests.rig_recordings import rotor
from tests.synthetic_runs import write_sweep

RECORD = "def record(folder: str, leak: float) -> None"
PNG = b"\x89PNG"
CENSORED = "pressure_bar_abs,flow_l_min,speed_rpm,seal\n1.60,44.0,232.3,old\n1.80,54.0,313.8,old\n2.00,>70,394.8,new\n"


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> sb.Opened:
    return sb.open(write_sweep(tmp_path_factory.mktemp("logs")))


@pytest.fixture(scope="module")
def post() -> sb.FitResult:
    return sb.fit("published_sweep", sb.Settings(seed=1, effective_samples=500, most_steps=3000))


def test_a_run_has_a_table_for_each_channel_with_its_unit(run):
    speed = run.readings["tach.speed_rpm"]
    assert speed.attrs["units"] == {"time_s": "s", "speed_rpm": "rpm"}
    assert set(speed.columns) == {"time_s", "speed_rpm", "speed_rpm_censored", "quality", "detail"}
    assert sum(len(table) for table in run.readings.values()) == len(run.run.samples)
    assert run.readings["gauge.temperature_c"].attrs["units"]["temperature_c"] == "degC"


def test_the_plateaus_of_a_run_are_its_means_with_standard_errors(run):
    used = run.run.plateaus
    assert run.plateaus["speed_rpm"].tolist() == [one.means["speed_rpm"].mean for one in used]
    assert run.plateaus["speed_rpm_se"].tolist() == [one.means["speed_rpm"].se for one in used]
    assert run.plateaus.attrs["units"]["flow_l_min_se"] == "L/min"


def test_the_events_of_a_run_are_all_there_in_order(run):
    assert run.events["event"].tolist() == [one.event for one in run.run.events]
    assert run.events["time_s"].is_monotonic_increasing
    assert run.events["details"].iloc[0]["which"] == "start"


def test_a_run_says_what_a_fit_takes_of_it(run):
    assert set(run.files) == {"sweep.csv", "zero.csv", "coast_down.csv", "spin_up.csv"}
    assert run.files["coast_down.csv"].attrs["kind"] == "transient"
    assert run.recording.sha256
    assert "simulated" in " ".join(run.notes)
    assert "simulated" in repr(run)


def test_a_run_is_opened_by_its_name_and_as_the_last(run):
    logs = run.folder.parent
    assert sb.open("last", logs=logs).name == sb.open(run.name[:8], logs=str(logs)).name == run.name


def test_a_recording_says_which_readings_are_off_the_scale(put_recording):
    found = sb.open(put_recording(("sweep.csv", "steady", CENSORED)))
    table = found.files["sweep.csv"]
    assert table["flow_l_min"].tolist() == [44.0, 54.0, 70.0]
    assert table["flow_l_min_censored"].tolist() == [0, 0, 1]
    assert "speed_rpm_censored" not in table
    assert table["seal"].tolist() == ["old", "old", "new"]
    assert found.plateaus[["file", "row"]].values.tolist() == [["sweep.csv", n] for n in (1, 2, 3)]
    assert found.plateaus.attrs["units"]["flow_l_min"] == "L/min"
    assert found.events.empty


def test_what_cannot_be_opened_is_told_in_a_sentence(tmp_path, put_recording):
    file = put_recording(("sweep.csv", "steady", CENSORED.replace("44.0", "forty"))) / "sweep.csv"
    for path, words in (
        ("nowhere", "there is no folder 'nowhere', and there is no run in logs yet"),
        (tmp_path / "nowhere", "there is no such folder"),
        (tmp_path, "neither a recording (it has no recording.toml) nor a run (it has no start.json)"),
        (file, "name the folder that it is in"),
        (file.parent, "row 1, column flow_l_min"),
    ):
        with pytest.raises(sb.RecordingError) as told:
            sb.open(path)
        assert words in str(told.value)


def test_a_mistake_in_a_motor_that_is_written_out_is_told_at_once_with_its_place(put_recording):
    toml = put_recording(("sweep.csv", "steady", CENSORED)) / "recording.toml"
    own = 'motor = {format = "motor/1", kind = "radial_piston", name = "mine"}'
    toml.write_text(toml.read_text(encoding="utf-8").replace('motor = "ptm3600"', own), encoding="utf-8")
    for call in (sb.open, lambda folder: sb.diagnose(sb.read_recording(folder))):
        with pytest.raises(sb.RecordingError) as told:
            call(toml.parent)
        assert all(line.startswith(f"{toml}: ") for line in str(told.value).splitlines())


def test_a_damaged_run_is_told_with_its_file_and_line(tmp_path):
    folder = write_sweep(tmp_path)
    samples = folder / "samples.csv"
    samples.write_text(samples.read_text(encoding="utf-8").replace("\n1,1,", "\n1,one,", 1), encoding="utf-8")
    with pytest.raises(sb.RunError, match=r"samples\.csv, line 2"):
        sb.open(folder)


def test_names_of_a_file_cannot_become_markup(put_recording):
    found = sb.open(put_recording(("sweep.csv", "steady", CENSORED.replace(",old", ",<script>"))))
    assert "<script>" not in found._repr_html_()
    assert "&lt;script&gt;" in found._repr_html_()


def test_operating_points_are_rows_in_the_order_asked_for():
    points = sb.simulate([2.0, 1.6], values={"f_overall": 0.0633, "heat_transfer": np.bool_(True)})
    assert points["pressure_bar_abs"].tolist() == [2.0, 1.6]
    assert points["speed_rpm"].is_monotonic_decreasing
    assert points.attrs["units"]["gas_torque_nm"] == "N m"
    assert sb.simulate(2.0)["speed_rpm"].iloc[0] == pytest.approx(397.06, abs=0.01)


def test_a_run_in_time_is_a_table_by_time():
    spin_up = sb.simulate(2.0, transient="spin-up", duration_s=0.05)
    assert spin_up["time_s"].iloc[[0, -1]].tolist() == [0.0, 0.05]
    assert spin_up.attrs["units"] == {"time_s": "s", "speed_rpm": "rpm", "angle_rad": "rad"}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"pressure_bar_abs": 20.0}, "pressure 20 bar is outside"),
        ({"pressure_bar_abs": []}, "no pressure is given"),
        ({"pressure_bar_abs": [1.6, 2.0], "transient": "spin-up"}, "one pressure"),
        (
            {"pressure_bar_abs": 2.0, "duration_s": 0.1},
            "duration_s is that of a run in time: say transient, or leave it",
        ),
        ({"pressure_bar_abs": 2.0, "transient": "spin-up", "duration_s": 0.0}, "duration_s: expected 0.001 to 60 s"),
        ({"pressure_bar_abs": 2.0, "transient": "spin-up", "duration_s": float("inf")}, "to 60 s; given inf"),
        ({"pressure_bar_abs": 2.0, "transient": "spinup"}, "expected 'spin-up' or 'coast-down'"),
        ({"pressure_bar_abs": 2.0, "values": {"f_overal": 0.06}}, "did you mean 'f_overall'"),
        ({"pressure_bar_abs": 2.0, "motor": "nowhere"}, "nowhere.toml"),
    ],
)
def test_what_cannot_be_simulated_is_told_in_a_sentence(wrong, words):
    with pytest.raises(ValueError, match=r"\w") as told:
        sb.simulate(**wrong)
    assert words in str(told.value)


def test_a_fit_is_a_table_and_samples_with_units(post):
    row = post.table.loc["f_overall"]
    assert row["unit"] == "N m s"
    assert row["q05"] < row["q50"] < row["q95"]
    assert post.samples["f_overall"].mean() == pytest.approx(row["mean"])
    assert post.samples.attrs["units"]["f_overall"] == "N m s"
    check(post.as_json())
    assert post.sentence.startswith("f_overall is 0.06")


def test_a_fit_still_has_what_the_fit_of_the_room_has(post):
    assert post.posterior["f_overall"].mean == post.table.loc["f_overall", "mean"]
    assert post.quality.model_fits
    assert (post.motor.name, post.settings.seed, post.effects) == ("ptm3600", 1, ())
    assert post.recordings == (post.recording,)


def test_a_fit_shows_itself_in_a_notebook(post):
    assert "f_overall is 0.06" in post._repr_html_()
    assert "port_lap" in post._repr_html_()
    assert post.plot()._repr_png_().startswith(PNG)


@pytest.mark.long
def test_arviz_is_had_though_another_program_imports_it_at_the_same_moment(tmp_path):
    """The file in which it notes the day is taken away in between; the second time it is there."""
    program = """
import pathlib
replace, calls = pathlib.Path.replace, []
def taken_away(self, target):
    calls.append(target)
    if len(calls) == 1:
        raise FileNotFoundError(2, "taken away", str(self))
    return replace(self, target)
pathlib.Path.replace = taken_away
from spinbench.api.arviz_data import arviz_module
print(arviz_module().__name__, len(calls))
"""
    home = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=home, check=False)
    assert done.stdout == "arviz 2\n", done.stderr


def test_arviz_reads_the_draws_and_finds_them_as_good_as_the_sampler_does(post, tmp_path):
    arviz = arviz_module()
    data = arviz.from_netcdf(post.to_netcdf(tmp_path / "new" / "posterior.nc"))
    told = arviz.summary(data, var_names=["f_overall"], round_to="none").loc["f_overall"]
    assert told["mean"] == pytest.approx(post.table.loc["f_overall", "mean"])
    assert told["r_hat"] < 1.02
    chain = post.posterior.chain
    at = [one.unknown.name for one in post.posterior.estimates].index("f_overall")
    assert told["ess_bulk"] == pytest.approx(chain.effective[at], rel=0.5)
    assert data.posterior["f_overall"].attrs["units"] == "N m s"
    assert data.posterior.sizes["chain"] == chain.samples.shape[0]
    assert float(data.prior["f_overall"].std()) > 10.0 * float(data.posterior["f_overall"].std())
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["posterior.nc"]


class Absent:
    """No package can be imported anew."""

    def find_spec(self, name, path=None, target=None):
        raise ModuleNotFoundError(f"No module named '{name}'", name=name)


@pytest.mark.parametrize("package", ["arviz", "xarray"])
def test_draws_without_their_package_say_what_to_install(post, tmp_path, monkeypatch, package):
    monkeypatch.delitem(sys.modules, package, raising=False)
    monkeypatch.setattr(sys, "meta_path", [Absent()])
    with pytest.raises(ImportError) as told:
        post.draws if package == "xarray" else post.to_netcdf(tmp_path / "posterior.nc")
    assert f"needs the package {package}, which is not installed" in str(told.value)
    assert str(told.value).endswith('`pip install "spinbench[notebook]"`')
    assert not list(tmp_path.iterdir())


def test_a_recording_that_is_given_twice_is_refused():
    for call in (sb.fit, sb.diagnose):
        with pytest.raises(sb.RecordingError, match="given twice"):
            call(["published_sweep", sb.published_sweep()])
        with pytest.raises(sb.RecordingError, match="no recording is given"):
            call([])
        with pytest.raises(TypeError, match="a dict is no recording; give a path"):
            call({})


@pytest.mark.parametrize(
    ("after", "kind", "says"),
    [
        ("published_sweep", sb.RecordingError, "given twice"),
        (["published_sweep"], TypeError, "a list is no recording; give a path"),
        ("nowhere", sb.RecordingError, "there is no folder 'nowhere'"),
    ],
)
def test_what_cannot_be_compared_is_told_in_a_sentence(after, kind, says):
    with pytest.raises(kind, match=says):
        sb.compare("published_sweep", after)


def test_what_is_held_out_is_one_recording(put_recording):
    one, two = (put_recording(("sweep.csv", "steady", CENSORED), name=name) for name in ("one", "two"))
    (two / "sweep.csv").write_text(CENSORED.replace("44.0", "45.0"), encoding="utf-8")
    with pytest.raises(sb.RecordingError, match="2 recordings are given, and one is predicted"):
        sb.diagnose("published_sweep", hold_out=[one, two])
    with pytest.raises(sb.RecordingError, match="is to be held out and diagnosed"):
        sb.diagnose("published_sweep", hold_out=sb.published_sweep())


def test_a_run_that_is_held_out_for_nothing_is_told():
    seen, unseen = (rotor(np.random.default_rng(seed)) for seed in (3, 2))
    found = sb.diagnose(seen, hold_out=replace(unseen, folder=Path("unseen")))
    assert found.verdict == "consistent"
    assert "unseen was not predicted: there is no set of effects to do it with" in found.remarks


def test_a_run_that_was_predicted_no_better_is_not_said_to_be_left_unpredicted():
    refused: Any = SimpleNamespace(unseen_run=object(), held_out=None)
    assert not_predicted(rotor(np.random.default_rng(2)), refused) == []


def test_a_test_without_a_command_says_what_it_needs():
    told = {"test": "read the flow beside a reference", "needs": "a reference flow meter (1 %)", "command": ""}
    (row,) = of_next_tests({"next_tests": [told]}).to_dict("records")
    assert {key: row[key] for key in told} == told


def test_readings_are_left_out_and_it_is_said():
    kept = sb.without("published_sweep", "sweep.csv:7")
    assert np.isnan(kept.files[0].columns["flow_l_min"].values[6])
    found = sb.diagnose(kept)
    assert found.verdict == "consistent"
    assert any("sweep.csv:7: left out" in words for words in found.remarks)
    (same,) = sb.without(["published_sweep"], ["sweep.csv:7"])
    assert same.sha256 == kept.sha256


def test_an_effect_of_each_recording_that_a_fit_does_not_hold_is_told_in_words_of_no_command(tmp_path):
    days = [sweep(tmp_path / name, seed, {}).folder for seed, name in enumerate(("one", "two"), 21)]
    with pytest.raises(ValueError, match=r"^windage .* the model does not hold it; add it to the effects$"):
        sb.fit(days, per_recording="windage")


def test_the_runs_of_a_folder_are_listed_by_its_name(run):
    assert [row.name for row in sb.list_runs(str(run.folder.parent))] == [run.name]


def test_one_effect_may_be_given_as_a_text():
    with pytest.raises(ValueError, match="windgage"):
        sb.fit("published_sweep", effects="windgage")


def test_a_diagnosis_says_what_is_missing_with_its_size():
    found = sb.diagnose(rotor(np.random.default_rng(1), torque=lambda speed: np.full_like(speed, 0.02)))
    assert (found.verdict, found.effects) == ("named", ["coulomb_friction"])
    (size,) = found.table.to_dict("records")
    assert (size["parameter"], size["unit"]) == ("torque_nm", "N m")
    assert size["q05"] < 0.02 < size["q95"]
    assert found.sets["effects"].iloc[0] == "coulomb_friction"
    check(found.document)
    assert "dry friction" in found._repr_html_()
    assert found.plot()._repr_png_().startswith(PNG)


def test_the_document_of_a_diagnosis_is_that_of_the_command_and_can_be_gone_on_with(tmp_path, spinbench_here):
    swept = Path(shutil.copytree(sb.published_sweep(), tmp_path / "swept"))
    kept, _ = sb.without([swept, rotor(np.random.default_rng(1))], "swept/sweep.csv:7")
    told = sb.diagnose(kept).document
    check(told)
    saved = tmp_path / "deep" / "told.json"
    saved.parent.mkdir()
    saved.write_text(json.dumps(told), encoding="utf-8")
    again = spinbench_here("diagnose", "--continue", saved, "swept", cwd=tmp_path)
    assert "a recording is given twice: swept;" in again.stderr
    done = spinbench_here("diagnose", "swept", "--without", "sweep.csv:7", "--json", "-", cwd=tmp_path)
    told["recordings"][0]["folder"] = "swept"
    assert json.loads(json.dumps(told)) == json.loads(done.stdout)


def test_a_diagnosis_of_what_lies_in_no_folder_does_not_say_what_it_is_of():
    found = sb.diagnose(rotor(np.random.default_rng(3)))
    assert (found.recordings, "recordings" in found.document) == ((), False)


def test_a_diagnosis_of_the_motor_draws_its_picture():
    found = sb.diagnose("published_sweep")
    assert found.verdict == found.document["verdict"]
    assert found.plot()._repr_png_().startswith(PNG)
    with pytest.raises(sb.RecordingError, match="there are published_sweep"):
        found.plot("june")


def machine(kind: str) -> type:
    return type("Mine", (), {"kind": kind})


def table(kind: str) -> type[sb.MotorTable]:
    return type("MineTable", (sb.MotorTable,), {"__annotations__": {"kind": Literal[kind]}, "__module__": __name__})


@pytest.mark.parametrize(
    ("system", "keys", "words"),
    [
        ("free_rotor", "free_rotor", "the kind 'free_rotor' comes with the program"),
        ("radial_piston", "radial_piston", "comes with the program"),
        ("tank", "vessel", 'MineTable: expected kind: Literal["tank"]'),
    ],
)
def test_a_machine_that_cannot_be_added_is_told(system, keys, words):
    with pytest.raises(sb.RecordingError) as told:
        sb.add_system(machine(system), table(keys))
    assert words in str(told.value)
    assert set(systems()) == {"free_rotor", "driven_axis", "displacement_machine"}


@pytest.mark.long
def test_a_fit_of_two_recordings_takes_their_runs_in_time_too(tmp_path):
    arviz = arviz_module()
    days = [sweep(tmp_path / name, seed, {}).folder for seed, name in enumerate(("one", "two"), 21)]
    add_coast_down(days[0], 21, {})
    toml = days[1] / "recording.toml"
    toml.write_text(toml.read_text(encoding="utf-8").replace("abs = 1.01325", "abs = 1.009"), encoding="utf-8")
    post = sb.fit([sb.open(days[0]), str(days[1])], sb.Settings(seed=1, effective_samples=200, most_steps=400))
    assert post.found.in_time
    told = arviz.from_netcdf(post.to_netcdf(tmp_path / "posterior.nc")).posterior
    sampled = post.posterior.chain.samples.shape[-1]
    assert list(told.data_vars) == list(post.table.index[:sampled])
    assert len(post.table) > sampled
    assert list(post.samples.columns) == list(post.table.index)
    assert post.plot()._repr_png_().startswith(PNG)
    assert not sb.fit(days[0], sb.Settings(seed=1, effective_samples=200), steady_only=True).found.in_time


@pytest.mark.long
def test_a_type_checker_sees_what_the_names_are(tmp_path):
    script = tmp_path / "script.py"
    names = ('sb.fit("x").table', "sb.open", "sb.System")
    script.write_text(
        "\n".join(["import spinbench as sb", *(f"reveal_type({one})" for one in names)]), encoding="utf-8"
    )
    told = subprocess.run([sys.executable, "-m", "mypy", str(script)], capture_output=True, text=True, timeout=600)
    for words in ("DataFrame", "spinbench.api.opened.Opened", "calibration.systems.machines.system.System"):
        assert words in told.stdout
    assert "Any" not in told.stdout


@pytest.mark.long
def test_a_type_checker_takes_the_machine_of_the_tutorial_for_a_system(tmp_path):
    script = tmp_path / "script.py"
    code = "\n".join(cell.code for cell in cells_of("docs/tutorials/own-machine.md"))
    script.write_text(code.replace("def record(folder, leak)", RECORD), encoding="utf-8")
    told = subprocess.run([sys.executable, "-m", "mypy", str(script)], capture_output=True, text=True, timeout=600)
    assert told.stdout == "Success: no issues found in 1 source file\n"


@pytest.mark.parametrize(
    ("call", "kind", "says"),
    [
        (lambda: sb.fit("published_sweep", {"seed": 1}), TypeError, "settings: expected Settings"),
        (lambda: sb.open(None), TypeError, "path: expected a folder, as text or a Path; given None"),
        (lambda: sb.open(["a", "b"]), TypeError, "path: expected a folder"),
        (lambda: sb.without("published_sweep", 7), TypeError, "left_out: expected a text, or a list of texts; given 7"),
        (lambda: sb.without("published_sweep", [7]), TypeError, "left_out: expected a text"),
        (lambda: sb.Settings(effective_samples=-5), ValueError, "effective_samples: expected 0 or more; given -5"),
        (lambda: sb.Settings(seed="a"), TypeError, "seed: expected a whole number; given 'a'"),
        (lambda: sb.fit("published_sweep", sb.Settings(effective_samples=5)), ValueError, "effective_samples.* 200 or"),
        (lambda: sb.diagnose("published_sweep", workers=0), ValueError, "workers: expected 1 or more; given 0"),
        (lambda: sb.diagnose("published_sweep", seed=-1), ValueError, "^seed: expected 0 or more; given -1"),
        (lambda: sb.diagnose("published_sweep", seed=None), TypeError, "^seed: expected a whole number; given None"),
        (lambda: sb.compare("a", "b", seed=-1), ValueError, "^seed: expected 0 or more; given -1"),
        (lambda: sb.compare("a", "b", seed=None), TypeError, "^seed: expected a whole number; given None"),
        (lambda: sb.simulate(2.0, values=["f_overall=0.06"]), TypeError, "^values: expected a mapping, such as"),
        (lambda: sb.fit("published_sweep", values=["f_overall=0.06"]), TypeError, "^values: expected a mapping"),
        (lambda: sb.simulate(2.0, motor=5), TypeError, "^motor: expected a name, a file or a Motor; given 5"),
        (lambda: sb.together([]), sb.RecordingError, "no recording is given; name one or more"),
        (lambda: sb.together(["a", "b"]), TypeError, "a str is no recording; give what `read_recording` gives"),
        (lambda: sb.compare("a", "b", workers=0.5), TypeError, "workers: expected a whole number; given 0.5"),
        (lambda: sb.open("nothere", logs="none"), sb.RecordingError, "say with logs=... where runs are"),
        (lambda: sb.without("published_sweep", "sweep.csv:99"), sb.RecordingError, "^left_out: sweep.csv:99: '99'"),
        (lambda: sb.simulate(2.0, values={"f_overal": 0.06}), ValueError, "^values: f_overal: no such parameter"),
        (lambda: sb.fit("published_sweep", values={"f_overal": 0.06}), ValueError, "^values: f_overal: no such"),
    ],
)
def test_an_argument_of_another_kind_is_refused_by_its_name(call, kind, says):
    with pytest.raises(kind, match=says):
        call()
