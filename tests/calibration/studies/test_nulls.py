"""The null calibration of the diagnosis's test, in small; `make nulls` is the campaign."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from calibration.diagnosis import diagnose
from calibration.diagnosis.mismatch import detect_mismatch
from calibration.diagnosis.steps.detect import rarity
from calibration.studies import campaigns, nulls_draw, nulls_table
from calibration.studies.campaigns import OtherCodeError, main, with_same_code
from calibration.studies.nulls import STUDY, p_of_null
from calibration.unknowns.priors import at_ambient
from model.layout import L_MIN, RPM
from model.motor import QUANTITIES, read_motor
from model.solvers import steady
from rig.recording import read_recording, write_recording
from rig.recording.columns import OF_CHANNEL

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
SEED = 7_000
COUNT = 4
PATIENCE_S = 120.0
WINDAGE = {"windage": {"drag_nm_s2": 5e-4}}
LEAK = {"leakage": {"conductance_kg_s_pa2": 1e-13}}


def argument(seed, concealed=None, noise="declared"):
    said = {"noise": noise, "with_runs": False, "seed": seed}
    return said | ({"concealed": concealed} if concealed else {})


def campaign(folder, count=COUNT, workers=0):
    """Make a small campaign; the arguments that do."""
    given = ["-o", str(folder), "--sweeps", str(count), "--with-runs", "0", "--noise", "declared"]
    given += ["--first-seed", str(SEED), "--workers", str(workers)]
    assert main(STUDY, given) == 0
    return given


def files_of(folder):
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in (folder / "results").glob("*.json")}


def p_values(folder):
    from pyarrow import parquet

    return parquet.read_table(folder / "nulls.parquet").column("p_value").to_pylist()


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A small campaign that nothing interrupted, made in this process."""
    folder = tmp_path_factory.mktemp("finished")
    campaign(folder)
    return folder


@pytest.mark.parametrize("noise", nulls_draw.NOISES)
def test_a_null_shows_what_its_instruments_can(noise):
    recording, _ = nulls_draw.null_recording(noise, False, np.random.default_rng(1))
    assert recording.files[0].direction.tolist() == ["up"] * 13 + ["down"] * 13
    for name in ("pressure_bar_abs", "flow_l_min", "speed_rpm"):
        steps = recording.files[0].columns[name].values / recording.channels[name].resolution
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_a_null_is_what_the_model_gives_for_its_truth():
    recording, truth = nulls_draw.null_recording("declared", False, np.random.default_rng(3))
    parameters = {name: truth[name] for name in QUANTITIES if name in truth}
    motor = at_ambient(read_motor("ptm3600"), recording).with_values(parameters)
    sweep = recording.files[0]
    levels = np.concatenate([nulls_draw.LEVELS_BAR, nulls_draw.LEVELS_BAR[::-1]])
    pressure = (levels - truth["pressure_offset"]) / (1.0 + truth["pressure_scale"])
    state = steady.steady(motor, pressure * 1e5)
    for name, exact in (("flow", state.flow_m3_s[0] * L_MIN), ("speed", state.speed_rad_s[0] * RPM)):
        column = OF_CHANNEL[name].column
        figures = recording.channels[column]
        shown = exact * (1.0 + truth[f"{name}_scale"]) + truth[f"{name}_offset"]
        off = (sweep.columns[column].values - shown) / np.hypot(figures.noise_sd, figures.resolution / np.sqrt(12.0))
        assert 0.5 < np.std(off) < 1.5
        assert np.max(np.abs(off)) < 4.5


def test_a_null_with_runs_starts_from_rest_and_comes_to_rest_and_is_a_recording(tmp_path):
    recording, truth = nulls_draw.null_recording("declared", True, np.random.default_rng(2))
    write_recording(recording, tmp_path / "null")
    sweep, spin_up, coast_down = read_recording(tmp_path / "null").files
    assert sweep.kind == "steady"
    assert spin_up.columns["speed_rpm"].values[:10].max() < 5.0 < spin_up.columns["speed_rpm"].values[-1]
    speed = coast_down.columns["speed_rpm"].values
    assert speed[-1] < 0.1 * speed[0]
    vented = coast_down.columns["pressure_bar_abs"].values[coast_down.columns["supply_open"].values < 0.5]
    assert np.mean(vented[-20:]) == pytest.approx(truth["ambient_pressure"] / 1e5, abs=0.02)
    assert 0.0 < truth["coast_down.csv.venting_time"] < 1.0


@pytest.mark.parametrize("noise", nulls_draw.NOISES)
def test_noise_of_every_class_has_the_declared_size_and_its_own_form(noise):
    found = nulls_draw.unit_noise(noise, 40_000, np.random.default_rng(5))
    assert np.std(found) == pytest.approx(1.0, abs=0.05)
    between = np.mean(found[1:] * found[:-1])
    assert between == pytest.approx(nulls_draw.CORRELATION if noise == "correlated" else 0.0, abs=0.03)
    far = np.mean(np.abs(found) > 4.0)
    assert (far > 1e-3) == (noise == "heavy")


def test_only_misdeclared_noise_is_off_and_only_a_coarse_instrument_says_it_is():
    factors = {}
    for noise in nulls_draw.NOISES:
        recording, truth = nulls_draw.null_recording(noise, False, np.random.default_rng(6))
        factors[noise] = truth["flow_noise_factor"]
        coarse = recording.channels["flow_l_min"].resolution == recording.channels["flow_l_min"].noise_sd
        assert coarse == (noise == "coarse")
    assert [noise for noise, factor in factors.items() if factor != 1.0] == ["misdeclared"]


def test_an_unknown_class_of_noise_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match="'pink' is no class of noise; there are declared, misdeclared"):
        nulls_draw.template("pink", False)


def test_the_p_value_counted_is_the_diagnosis_s_own():
    recording, _ = nulls_draw.null_recording("declared", False, np.random.default_rng(8))
    whole = diagnose(recording, 5)
    assert whole.verdict.kind == "consistent"
    assert detect_mismatch(recording, np.random.default_rng(5)).detection.p_value == whole.detection.p_value


@pytest.mark.parametrize("effect", [WINDAGE, LEAK], ids=["windage", "leakage"])
def test_an_effect_smuggled_into_a_null_shows_as_a_small_p(effect):
    seeds = range(SEED, SEED + 3)
    concealed = [p_of_null(argument(seed, effect)) for seed in seeds]
    assert np.median([one["p_value"] for one in concealed]) < 1e-4


def test_nulls_without_an_effect_have_p_values_all_over(finished):
    p = p_values(finished)
    assert len(p) == COUNT
    assert min(p) > 1e-3
    assert max(p) - min(p) > 0.1


def test_results_do_not_depend_on_the_number_of_workers(finished, tmp_path):
    campaign(tmp_path, 3, 2)
    assert p_values(tmp_path) == p_values(finished)[:3]


def test_classes_and_seeds_draw_different_nulls():
    drawn = {
        p_of_null(argument(seed, noise=noise))["truth"]["f_overall"]
        for seed, noise in ((1, "declared"), (2, "declared"), (1, "coarse"))
    }
    assert len(drawn) == 3


@pytest.mark.parametrize("blow", [signal.SIGINT, signal.SIGKILL])
def test_a_campaign_that_is_stopped_goes_on_where_it_was(finished, tmp_path, blow):
    command = [
        sys.executable,
        "-m",
        "calibration.studies.nulls",
        "-o",
        str(tmp_path),
        "--sweeps",
        "200",
        "--with-runs",
        "0",
    ]
    command += ["--noise", "declared", "--first-seed", str(SEED), "--workers", "1"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    running = subprocess.Popen(command, cwd=ROOT, env=environment, stderr=subprocess.PIPE)
    end = time.monotonic() + PATIENCE_S
    while not list((tmp_path / "results").glob("declared-*.json")):
        assert running.poll() is None and time.monotonic() < end, "no null was ever made"
        time.sleep(0.02)
    running.send_signal(blow)
    told = running.communicate(timeout=PATIENCE_S)[1].decode()
    assert ("the same command goes on" in told) == (blow == signal.SIGINT)
    before = files_of(tmp_path)
    assert 1 <= len(before) < 200
    campaign(tmp_path)
    after = files_of(tmp_path)
    assert {name: after[name] for name in before} == before
    assert p_values(tmp_path) == p_values(finished)


def test_a_worker_with_other_code_gives_no_result():
    assert with_same_code(STUDY.roots, STUDY.code(), len, "four") == 4
    with pytest.raises(OtherCodeError):
        with_same_code(STUDY.roots, "another", len, "four")


def test_a_campaign_whose_worker_has_other_code_says_nothing(tmp_path, monkeypatch):
    given = SimpleNamespace(out=tmp_path, workers=0, scheduler=None, first_seed=SEED)
    asked = SimpleNamespace(sweeps=1, with_runs=0, noise=["coarse"], first_seed=SEED)
    items = STUDY.items(asked, STUDY.code())
    monkeypatch.setattr(campaigns, "imported_sha256", lambda *roots: "another")
    monkeypatch.setattr(campaigns.Study, "code", lambda study: "ours")
    with pytest.raises(OtherCodeError, match="the code was changed while"):
        campaigns.run(STUDY, items, given, lambda *told: None)
    assert not (tmp_path / "nulls.json").exists()


def test_every_null_s_result_is_marked_with_the_code():
    asked = SimpleNamespace(sweeps=2, with_runs=1, noise=["coarse"], first_seed=SEED)
    items = STUDY.items(asked, "code")
    assert [item.name for item in items] == [f"coarse-{SEED}", f"coarse-{SEED + 1}", f"coarse_with_runs-{SEED}"]
    assert {item.mark for item in items} == {"code"}


def rows_of(p, name="declared"):
    return [
        {"class": name, "p_value": one, "seconds": 1.0, "error": "" if one is not None else "it broke"} for one in p
    ]


def test_the_band_holds_99_per_cent_of_the_counts_of_a_calibrated_test():
    counts = np.random.default_rng(9).binomial(1000, 0.05, 100_000)
    low, high = nulls_table.binomial_band(1000, 0.05)
    assert np.mean((counts < low) | (counts > high)) < 0.0105
    assert np.mean((counts <= low) | (counts >= high)) > 0.0095


def test_uniform_p_values_lie_within_the_bands_and_failures_are_counted_apart():
    uniform = [*((np.arange(1000) + 0.5) / 1000), None, None]
    one = nulls_table.summary(rows_of(uniform), SEED, "code")["classes"]["declared"]
    assert (one["nulls"], one["failed"], one["errors"]) == (1002, 2, {"it broke": 2})
    assert [one["rates"][alpha]["hits"] for alpha in ("0.01", "0.05")] == [10, 50]
    assert all(rate["inside"] and rate["low"] < rate["share"] < rate["high"] for rate in one["rates"].values())
    assert one["ks_p_value"] > 0.99


@pytest.mark.parametrize("power", [0.5, 2.0])
def test_p_values_that_are_too_large_or_too_small_lie_outside(power):
    found = nulls_table.summary(rows_of(((np.arange(1000) + 0.5) / 1000) ** power), SEED, "code")
    one = found["classes"]["declared"]
    assert not any(rate["inside"] for rate in one["rates"].values())
    assert one["ks_p_value"] < 1e-6
    assert "**no**" in nulls_table.table(found)


def test_a_class_that_failed_altogether_is_shown_as_such():
    rows = rows_of([None, None], "heavy_with_runs")
    found = nulls_table.summary(rows, SEED, "code")
    assert "| heavy_with_runs | 2 | 2 | - | - | - | - | - | 1.0 |" in nulls_table.page(found)
    assert "2 times it broke" in nulls_table.page(found)
    assert nulls_table.picture(rows).startswith(b"\x89PNG")


def test_the_page_is_written_only_where_it_is_asked_for(finished, capsys):
    page = finished / "page"
    given = campaign(finished)
    assert not page.exists()
    assert main(STUDY, [*given, "--page", str(page)]) == 0
    assert sorted(path.name for path in page.iterdir()) == ["nulls.json", "nulls.md", "nulls.png"]
    assert f"Seeds: {SEED}" in (page / "nulls.md").read_text(encoding="utf-8")
    assert f"| declared | {COUNT} | 0 |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--sweeps", "0", "--with-runs", "0"], "nothing to do"),
        (["--sweeps", "-3"], "'-3' is not a whole number of 0 or more"),
        (["--noise", "pink"], "invalid choice: 'pink'"),
    ],
)
def test_a_command_that_cannot_be_done_is_refused_in_a_line(given, said, tmp_path, capsys):
    try:
        code = main(STUDY, ["-o", str(tmp_path / "out"), *given])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_rarity_of_a_statistic_is_a_probability():
    """Draws and statistics of one law: each level is passed as often as it says, in the fitted tail too."""
    rng = np.random.default_rng(5)
    found = np.array([rarity(float(rng.exponential()), rng.exponential(size=200))[0] for _ in range(5000)])
    for level in (0.5, 0.05, 0.01, 0.002):
        low, high = binom.ppf([0.0005, 0.9995], found.size, level)
        assert low <= np.sum(found < level) <= high, level
