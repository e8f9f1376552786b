"""Calibration in strata, in small; `make sbc-strata` is the campaign."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from calibration.likelihood.function import Function
from calibration.studies import strata_table
from calibration.studies.strata import calibrate
from calibration.studies.strata_draw import STRATA, case_of

SEED = 7_500
COUNT = 6
PLACES = np.linspace(0.025, 0.975, 39)


@pytest.fixture(scope="module")
def rows():
    return [
        calibrate({"stratum": stratum, "seed": SEED + i, "emcee": False})
        | {"name": f"{stratum}-{SEED + i}", "error": "", "seconds": 1.0}
        for stratum in ("sweep", "sweep_effect")
        for i in range(COUNT)
    ]


@pytest.mark.parametrize("stratum", ["sweep_effect", "two_days"])
def test_readings_are_the_models_with_noise_as_drawn(stratum):
    case = case_of(STRATA[stratum], SEED)
    predicted = Function(case.comparison, case.names)(case.z)
    white = case.comparison.whitener(predicted, case.u)
    left = white(case.comparison.read - case.comparison.raw(predicted))
    low, high = stats.chi2.ppf([0.0005, 0.9995], left.size)
    assert low < float(left @ left) < high


def test_the_same_seed_draws_the_same_case():
    first, second = (case_of(STRATA["sweep"], SEED) for _ in range(2))
    np.testing.assert_array_equal(first.comparison.read, second.comparison.read)
    np.testing.assert_array_equal(first.z, second.z)


@pytest.mark.long
def test_truths_lie_where_laplace_says(rows):
    """The distances of f_overall and the sizes in their sds, all together."""
    ranks = [row["laplace"][of]["rank"] for row in rows for of in ("f_overall", "size") if of in row["laplace"]]
    scores = stats.norm.ppf(ranks)
    low, high = stats.chi2.ppf([0.0005, 0.9995], scores.size)
    assert scores.size == 3 * COUNT
    assert low < float(scores @ scores) < high
    assert all(row["behind"] < strata_table.MISSED for row in rows)


@pytest.mark.long
@pytest.mark.parametrize("seed", [640_020, 640_030])
def test_the_search_follows_the_lines_of_runs_in_time(seed):
    """A line that fills or empties can be followed in several ways, of which one is far better."""
    assert calibrate({"stratum": "runs", "seed": seed, "emcee": False})["behind"] < 0.0


@pytest.mark.long
def test_a_real_supplys_design_is_of_another_bench_for_each_seed():
    first, second = (case_of(STRATA["real_supplies"], SEED + i) for i in range(2))
    assert first.comparison.read.size != second.comparison.read.size
    first.comparison.see_pulses(first.z)
    predicted = Function(first.comparison, ())(first.z)
    white = first.comparison.whitener(predicted, first.u)
    left = white(first.comparison.read - first.comparison.raw(predicted))
    low, high = stats.chi2.ppf([0.0005, 0.9995], left.size)
    assert low < float(left @ left) < high


def test_the_summary_counts_each_part(rows):
    found = strata_table.summary([*rows, {"name": f"sweep-{SEED + COUNT}", "error": "it broke"}], SEED, "code")
    sweep, effect = found["strata"]["sweep"], found["strata"]["sweep_effect"]
    assert (sweep["cases"], sweep["failed"], effect["failed"]) == (COUNT, 1, 0)
    inside = sum(abs(row["laplace"]["f_overall"]["rank"] - 0.5) < 0.45 for row in rows if row["stratum"] == "sweep")
    assert sweep["parts"]["all"]["f_overall"]["90"]["hits"] == inside
    assert sweep["parts"]["all"]["size"] is None
    at_bound = [effect["parts"][f"size at {which}"]["size"] for which in ("a bound", "no bound")]
    assert sum(one["90"]["n"] for one in at_bound if one) == COUNT
    assert "an effect's size" in strata_table.table(found)
    documents = strata_table.documents(found, rows)
    for picture in ("sbc_strata.png", "sbc_strata_coverage.png"):
        assert documents[picture].startswith(b"\x89PNG")


def test_the_band_holds_uniform_ranks_and_not_those_of_intervals_too_narrow():
    low, high = strata_table.band(150, PLACES)
    rng = np.random.default_rng(1)

    def leaves(ranks):
        ecdf = np.searchsorted(np.sort(ranks), PLACES, side="right") / ranks.size
        return bool(np.any((ecdf < low) | (ecdf > high)))

    assert sum(leaves(rng.uniform(size=150)) for _ in range(500)) < 20
    assert leaves(stats.norm.cdf(2.0 * rng.standard_normal(150)))


@pytest.mark.long
def test_emcee_has_the_same_f_overall_of_a_sweep():
    row = calibrate({"stratum": "sweep", "seed": 650_000, "emcee": True})
    found = strata_table.summary([row | {"name": "sweep", "error": "", "seconds": 1.0}], SEED, "")
    (against,) = found["emcee"]["against"]
    assert abs(against["means_apart"]) < 0.5
    assert against["sd_ratio"] == pytest.approx(1.0, abs=0.3)
