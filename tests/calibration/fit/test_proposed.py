"""Polynomials that propose for a fit of plateaus: how near they are, and that wrong ones are not trusted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.fit import fit, proposed
from calibration.fit.sampling import Settings
from calibration.systems.radial_piston.batch.likelihood import Likelihood
from rig.recording import Recording, read_recording

ROOT = Path(__file__).resolve().parents[3]
FEW = Settings(seed=1, effective_samples=1000, walkers=32)


@pytest.fixture(scope="module")
def published() -> Recording:
    return read_recording(ROOT / "logs" / "published_sweep")


@pytest.fixture
def likelihood(published) -> Likelihood:
    return fit.prepare(published)[2]


@pytest.fixture(scope="module")
def begun(published) -> proposed.Begun:
    found = proposed._begun(fit.prepare(published)[2], FEW)
    assert found is not None
    return found


def test_polynomials_agree_with_the_model_where_the_posterior_has_its_mass(likelihood, begun):
    points = begun.points
    there = points.mean(axis=0) + points.std(axis=0) * np.random.default_rng(1).standard_normal(
        (likelihood.points_wanted, points.shape[1])
    )
    polynomials = likelihood.polynomials(there)
    miss = likelihood.log_prob_by(polynomials, points) - likelihood.log_prob(points)
    assert np.std(miss) < 0.1


@pytest.mark.long
def test_a_chain_that_they_begin_needs_few_evaluations_for_a_sample(likelihood, monkeypatch):
    asked, true = [], likelihood.log_prob
    monkeypatch.setattr(likelihood, "log_prob", lambda z: asked.append(len(z)) or true(z))
    before = proposed._begun(likelihood, FEW)
    assert before is not None
    begin = sum(asked)
    chain = proposed.draw(likelihood, FEW)
    assert chain.converged
    assert chain.tau.max() < 2.5
    assert sum(asked) - 2 * begin < 4 * chain.effective.min()


@pytest.mark.long
def test_polynomials_that_are_wrong_are_not_trusted(likelihood, monkeypatch):
    right = Likelihood.polynomials

    def bent(self, z):
        found = right(self, z)
        found.coefficients[:, :, 0] *= 1.0 + 0.004 * np.arange(found.coefficients.shape[1])
        return found

    monkeypatch.setattr(Likelihood, "polynomials", bent)
    assert proposed._begun(likelihood, FEW) is None


def test_where_a_rotor_stands_still_none_are_made(published, tmp_path):
    (sweep,) = published.files
    speed = sweep.columns["speed_rpm"]
    pressure = sweep.columns["pressure_bar_abs"]
    values, at_rest = pressure.values.copy(), speed.values.copy()
    values[0], at_rest[0] = 1.03, 0.0
    columns = {
        **sweep.columns,
        "pressure_bar_abs": replace(pressure, values=values),
        "speed_rpm": replace(speed, values=at_rest),
    }
    _, _, likelihood = fit.prepare(replace(published, files=(replace(sweep, columns=columns),)))
    assert proposed._begun(likelihood, FEW) is None


@pytest.mark.parametrize("k", [0.2, 0.6, 1.2])
def test_heaviness_is_the_shape_of_a_pareto_tail(k):
    """Weights u^-k have a tail of that shape."""
    u = np.random.default_rng(3).random(20_000)
    assert proposed.heaviness(-k * np.log(u)) == pytest.approx(k, abs=0.12)


def test_equal_weights_have_no_tail_and_one_that_is_no_number_or_all_impossible_is_the_heaviest():
    assert proposed.heaviness(np.zeros(1000)) < 0.0
    assert proposed.heaviness(np.append(np.zeros(999), np.nan)) == np.inf
    assert proposed.heaviness(np.full(1000, -np.inf)) == np.inf
