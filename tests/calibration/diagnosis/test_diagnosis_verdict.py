"""The diagnosis of recordings whose truth is known: what is said, what is refused, and its form."""

from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from calibration.data.refusals import refuse_unusable
from calibration.diagnosis import as_json, diagnose
from calibration.diagnosis.diagnose import _rivals
from calibration.diagnosis.document import set_probability
from calibration.diagnosis.steps import confirm
from calibration.diagnosis.steps.candidate import Candidate, no_larger
from calibration.diagnosis.steps.confirm import HeldOut, Predicted, cross_validate, fit_on, predict_held
from calibration.diagnosis.steps.detect import _Test
from calibration.diagnosis.steps.misread import alone_at_an_end
from calibration.diagnosis.steps.name import log_prior, refusal, weigh
from calibration.diagnosis.steps.verdict import Verdict, VerdictKind, judge, not_excluded, with_open
from calibration.likelihood.compared import Row
from calibration.likelihood.descent import find
from calibration.likelihood.signatures import signatures
from calibration.report.diagnosis.words import sentence
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.noise import SCALES
from calibration.systems.radial_piston.places.forces import forces
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.work.step_clock import StepClock
from model.motor import read_motor
from rig.recording import Recording, RecordingError, read_recording
from tests.diagnosis_recordings import add_coast_down, sweep

PRACTICE = Path(__file__).resolve().parents[4] / "shared" / "practice"

LEAK = 4e-14  # kg/(s Pa2)
KEYS = {
    "format",
    "verdict",
    "mismatch",
    "located",
    "set_probability",
    "effects",
    "alternatives",
    "term",
    "improvement",
    "f_overall_before",
    "f_overall_after",
    "next_tests",
}


def sets_said(document: dict) -> list[set[str]]:
    return [{e["id"] for e in document["effects"]}, *(set(names) for names in document["alternatives"])]


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> tuple[Recording, dict]:
    """A recording of the model itself, and its diagnosis with seed 1."""
    recording = sweep(tmp_path_factory.mktemp("plain"), 11, {})
    return recording, as_json(diagnose(recording, 1))


def test_a_recording_of_the_model_itself_is_consistent(plain, tmp_path: Path) -> None:
    for found in (plain[1], as_json(diagnose(sweep(tmp_path, 12, {}), 1))):
        assert found["verdict"] == "consistent"
        assert found["effects"] == [] and found["alternatives"] == []


def test_a_warm_up_is_named_and_located_in_time(tmp_path: Path) -> None:
    truth = {"friction_warm_up": {"share_cold": 0.15, "time_s": 240.0}}
    found = as_json(diagnose(sweep(tmp_path, 4, truth), 1))
    assert (found["verdict"], sets_said(found)) == ("named", [{"friction_warm_up"}])
    assert found["located"][0]["coordinate"] in ("time", "direction")
    assert found["located"][0]["balance"] == "torque"
    held_out = found["improvement"]["held_out"]
    assert held_out["rmse_after"]["speed_rad_s"] < held_out["rmse_before"]["speed_rad_s"]


@pytest.mark.long
def test_a_misread_row_is_named_with_its_place(tmp_path: Path) -> None:
    found = as_json(diagnose(sweep(tmp_path, 5, {}, bad_row=7), 1))
    assert found["verdict"] == "named" and found["mismatch"]["p_value"] < 0.01
    assert [(row["row"], row["channel"]) for row in found["suspect_rows"]] == [(7, "speed")]
    assert [e["id"] for e in found["effects"]] == ["bad_reading"]
    # Beside a misread row what is too small to be seen is weighed in as it is where nothing is off.
    assert found["f_overall_after"]["sd"] > found["f_overall_before"]["sd"]


@pytest.mark.long
def test_of_a_flow_that_is_misread_the_speed_beside_it_is_not_accused(tmp_path: Path) -> None:
    sweep(tmp_path, 1, {})
    lines = (tmp_path / "sweep.csv").read_text(encoding="utf-8").splitlines()
    cells = lines[11].split(",")
    cells[3] = str(float(cells[3]) + 30.0)
    lines[11] = ",".join(cells)
    (tmp_path / "sweep.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = as_json(diagnose(read_recording(tmp_path), 1))
    assert (found["verdict"], [e["id"] for e in found["effects"]]) == ("named", ["bad_reading"])
    assert [(row["row"], row["channel"]) for row in found["suspect_rows"]] == [(11, "flow")]


@pytest.mark.long
def test_a_misread_row_is_named_beside_an_effect(tmp_path: Path) -> None:
    found = as_json(diagnose(sweep(tmp_path, 6, {"leakage": {"conductance_kg_s_pa2": LEAK}}, bad_row=7), 1))
    assert (found["verdict"], sets_said(found)) == ("named", [{"leakage", "bad_reading"}])
    assert [(row["row"], row["channel"]) for row in found["suspect_rows"]] == [(7, "speed")]
    assert any(place["coordinate"] == "row" and place["where"] == [7.0, 7.0] for place in found["located"])
    misread = next(effect for effect in found["effects"] if effect["id"] == "bad_reading")
    assert misread["parameters"]["readings"]["mean"] == 1.0 and misread["log10_bayes_factor"] > 2.0


@pytest.mark.long
def test_what_is_off_at_a_level_each_time_is_not_called_misread(tmp_path: Path) -> None:
    found = as_json(diagnose(sweep(tmp_path, 5, {}, bad_row=(7, 20), off_rpm=20.0), 1))
    assert found["verdict"] == "unresolved" and found["suspect_rows"] == []


@pytest.mark.long
def test_an_outlier_of_heavy_tails_is_suspect_and_not_called_misread(tmp_path: Path) -> None:
    found = as_json(diagnose(sweep(tmp_path, 5, {}, bad_row=7, off_rpm=6.0), 1))
    assert found["verdict"] == "consistent" and not found["effects"]
    assert [(row["row"], row["channel"]) for row in found["suspect_rows"]] == [(7, "speed")]
    assert "tails" in found["why"]


@pytest.fixture(scope="module")
def leaking(tmp_path_factory) -> tuple[Recording, dict]:
    """A recording of a motor that leaks, and its diagnosis with seed 1, another run of that motor held out."""
    leak = {"leakage": {"conductance_kg_s_pa2": LEAK}}
    recording = sweep(tmp_path_factory.mktemp("leaking") / "seen", 6, leak)
    unseen = sweep(recording.folder.parent / "unseen", 7, leak)
    return recording, as_json(diagnose(recording, 1, hold_out=unseen))


def test_a_leak_is_named_with_its_size(leaking) -> None:
    _, found = leaking
    assert (found["verdict"], sets_said(found)) == ("named", [{"leakage"}])
    said = found["effects"][0]["parameters"]["conductance_kg_s_pa2"]
    assert abs(said["mean"] - LEAK) < 3.0 * said["sd"]
    assert said["sd"] < 0.2 * LEAK


@pytest.mark.long
def test_a_diagnosis_proves_what_it_names_on_an_unseen_run(leaking, tmp_path: Path) -> None:
    recording, found = leaking
    held_out = found["improvement"]["held_out"]
    assert found["verdict"] == "named" and held_out["scheme"] == "unseen run unseen"
    assert held_out["elpd_gain"] > held_out["elpd_gain_se"] > 0.0
    # A run without the leak speaks against it: then nothing is named.
    against = as_json(diagnose(recording, 1, hold_out=sweep(tmp_path / "clean", 8, {})))
    assert against["verdict"] == "unresolved" and "does not predict the unseen run better" in against["why"]
    held_out = against["improvement"]["held_out"]  # what decided it is kept
    assert held_out["scheme"] == "unseen run clean" and held_out["elpd_gain"] <= held_out["elpd_gain_se"]


def test_no_probability_is_stated_higher_than_such_verdicts_came_true(leaking) -> None:
    _, found = leaking
    assert 0.5 < found["set_probability"] <= 0.85
    assert all(0.5 < effect["probability"] <= 0.95 for effect in found["effects"])
    assert found["effects"][0]["probability"] >= found["set_probability"]


def test_misread_rows_alone_are_said_to_be_the_whole_truth_as_often_as_they_were() -> None:
    rows = Verdict(VerdictKind.NAMED, None, (), 0.999, "single readings that nothing explains")
    assert set_probability(rows) == pytest.approx(0.6, abs=0.001)
    assert set_probability(Verdict(VerdictKind.CONSISTENT, None, (), 0.9, "")) == 0.9


def test_a_recording_in_which_the_rotor_turns_nowhere_is_refused(tmp_path: Path) -> None:
    toml = 'format = "recording/1"\nmotor = "ptm3600"\n[[files]]\nfile = "sweep.csv"\nkind = "steady"\n'
    (tmp_path / "recording.toml").write_text(toml)
    sweep = tmp_path / "sweep.csv"
    sweep.write_text("pressure_bar_abs,flow_l_min,speed_rpm\n1.1,0,0\n1.2,0,0\n")
    with pytest.raises(RecordingError, match="speed_rpm shows a rotor at rest in every row, so there is"):
        diagnose(read_recording(tmp_path), 1)
    sweep.write_text("pressure_bar_abs,flow_l_min,speed_rpm\n1.1,0,0\n2.0,72,395\n")
    refuse_unusable(read_recording(tmp_path))


def test_the_document_has_the_promised_form(leaking) -> None:
    again = json.loads(json.dumps(leaking[1], allow_nan=False))
    assert set(again) >= KEYS
    assert again["format"] == "diagnosis/1"
    assert 0.0 <= again["mismatch"]["p_value"] <= 1.0
    for place in again["located"]:
        assert set(place) == {
            "kind", "channel", "balance", "coordinate", "where", "unit", "p_value", "sentence", "same_as",
            "recording", "file",
        }  # fmt: skip
        assert place["where"][0] < place["where"][1]
    for effect in again["effects"]:
        assert set(effect) == {"id", "probability", "log10_bayes_factor", "parameters"}
        for figures in effect["parameters"].values():
            assert figures["q05"] <= figures["mean"] <= figures["q95"]


def test_the_same_seed_gives_the_same_document(plain) -> None:
    """Of one that names something, the test of a challenge's command says so."""
    recording, found = plain
    assert as_json(diagnose(recording, 1)) == found


@pytest.mark.long
def test_dry_friction_that_hides_behind_the_rollers_is_not_excluded_and_gets_its_test(tmp_path: Path) -> None:
    """Several times the roller friction, less f_overall and less inertia fit as well: only their priors speak."""
    hidden = {"coulomb_friction": {"torque_nm": 0.12}}
    sweep(tmp_path, 4, hidden)
    found = as_json(diagnose(add_coast_down(tmp_path, 4, hidden), 1))
    true = read_motor("ptm3600").parameters.f_overall.value
    assert found["verdict"] == "consistent"
    assert "not excluded: coulomb_friction" in found["why"]
    rivals = [one["effects"] for one in found["rivals"]]
    assert rivals[:2] == [[], ["coulomb_friction"]]
    assert "Still possible: “dry friction (coulomb_friction)”" in sentence(found)
    assert found["f_overall_before"]["q95"] < true
    assert found["f_overall_after"]["q05"] < true < found["f_overall_after"]["q95"]
    assert {"nothing missing", "coulomb_friction"} <= set(found["next_tests"][0]["separates"])
    assert "flywheel" in found["next_tests"][0]["test"]


@dataclass
class Weighed:
    """A set as a verdict looks at it."""

    names: tuple[str, ...]
    probability: float
    refused: str = ""


def test_the_time_of_a_step_that_comes_again_is_added_up(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 1.0, 3.0, 7.0, 15.0])
    monkeypatch.setattr("calibration.work.step_clock.time.monotonic", lambda: next(now))
    told: list[str] = []
    clock = StepClock(told.append)
    for step in ("name", "test", "name", ""):
        clock(step)
    assert clock.seconds == {"name": 2.0 + 8.0, "test": 4.0} and told == ["name", "test", "name"]


def test_what_is_not_excluded_is_likely_enough_and_can_be_named() -> None:
    base, leak, drag = Weighed((), 0.4), Weighed(("leakage",), 0.3), Weighed(("windage",), 0.1)
    gauge = Weighed(("pressure_gauge_offset",), 0.25, "pressure_gauge_offset is no larger than declared")
    assert not_excluded([base, leak, gauge, drag]) == [leak]
    found = judge(0.3, [base, leak, gauge, drag], {(): 0.3}, None)
    assert (found.kind, found.alternatives, found.set_probability) == ("consistent", (), 0.4)
    assert with_open(found, [base]) == found
    # However it came to be a rival: `why`, the sentence and the proposed tests go by one list.
    assert with_open(found, [base, leak]).why == "the base model explains the recording; not excluded: leakage (0.30)"


@pytest.mark.parametrize(
    ("names", "left", "kind"),
    [
        (("pressure_gauge_offset",), 0.3, "consistent"),
        (("pressure_gauge_offset",), 1e-6, "unresolved"),
        (("leakage", "pressure_gauge_offset"), 0.3, "unresolved"),
    ],
)
def test_an_error_as_large_as_declared_closes_the_matter_only_where_it_explains_it(names, left, kind) -> None:
    base, small = Weighed((), 0.0), Weighed(names, 0.9, no_larger("pressure_gauge_offset"))
    drag = Weighed(("windage",), 0.1)
    assert judge(1e-9, [small, drag, base], {(): 1e-9, names: left, drag.names: 1e-6}, None).kind == kind


def test_many_unlikely_rivals_together_keep_a_set_from_being_named() -> None:
    best, base = Weighed(("windage",), 0.9), Weighed((), 0.0)
    rivals = [Weighed((name,), 0.0089) for name in ("leakage", "flow_offset", "flow_scale", "speed_scale", "inertia")]
    rivals += [Weighed((name,), 0.0089) for name in ("speed_lag", "wall_heat_exchange", "stribeck_friction")]
    found = judge(1e-9, [best, *rivals, base], {(): 1e-9} | {one.names: 0.3 for one in (best, *rivals)}, None)
    assert (found.kind, found.chosen) == ("confounded", best)
    assert found.alternatives == tuple(one.names for one in rivals[:7])  # with them it is 99 % of what passes
    found = judge(1e-9, [best, *rivals[:3], base], {(): 1e-9} | {one.names: 0.3 for one in (best, *rivals)}, None)
    assert found.kind == "named"


@pytest.mark.parametrize(("p_alone", "kind"), [(1e-6, "named"), (0.002, "confounded")])
def test_a_further_effect_is_named_only_where_the_smaller_set_clearly_fails(p_alone: float, kind: str) -> None:
    base, drag, both = Weighed((), 0.0), Weighed(("windage",), 1e-6), Weighed(("stribeck_friction", "windage"), 0.999)
    found = judge(1e-9, [both, drag, base], {(): 1e-9, drag.names: p_alone, both.names: 0.3}, None)
    assert (found.kind, found.chosen) == (kind, both)
    assert found.alternatives == ((drag.names,) if kind == "confounded" else ())


def test_beside_a_base_model_that_is_not_excluded_it_is_listed() -> None:
    drag, base = Weighed(("windage",), 0.69), Weighed((), 0.3)
    found = judge(0.005, [drag, base], {(): 0.005, drag.names: 0.4}, None)
    assert (found.kind, found.chosen, found.alternatives) == ("confounded", drag, ((),))
    document = {"verdict": "confounded", "mismatch": {"p_value": 0.005}, "effects": [{"id": "windage"}]}
    said = sentence(document | {"alternatives": [[]], "next_tests": [{"test": "a coast-down"}]})
    assert said.startswith("The model may not fit (p = 0.005). Most likely ")
    assert said.endswith("; also possible: nothing left out. To decide: a coast-down.")


@pytest.mark.parametrize(("row", "alone"), [(0, True), (1, False), (2, False), (4, False), (5, False)])
def test_a_row_alone_at_an_end_of_the_pressures_is_not_called_misread(row: int, alone: bool) -> None:
    """Nothing tells there whether it is misread, or the motor does something else."""
    pressure = np.array([1.2, 1.5, 1.8, 1.5, 2.1, 2.1]) * 1e5
    rows = [Row("sweep.csv", i + 1, channel, P) for channel in ("flow", "speed") for i, P in enumerate(pressure)]
    comparison = SimpleNamespace(known=np.ones(12, dtype=bool), rows=rows)
    bad = np.zeros(12)
    bad[6 + row] = 1.0
    assert alone_at_an_end(comparison, SimpleNamespace(bad=bad)) is None  # type: ignore[arg-type]  # its flow is right
    bad[row] = 1.0
    found = alone_at_an_end(comparison, SimpleNamespace(bad=bad))  # type: ignore[arg-type]
    assert found == (("sweep.csv", row + 1, "flow", 1.0) if alone else None)


@pytest.mark.parametrize(("p", "kind"), [(0.005, "consistent"), (1e-9, "unresolved")])
def test_a_likely_base_model_is_held_to_what_any_set_is_held_to(p: float, kind: str) -> None:
    base, drag = Weighed((), 0.9), Weighed(("windage",), 0.1)
    assert judge(p, [base, drag], {(): p, drag.names: 0.4}, None).kind == kind


@pytest.mark.parametrize(
    ("gain", "declared", "kind"),
    [
        (-3.0, 12.0, "named"),
        (0.5, 12.0, "named"),
        (-5.0, 12.0, "unresolved"),
        (0.5, 3.0, "unresolved"),
        (8.0, -6.0, "unresolved"),
    ],
)
def test_a_declared_figure_that_is_predicted_better_counts_as_a_reading(
    gain: float, declared: float, kind: str
) -> None:
    """Differences below 4 decide nothing, whatever few folds say of their error."""
    base, heavy = Weighed((), 0.0), Weighed(("inertia",), 0.999)
    held_out = HeldOut(12, 12, {}, {}, gain, 1.5, "", Predicted.BY_SET, declared=declared)
    assert judge(1e-9, [heavy, base], {(): 1e-9, heavy.names: 0.3}, held_out).kind == kind


def test_a_set_that_was_not_tested_is_not_named() -> None:
    """However probable: what it leaves was never looked at."""
    base, drag, both = Weighed((), 0.0), Weighed(("windage",), 0.001), Weighed(("stribeck_friction", "windage"), 0.999)
    found = judge(1e-9, [both, drag, base], {(): 1e-9, drag.names: 0.3}, None)
    assert (found.kind, found.chosen, found.alternatives) == ("confounded", drag, (both.names,))


@pytest.mark.parametrize(
    ("names", "place", "value"),
    [("flow_density_correction", 0, 0.5), ("once_per_rev_torque", 1, 2.0), ("once_per_rev_torque", 1, -2.0)],
)
def test_a_size_at_the_edge_of_what_is_believable_is_refused(leaking, names: str, place: int, value: float) -> None:
    """At the lower edge too, and in either component of a torque once per turn."""
    comparison = Comparison(Problem(leaking[0]))
    k, (name, unknown) = len(comparison.problem.nuisances), comparison.problem.effect_unknowns((names,))[place]
    found = find(comparison, ())
    z = np.append(found.z, np.full(len(comparison.problem.effect_unknowns((names,))), 0.3))
    z[k + place] = unknown.z(value)
    said = refusal(comparison, replace(found, names=(name,), z=z))
    assert str(said) == f"{name}: {unknown.name} is at the bound of what is believable"


def test_a_declared_figure_is_predicted_as_if_it_had_not_been_declared(leaking) -> None:
    """Its own prior is taken off, the point found anew, and what was declared is read there."""
    comparison = Comparison(Problem(leaking[0]))
    z, A, _ = fit_on(comparison, find(comparison, ()), comparison.known)
    figures = [i for i in range(z.size) if comparison.problem.run_of(i) is None]
    predicted = []
    for i in figures:
        without = A.copy()
        without[i, i] -= 1.0
        there, variance = np.linalg.solve(without, A @ z)[i], np.linalg.inv(without)[i, i]
        predicted.append(norm.logpdf(0.0, there, math.sqrt(1.0 + variance)) - norm.logpdf(0.0))
    assert confirm._declared(comparison, z, A) == pytest.approx(predicted, rel=1e-5, abs=1e-5)
    assert min(predicted) < -1.0 < max(predicted)


def test_what_is_held_out_counts_in_every_model_whichever_takes_it_for_bad(leaking) -> None:
    """A reading that one model alone gives up costs that model a bad reading's price, in whatever unit it is."""
    comparison = Comparison(Problem(leaking[0]))
    found = find(comparison, ("leakage",))
    held = np.zeros(found.r.size, dtype=bool)
    held[0] = True
    given_up = replace(found, bad=np.where(held, 1.0, found.bad))
    z, A, _ = fit_on(comparison, found, ~held)
    good, bad = (predict_held(comparison, mode, z, A, held)[0] for mode in (found, given_up))
    r, J = (found.r + found.J @ (found.z - z))[0], found.J[0]
    spread = float(J @ np.linalg.solve(A, J))
    # Cauchy's law, as dense at 0 as a normal one ten times as wide, and the normal law that has its slope at the mode.
    at, scale = found.r[0], 10.0 * math.sqrt(2.0 / math.pi)
    own = (scale**2 + at**2) / 2.0
    law = -math.log(10.0) - math.log1p((at / scale) ** 2) + 0.5 * at**2 / own
    wide, narrow = own + spread, 1.0 + spread
    price = math.log(0.01 / 0.99) + law - 0.5 * math.log(wide / own / narrow) - 0.5 * r**2 * (1.0 / wide - 1.0 / narrow)
    assert bad - good == pytest.approx(price, abs=1e-9)


def test_every_fold_chooses_a_leak_that_is_there(leaking) -> None:
    comparison = Comparison(Problem(leaking[0]))
    modes = {names: find(comparison, names) for names in ((), ("leakage",), ("windage",))}
    candidates = weigh(comparison, modes)
    found = cross_validate(comparison, candidates, candidates[0].names)
    assert found.same == found.folds
    assert found.gain > 4.0


def test_a_model_that_is_thousands_of_nats_behind_is_so_in_every_fold_that_does_not_hold_out_why(leaking) -> None:
    """Its probability is no number that a computer holds; its logarithm is."""
    comparison = Comparison(Problem(leaking[0]))
    modes = {names: find(comparison, names) for names in ((), ("leakage",))}
    held = comparison.folds()[0][0]
    found = {}
    for block_is_off in (False, True):
        base = modes[()]
        r = base.r + np.where(held, 100.0 * block_is_off, 0.0)
        behind = 0.5 * float(r @ r - base.r @ base.r)
        off = replace(base, r=r, log_evidence=base.log_evidence - behind)
        found[block_is_off] = cross_validate(comparison, weigh(comparison, {**modes, (): off}), ("leakage",))
    assert found[True].same == found[True].folds
    assert found[True].gain > found[False].gain + 1000.0


def test_the_law_of_the_test_is_drawn_with_noise_as_loud_as_the_recordings(tmp_path: Path) -> None:
    sweep(tmp_path, 7, {})
    text = (tmp_path / "recording.toml").read_text(encoding="utf-8")
    loud = []
    for factor in (1.0, 0.5):
        for sd in ("0.0015", "0.8", "0.4"):
            text = text.replace(f"noise_sd = {sd}\n", f"noise_sd = {factor * float(sd):g}\n")
        (tmp_path / "recording.toml").write_text(text, encoding="utf-8")
        comparison = Comparison(Problem(read_recording(tmp_path)))
        base = base_of(comparison)
        difference = np.nan_to_num(comparison.read - comparison.raw(base.prediction) + base.D @ base.z)
        test = _Test(comparison, base, signatures(comparison, base), forces(comparison, base))
        noise, spread = test.noise.law(difference)
        loud.append(noise[SCALES])
        assert np.all(spread[:4] > 0.05) and np.all(spread < 0.35) and spread[4] == 0.0  # there are no runs
    assert np.abs(loud[0]).max() < 0.4  # declared rightly
    assert (loud[1] - loud[0]).mean() == pytest.approx(np.log(2.0), abs=0.35)  # the prior draws it back a little


@pytest.mark.long
def test_noise_far_louder_than_declared_is_a_mismatch_and_said_so(tmp_path: Path) -> None:
    sweep(tmp_path, 8, {})
    text = (tmp_path / "recording.toml").read_text(encoding="utf-8")
    for sd in ("0.0015", "0.4"):
        text = text.replace(f"noise_sd = {sd}\n", f"noise_sd = {float(sd) / 12.0:g}\n")
    (tmp_path / "recording.toml").write_text(text, encoding="utf-8")
    found = as_json(diagnose(read_recording(tmp_path), 1))
    assert found["verdict"] == "unresolved" and found["mismatch"]["p_value"] < 1e-4
    said = re.search(r"the (pressure|speed)'s noise would be ([0-9.]+) times as large as declared", found["why"])
    assert said is not None and 4.0 < float(said[2]) < 20.0


def test_an_effect_that_is_not_there_adds_no_evidence(tmp_path: Path) -> None:
    comparison = Comparison(Problem(sweep(tmp_path, 8, {})))
    base = find(comparison, ())
    assert find(comparison, ("windage",), base).log_evidence < base.log_evidence + 2.0


def test_a_further_effect_costs_more_than_the_first(tmp_path: Path) -> None:
    assert log_prior(0, 17) > log_prior(1, 17) > log_prior(2, 17)
    assert np.isclose(log_prior(1, 17) - log_prior(0, 17), -np.log(17.0))
    assert np.isclose(log_prior(2, 17) - log_prior(1, 17), -np.log(10.0) - np.log(8.0))  # 136 pairs, ten times rarer


CASES = {"p02": [set()], "p09": [{"friction_warm_up"}]}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.long
def test_a_practice_recording_is_not_misnamed(name: str) -> None:
    if not (PRACTICE / name).is_dir():
        pytest.skip("the practice recordings are not on this machine")
    found = as_json(diagnose(read_recording(PRACTICE / name), 1))
    if found["verdict"] == "consistent":
        assert set() in CASES[name]
    else:
        assert any(said in CASES[name] for said in sets_said(found))
        if found["verdict"] == "named":
            assert {e["id"] for e in found["effects"]} in CASES[name]


def test_the_most_probable_of_what_is_possible_is_told_apart_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A friction that f_overall hides is one of three that the next test is weighed for, and not ahead of likelier."""
    sets = (("load_friction",), ("coulomb_friction",), ("leakage",), ())
    candidates = [
        Candidate(names, None, 0.0, math.log(p)) for names, p in zip(sets, (0.4, 0.2, 0.21, 0.19), strict=True)
    ]
    monkeypatch.setattr(sys.modules[_rivals.__module__], "behind_friction", lambda *_: [candidates[1]])
    rivals = _rivals(SimpleNamespace(), candidates, judge(0.4, candidates, {}, None))
    assert [one.names for one in rivals] == [(), ("load_friction",), ("leakage",), ("coulomb_friction",)]


def test_all_sets_that_are_not_excluded_are_said_to_be_possible() -> None:
    without_friction = SimpleNamespace(problem=SimpleNamespace(friction="", place=lambda _: None), rig=False)
    possible = ["leakage", "pressure_gauge_offset", "windage"]
    sets = [*((name,) for name in possible), ()]
    candidates = [
        Candidate(names, None, 0.0, math.log(p)) for names, p in zip(sets, (0.3, 0.25, 0.24, 0.2), strict=True)
    ]
    verdict = judge(0.4, candidates, {}, None)
    rivals = _rivals(without_friction, candidates, verdict)
    assert [one.names for one in rivals] == [(), *sets[:3]]
    document = {
        "verdict": "consistent",
        "mismatch": {"p_value": 0.4},
        "rivals": [{"effects": list(one.names)} for one in rivals],
    }
    said = sentence(document)
    assert all(name in said.partition("Still possible: ")[2] for name in possible)
