"""The order of a sweep's levels, settling, and plateau means: pure functions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.plateaus.plan import Step, SweepError, plan, stepping_stone
from rig.plateaus.plateau import Plateau, mean_of
from rig.plateaus.series import integrated_time, standard_error
from rig.plateaus.settle import settled
from rig.readings import Quality, with_error
from rig.runlog import plateaus as table

LEVELS = [1.9, 1.3, 1.6]


def levels_of(steps):
    return [step.level_bar_abs for step in steps]


def test_up_rises_whatever_the_order_in_the_file():
    assert levels_of(plan(LEVELS, "up")) == [1.3, 1.6, 1.9]


def test_up_down_takes_the_top_level_once_on_each_leg():
    steps = plan(LEVELS, "up-down")
    assert levels_of(steps) == [1.3, 1.6, 1.9, 1.9, 1.6, 1.3]
    assert [step.direction for step in steps] == ["up"] * 3 + ["down"] * 3


def test_down_up_takes_the_lowest_level_once_on_each_leg():
    assert levels_of(plan(LEVELS, "down-up")) == [1.9, 1.6, 1.3, 1.3, 1.6, 1.9]


def test_repeats_go_through_the_whole_again_and_are_numbered():
    assert [step.repeat for step in plan(LEVELS, "up", repeats=2)] == [1, 1, 1, 2, 2, 2]


def test_random_is_the_same_for_a_seed_and_another_for_another():
    many = [1.1 + 0.05 * i for i in range(20)]
    assert plan(many, "random", 2, seed=3) == plan(many, "random", 2, seed=3)
    assert plan(many, "random", 2, seed=3) != plan(many, "random", 2, seed=4)


def test_random_says_from_which_side_each_level_is_approached():
    steps = plan([1.1 + 0.05 * i for i in range(20)], "random", seed=3)
    last = 0.0
    for step in steps:
        assert step.direction == ("up" if step.level_bar_abs >= last else "down")
        last = step.level_bar_abs


def test_a_level_that_stands_twice_is_taken_once():
    assert levels_of(plan([1.3, 1.3, 1.6], "up")) == [1.3, 1.6]


def test_a_continued_sweep_leaves_out_what_its_parent_finished():
    whole = plan(LEVELS, "up-down")
    assert levels_of(plan(LEVELS, "up-down", finished=whole[:2])) == [1.9, 1.9, 1.6, 1.3]


def test_a_falling_leg_that_is_continued_is_still_approached_from_above():
    whole = plan(LEVELS, "up-down")
    left = plan(LEVELS, "up-down", finished=whole[:4])
    assert left == [Step(1.6, "down", 1, by_way_of_bar_abs=1.9), Step(1.3, "down", 1)]


@given(st.integers(0, 11), st.sampled_from(["up", "down", "up-down", "down-up", "random"]))
def test_what_was_finished_and_what_is_left_make_the_whole(count, order):
    whole = plan(LEVELS, order, repeats=2, seed=5)
    left = plan(LEVELS, order, repeats=2, seed=5, finished=whole[:count])
    assert sorted(step.key for step in [*whole[:count], *left]) == sorted(step.key for step in whole)


@pytest.mark.parametrize(
    ("highest", "expected"),
    [(1.369, 1.36), (1.36, 1.36), (1.265, None), (1.45, None), (1.0, None)],
    ids=["rounded down", "on the grid", "no step worth the time", "not refused", "below what was taken"],
)
def test_a_stepping_stone_lies_between_what_was_taken_and_what_is_refused(highest, expected):
    assert stepping_stone(1.40, highest, [1.013, 1.25]) == expected


@pytest.mark.parametrize(("levels", "order"), [([], "up"), ([1.3], "sideways")])
def test_an_empty_plan_and_an_unknown_order_are_refused(levels, order):
    with pytest.raises(SweepError):
        plan(levels, order)


# Settling.

TIME = np.arange(0.0, 3.01, 0.1)
NOISE = np.random.default_rng(2).normal(size=TIME.size)


def test_a_steady_noisy_reading_has_settled():
    verdict = settled(TIME, 300.0 + 0.4 * NOISE, 3.0, slope_limit=2.0, scatter_limit=10.0)
    assert verdict.settled, verdict.why
    assert verdict.why == ""


def test_a_drifting_reading_has_not_and_the_drift_is_named():
    verdict = settled(TIME, 300.0 + 5.0 * TIME + 0.4 * NOISE, 3.0, slope_limit=2.0)
    assert not verdict.settled
    assert "changes by +4.98 per second, more than 2" in verdict.why


def test_a_reading_still_on_its_way_has_not_settled():
    assert not settled(TIME, 300.0 * (1.0 - np.exp(-TIME / 1.0)), 3.0, slope_limit=2.0).settled


def test_noise_that_hides_any_drift_shows_nothing():
    verdict = settled(TIME, 300.0 + 30.0 * NOISE, 3.0, slope_limit=2.0)
    assert not verdict.settled
    assert "too noisy to tell" in verdict.why


def test_a_hunting_reading_scatters_too_much_although_it_has_no_slope():
    hunting = 300.0 + 20.0 * np.cos(2.0 * np.pi * (TIME - 1.5) / 0.6)
    verdict = settled(TIME, hunting, 3.0, slope_limit=50.0, scatter_limit=10.0)
    assert not verdict.settled
    assert "scatters by" in verdict.why


def test_too_few_readings_are_not_judged():
    assert "4 readings" in settled(TIME[:4], NOISE[:4], 3.0, 1.0).why


def test_readings_that_do_not_fill_the_window_are_not_judged():
    assert "cover" in settled(TIME[:10], NOISE[:10], 3.0, 1.0).why


def test_readings_older_than_the_window_are_not_looked_at():
    time = np.arange(0.0, 6.01, 0.1)
    value = np.where(time < 2.9, 100.0 * time, 300.0)
    assert settled(time, value, 3.0, slope_limit=2.0).settled


@given(st.floats(-100.0, 100.0), st.floats(0.01, 10.0))
@settings(max_examples=50)
def test_the_verdict_does_not_depend_on_the_unit(offset, scale):
    value = 0.5 * TIME + NOISE
    here = settled(TIME, value, 3.0, 1.0, 2.0)
    there = settled(TIME, offset + scale * value, 3.0, scale, 2.0 * scale)
    assert here.settled == there.settled


# Means.


def autoregressive(n, phi, generator):
    """Readings of variance 1 with autocorrelation phi^lag, stationary from the first."""
    noise = generator.normal(size=n)
    value = np.empty(n)
    value[0] = noise[0]
    for i in range(1, n):
        value[i] = phi * value[i - 1] + np.sqrt(1.0 - phi**2) * noise[i]
    return value


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.8])
def test_the_autocorrelation_time_of_a_long_series_is_found_and_never_too_short(phi):
    generator = np.random.default_rng(7)
    found = np.mean([integrated_time(autoregressive(2000, phi, generator)) for _ in range(40)])
    assert 0.97 <= found / ((1.0 + phi) / (1.0 - phi)) <= 1.25


@pytest.mark.parametrize(
    ("n", "phi"), [(15, 0.0), (15, 0.3), (25, 0.0), (25, 0.6), (50, 0.6), (50, 0.8), (200, 0.0), (200, 0.9)]
)
def test_95_percent_intervals_of_the_mean_hold_about_as_often_as_they_say(n, phi):
    generator = np.random.default_rng(11)
    held = 0
    for _ in range(600):
        value = autoregressive(n, phi, generator)
        se, _ = standard_error(value)
        held += abs(value.mean()) < 1.96 * se
    assert 0.87 <= held / 600 <= 0.99


def test_a_plain_standard_error_would_be_far_too_small():
    value = autoregressive(200, 0.8, np.random.default_rng(3))
    assert standard_error(value)[0] > 2.0 * value.std() / np.sqrt(200)


def test_the_effective_number_is_fewer_when_readings_follow_each_other():
    generator = np.random.default_rng(3)
    assert standard_error(autoregressive(200, 0.9, generator))[1] < 0.3 * 200


def test_constant_readings_have_no_scatter():
    assert standard_error(np.full(20, 72.0)) == (0.0, 20.0)


def test_one_reading_has_no_standard_error():
    mean = mean_of(np.array([1.0]), np.array([72.0]), np.array([0]), [Quality.MANUAL])
    assert (mean.mean, mean.se, mean.n) == (72.0, None, 1)


def test_no_reading_is_no_mean():
    mean = mean_of(np.empty(0), np.empty(0))
    assert (mean.mean, mean.n, mean.note) == (None, 0, "no reading")


def test_readings_off_the_scale_make_the_mean_a_limit():
    mean = mean_of(np.arange(4.0), np.array([99.0, 100.0, 100.0, 100.0]), np.array([0, 1, 1, 1]))
    assert mean.censored == 1
    assert mean.se is None
    assert mean.cell == ">99.75"
    assert mean.note == "3 of 4 readings above the scale"


def test_a_rare_reading_off_the_scale_is_named_and_no_more():
    value, off = np.full(20, 99.0), np.zeros(20, dtype=int)
    value[3], off[3] = 100.0, 1
    mean = mean_of(np.arange(20.0), value, off)
    assert mean.censored == 0
    assert mean.note == "1 of 20 readings above the scale"


def test_a_rotor_at_rest_is_a_speed_of_zero_in_the_table():
    assert mean_of(np.arange(5.0), np.zeros(5), np.full(5, -1)).cell == 0.0


def test_the_drift_within_a_plateau_is_told_with_its_error():
    mean = mean_of(TIME, 300.0 + 0.5 * TIME + 0.01 * NOISE)
    assert mean.drift == pytest.approx(1.5, abs=4.0 * mean.drift_se)


def test_the_qualities_of_the_readings_are_counted():
    mean = mean_of(np.arange(3.0), np.ones(3), None, [Quality.OK, Quality.UNVERIFIED, Quality.OK])
    assert mean.qualities == {"ok": 2, "unverified": 1}


def test_a_plateau_fits_the_runs_table():
    speed = mean_of(np.arange(5.0), np.full(5, 300.0))
    flow = mean_of(np.arange(4.0), np.full(4, 100.0), np.ones(4, dtype=int))
    plateau = Plateau(1, Step(1.6, "up", 1), 0, 5_000_000_000, True, {"speed": speed, "flow": flow}, "noted")
    row = plateau.row({"speed": "speed_rpm", "flow": "flow_l_min"})
    cells = dict(zip(table.COLUMNS, table.line(row).decode().rstrip("\n").split(","), strict=True))
    assert (cells["speed_rpm"], cells["speed_rpm_n"]) == ("300.0", "5")
    assert (cells["flow_l_min"], cells["flow_l_min_se"], cells["note"]) == (">100", "", "noted")


@pytest.mark.parametrize(
    ("mean", "error", "shown"),
    [
        (1.2479, 6.6e-05, "1.2479 +- 0.0001"),
        (0.60031, 0.02, "0.6 +- 0.020"),
        (480.83, 0.0012, "480.83 +- 0.01"),
        (1.81, 0.0058, "1.81 +- 0.0058"),
        (13.09, 0.017, "13.09 +- 0.017"),
        (0.0, 0.0, "0"),
        (397.06, None, "397.06"),
        (12345.6, 250.0, "12346 +- 250"),
    ],
)
def test_a_mean_is_told_no_finer_than_it_is_known(mean, error, shown):
    assert with_error(mean, error) == shown
