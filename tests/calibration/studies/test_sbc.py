"""Simulation-based calibration in small; `make sbc` is the campaign."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calibration.studies import sbc

pytestmark = pytest.mark.long

SEEDS = range(7_100, 7_104)
BUDGET = {"effective_samples": 100, "most_steps": 500, "times_tau": 8.0}  # a mean and a spread need no more


@pytest.fixture(scope="module")
def results():
    return [sbc.simulate_and_rank(seed, **BUDGET) for seed in SEEDS]


def uniformity(results, narrower=1.0):
    """p-value of the truths' places in their posteriors, if those were ``narrower`` times narrower than they are."""
    scores = [narrower * score for result in results for score in result["scores"].values()]
    return stats.kstest(stats.norm.cdf(scores), "uniform").pvalue


def test_a_simulated_recording_shows_what_its_instruments_can():
    recording, truth = sbc.simulated_recording(np.random.default_rng(11))
    for name, column in recording.files[0].columns.items():
        steps = column.values / recording.channels[name].resolution
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    assert set(truth) >= {"f_overall", "port_lap", "roller_friction", "pressure_offset"}


def test_the_same_seed_draws_the_same_recording():
    first, second = (sbc.simulated_recording(np.random.default_rng(12))[0] for _ in range(2))
    for name, column in first.files[0].columns.items():
        np.testing.assert_array_equal(column.values, second.files[0].columns[name].values)


@pytest.mark.slow
def test_truths_lie_where_their_posteriors_say(results):
    assert sum(result["converged"] for result in results) >= len(results) - 1
    assert uniformity(results) > 1e-2


@pytest.mark.slow
def test_no_truth_is_far_from_its_posterior(results):
    """The distances' squares, and those of what the sweep tells most of, each by itself."""
    scores = [score for result in results for score in result["scores"].values()]
    low, high = stats.chi2.ppf([0.0005, 0.9995], len(scores))
    assert low < np.sum(np.square(scores)) < high
    for result in results:
        assert abs(result["scores"]["f_overall"]) < 3.3
        assert abs(result["scores"]["port_lap"]) < 3.3


@pytest.mark.slow
def test_posteriors_half_as_wide_would_be_noticed(results):
    assert uniformity(results, narrower=2.0) < 1e-2


@pytest.mark.slow
def test_the_summary_counts_fits_and_coverage(results):
    rows = [result | {"error": ""} for result in results]
    summary = sbc.summary([*rows, {"error": "it broke"}], SEEDS[0], "code")
    assert (summary["fits"], summary["failed"]) == (len(results), 1)
    hits = sum(result["inside"]["90"] for result in results)
    assert summary["coverage_of_f_overall"]["90"]["share"] == pytest.approx(hits / len(results))
    assert sbc.rank_plot(results).startswith(b"\x89PNG")
