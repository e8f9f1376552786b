"""What a chain is summarised to, and what of it stands in posterior/1."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import norm

from calibration.fit import fit, posterior
from calibration.fit.sampling import Chain
from calibration.systems.radial_piston.batch.likelihood import Likelihood
from rig.recording import Recording, read_recording

SWEEP = "pressure_bar_abs,flow_l_min,speed_rpm\n1.6,41.5,229.4\n1.8,57.2,270.0\n2.0,72.9,397.1\n"


@pytest.fixture
def recording(put_recording) -> Recording:
    """Three plateaus of the default motor at 20 degrees Celsius; the speed of row 2 is 43 rpm too low."""
    return read_recording(put_recording(("sweep.csv", "steady", SWEEP)))


@pytest.fixture
def likelihood(recording) -> Likelihood:
    return fit.prepare(recording)[2]


@pytest.fixture
def chain(likelihood) -> Chain:
    """Draws about the default motor: the air's temperature at half its prior sd, the others narrow (seed 31)."""
    n = len(likelihood.unknowns)
    samples = 0.001 * np.random.default_rng(31).standard_normal((4, 100, 16, n))
    samples[..., name_index(likelihood, "ambient_temperature")] *= 500.0
    samples[..., name_index(likelihood, "inertia")] *= 1000.0
    samples[..., name_index(likelihood, "f_overall")] = likelihood.unknowns[name_index(likelihood, "f_overall")].z(
        0.0625
    )
    tau = np.linspace(2.0, 4.0, n)
    return Chain(samples, tau, np.full(n, 1.001), 6400.0 / tau, 0.5, 275, 100, True, 1.0)


@pytest.fixture
def found(chain, likelihood, recording) -> posterior.Posterior:
    return posterior.summarise(chain, likelihood.unknowns, fit.suspects(chain, likelihood, recording), 12.5)


def name_index(likelihood: Likelihood, name: str) -> int:
    return [unknown.name for unknown in likelihood.unknowns].index(name)


def test_an_estimate_is_in_the_unknowns_own_unit(found):
    air = found["ambient_temperature"]
    assert air.unknown.unit == "K"
    assert air.mean == pytest.approx(293.15, abs=0.01)
    assert air.sd == pytest.approx(0.25, rel=0.03)


def test_quantiles_are_those_of_the_draws(found):
    q = found["ambient_temperature"].quantiles
    assert list(q) == ["q05", "q50", "q95"]
    np.testing.assert_allclose(list(q.values()), 293.15 + 0.25 * norm.ppf([0.05, 0.5, 0.95]), atol=0.015)


def test_the_share_of_the_prior_left_says_whether_it_dominates(found):
    assert found["ambient_temperature"].sd_of_prior == pytest.approx(0.5, rel=0.03)
    assert found["inertia"].sd_of_prior == pytest.approx(1.0, rel=0.03)
    assert found.prior_dominates("inertia")
    assert not found.prior_dominates("flow_offset")


def test_values_are_kept_draw_by_draw(found, likelihood, chain):
    np.testing.assert_array_equal(found.values, likelihood.values(chain.flat()))


def test_a_reading_more_probably_bad_than_good_is_named_with_its_row_and_column(found):
    (row,) = found.suspect_rows
    assert (row.file, row.row, row.channel) == ("sweep.csv", 2, "speed_rpm")
    assert 0.5 < row.probability <= 1.0


def test_thinned_draws_are_evenly_spaced_and_not_too_many():
    flat = np.arange(1001.0)[:, None]
    kept = posterior.thinned(flat, most=100)
    assert len(kept) <= 100
    assert set(np.diff(kept[:, 0])) == {11.0}
    np.testing.assert_array_equal(posterior.thinned(flat, most=2000), flat)


def test_posterior_1_is_plain_json_of_these_numbers(found, chain):
    data = posterior.as_json(found)
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["format"] == "posterior/1"
    assert list(data["parameters"]) == [estimate.unknown.name for estimate in found.estimates]
    air = found["ambient_temperature"]
    assert data["parameters"]["ambient_temperature"] == {"unit": "K", "mean": air.mean, "sd": air.sd, **air.quantiles}
    assert data["convergence"] == {
        "rhat_max": pytest.approx(1.001),
        "ess_min": pytest.approx(1600.0),
        "acceptance": 0.5,
        "steps": 275,
        "walkers": 16,
        "ensembles": 4,
    }
    assert data["suspect_rows"][0]["row"] == 2
    assert data["seconds"] == 12.5
