"""A fit whose model holds named effects: which it takes, their priors, that the physics is theirs, and the result."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import johnsonsu, norm
from typer.testing import CliRunner

from calibration.fit import fit, posterior, sampling
from calibration.fit.sampling import Settings
from calibration.report.fit import numbers as fit_numbers
from calibration.systems.radial_piston.batch import effects as with_effects
from calibration.systems.radial_piston.batch import states as effect_states
from calibration.unknowns.priors import Unknown
from model.effects import effects
from model.effects import steady as effect_steady
from model.effects.laws import behind_the_gauge, readings_of
from model.motor import read_motor
from model.solvers import steady
from rig.recording import Column, Recording, read_recording
from spinbench.api.arviz_data import arviz_module
from spinbench.cli import app
from tests import diagnosis_recordings

ROOT = Path(__file__).resolve().parents[3]
PUBLISHED_SWEEP = ROOT / "logs" / "published_sweep"

TORQUE = 0.15
SOLVED = [name for name, one in effects().items() if name != "bad_reading" and not one.transient_only]
AT_ONCE = {"coulomb_friction", "load_friction", "wall_heat_exchange", "leakage", "flow_scale", "pressure_gauge_offset"}
IN_PASSES = {"windage", "stribeck_friction", "inlet_throttling", "exhaust_back_pressure"}


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory) -> Recording:
    """Four plateaus of a motor with dry friction."""
    folder = tmp_path_factory.mktemp("recordings") / "rubbing"
    diagnosis_recordings.sweep(folder, 9, {"coulomb_friction": {"torque_nm": TORQUE}})
    header, *rows = (folder / "sweep.csv").read_text(encoding="utf-8").splitlines()
    (folder / "sweep.csv").write_text("\n".join([header, *rows[:13:4]]) + "\n", encoding="utf-8")
    return read_recording(folder)


@pytest.fixture(scope="module")
def fitted(rubbing) -> fit.Fit:
    """A fit with dry friction, stopped early: long enough for its intervals, too short for `fit.fit` to accept."""
    settings = Settings(seed=1, effective_samples=100, most_steps=125, walkers=40)
    motor, measured, likelihood = fit.prepare(rubbing, effects=["coulomb_friction"])
    chain = sampling.sample(likelihood.log_prob, len(likelihood.unknowns), likelihood.factors, settings)
    result = posterior.summarise(chain, likelihood.unknowns, [], 1.0)
    return fit.Fit(rubbing, motor, measured, likelihood, result, settings, ("coulomb_friction",))


@pytest.mark.long
def test_dry_friction_is_recovered_and_f_overall_with_it(fitted):
    truth = {"coulomb_friction.torque_nm": TORQUE, "f_overall": read_motor("ptm3600")["f_overall"].value}
    for name, true in truth.items():
        one = fitted.posterior[name]
        assert one.quantiles["q05"] < true < one.quantiles["q95"]
        assert one.sd_of_prior < 0.7


@pytest.mark.long
def test_posterior_1_holds_the_effect_with_its_unit(fitted):
    found = posterior.as_json(fitted.posterior)["parameters"]
    assert list(found)[-1] == "coulomb_friction.torque_nm"
    one = found["coulomb_friction.torque_nm"]
    assert one["unit"] == "N m"
    assert 0.0 <= one["q05"] < one["q50"] < one["q95"] < 1.0


@pytest.mark.long
def test_the_command_takes_a_list_of_effects_and_writes_the_report(fitted, tmp_path, monkeypatch):
    asked: list[object] = []

    def instead(*arguments: object) -> fit.Fit:
        asked.append(arguments[-1])
        return fitted

    monkeypatch.setattr(fit, "fit", instead)
    arguments = ["fit", str(fitted.recording.folder), "--effects", "coulomb_friction, leakage", "-o", str(tmp_path)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert asked == [["coulomb_friction", "leakage"]]
    written = {"posterior.json", "posterior.nc", "report.html", "report.png"}
    assert {place.name for place in tmp_path.iterdir()} == written
    assert "coulomb_friction.torque_nm" in arviz_module().from_netcdf(tmp_path / "posterior.nc").posterior
    page = (tmp_path / "report.html").read_text()
    assert "The model holds, beyond the article" in page
    assert "coulomb_friction.torque_nm" in page
    assert f"{effects()['coulomb_friction'].title} (coulomb_friction): dry friction torque " in page
    assert "coulomb_friction.torque_nm" in json.loads((tmp_path / "posterior.json").read_text())["parameters"]


@pytest.mark.long
def test_the_bands_of_the_report_are_those_of_the_model_with_its_effects(fitted):
    rows = fitted.measured.steady
    still = np.zeros(len(rows))
    here = fit_numbers.expected(fitted, rows.pressure, rows.is_gauge, rows.noise_scale, still)["speed"]
    assert np.all(np.abs(rows.speed - here.mean) < 4.0 * here.sd)
    z = fitted.posterior.chain.flat().copy()
    z[:, -1] = -8.0  # no friction worth speaking of
    chain = replace(fitted.posterior.chain, samples=z.reshape(fitted.posterior.chain.samples.shape))
    without = replace(fitted, posterior=replace(fitted.posterior, chain=chain))
    there = fit_numbers.expected(without, rows.pressure, rows.is_gauge, rows.noise_scale, still)["speed"]
    assert np.all(there.mean > here.mean + 1.0)  # rpm


@pytest.mark.long
def test_an_effect_that_changes_with_time_is_drawn_at_the_middle_of_the_sweep(rubbing):
    settings = Settings(seed=1, effective_samples=10, most_steps=25, walkers=40)
    time = np.array([0.0, 100.0, 200.0, 600.0])
    columns = dict(rubbing.files[0].columns, time_s=Column(time, np.zeros(4, dtype=np.int8)))
    timed = replace(rubbing, files=(replace(rubbing.files[0], columns=columns),))
    motor, measured, likelihood = fit.prepare(timed, effects=["friction_warm_up"])
    chain = sampling.sample(likelihood.log_prob, len(likelihood.unknowns), likelihood.factors, settings)
    result = posterior.summarise(chain, likelihood.unknowns, [], 1.0)
    found = fit.Fit(timed, motor, measured, likelihood, result, settings, ("friction_warm_up",))
    shown = {channel.name: channel for channel in fit_numbers.channels(found)}["speed"]
    rows, one = measured.steady, np.ones(1)
    for at_s, wanted in ((150.0, True), (600.0, False)):
        same = fit_numbers.expected(found, shown.curve.pressure_bar[:1], rows.is_gauge[:1], one, np.array([at_s]))
        assert (same["speed"].mean[0] == pytest.approx(shown.curve.mean[0], rel=1e-9)) == wanted


@pytest.mark.parametrize("name", SOLVED)
def test_the_states_are_those_of_the_effects_own_solver(rubbing, name):
    _, measured, likelihood = fit.prepare(rubbing, effects=[name])
    z = 0.3 * np.random.default_rng(2).standard_normal((12, len(likelihood.unknowns)))
    z = z[np.isfinite(likelihood.log_likelihood(z))][:3]
    parameters, errors = likelihood.split(z)
    errors[:, 0, :2] = 0.0
    out, rows = likelihood.predict(parameters, errors, likelihood.chosen(z)), measured.steady
    for i, chosen in enumerate(likelihood.chosen(z)):
        P = rows.pressure * 1e5
        if "pressure" in effects()[name].reads:
            P = behind_the_gauge(chosen, P)
        one = np.tile(parameters[i], (len(rows), 1))
        gas, time = likelihood._gas, likelihood.effects.time
        there = effect_steady.solve(one, likelihood._readings, P, gas, chosen, time, slopes=True)
        shown = readings_of(chosen, "speed", there.speed, there.state)
        runs = there.running
        assert out[i, runs, steady.SPEED_OUT] == pytest.approx(shown[runs], rel=1e-5)
        flow = readings_of(chosen, "flow", there.flow, there.state)
        assert out[i, runs, steady.VOLUME_FLOW] == pytest.approx(flow[runs], rel=1e-5)


def test_an_effect_that_does_not_depend_on_what_it_changes_needs_no_passes():
    motor, time = read_motor("ptm3600"), 60.0 * np.arange(5)
    assert {effect_states.way_of([name], motor, time) for name in AT_ONCE} == {"at once"}
    assert {effect_states.way_of([name], motor, time) for name in IN_PASSES} == {"in passes"}
    assert effect_states.way_of(["friction_warm_up"], motor, time) == "row by row"
    assert effect_states.way_of(["coulomb_friction", "windage"], motor, time) == "in passes"


def test_without_effects_the_likelihood_is_the_same_to_the_bit(rubbing):
    _, _, plain = fit.prepare(rubbing)
    _, measured, asked = fit.prepare(rubbing, effects=[])
    assert asked.effects is None
    z = np.random.default_rng(3).standard_normal((6, len(plain.unknowns)))
    parameters, errors = plain.split(z)
    P = (measured.steady.pressure - errors[:, 0, 0:1]) / (1.0 + errors[:, 0, 1:2]) * 1e5 + 0.0
    out = steady.solve(parameters, plain._readings, np.clip(P, 2e4, 2e6), plain._gas, slopes=True)
    assert np.array_equal(asked.predict(parameters, errors), out)


def test_a_chain_with_effects_is_not_taken_for_one_without(rubbing):
    motor, measured, _ = fit.prepare(rubbing)
    marks = [fit.fingerprint(rubbing, motor, measured, Settings(), names) for names in ((), ("leakage",), ("windage",))]
    assert len(set(marks)) == 3
    assert marks[0] == fit.fingerprint(rubbing, motor, measured, Settings())


def test_a_chain_of_other_code_is_not_gone_on_with(rubbing, monkeypatch):
    motor, measured, _ = fit.prepare(rubbing)
    mark = fit.fingerprint(rubbing, motor, measured, Settings())
    monkeypatch.setattr(fit, "imported_sha256", lambda *roots: "another")
    assert fit.fingerprint(rubbing, motor, measured, Settings()) != mark


@pytest.mark.parametrize(("kind", "folded"), [("size", False), ("halfsize", True)])
def test_a_size_has_the_prior_with_the_long_tails_that_a_diagnosis_gives_it(kind, folded):
    unknown = Unknown("coulomb_friction.torque_nm", "N m", kind, 0.0, 0.15, "")
    z = np.linspace(-6.0, 6.0, 25)
    values = unknown.value(z)
    assert np.all(np.diff(values) > 0.0) and (values[0] >= 0.0) == folded
    below = johnsonsu(0.0, 1.0, scale=0.15).cdf(values)
    assert (2.0 * below - 1.0 if folded else below) == pytest.approx(norm.cdf(z), abs=1e-12)
    assert [unknown.z(float(value)) for value in values[6:]] == pytest.approx(z[6:], abs=1e-6)


def test_unknowns_are_named_by_effect_and_parameter_with_their_units(rubbing):
    _, _, likelihood = fit.prepare(rubbing, effects=["stribeck_friction", "leakage"])
    last = likelihood.unknowns[-4:]
    assert [(one.name, one.unit, one.kind) for one in last] == [
        ("stribeck_friction.torque_nm", "N m", "halfsize"),
        ("stribeck_friction.speed_rad_s", "rad/s", "lognormal"),
        ("leakage.conductance_kg_s_pa2", "kg/(s Pa2)", "halfsize"),
        ("leakage.exponent", "1", "lognormal"),
    ]


def test_a_size_beyond_what_an_engineer_would_believe_is_impossible(rubbing):
    _, _, likelihood = fit.prepare(rubbing, effects=["coulomb_friction"])
    z = np.zeros((2, len(likelihood.unknowns)))
    z[1, -1] = likelihood.unknowns[-1].z(1.01)
    found = likelihood.log_likelihood(z)
    assert np.isfinite(found[0]) and found[1] == -np.inf


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["coulom_friction"], "no effect is called 'coulom_friction'; the nearest is coulomb_friction"),
        (["turbulence"], "no effect is called 'turbulence'; known: "),
        (["inertia"], "inertia shows in runs in time only"),
        (["bad_reading"], "every fit looks for bad readings"),
        (["leakage", "leakage"], "leakage is named twice"),
    ],
)
def test_an_effect_that_a_fit_cannot_hold_is_refused(rubbing, names, words):
    with pytest.raises(with_effects.EffectsError, match=words):
        fit.prepare(rubbing, effects=names)


def test_an_effect_on_the_flow_is_refused_where_the_flow_is_left_out(rubbing):
    with pytest.raises(with_effects.EffectsError, match="acts on the flow alone"):
        fit.prepare(rubbing, channels=("pressure", "speed"), effects=["flow_scale"])
    assert with_effects.seen(["flow_scale", "windage"], ("pressure", "speed")) == ["windage"]


def test_an_effect_that_changes_with_time_needs_rows_with_a_time():
    with pytest.raises(with_effects.EffectsError, match="row 1, has no time_s"):
        fit.prepare(read_recording(PUBLISHED_SWEEP), effects=["friction_warm_up"])


@pytest.mark.parametrize(
    ("effects", "said"), [("leakge", "the nearest is leakage"), ("", "''; known: bad_reading"), (" , ", "''; known: ")]
)
def test_the_command_refuses_an_effect_that_there_is_not_in_a_line(spinbench_here, effects, said):
    done = spinbench_here("fit", PUBLISHED_SWEEP, "--effects", effects, cwd=ROOT)
    assert done.returncode == 2
    assert said in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr
