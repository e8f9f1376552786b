"""`spinbench fit` as a person runs it: what it writes, repeats, survives and refuses."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.data import rows_used
from calibration.fit import fit as fits
from calibration.fit.posterior import FAR_OFF
from calibration.fit.sampling import Settings
from calibration.report.fit import page as fit_page
from calibration.report.fit import words as fit_words
from model import layout
from model.motor import read_motor
from model.solvers import steady
from rig.recording import Column, RecordingError, read_recording, write_recording
from tests.diagnosis_recordings import add_coast_down, sweep
from tests.documents import check

ROOT = Path(__file__).resolve().parents[3]
PUBLISHED = ROOT / "logs" / "published_sweep"
PRACTICE = ROOT.parent / "shared" / "practice"
COMMAND = str(Path(sys.executable).parent / "spinbench")
BRIEF = ("--effective-samples", "200")
HEADER = "pressure_bar_abs,flow_l_min,speed_rpm\n"
# Enough for intervals of 99 % and for sds to a few per cent.
QUICK = Settings(seed=1, effective_samples=300, most_steps=2000, walkers=32, times_tau=10.0)


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [COMMAND, "fit", *map(str, arguments)], capture_output=True, text=True, cwd=cwd, timeout=400, check=False
    )


def posterior(path: Path) -> dict:
    """posterior/1 but for the wall time."""
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data.pop("seconds") > 0.0
    return data


def interval(found: fits.Fit, name: str) -> tuple[float, float]:
    """The central 99 % of an unknown."""
    index = [estimate.unknown.name for estimate in found.posterior.estimates].index(name)
    low, high = np.quantile(found.posterior.values[:, index], [0.005, 0.995])
    return float(low), float(high)


# The published sweep


@pytest.fixture(scope="module")
def published(tmp_path_factory) -> Path:
    """A working folder with the published sweep as `bench`, and the JSON of its fit without an output folder."""
    folder = tmp_path_factory.mktemp("published")
    shutil.copytree(PUBLISHED, folder / "bench")
    done = run("bench", "--json", "fit.json", *BRIEF, cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_json_is_posterior_1(published):
    data = json.loads((published / "fit.json").read_text())
    assert list(data) == [
        "format",
        "parameters",
        "convergence",
        "suspect_rows",
        "fit_quality",
        "files",
        "seconds",
    ]
    check(data)
    assert {"f_overall", "port_lap", "roller_friction", "pressure_offset", "flow_scale"} <= set(data["parameters"])
    for parameter in data["parameters"].values():
        assert set(parameter) == {"unit", "mean", "sd", "q05", "q50", "q95"}
        assert parameter["q05"] < parameter["q50"] < parameter["q95"]
    assert set(data["convergence"]) == {"rhat_max", "ess_min", "acceptance", "steps", "walkers", "ensembles"}
    assert all(set(row) == {"file", "row", "channel", "probability"} for row in data["suspect_rows"])


@pytest.mark.slow
def test_the_published_readings_do_not_contradict_the_model(published):
    quality = posterior(published / "fit.json")["fit_quality"]
    assert set(quality) == {"p_value", "model_fits", "why"}
    assert quality["model_fits"] is True
    assert 0.01 < quality["p_value"] < 1.0


@pytest.mark.slow
def test_the_chain_has_converged(published):
    convergence = posterior(published / "fit.json")["convergence"]
    assert convergence["rhat_max"] <= 1.01
    assert convergence["ess_min"] >= 300
    assert convergence["ensembles"] == 4


@pytest.mark.slow
def test_the_flow_at_2_bar_is_the_one_suspect_reading(published):
    (row,) = posterior(published / "fit.json")["suspect_rows"]
    assert (row["file"], row["row"], row["channel"]) == ("sweep.csv", 7, "flow_l_min")
    assert row["probability"] > 0.9


@pytest.mark.slow
def test_f_overall_is_where_the_article_has_it(published):
    """A sanity check, wide on purpose: the article prints 0.0625, and how sure one can be hangs on assumed figures."""
    found = posterior(published / "fit.json")["parameters"]["f_overall"]
    assert found["unit"] == "N m s"
    assert 0.060 < found["mean"] < 0.068
    assert 0.001 < found["sd"] < 0.004


@pytest.fixture(scope="module")
def killed(published) -> tuple[Path, bool]:
    """That folder with the same fit in `out`, killed on the way and started again; whether its first block was kept."""
    process = subprocess.Popen(
        [COMMAND, "fit", "bench", "-o", "out", *BRIEF],
        cwd=published, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    chain = published / "out" / "chain"
    until = time.monotonic() + 120.0
    while len(list(chain.glob("block_*.npz"))) < 3 and process.poll() is None and time.monotonic() < until:
        time.sleep(0.005)
    assert process.poll() is None, process.communicate()[1]
    os.kill(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert not (published / "out" / "posterior.json").exists()
    first = chain / "block_00000.npz"
    before = first.stat().st_mtime_ns
    (chain / "block_00099.partial").write_bytes(b"PK torn")
    done = run("bench", "-o", "out", *BRIEF, cwd=published)
    assert done.returncode == 0, done.stderr
    return published, first.stat().st_mtime_ns == before


@pytest.mark.long
@pytest.mark.slow
def test_a_killed_fit_goes_on_to_the_bits_of_one_without_a_folder(killed):
    folder, kept = killed
    assert kept
    assert posterior(folder / "out" / "posterior.json") == posterior(folder / "fit.json")


@pytest.mark.long
@pytest.mark.slow
def test_its_report_says_that_the_readings_do_not_contradict_the_model(killed):
    folder, _ = killed
    assert "The readings do not contradict the model" in (folder / "out" / "report.html").read_text()


@pytest.mark.long
@pytest.mark.slow
def test_a_finished_fit_run_again_gives_the_same_posterior(killed, spinbench_here):
    folder, _ = killed
    done = spinbench_here("fit", "bench", "-o", "out", "--json", "again.json", *BRIEF, cwd=folder)
    assert done.returncode == 0, done.stderr
    assert posterior(folder / "again.json") == posterior(folder / "fit.json")


@pytest.mark.long
@pytest.mark.slow
def test_the_folder_of_another_recording_is_refused_in_a_line(killed, spinbench_here):
    folder, _ = killed
    shutil.copytree(folder / "bench", folder / "other")
    text = (folder / "other" / "sweep.csv").read_text()
    (folder / "other" / "sweep.csv").write_text(text.replace("374.5", "373.0"))
    before = {path: path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()}
    done = spinbench_here("fit", "other", "-o", "out", *BRIEF, cwd=folder)
    assert done.returncode == 2
    assert "holds the chain of another recording, motor, setting or version" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
    assert {path: path.read_bytes() for path in (folder / "out").rglob("*") if path.is_file()} == before


@pytest.mark.long
@pytest.mark.slow
def test_another_seed_or_motor_is_another_fit(killed, spinbench_here):
    folder, _ = killed
    for change in (("--seed", 2), ("--set", "port_lap=7.5"), ("--speed-only",)):
        assert spinbench_here("fit", "bench", "-o", "out", *change, *BRIEF, cwd=folder).returncode == 2


# A model that is wrong


@pytest.fixture(scope="module")
def windy(tmp_path_factory) -> Path:
    """A working folder with the recording `bench` of five plateaus and a coast-down, windage in both; modest meters."""
    folder = tmp_path_factory.mktemp("windy")
    chosen = {"windage": {"drag_nm_s2": 3e-4}}
    sweep(folder / "bench", 1, chosen)
    add_coast_down(folder / "bench", 1, chosen)
    toml = (folder / "bench" / "recording.toml").read_text()
    toml = toml.replace("noise_sd = 0.0015", "noise_sd = 0.006").replace("noise_sd = 0.4", "noise_sd = 1.0")
    (folder / "bench" / "recording.toml").write_text(toml)
    header, *rows = (folder / "bench" / "sweep.csv").read_text().splitlines()
    (folder / "bench" / "sweep.csv").write_text("\n".join([header, *rows[0:13:3]]) + "\n")
    return folder


@pytest.fixture(scope="module")
def wrong(windy, spinbench_anywhere) -> subprocess.CompletedProcess[str]:
    words = ("bench", "-o", "out", "--json", "fit.json", "--steady-only", *BRIEF)
    return spinbench_anywhere("fit", *words, cwd=windy)


@pytest.mark.slow
def test_a_fit_of_a_model_that_lacks_windage_ends_with_code_5(wrong):
    assert wrong.returncode == 5, wrong.stderr
    assert "Traceback" not in wrong.stderr


@pytest.mark.slow
def test_its_first_sentence_says_so_and_the_next_command_is_given(wrong):
    lines = wrong.stderr.splitlines()
    bar = next(i for i, line in enumerate(lines) if line.startswith("fit: "))
    said = lines[bar + 1 : bar + 5]
    assert re.fullmatch(r"The model does not explain the readings \(p = .*\): do not rely on its f_overall\.", said[0])
    assert "error depends on" in said[1]
    assert said[2].startswith("What it gives, not to be relied on: f_overall is ")
    assert said[3] == "Next: spinbench diagnose bench"
    assert "f_overall (do not rely on it)" in wrong.stdout


@pytest.mark.slow
def test_its_json_says_what_stands_out_and_which_rows_were_used(wrong, windy):
    data = posterior(windy / "fit.json")
    assert data["fit_quality"]["model_fits"] is False
    assert 0.0 < data["fit_quality"]["p_value"] < 0.01
    assert "error depends on" in data["fit_quality"]["why"]
    assert data["files"] == [
        {"file": "sweep.csv", "rows": 5, "rows_used": 5, "why": ""},
        {"file": "coast_down.csv", "rows": 60, "rows_used": 0, "why": rows_used.NOT_IN_A_FIT},
    ]
    assert posterior(windy / "out" / "posterior.json") == data


@pytest.mark.slow
def test_its_page_does_not_say_that_the_recording_decides_it(wrong, windy):
    page = (windy / "out" / "report.html").read_text()
    assert '<p class="verdict">The model does not explain the readings (p = ' in page
    assert "What it gives, not to be relied on: f_overall is" in page
    assert "<code>spinbench diagnose bench</code>" in page
    assert "The data determine f_overall" not in page


@pytest.fixture(scope="module")
def short(windy, spinbench_anywhere) -> subprocess.CompletedProcess[str]:
    words = ("bench", "-o", "short", "--json", "short.json", "--max-steps", "50", "--steady-only")
    words += ("--effective-samples", "100000")
    return spinbench_anywhere("fit", *words, cwd=windy)


@pytest.mark.slow
def test_too_small_a_budget_ends_with_code_3_and_no_posterior(short, windy):
    assert short.returncode == 3
    assert re.search(r"not converged in 50 steps: [a-z_]+ limits it; ", short.stderr)
    assert "give a larger --max-steps" in short.stderr
    assert "Traceback" not in short.stderr
    assert not (windy / "short" / "posterior.json").exists()
    assert not (windy / "short.json").exists()


@pytest.mark.slow
def test_a_fit_that_has_not_converged_tells_of_the_model_beside(short):
    assert "nor does the model explain the readings" in short.stderr


# Known truth

TRUTH = {"f_overall": 0.0585, "port_lap": 8.6, "roller_friction": 0.011, "ambient_pressure": 101_400.0}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Path:
    """A sweep of the steady solver's own, with offsets, scales and noise as declared, on disk (seed 11)."""
    rng = np.random.default_rng(11)
    pressure = np.array([1.4, 1.75, 2.1, 2.4])
    state = steady.steady(read_motor("ptm3600").with_values(TRUTH), pressure * 1e5)
    columns = {
        "pressure_bar_abs": pressure + 0.02 + 0.003 * rng.standard_normal(4),
        "flow_l_min": state.flow_m3_s[0] * 6e4 * 1.01 + 0.4 + rng.standard_normal(4),
        "speed_rpm": state.speed_rad_s[0] * 30 / np.pi * 1.0002 + 0.5 * rng.standard_normal(4),
    }
    recording = read_recording(PUBLISHED)
    measured = {name: Column(values, np.zeros(4, dtype=np.int8)) for name, values in columns.items()}
    file = replace(recording.files[0], rows=4, columns=measured)
    folder = tmp_path_factory.mktemp("simulated") / "bench"
    write_recording(replace(recording, files=(file,)), folder)
    return folder


@pytest.fixture(scope="module")
def recovered(simulated) -> fits.Fit:
    return fits.fit(read_recording(simulated), QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUTH)
def test_the_truth_of_a_simulated_sweep_is_inside_the_99_percent_interval(recovered, name):
    low, high = interval(recovered, name)
    assert low < TRUTH[name] < high


@pytest.mark.slow
def test_the_prior_dominates_what_a_sweep_does_not_tell(recovered):
    assert recovered.posterior.prior_dominates("inertia")
    assert recovered.posterior.prior_dominates("roller_friction")
    assert not recovered.posterior.prior_dominates("f_overall")


@pytest.mark.slow
def test_nothing_is_suspect_in_a_simulated_sweep(recovered):
    assert recovered.posterior.suspect_rows == ()


@pytest.mark.slow
def test_a_prior_that_the_readings_contradict_is_named(recovered):
    z, places = recovered.posterior.z.copy(), [one.unknown.name for one in recovered.posterior.estimates]
    z[:, places.index("port_lap")] += FAR_OFF + 1.0 - z[:, places.index("port_lap")].mean()
    assert not [words for words in fit_page.remarks(recovered) if "contradict the prior" in words]
    (said,) = fit_words.against_priors(replace(recovered.posterior, z=z))
    assert said.startswith("the readings contradict the prior of the port lap: 8 ± 1 deg was given, and the fit says ")
    assert said.endswith(", 5.0 of the prior's sds from its middle")


@pytest.mark.long
def test_a_port_lap_given_six_degrees_too_small_is_named_beside_a_good_flow_meter(simulated, tmp_path):
    recording = read_recording(simulated)
    meter = replace(recording.channels["flow_l_min"], scale_sd=0.002, bias_sd=0.1)
    write_recording(replace(recording, channels=recording.channels | {"flow_l_min": meter}), tmp_path / "bench")
    done = run("bench", "-o", "out", "--set", "port_lap=2", *BRIEF, cwd=tmp_path)
    words = "the readings contradict the prior of the port lap: 2 ± 1 deg was given, and the fit says"
    assert words in " ".join(done.stderr.split())
    assert words in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_without_the_flow_less_is_known(simulated, recovered):
    alone = fits.fit(read_recording(simulated), QUICK, channels=("pressure", "speed"))
    assert alone.posterior["f_overall"].sd > 1.1 * recovered.posterior["f_overall"].sd
    assert alone.posterior["port_lap"].sd > 1.1 * recovered.posterior["port_lap"].sd
    assert not [e for e in alone.posterior.estimates if e.unknown.name.startswith("flow")]


@pytest.mark.slow
@pytest.mark.skipif(not PRACTICE.is_dir(), reason="the practice recordings are not beside the repository")
def test_the_truth_of_a_practice_sweep_is_inside_the_99_percent_interval():
    """Every sixth row of a sweep by another simulator."""
    recording = read_recording(PRACTICE / "p02")
    file = recording.files[0]
    kept = {name: Column(column.values[::6], column.censor[::6]) for name, column in file.columns.items()}
    thin = replace(file, rows=len(kept["speed_rpm"].values), columns=kept)
    found = fits.fit(replace(recording, files=(thin,)), replace(QUICK, effective_samples=300, times_tau=10.0))
    low, high = interval(found, "f_overall")
    assert low < 0.057719849465073164 < high


@pytest.mark.parametrize("place", ["rig", "file"])
def test_a_flywheel_is_on_the_shaft_wherever_it_is_stated(windy, place):
    seen = read_recording(windy / "bench")
    likelihood = fits.prepare(seen)[2]
    files = tuple(replace(file, added_inertia_kg_m2=0.015) for file in seen.files)
    heavy = replace(seen, added_inertia_kg_m2=0.015) if place == "rig" else replace(seen, files=files)
    at_z = np.zeros((1, len(likelihood.unknowns)))
    bare, mounted = (one.split(at_z)[0][0, layout.J] for one in (likelihood, fits.prepare(heavy)[2]))
    assert mounted == pytest.approx(bare + 0.015)


def test_plateaus_with_two_flywheels_are_no_fit_to_plateaus(windy):
    seen = read_recording(windy / "bench")
    other = replace(seen.files[0], file="other.csv", added_inertia_kg_m2=0.015)
    with pytest.raises(RecordingError, match=r"flywheels of 0 and 0\.015 kg m2.*leave out --steady-only"):
        fits.prepare(replace(seen, files=(*seen.files, other)))


def test_a_single_row_is_fitted_and_its_prior_said_to_dominate(put_recording):
    recording = read_recording(put_recording(("sweep.csv", "steady", f"{HEADER}2.0,71.5,394.8\n")))
    found = fits.fit(recording, QUICK)
    assert any("one row: the prior dominates f_overall" in sentence for sentence in fit_page.remarks(found))


# Bad input

TOML = """\
format = "recording/1"
motor = "ptm3600"
[ambient]
pressure_bar_abs = 1.01325
[channels.pressure_bar_abs]
noise_sd = 0.0015
[[files]]
file = "sweep.csv"
kind = "steady"
"""
SWEEP = f"{HEADER}1.6,44,232\n2.0,70,394\n"
RADIAL = TOML.replace('motor = "ptm3600"\n', "") + '[motor]\nkind = "{kind}"\n{more}\n'

BAD = {
    "column_missing": (TOML, "flow_l_min,speed_rpm\n44,232\n", (), "no column 'pressure_bar_abs'"),
    "another_unit": (TOML, "pressure_kpa_abs,speed_rpm\n160,232\n", (), "divide by 100"),
    "unit_of_the_instrument": (
        TOML,
        "pressure_bar_gauge,speed_rpm\n0.6,232\n",
        (),
        "the files have pressure_bar_gauge",
    ),
    "text_in_a_number": (TOML, f"{HEADER}1.6,44,fast\n", (), "row 1, column speed_rpm: 'fast' is not a number"),
    "gauge_declared_absolute": (TOML, f"{HEADER}0.6,44,232\n", (), "name the column pressure_bar_gauge"),
    "gauge_betrayed_by_speeds": (TOML, f"{HEADER}1.1,82,441\n1.9,145,778\n", (), "the speeds do not go with"),
    "strongly_negative_flow": (TOML, f"{HEADER}1.6,-44,232\n", (), "row 1, column flow_l_min"),
    "nothing_in_the_file": (TOML, "", (), "sweep.csv"),
    "no_row": (TOML, HEADER, (), "sweep.csv"),
    "times_twice": (
        TOML.replace('"steady"', '"transient"'),
        "time_s,pressure_bar_abs,speed_rpm\n0,2,0\n0,2,9\n",
        (),
        "row 2, column time_s",
    ),
    "only_a_transient": (
        TOML.replace('"steady"', '"transient"'),
        "time_s,pressure_bar_abs,speed_rpm\n0,2,0\n1,2,9\n",
        (),
        "no speed to compare with the model",
    ),
    "only_a_transient_for_plateaus": (
        TOML.replace('"steady"', '"transient"'),
        "time_s,pressure_bar_abs,speed_rpm\n0,2,0\n1,2,9\n",
        ("--steady-only",),
        "no steady row",
    ),
    "misspelt_key": (TOML.replace("noise_sd", "nois_sd"), SWEEP, (), "noise_sd"),
    "key_twice": (
        TOML.replace("noise_sd = 0.0015", "noise_sd = 0.0015\nnoise_sd = 0.002"),
        SWEEP,
        (),
        "recording.toml",
    ),
    "file_outside": (TOML.replace("sweep.csv", "../sweep.csv"), SWEEP, (), "outside the folder"),
    "motor_unknown": (TOML.replace("ptm3600", "ptm3601"), SWEEP, (), "ptm3600"),
    "negative_diameter": (TOML, SWEEP, ("--set", "cylinder_diameter=-24"), "cylinder_diameter"),
    "misspelt_parameter": (TOML, SWEEP, ("--set", "f_overal=0.06"), "did you mean 'f_overall'?"),
    "inline_rotor": (
        RADIAL.format(kind="free_rotor", more="inertia_kg_m2 = 0.01"),
        SWEEP,
        (),
        "'free_rotor' cannot be fitted yet",
    ),
    "inline_motor_of_negative_diameter": (
        RADIAL.format(kind="radial_piston", more='name = "ours"\ncylinder_diameter = -24.0'),
        SWEEP,
        (),
        "recording.toml",
    ),
    "pressure_out_of_range": (TOML, f"{SWEEP}9.5,,2000\n", (), "row 3: 9.5 bar absolute is outside 0.5..8 bar"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_in_words_and_nothing_is_written(tmp_path, spinbench_here, name):
    toml, sweep, more, words = BAD[name]
    (tmp_path / "bench").mkdir()
    (tmp_path / "bench" / "recording.toml").write_text(toml)
    (tmp_path / "bench" / "sweep.csv").write_text(sweep)
    before = sorted(tmp_path.rglob("*"))
    done = spinbench_here("fit", "bench", "-o", "out", "--json", "fit.json", *more, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert all(line.startswith("spinbench: ") for line in lines), done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_a_missing_folder_is_refused_in_a_line(tmp_path, spinbench_here):
    done = spinbench_here("fit", "gone", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("spinbench: there is no folder 'gone', and there is no run in logs yet")
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_motor_file_with_a_negative_diameter_is_refused(tmp_path, spinbench_here):
    text = (ROOT / "configs" / "motors" / "ptm3600.toml").read_text(encoding="utf-8")
    (tmp_path / "bad.toml").write_text(text.replace("value = 24.03", "value = -24.03"), encoding="utf-8")
    done = spinbench_here("simulate", "--pressure-bar-abs", "2", "--motor", "bad.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("spinbench: ")
    assert "cylinder_diameter: -24.03 mm is outside" in done.stderr
