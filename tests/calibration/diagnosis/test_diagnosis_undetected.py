"""What may be there unseen beside a set, and what f_overall is averaged over."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.document import as_json
from calibration.diagnosis.f_overall import SOLVERS_DIFFER
from calibration.diagnosis.sizes.not_excluded import undetected
from calibration.diagnosis.steps.name import beyond
from calibration.likelihood.descent import find
from calibration.likelihood.signatures import signatures
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from tests import diagnosis_recordings as recordings

AGREE = 1.0  # nats; the linear model's evidence against that of a refit


@pytest.mark.parametrize("name", ["coulomb_friction", "leakage", "stribeck_friction", "speed_scale", "windage"])
def test_the_linear_model_says_of_a_faint_effect_what_a_refit_says(name: str, tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 1, {})))
    base = base_of(comparison)
    place = comparison.problem.place("f_overall")
    one = {o.effect: o for o in undetected(comparison, base, signatures(comparison, base), np.random.default_rng(0))}[
        name
    ]
    refit = find(comparison, (name,), base, None)
    evidence = refit.log_evidence + beyond(comparison.problem, refit, name) - base.log_evidence
    K = len(comparison.problem.effects_that_could())
    assert math.log(one.odds * K) == pytest.approx(evidence, abs=AGREE)
    sd = math.sqrt(refit.covariance[place, place])
    assert one.f_overall_z.mean() == pytest.approx(refit.z[place], abs=sd)
    assert 0.6 * sd < one.f_overall_z.std() < 1.6 * sd


def test_an_effect_that_cannot_be_negative_moves_f_overall_one_way(tmp_path: Path) -> None:
    """Of dry friction there is none or some: f_overall with it lies to one side."""
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 1, {})))
    base = base_of(comparison)
    place = comparison.problem.place("f_overall")
    one = next(
        o
        for o in undetected(comparison, base, signatures(comparison, base), np.random.default_rng(0))
        if o.effect == "coulomb_friction"
    )
    away = (one.f_overall_z - base.z[place]) / math.sqrt(base.covariance[place, place])
    assert abs(np.quantile(away, 0.95)) > 1.3 * abs(np.quantile(away, 0.05))


def test_f_overall_of_a_consistent_recording_holds_what_may_be_there_unseen(tmp_path: Path) -> None:
    found = diagnose(recordings.sweep(tmp_path, 1, {}), seed=1)
    assert found.verdict.kind == "consistent"
    assert set(found.undetected) == {()}
    document = as_json(found)
    before, after = document["f_overall_before"], document["f_overall_after"]
    assert after["q05"] < before["q05"]
    assert after["q95"] > before["q95"]
    assert after["sd"] < 3.0 * before["sd"]


@pytest.mark.long
def test_no_interval_of_f_overall_is_narrower_than_two_solvers_differ(tmp_path: Path) -> None:
    recordings.sweep(tmp_path, 1, {})
    found = as_json(diagnose(recordings.add_coast_down(tmp_path, 1, {}), seed=1))
    before, after = found["f_overall_before"], found["f_overall_after"]
    assert before["sd"] / before["mean"] > SOLVERS_DIFFER
    assert after["sd"] / after["mean"] > SOLVERS_DIFFER


@pytest.mark.long
def test_f_overall_beside_an_effect_holds_that_its_law_may_have_another_form(tmp_path: Path) -> None:
    found = diagnose(recordings.sweep(tmp_path, 3, {"windage": {"drag_nm_s2": 3e-4}}), seed=1)
    assert found.verdict.chosen is not None
    assert found.verdict.chosen.names == ("windage",)
    mode, place = found.verdict.chosen.mode, found.comparison.problem.place("f_overall")
    unknown = found.comparison.problem.nuisances[place]
    sd = math.sqrt(mode.covariance[place, place])
    moved = float(unknown.value(mode.z[place]) - unknown.value(found.base.z[place]))
    alone = 0.5 * float(unknown.value(mode.z[place] + sd) - unknown.value(mode.z[place] - sd))
    after = as_json(found)["f_overall_after"]
    assert abs(moved) > 3.0 * alone
    assert after["q95"] - after["q05"] > 3.0 * math.hypot(alone, 0.2 * moved)
    assert after["mean"] == pytest.approx(float(unknown.value(mode.z[place])), abs=2.0 * after["sd"])
