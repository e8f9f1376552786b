"""The check of the evidence: integrals that are known, a real sweep, the campaign and its page."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from calibration.likelihood.descent import find
from calibration.likelihood.mode import minus_log_posterior
from calibration.studies import evidence, evidence_page, evidence_reference
from calibration.studies.campaigns import main
from calibration.studies.evidence_reference import NOWHERE, adapted, importance, nested
from calibration.studies.evidence_target import Target
from calibration.studies.nulls_draw import null_recording
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from model.effects import effects

SEED = 7
NO_STALL = 8  # a seed whose sweep has no level near a stall


@pytest.fixture(scope="module")
def comparison():
    recording, _ = null_recording("declared", False, np.random.default_rng(NO_STALL))
    return Comparison(Problem(recording))


@pytest.fixture(scope="module")
def base(comparison):
    return base_of(comparison)


def half_of_a_normal(d):
    """A correlated normal of which only the half above 0 counts: its integral is 1/2."""
    mixed = np.random.default_rng(SEED).standard_normal((d, d))
    covariance = mixed @ mixed.T / d + 0.3 * np.eye(d)
    precision, log_det = np.linalg.inv(covariance), np.linalg.slogdet(2.0 * np.pi * covariance)[1]

    def density(v):
        return -0.5 * float(v @ precision @ v + log_det) if v[0] > 0.0 else NOWHERE

    return density, covariance


def test_nested_sampling_finds_a_known_integral_within_the_error_that_it_states():
    density, covariance = half_of_a_normal(6)
    runs = [nested(density, np.zeros(6), covariance, [SEED, i]) for i in range(8)]
    off = np.array([run.log_evidence - math.log(0.5) for run in runs])
    error = np.mean([run.error for run in runs])
    assert error < 0.2
    assert abs(off.mean()) < error
    assert np.sqrt(np.mean(off**2)) < 1.5 * error


def test_importance_sampling_finds_a_known_integral_within_the_error_that_it_states():
    density, covariance = half_of_a_normal(6)
    found = importance(density, np.zeros(6), covariance, [SEED], 4000)
    assert found.error < 0.03
    assert abs(found.log_evidence - math.log(0.5)) < 3.0 * found.error
    assert found.calls == 4000


def test_the_error_grows_and_the_effective_draws_fall_where_few_draws_carry_the_weight():
    density, covariance = half_of_a_normal(6)
    good = importance(density, np.zeros(6), covariance, [SEED], 1000)
    poor = importance(density, np.full(6, 1.0), 9.0 * covariance, [SEED], 1000)
    assert poor.error > 2.0 * good.error
    assert poor.effective < 0.3 * good.effective


def test_a_density_that_is_elsewhere_and_narrower_than_thought_is_found():
    d, centre, sd = 6, 1.5, 0.3

    def density(v):
        return float(-0.5 * np.sum(((v - centre) / sd) ** 2)) - d * math.log(sd * math.sqrt(2.0 * math.pi))

    found = adapted(density, np.ones(d), [SEED])
    np.testing.assert_allclose(found.mean, centre, atol=0.3 * sd)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sd, rtol=0.4)
    fresh = importance(density, found.mean, found.covariance, [SEED], 1000)
    assert abs(fresh.log_evidence) < 4.0 * fresh.error < 0.3


def test_at_the_mode_the_target_is_the_posterior_of_the_diagnosis(comparison, base):
    target = Target(comparison, base)
    white = comparison.whitener(base.prediction, base.u)
    r = white(comparison.read - comparison.raw(base.prediction))
    cost = minus_log_posterior(r, white.log_scale, base.z, base.u, comparison)
    half_log_det = 0.5 * np.linalg.slogdet(base.covariance)[1]
    prior = -0.5 * base.z.size * math.log(2.0 * math.pi)
    per_noise = target(np.zeros(target.size)) + cost - half_log_det - prior
    assert per_noise == pytest.approx(target.noise_log_volume - 0.5 * base.u.size * math.log(2.0 * math.pi), abs=1e-3)


def test_going_once_through_each_level_predicts_the_same(comparison, base):
    target, rng = Target(comparison, base), np.random.default_rng(SEED)
    for _ in range(5):
        v = rng.standard_normal(target.size)
        z = target._unknowns(v)
        once, whole = target._sweep(z), target._f(z)
        for name in ("flow", "speed", "flow_slope", "speed_slope"):
            np.testing.assert_array_equal(getattr(once, name), getattr(whole, name))


def test_an_effect_that_follows_time_is_not_taken_to_repeat(comparison, base):
    warm = find(comparison, ("friction_warm_up",), base)
    target = Target(comparison, warm)
    there = warm.z.copy()
    there[-2] += 1.0
    n = comparison.n
    up, down = target._sweep(there).speed[[3, n - 4]]
    assert abs(up - down) > 1e-3 * up


def test_the_change_of_coordinates_keeps_volume_but_for_the_root_of_the_covariance(comparison, base):
    target, rng = Target(comparison, base), np.random.default_rng(SEED)
    v = 0.5 * rng.standard_normal(target.size)
    m, step = base.z.size, 1e-4
    columns = []
    for i in range(m):
        by = np.zeros(target.size)
        by[i] = step
        columns.append((target._unknowns(v + by) - target._unknowns(v - by)) / (2.0 * step))
    found = np.linalg.slogdet(np.column_stack(columns))[1]
    assert found == pytest.approx(0.5 * np.linalg.slogdet(base.covariance)[1], abs=1e-3)


def test_outside_the_bounds_of_an_effect_there_is_nothing(comparison, base):
    mode = find(comparison, ("windage",), base)
    target = Target(comparison, mode)
    calls = target.calls
    v = np.zeros(target.size)
    v[base.z.size - 1] = -1e3  # the amplitude, far below 0
    assert target(v) == NOWHERE
    assert target.calls == calls


@pytest.mark.long
@pytest.mark.slow
def test_of_a_real_sweep_both_samplers_and_laplace_give_one_evidence(comparison, base):
    target = Target(comparison, base)
    near = adapted(target, target.width, [SEED, 0])
    # One draw far out may outweigh a whole sample: the middle one of three.
    samples = [importance(target, near.mean, near.covariance, [SEED, turn], 4000) for turn in (1, 3, 4)]
    weighed = sorted(samples, key=lambda one: one.effective)[1]
    run = nested(target, near.mean, near.covariance, [SEED, 2], live=40)
    laplace = base.log_evidence + target.noise_log_volume
    assert weighed.effective > 50.0
    assert abs(run.log_evidence - weighed.log_evidence) < 3.0 * math.hypot(run.error, weighed.error)
    assert abs(laplace - weighed.log_evidence) < evidence_page.AGREE


def items_of(cases, nested_every=1):
    return evidence.items_of(SimpleNamespace(cases=cases, nested_every=nested_every, first_seed=SEED), "code")


def test_every_effect_of_a_sweep_is_concealed_and_every_other_case_is_a_null():
    items = items_of(50)
    concealed = [item.argument["concealed"] for item in items]
    assert [bool(one) for one in concealed] == [i % 2 == 0 for i in range(50)]
    names = {name for one in concealed for name in one}
    assert names == {e.id for e in effects().values() if e.listed and e.id != "bad_reading" and not e.transient_only}
    for name, values in ((name, values) for one in concealed for name, values in one.items()):
        for parameter in effects()[name].parameters:
            assert parameter.low <= values[parameter.name] <= parameter.high
    assert len({item.argument["noise"] for item in items}) == 5


def test_fewer_cases_are_the_first_of_more():
    assert items_of(5) == items_of(50)[:5]


def test_nested_sampling_is_done_where_it_is_asked_for_and_repeated_in_one_case_of_five():
    repeats = [item.argument["repeats"] for item in items_of(20, nested_every=2)]
    assert repeats == [2, 0, 1, 0, 1, 0, 1, 0, 1, 0] * 2
    assert {item.argument["repeats"] for item in items_of(4, nested_every=0)} == {0}


def model_of(laplace, sampled, runs=()):
    return {
        "unknowns": 17,
        "laplace": laplace,
        "noise_log_volume": -2.0,
        "importance": {"log_evidence": sampled, "error": 0.03, "effective": 200.0},
        "nested": [{"log_evidence": one, "error": 0.04, "calls": 100} for one in runs],
        "calls": 500,
    }


def row_with(base, full, **changes):
    value = {"amplitude": 1.0, "amplitude_sd": 0.1, "slowest_rad_s": 9.0, "not_read": 0} | changes
    numbers = evidence_page.numbers(value | {"base": base, "with_effect": full})
    row = {"name": "case", "seed": 1, "noise": "declared", "concealed": "", "size": None, "effect": "windage"}
    return row | numbers | {"seconds": 2.0, "error": ""}


def test_figures_are_of_the_effect_over_the_base_model():
    row = row_with(model_of(10.0, 7.9, (7.8, 8.0)), model_of(13.0, 10.1, (10.3, 10.6)))
    assert row["laplace"] == pytest.approx(3.0)
    assert row["nested"] == pytest.approx(2.5)
    assert row["nested_again"] == pytest.approx(2.6)
    assert row["importance"] == pytest.approx(2.2)
    assert row["importance_error"] == pytest.approx(math.hypot(0.03, 0.03))
    assert (row["base_off"], row["effect_off"]) == (pytest.approx(0.1), pytest.approx(0.9))
    assert evidence_page.reference(row) == (row["nested"], row["nested_error"])


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({}, "other"),
        ({"amplitude_sd": 0.6}, "zero"),
        ({"not_read": 1}, "stall"),
        ({"slowest_rad_s": 0.2, "amplitude_sd": 0.6}, "stall"),
    ],
)
def test_a_case_is_of_the_kind_that_its_mode_shows(changes, kind):
    assert evidence_page.kind(row_with(model_of(0.0, 0.0), model_of(0.0, 0.0), **changes)) == kind


def test_a_case_that_is_off_is_counted_shown_and_set_in_bold():
    near, far = row_with(model_of(10.0, 8.0), model_of(10.3, 8.0)), row_with(model_of(10.0, 8.0), model_of(9.0, 8.0))
    failed = dict.fromkeys(near) | {"name": "case-9", "seed": 9, "noise": "heavy", "effect": "", "concealed": ""}
    rows = [near, far, failed | {"seconds": 1.0, "error": "it broke"}]
    found = evidence_page.summary(rows, SEED, "code")
    assert (found["cases"], found["failed"], found["nested"]) == (3, 1, 0)
    assert (found["all"]["cases"], found["all"]["within"], found["all"]["smaller"]) == (2, 1, 1)
    page = evidence_page.page(found, rows)
    assert "**-1.00**" in page and "**+0.30**" not in page
    assert "case-9: it broke" in page and "| failed |" in page
    assert evidence_page.picture(rows).startswith(b"\x89PNG")


@pytest.mark.long
def test_a_campaign_is_written_and_its_page_only_where_it_is_asked_for(tmp_path, capsys, monkeypatch):
    for name, value in (("ROUND_DRAWS", 60), ("FEWEST_ROUNDS", 1), ("MOST_ROUNDS", 2)):
        monkeypatch.setattr(evidence_reference, name, value)
    monkeypatch.setattr(evidence, "DRAWS", 60)
    given = ["-o", str(tmp_path), "--cases", "1", "--nested-every", "0", "--workers", "0"]
    page = tmp_path / "page"
    assert main(evidence.STUDY, given) == 0
    (result,) = (tmp_path / "results").glob("*.json")
    before = result.read_bytes()
    assert not page.exists()
    assert main(evidence.STUDY, [*given, "--page", str(page)]) == 0
    assert result.read_bytes() == before
    assert sorted(path.name for path in page.iterdir()) == ["evidence.json", "evidence.md", "evidence.png"]
    (case,) = json.loads((page / "evidence.json").read_text(encoding="utf-8"))["cases"]
    assert case["effect"] == "coulomb_friction"
    assert case["nested"] is None and np.isfinite(case["importance"])
    assert "| all | 1 |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "said"),
    [(["--cases", "0"], "nothing to do"), (["--cases", "-3"], "'-3' is not a whole number of 0 or more")],
)
def test_a_command_that_cannot_be_done_is_refused_in_a_line(given, said, tmp_path, capsys):
    try:
        code = main(evidence.STUDY, ["-o", str(tmp_path / "out"), *given])
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
