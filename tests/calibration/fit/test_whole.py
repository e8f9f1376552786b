"""The fit of everything measured: plateaus, runs in time, several recordings; by commands and in its parts."""

from __future__ import annotations

import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from calibration import fit_quality
from calibration.fit import moves, surrogate, whole
from calibration.fit.integrated import Integrated
from calibration.fit.sampling import Begun, Settings, sample
from calibration.fit.surrogate import Surrogate, scattered, simulated, wanted
from calibration.fit.transport import TransportMap
from calibration.fleet import fit_all
from calibration.likelihood.mode import minus_log_posterior
from calibration.report.fit import whole as whole_page
from calibration.studies.strata_draw import STRATA, case_of
from calibration.systems.look_up import compared
from calibration.systems.radial_piston.predict.kinds import FLOW
from model.motor import read_motor
from rig.recording import read_recording
from tests.densities import log_normal
from tests.diagnosis_recordings import add_coast_down, sweep
from tests.documents import check

SPINBENCH = Path(sys.executable).with_name("spinbench")
BRIEF = ("--effective-samples", "400")
KEPT = {"one": 3, "two": 5}  # every so many rows of its sweep


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """Two days of the default motor, nothing concealed: `one` with a coast-down, `two` in another room."""
    folder = tmp_path_factory.mktemp("bench")
    for seed, (name, every) in enumerate(KEPT.items(), 21):
        sweep(folder / name, seed, {})
        header, *rows = (folder / name / "sweep.csv").read_text().splitlines()
        (folder / name / "sweep.csv").write_text("\n".join([header, *rows[:13:every]]) + "\n")
    add_coast_down(folder / "one", 21, {})
    toml = folder / "two" / "recording.toml"
    toml.write_text(toml.read_text().replace("pressure_bar_abs = 1.01325", "pressure_bar_abs = 1.009"))
    return folder


@pytest.fixture(scope="module")
def fitted(bench, spinbench_anywhere) -> subprocess.CompletedProcess[str]:
    return spinbench_anywhere("fit", "one", "two", "-o", "out", "--json", "fit.json", *BRIEF, cwd=bench)


@pytest.fixture(scope="module")
def found(fitted, bench) -> dict:
    assert fitted.returncode == 0, fitted.stderr
    return json.loads((bench / "fit.json").read_text())


# Two days and a run in time


@pytest.mark.long
@pytest.mark.slow
def test_the_chain_of_another_motor_is_not_gone_on_with(found, bench, spinbench_here):
    done = spinbench_here("fit", "one", "two", "-o", "out", "--set", "piston_length=30", *BRIEF, cwd=bench)
    assert (done.returncode, "holds the chain of another recording, motor" in done.stderr) == (2, True)


@pytest.mark.long
@pytest.mark.slow
def test_joined_recordings_go_on_with_the_chain_of_their_own_readings_alone(tmp_path, spinbench_here):
    for seed, name in enumerate(("one", "two"), 3):
        sweep(tmp_path / name, seed, {})
    few = ("fit", "one", "two", "-o", "out", "--effective-samples", "200")
    assert spinbench_here(*few, cwd=tmp_path).returncode == 0
    done = spinbench_here(*few, "--without", "two/sweep.csv:3", cwd=tmp_path)
    assert (done.returncode, "holds the chain of another recording, motor" in done.stderr) == (2, True)


@pytest.mark.long
@pytest.mark.slow
def test_f_overall_holds_the_truth_and_the_run_narrows_it(found, bench, spinbench_here):
    true = read_motor("ptm3600")["f_overall"].value
    one = found["parameters"]["f_overall"]
    assert one["q05"] < true < one["q95"]
    few = ("--effective-samples", "200")
    done = spinbench_here("fit", "one", "--steady-only", "--json", "steady.json", *few, cwd=bench)
    assert done.returncode == 0, done.stderr
    alone = json.loads((bench / "steady.json").read_text())
    assert one["sd"] < alone["parameters"]["f_overall"]["sd"]
    used = {file["file"]: file["rows_used"] for file in alone["files"]}
    assert used["coast_down.csv"] == 0 and used["sweep.csv"] == 5


@pytest.mark.long
@pytest.mark.slow
def test_many_fit_fits_what_fit_fits(bench, tmp_path):
    few = Settings(effective_samples=10, most_steps=60, walkers=160, times_tau=0.1)
    (row,) = fit_all([bench / "one"], read_recording, few, False, tmp_path, 0, None, lambda *_: None)
    assert not row["error"]
    assert row["inertia_sd"] > 0.0  # no plateau tells of it
    assert row["model_fits"] is True


@pytest.mark.long
@pytest.mark.slow
def test_what_is_of_a_day_has_its_name_and_what_is_shared_has_none(found):
    names = set(found["parameters"])
    assert {"f_overall", "port_lap", "roller_friction"} <= names
    assert {"one: ambient_pressure", "two: ambient_pressure", "one: pressure_offset", "two: pressure_offset"} <= names
    assert "ambient_pressure" not in names
    assert found["parameters"]["one: ambient_pressure"]["q50"] > found["parameters"]["two: ambient_pressure"]["q50"]


@pytest.mark.long
@pytest.mark.slow
def test_its_json_is_posterior_1_with_every_file(found):
    check(found)
    assert found["convergence"]["rhat_max"] <= 1.01 and found["convergence"]["ess_min"] >= 400
    assert found["fit_quality"]["model_fits"] is True
    files = {file["file"]: file["rows_used"] for file in found["files"]}
    assert files["one/coast_down.csv"] > 20 and files["one/sweep.csv"] == 5 and files["two/sweep.csv"] == 3


@pytest.mark.long
@pytest.mark.slow
def test_its_report_shows_the_run_in_time_and_holds_sampling_against_laplace(fitted, found, bench):
    page = (bench / "out" / "report.html").read_text()
    assert "coast_down.csv" in page
    assert page.count("data:image/png") >= 3
    assert "Laplace" in page
    assert "Traceback" not in fitted.stderr


def test_a_channel_that_no_plateau_was_read_of_has_no_panel(tmp_path, monkeypatch):
    sweep(tmp_path / "one", 3, {})
    comparison = compared(read_recording(tmp_path / "one"))
    comparison.known[comparison.kind == FLOW] = False
    found = SimpleNamespace(comparison=comparison, bands=np.zeros((5, comparison.read.size)))
    monkeypatch.setattr(whole_page.page, "on_the_picture", lambda _: "f_overall")
    labels = [axes.get_ylabel() for axes in whole_page.plateaus(found).axes]
    assert labels == ["speed (rpm)", "residual (rpm)"]


@pytest.mark.long
@pytest.mark.slow
def test_a_fit_that_is_killed_goes_on_to_the_same_posterior(found, bench, spinbench_here):
    arguments = ["fit", "one", "two", "-o", "again", "--json", "again.json", *BRIEF]
    process = subprocess.Popen([SPINBENCH, *arguments], cwd=bench, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    give_up = time.monotonic() + 300.0
    while not (bench / "again" / "chain" / "block_00001.npz").exists():
        assert process.poll() is None and time.monotonic() < give_up
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert not (bench / "again.json").exists()
    assert spinbench_here(*arguments, cwd=bench).returncode == 0
    again = json.loads((bench / "again.json").read_text())
    assert again["parameters"] == found["parameters"]


@pytest.mark.long
@pytest.mark.slow
def test_another_set_of_recordings_is_another_fit(found, bench, spinbench_here):
    done = spinbench_here("fit", "one", "-o", "out", *BRIEF, cwd=bench)
    assert done.returncode == 2
    assert "holds the chain of another recording, motor, setting or version" in done.stderr.splitlines()[-1]


# Refusals

REFUSED = {
    "twice": (("one", "one"), "given twice"),
    "effect_unknown": (("one", "two", "--effects", "widnage"), "the nearest is windage"),
    "effect_unseen": (("two", "two/../one", "--effects", "tachometer_lag", "--steady-only"), "tachometer_lag"),
    "missing": (("one", "gone"), "gone"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_bad_input_is_refused_in_words_and_nothing_is_written(bench, spinbench_here, name):
    arguments, words = REFUSED[name]
    done = spinbench_here("fit", *arguments, "-o", "refused", "--json", "refused.json", cwd=bench)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (bench / "refused").exists() and not (bench / "refused.json").exists()


@pytest.mark.long
def test_a_run_that_the_model_cannot_follow_is_no_fit_but_an_error_that_says_so(bench, tmp_path, spinbench_here):
    """A tachometer that skips: its noise would have to be far louder than a fit ever looks."""
    shutil.copytree(bench / "one", tmp_path / "skips")
    run = tmp_path / "skips" / "coast_down.csv"
    header, *rows = run.read_text().splitlines()
    place, rng = header.split(",").index("speed_rpm"), np.random.default_rng(1)
    table = [row.split(",") for row in rows]
    for row in table:
        row[place] = f"{float(row[place]) * rng.uniform(0.5, 1.5):.3f}"
    run.write_text("\n".join([header, *(",".join(row) for row in table)]) + "\n")
    done = spinbench_here("fit", "skips", "-o", "out", "--json", "out.json", *BRIEF, cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "too far out for a fit: speed_noise_scale " in done.stderr
    assert "nor does the model explain the readings" in done.stderr
    assert not (tmp_path / "out").exists() and not (tmp_path / "out.json").exists()
    done = spinbench_here("fit", "skips", "--without", "coast_down.csv", *BRIEF, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


# The parts


def banana(z: np.ndarray) -> np.ndarray:
    """z0 ~ N(0, 1), z1 ~ N(z0^2 / 2, 0.3): means 0 and 1/2, variances 1 and 0.59."""
    found: np.ndarray = log_normal(z[:, 0]) + log_normal(z[:, 1], z[:, 0] ** 2 / 2, 0.3)
    return found


@pytest.mark.long
def test_a_stand_in_that_is_wrong_changes_nothing_of_what_is_sampled():
    def wrong(z: np.ndarray) -> np.ndarray:
        found: np.ndarray = log_normal(z[:, 0], 0.3, 1.2) + log_normal(z[:, 1], 0.4 * z[:, 0] ** 2, 0.4)
        return found

    rng = np.random.default_rng(5)
    first = 0.3 + 1.2 * rng.standard_normal(2000)
    known = np.column_stack([first, 0.4 * first**2 + 0.4 * rng.standard_normal(2000)])
    shape = TransportMap(known, np.ones(2))
    settings = Settings(seed=4, effective_samples=8000, most_steps=3000, walkers=24)
    begun = Begun(known, lambda: moves.delayed(wrong, shape, known))
    chain = sample(banana, 2, np.ones_like, settings, begun=begun)
    assert chain.converged and 0.1 < chain.acceptance < 0.95
    flat = chain.flat()
    np.testing.assert_allclose(flat.mean(axis=0), [0.0, 0.5], atol=0.04)
    np.testing.assert_allclose(flat.var(axis=0), [1.0, 0.59], rtol=0.06)


@pytest.fixture(scope="module")
def target(bench) -> Integrated:
    used, start, quality = fit_quality.judge_whole([read_recording(bench / "one")], 1)
    assert quality.model_fits and len(used) == 1
    return Integrated(start.comparison, start.base)


def least_cost(target: Integrated, z: np.ndarray) -> float:
    """Minus the log posterior of a sampled point, what is the run's own found by steps of the full model."""
    comparison, (full, u) = target.comparison, target.whole(z)
    for _ in range(6):
        prediction = target.f(full)
        white = comparison.whitener(prediction, u)
        r, J = white(comparison.read - comparison.raw(prediction)), white(target.D)
        found = minus_log_posterior(r, white.log_scale, full, u, comparison, found=True)
        A = J.T @ J + np.eye(target.own.size)
        integrated = found + 0.5 * np.linalg.slogdet(A)[1]
        full[target.own] += np.linalg.solve(A, J.T @ r - full[target.own]) - target.off
    return integrated


@pytest.mark.long
@pytest.mark.slow
def test_what_is_integrated_out_in_first_order_is_as_likely_as_the_full_model_finds_it(target):
    mode, n = target.mode, target.shared.size
    root = np.linalg.cholesky(mode.covariance[np.ix_(target.shared, target.shared)])
    top = target.centre()
    for k, sds in itertools.product(range(n), (-0.5, 0.5)):
        z = top.copy()
        z[:n] += sds * root[:, k]
        fallen = target.at(top).log_prob - target.at(z).log_prob
        assert fallen == pytest.approx(least_cost(target, z) - least_cost(target, top), abs=0.1 + 0.1 * abs(fallen))


@pytest.mark.long
def test_the_stand_in_follows_a_bent_valley_to_its_ends():
    """Two sds along it, what the readings tell best is over nine sds off; the profile rises as Laplace has it."""
    comparison = case_of(STRATA["sweep"], 780_000).comparison
    mode = comparison.base()
    target = Integrated(comparison, mode)
    _, drawn = whole.stand_in_for(target, np.random.default_rng(1), Settings(), lambda *_: None)
    place = comparison.problem.place("f_overall")
    sampled = int(np.flatnonzero(target.shared == place)[0])
    assert drawn.flat()[:, sampled].std() == pytest.approx(np.sqrt(mode.covariance[place, place]), rel=0.1)


@pytest.mark.slow
def test_the_stand_in_knows_what_noise_scales_do_together():
    """A quieter gauge and a louder tachometer leave the speeds' scatter as it is."""
    comparison = case_of(STRATA["sweep"], 770_000).comparison
    target = Integrated(comparison, comparison.base())
    stand_in = Surrogate(target, *simulated(target, scattered(target, np.random.default_rng(2), 2 * wanted(target))))
    moved = np.array([[-2.8, 0.0, 3.6], [-1.0, 0.5, 1.0], [2.0, -2.0, 1.0], [0.5, 0.5, -3.0]])
    z = np.repeat(target.centre()[None], 1 + len(moved), axis=0)
    z[1:, target.shared.size :] += moved
    above = stand_in.log_prob(z) - target.log_prob(z)
    above -= above[0]
    assert above[1] < 1.0  # far out it may have too little mass, but none where the posterior has none
    np.testing.assert_allclose(above[2:], 0.0, atol=1.0)


@pytest.mark.long
@pytest.mark.slow
def test_the_stand_in_follows_the_posterior_where_it_was_not_fitted(target, monkeypatch):
    rng = np.random.default_rng(2)
    cloud = scattered(target, rng, 2 * wanted(target) + 100)
    stand_in = Surrogate(target, *simulated(target, cloud[:-100]))
    held = cloud[-100:]
    true = target.log_prob(held)
    near = true > target.log_prob(target.centre()[None, :])[0] - 12.0
    off = true[near] - stand_in.log_prob(held[near])
    assert near.sum() > 30
    assert np.std(off) < 0.5
    monkeypatch.setattr(surrogate, "LEFT_OUT", 1e-9)
    in_all_directions = Surrogate(target, *simulated(target, cloud[:-100])).log_prob(held[near])
    assert np.max(np.abs(stand_in.log_prob(held[near]) - in_all_directions)) < 0.05
