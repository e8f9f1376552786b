"""The longer tails of what a size may be, and of what a misread reading may be off by."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import johnsonsu, multivariate_normal, norm

from calibration.diagnosis import as_json, diagnose
from calibration.diagnosis.sizes.sizes import sizes_of
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.confirm import fit_on, predict_held
from calibration.likelihood.descent import find
from calibration.likelihood.mode import log_bad, minus_log_posterior
from calibration.likelihood.tails import log_ratio, reweighed, reweighed_sizes, share
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from rig.recording import read_recording
from tests import diagnosis_recordings as recordings

SU = johnsonsu(0.0, 1.0)  # the hyperbolic sine of a standard normal number


def test_the_prior_is_the_law_of_a_hyperbolic_sine() -> None:
    z = np.array([-40.0, -3.0, -0.1, 0.0, 0.5, 2.0, 9.0])
    assert log_ratio(z) + norm.logpdf(z) == pytest.approx(SU.logpdf(z), abs=1e-9)
    for low, high in ((0.0, math.inf), (-1.0, 3.0), (0.0, 0.4)):
        assert share(low, high) == pytest.approx(SU.cdf(high) - SU.cdf(low), abs=1e-12)


@pytest.mark.parametrize(
    ("told", "width", "low", "high"),
    [
        (6.0, 0.3, 0.0, 20.0),
        (-4.0, 0.5, -20.0, 20.0),
        (0.3, 2.0, 0.0, 9.0),
        (1.0, 1.0, -2.0, 2.0),
        (3.0, 0.02, 0.0, 3.5),
    ],
)
def test_a_marginal_is_that_of_the_longer_tails(told: float, width: float, low: float, high: float) -> None:
    """Readings that say so much of a size: under either prior by quadrature, beside what is made of the normal one."""

    def integral(prior: Callable[[float], float], power: int = 0) -> float:
        near = [min(max(told + i * width, low), high) for i in (-8, -3, 0, 3, 8)]
        edges = np.unique([low, *near, min(max(0.0, low), high), high])
        parts = itertools.pairwise(edges)
        return sum(quad(lambda x: prior(x) * norm.pdf(x, told, width) * x**power, a, b)[0] for a, b in parts)

    precision = 1.0 + width**-2
    z, covariance = np.array([told * width**-2 / precision]), np.array([[1.0 / precision]])
    found = reweighed(z, covariance, np.array([low]), np.array([high]))
    whole = integral(SU.pdf)
    mean = integral(SU.pdf, 1) / whole
    without = norm.pdf(told, 0.0, math.hypot(1.0, width))  # the normal prior, without bounds
    assert found.log_gain == pytest.approx(math.log(whole / share(low, high) / without), abs=2e-3)
    assert found.z[0] == pytest.approx(mean, abs=2e-3 * found.sd[0])
    assert found.sd[0] == pytest.approx(math.sqrt(integral(SU.pdf, 2) / whole - mean**2), rel=5e-3)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize(
    ("told", "along", "across", "low"),
    [
        # Two effects that stand in for each other: 4 of one and 3 of the other, or 6 of one.
        ((4.0, 3.0), 3.0, 0.2, 0.0),
        ((1.0, 6.0), 1.5, 0.4, 0.0),
        ((3.0, 3.0), 0.2, 0.1, 0.0),
        ((-5.0, 4.0), 4.0, 0.3, -20.0),
    ],
)
def test_two_sizes_are_weighed_together(
    told: tuple[float, float], along: float, across: float, low: float, order: tuple[int, int]
) -> None:
    """Readings that say the sum of two well, and their difference badly: against a sum over both, on a fine grid."""
    turn = np.array([[1.0, 1.0], [-1.0, 1.0]]) / math.sqrt(2.0)
    precision = turn.T @ np.diag([across**-2, along**-2]) @ turn
    covariance = np.linalg.inv(precision + np.eye(2))
    z = covariance @ precision @ told
    t = np.linspace(math.asinh(low), math.asinh(20.0), 801)
    x, y = np.meshgrid(np.sinh(t), np.sinh(t), indexing="ij")
    log_density = multivariate_normal(z, covariance).logpdf(np.stack([x, y], axis=-1))
    log_density += log_ratio(x) + log_ratio(y) + np.log(np.cosh(t))[:, None] + np.log(np.cosh(t))
    density = np.exp(log_density)
    whole = float(density.sum()) * float(t[1] - t[0]) ** 2 / share(low, 20.0) ** 2
    found = reweighed(z[[*order]], covariance[np.ix_(order, order)], np.full(2, low), np.full(2, 20.0))
    assert found.log_gain == pytest.approx(math.log(whole), abs=0.03)
    for i, one in enumerate((x, y)):
        mean = float((density * one).sum() / density.sum())
        sd = math.sqrt(float((density * (one - mean) ** 2).sum() / density.sum()))
        assert found.z[order[i]] == pytest.approx(mean, abs=0.05 * sd)
        assert found.sd[order[i]] == pytest.approx(sd, rel=0.05)


def test_a_large_size_costs_little_and_is_hardly_pulled(tmp_path: Path) -> None:
    true = 8.5e9  # 5.7 scales
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 5, {"inlet_throttling": {"loss_pa_s2_m6": true}})))
    names = ("inlet_throttling",)
    mode = find(comparison, names, base_of(comparison))
    scales = mode.z[-1]
    assert scales > 4.5
    gain = reweighed_sizes(comparison.problem, names, mode.z, mode.covariance)[1].log_gain
    allowed = math.log(2.0 * (SU.cdf(2e10 / 1.5e9) - 0.5))
    assert gain == pytest.approx(SU.logpdf(scales) - norm.logpdf(scales) - allowed, abs=1.0)
    assert gain > 6.0
    (size,) = sizes_of(comparison.problem, Candidate(names, mode, 0.0, 0.0))
    assert scales < size.z < scales + 2.0 * math.sqrt(mode.covariance[-1, -1])
    assert size.unknown.value(np.array(size.z)) == pytest.approx(true, abs=2.0 * size.sd * size.unknown.b)


def test_a_misread_reading_costs_hardly_more_the_farther_it_is_off() -> None:
    r = np.array([0.0, 10.0, 100.0, 1000.0])
    assert log_bad(r)[0] == pytest.approx(math.log(0.01) + norm.logpdf(0.0, 0.0, 10.0) - norm.logpdf(0.0))
    assert np.diff(log_bad(r)) == pytest.approx([-0.944, -4.12, -4.6], abs=0.01)


def test_a_misread_reading_held_out_costs_what_it_costs_in_a_fit(tmp_path: Path) -> None:
    comparison = Comparison(Problem(recordings.sweep(tmp_path, 8, {}, bad_row=7, off_rpm=60.0)))
    mode = find(comparison, (), None)
    (place,) = np.flatnonzero(mode.bad > 0.5)
    assert abs(mode.r[place]) > 50.0
    held = np.zeros(comparison.read.size, dtype=bool)
    held[place] = True
    z, A, _ = fit_on(comparison, mode, ~held)
    density, _ = predict_held(comparison, mode, z, A, held)
    scale = comparison.whitener(mode.prediction, mode.u).scale[place]
    assert density + math.log(scale) == pytest.approx(log_bad(mode.r[[place]])[0], abs=0.3)
    # And all that a fit says of it: moved farther off by a factor, the cost rises by its logarithm twice.
    there = mode.r.copy()
    there[place] *= 3.0
    costs = [minus_log_posterior(r, 0.0, mode.z, mode.u, comparison) for r in (mode.r, there)]
    assert costs[1] - costs[0] == pytest.approx(2.0 * math.log(3.0), abs=0.1)


@pytest.mark.long
def test_a_warm_up_is_named_beside_rows_misread_by_far(tmp_path: Path) -> None:
    """Three readings far off: the noise that would pass them and the warm-up for chance is no explanation."""
    recordings.sweep(tmp_path, 11, {"friction_warm_up": {"share_cold": 0.15, "time_s": 400.0}})
    lines = (tmp_path / "sweep.csv").read_text(encoding="utf-8").splitlines()
    for row, column, off in ((6, 2, -0.17), (17, 2, 0.08), (22, 3, -12.0)):
        cells = lines[row].split(",")
        cells[column] = f"{float(cells[column]) + off:.3f}"
        lines[row] = ",".join(cells)
    (tmp_path / "sweep.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = as_json(diagnose(read_recording(tmp_path), 1))
    assert found["verdict"] == "named", found["why"]
    assert {one["id"] for one in found["effects"]} == {"friction_warm_up", "bad_reading"}
    assert {one["row"] for one in found["suspect_rows"]} == {6, 17, 22}
