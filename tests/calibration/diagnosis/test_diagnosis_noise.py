"""The noise of a diagnosis: its whitening, and what readings say of its scales and correlations."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.likelihood.mode import Mode, close, suiting_noise
from calibration.studies.nulls_draw import null_recording
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.noise import ROWS, SAMPLES, SPREAD
from calibration.systems.radial_piston.predict.problem import Problem

U = np.array([0.1, -0.2, 0.05, 0.4, 0.5])


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    recording, _ = null_recording("declared", True, np.random.default_rng(7))
    return Comparison(Problem(recording))


@pytest.fixture(scope="module")
def prediction(comparison: Comparison):
    return comparison.problem.predict(np.zeros(len(comparison.problem.nuisances)), {})


def drawn(comparison, prediction, u, count, rng):
    """Differences of readings by noise and rounding alone, shape (count, m)."""
    n, end = comparison.n, comparison.end
    out = np.zeros((count, comparison.read.size))
    for one in out:
        pressure, flow, speed = comparison.noise.draw_plateaus(u, rng)
        pressure = pressure + comparison.problem.resolution["pressure"] * (rng.random(n) - 0.5)
        one[:n] = prediction.flow_slope * pressure + flow
        one[:n] += comparison.problem.resolution["flow"] * (rng.random(n) - 0.5)
        one[n : 2 * n] = prediction.speed_slope * pressure + speed
        one[2 * n : end] = comparison.noise.draw_samples(u, rng)
        one[n:end] += comparison.problem.resolution["speed"] * (rng.random(end - n) - 0.5)
        angle = comparison.angle_sd * rng.standard_normal(end - 2 * n)
        first = np.flatnonzero(comparison.noise.first)
        before = np.roll(angle, 1)
        before[first] = comparison.angle_sd[first] * rng.standard_normal(first.size)
        one[2 * n : end] += (angle - before) / comparison.step
    return out


def test_whitened_noise_is_standard_normal_whatever_its_correlations(comparison, prediction):
    noise = drawn(comparison, prediction, U, 400, np.random.default_rng(1))[:, : comparison.end]
    padded = np.pad(noise, ((0, 0), (0, comparison.read.size - comparison.end)))
    white = comparison.whitener(prediction, U)(padded.T)[: comparison.end]
    m, count = white.shape
    assert np.mean(white**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / (m * count)))
    together = (white[1:] * white[:-1]).mean(axis=1)
    assert np.abs(together).max() < 5.0 / np.sqrt(count)
    plain = comparison.whitener(prediction, np.append(U[:3], [0.0, 0.0]))(padded.T)[: comparison.end]
    assert np.abs((plain[1:] * plain[:-1]).mean(axis=1)).max() > 5.0 / np.sqrt(count)


def test_how_the_shaft_stood_is_left_to_chance(comparison):
    assert comparison.pitch_sd == 0.0  # no teeth are stated
    assert np.all(comparison.angle_sd > 0.0)


def test_the_density_of_whitened_readings_is_that_of_the_covariance(comparison, prediction):
    """log |det| of the map: the scale that the likelihood takes has to belong to the map."""
    white = comparison.whitener(prediction, U)
    there = np.flatnonzero(comparison.known[: comparison.end])
    columns = white(np.eye(comparison.read.size))[np.ix_(there, there)]
    assert -np.linalg.slogdet(columns)[1] == pytest.approx(white.log_scale, rel=1e-9)


def restricted(comparison, mode, difference, u):
    """Log posterior of u with the unknowns integrated out, up to a constant."""
    white = comparison.whitener(mode.prediction, u)
    J, y = white(mode.D), white(difference)
    A = J.T @ J + np.eye(J.shape[1])
    z = np.linalg.solve(A, J.T @ y)
    r = y - J @ z
    return -0.5 * (r @ r + z @ z) - white.log_scale - 0.5 * np.linalg.slogdet(A)[1] - 0.5 * np.sum((u / SPREAD) ** 2)


@pytest.fixture
def sweep_mode() -> tuple[Comparison, Mode]:
    recording, _ = null_recording("declared", False, np.random.default_rng(5))
    comparison = Comparison(Problem(recording))
    return comparison, base_of(comparison)


def test_a_step_of_the_noise_follows_the_slope_of_the_restricted_likelihood(sweep_mode):
    comparison, mode = sweep_mode
    difference = np.nan_to_num(comparison.read - comparison.raw(mode.prediction) + mode.D @ mode.z)
    u = 0.5 * U
    u[SAMPLES] = 0.0
    white = comparison.whitener(mode.prediction, u)
    J, y = white(mode.D), white(difference)
    z = np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ y)
    good = np.ones(difference.size)
    step, information = comparison.noise_step(difference - mode.D @ z, mode.prediction, u, good, mode.D)
    assert np.abs(step).max() < 0.5  # else it was cut short
    numeric = [
        (restricted(comparison, mode, difference, u + h) - restricted(comparison, mode, difference, u - h)) / 2e-4
        for h in 1e-4 * np.eye(u.size)
    ]
    np.testing.assert_allclose(information @ step, numeric, rtol=1e-4, atol=1e-4)


def test_loud_samples_are_heard_though_the_plateaus_are_quiet(comparison, prediction):
    """Samples are taken for no quieter than declared: below that their loudness has no slope."""
    quiet, loud = np.array([0.0, 0.0, -0.4, 0.0, 0.0]), np.array([0.0, 0.0, 0.6, 0.0, 0.0])
    plateaus, runs = (drawn(comparison, prediction, u, 1, np.random.default_rng(4))[0] for u in (quiet, loud))
    difference = np.append(plateaus[: 2 * comparison.n], runs[2 * comparison.n :])
    ends = []
    for u in (quiet, loud):
        for _ in range(12):
            u = u + comparison.noise_step(difference, prediction, u, np.ones(difference.size))[0]
        ends.append(u)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)
    assert ends[0][2] > 0.4


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_correlations_are_found_within_their_errors(sweep_mode, correlation):
    comparison, mode = sweep_mode
    rng = np.random.default_rng(3)
    truth = np.array([0.0, 0.0, 0.0, np.arctanh(correlation), 0.0])
    found = []
    for difference in drawn(comparison, mode.prediction, truth, 60, rng):
        u, z = np.zeros(SPREAD.size), np.zeros(mode.z.size)
        for _ in range(8):
            white = comparison.whitener(mode.prediction, u)
            J, y = white(mode.D), white(difference)
            z = np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ y)
            good = np.ones(difference.size)
            u = u + comparison.noise_step(difference - mode.D @ z, mode.prediction, u, good, mode.D)[0]
        found.append(u[ROWS])
    # Its prior draws it to 0: by less than a third of the way with so many rows.
    assert np.std(found) < 0.25
    assert 0.67 * truth[ROWS] - 0.1 < np.mean(found) < truth[ROWS] + 0.1


def test_far_from_a_good_fit_the_correlations_stay_at_nothing(sweep_mode):
    comparison, mode = sweep_mode
    z = mode.z.copy()
    z[[u.name for u in comparison.problem.nuisances].index("f_overall")] += 0.02
    off = comparison.problem.predict(z, {})
    start = np.zeros(SPREAD.size)
    nothing = np.zeros_like(mode.D)
    assert suiting_noise(comparison, off, start, nothing, False)[ROWS] == 0.0
    assert suiting_noise(comparison, off, start, nothing, True)[ROWS] > 0.2  # it would pass the misfit for noise


def test_a_misread_row_says_nothing_of_its_neighbours(sweep_mode):
    comparison, mode = sweep_mode
    u = np.append(np.zeros(3), [0.5, 0.0])
    n, off = comparison.n, np.zeros(comparison.read.size)
    off[comparison.n + 6] = 1.0
    beside = [n + 5, n + 7]
    assert np.abs(comparison.whitener(mode.prediction, u)(off))[beside].max() > 0.0
    comparison.noise.leave_alone(np.arange(n) == 6, np.zeros(n, dtype=bool))
    alone = np.abs(comparison.whitener(mode.prediction, u)(off))
    assert alone[n + 6] > 0.0
    assert np.all(alone[beside] == 0.0)
    off = np.zeros(comparison.read.size)
    off[6] = 1e-3
    assert abs(comparison.whitener(mode.prediction, u)(off)[n + 6]) > 0.1
    comparison.noise.leave_alone(np.arange(n) == 6, np.arange(n) == 6)
    found = comparison.whitener(mode.prediction, u)(off)
    assert found[6] != 0.0 and found[n + 6] == 0.0


def test_correlated_noise_is_evidence_for_itself():
    recording, _ = null_recording("correlated", False, np.random.default_rng(2))
    comparison = Comparison(Problem(recording))
    mode = base_of(comparison)
    without = np.append(mode.u[:3], [0.0, 0.0])
    white = close(comparison, (), mode.z, without, mode.D, mode.prediction)
    assert mode.u[ROWS] > 0.2
    assert mode.log_evidence > white.log_evidence
