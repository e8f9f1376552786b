"""The guard: what it predicts covers what comes, what is plainly safe is allowed, and what is not is refused."""

import dataclasses

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import binom

from model.layout import RPM
from model.motor import QUANTITIES, read_motor
from model.solvers import steady
from rig.interlock import SafetyError
from rig.interlock.belief import Discrepancy
from rig.interlock.guard import Guard, Point

MOTOR = read_motor("ptm3600")
GAUGE_SD_PA = 2000.0
BAR = 1e5
GUARD = Guard(MOTOR, 600.0, gauge_sd_pa=GAUGE_SD_PA)
LEVELS = np.array([1.2, 1.3, 1.5, 1.8, 2.1]) * BAR


def speed_at(motor, pressure):
    return float(steady.steady(motor, [pressure]).speed_rad_s[0, 0])


def point(motor, pressure):
    return Point(pressure, speed_at(motor, pressure), 0.05, 100.0)


def drawn_motor(random):
    """A motor whose every unknown is drawn from its prior, written anew here."""
    values = {}
    for name, quantity in QUANTITIES.items():
        prior = MOTOR[name].prior
        if prior is None:
            continue
        z, value = random.standard_normal(), MOTOR[name].value
        if prior.kind == "normal":
            value += prior.sd * z
        elif prior.kind == "lognormal":
            value *= prior.factor**z
        else:
            value = prior.low * (prior.high / prior.low) ** ndtr(z)
        values[name] = float(np.clip(value, quantity.low, quantity.high))
    return MOTOR.with_values(values)


def drawn_truth(random):
    """Speeds [rad/s] at the levels that a gauge shows: model, a shift of the pressure, and a discrepancy of 4 %.

    In figures of its own, so that a guard that trusts the model more than docs/safety.md says passes its bound.
    """
    shift = random.standard_normal() * np.hypot(GAUGE_SD_PA, 3600.0)
    speeds = steady.steady(drawn_motor(random), LEVELS + shift).speed_rad_s[0]
    place = np.log(LEVELS - MOTOR.si("ambient_pressure"))
    root = np.linalg.cholesky(Discrepancy(0.04, np.log(2.0)).covariance(place, place))
    return speeds * np.exp(root @ random.standard_normal(LEVELS.size))


@pytest.fixture(scope="module")
def covered():
    """Of drawn benches, each with some plateaus measured: true speed at the next level, upper bound and mean [rpm]."""
    random = np.random.default_rng(3)
    guard = GUARD
    found = []
    while len(found) < 500:
        truth = drawn_truth(random)
        known = int(random.integers(1, LEVELS.size))
        speed_sd, pressure_sd = 0.05, 100.0
        points = [
            Point(
                float(LEVELS[i] + pressure_sd * random.standard_normal()),
                max(0.0, float(truth[i] + speed_sd * random.standard_normal())),
                speed_sd,
                pressure_sd,
            )
            for i in range(known)
        ]
        if truth[0] < 1.0:
            continue  # a motor that stands at the first level has tests of its own
        expected = guard.predict(LEVELS[known], points)
        found.append((truth[known] * RPM, expected.upper99_rpm, expected.mean_rpm))
    return np.array(found)


def test_the_upper_bound_is_passed_by_no_more_than_one_in_a_hundred(covered):
    passed = int(np.sum(covered[:, 0] > covered[:, 1]))
    assert passed <= binom.ppf(0.999, len(covered), 0.01)


def test_the_upper_bound_is_a_bound_of_one_in_a_hundred_and_not_of_never(covered):
    margin = covered[:, 1] / covered[:, 2] - 1.0
    assert np.median(margin) < 0.35
    assert np.sum(covered[:, 0] > covered[:, 2]) > 0.3 * len(covered)  # the mean is passed by about half


def test_a_step_from_1_3_to_1_5_bar_is_allowed():
    verdict = GUARD.verdict(1.5 * BAR, [point(MOTOR, 1.3 * BAR)])
    assert verdict.allowed
    assert "limit 600 rpm" in verdict.text


def test_steps_of_a_tenth_of_a_bar_are_allowed_up_to_close_below_the_limit():
    guard, points = GUARD, [point(MOTOR, 1.2 * BAR)]
    for pressure in np.arange(1.3, 2.41, 0.1) * BAR:  # 565 rpm at 2.4 bar
        assert guard.verdict(float(pressure), points).allowed
        points.append(point(MOTOR, float(pressure)))


def test_a_step_beyond_the_limit_is_refused_with_the_level_that_would_do():
    verdict = GUARD.verdict(2.6 * BAR, [point(MOTOR, 1.3 * BAR)])
    assert not verdict.allowed
    assert "2.60 bar abs is not yet allowed; the speed there could reach" in verdict.text
    assert "limit 600 rpm" in verdict.text
    assert GUARD.verdict(verdict.highest_pa_abs, [point(MOTOR, 1.3 * BAR)]).allowed
    assert speed_at(MOTOR, verdict.highest_pa_abs) * RPM < 600.0


def test_a_step_down_is_allowed_where_the_motor_ran_below_the_limit():
    points = [point(MOTOR, pressure * BAR) for pressure in (1.3, 1.8, 2.2)]
    assert GUARD.verdict(1.5 * BAR, points).allowed


def test_without_a_point_the_prior_speaks_and_allows_only_what_a_frictionless_motor_would_bear():
    guard = GUARD
    slippery = MOTOR.with_values({"f_overall": 0.0105})
    highest = guard.highest_pa([])
    assert 1.15 * BAR < highest < 1.4 * BAR
    assert speed_at(slippery, highest) * RPM < 600.0
    assert not guard.verdict(1.6 * BAR, []).allowed


def test_more_plateaus_narrow_the_prediction():
    guard = GUARD
    one = guard.predict(2.2 * BAR, [point(MOTOR, 1.3 * BAR)])
    three = guard.predict(2.2 * BAR, [point(MOTOR, pressure * BAR) for pressure in (1.3, 1.7, 2.1)])
    assert three.upper99_rpm - three.mean_rpm < 0.5 * (one.upper99_rpm - one.mean_rpm)


def test_a_nearer_point_narrows_the_prediction():
    guard = GUARD
    near, far = (guard.predict(2.0 * BAR, [point(MOTOR, pressure * BAR)]) for pressure in (1.9, 1.3))
    assert near.upper99_rpm < far.upper99_rpm


@pytest.mark.parametrize("torque_nm", [0.05, 0.1, 0.2])
def test_dry_friction_that_the_model_lacks_stays_below_the_bound(torque_nm):
    def real(pressure):
        return max(0.0, speed_at(MOTOR, pressure) - torque_nm / MOTOR.si("f_overall"))

    points = [Point(pressure * BAR, real(pressure * BAR), 0.05, 100.0) for pressure in (1.3, 1.5)]
    assert real(2.4 * BAR) * RPM < GUARD.predict(2.4 * BAR, points).upper99_rpm


@pytest.mark.parametrize("f_overall", [0.012, 0.03, 0.15, 0.35])
def test_the_highest_level_allowed_keeps_motors_of_any_friction_below_the_limit(f_overall):
    motor = MOTOR.with_values({"f_overall": f_overall})
    guard, points = GUARD, []
    for _ in range(5):
        level = guard.highest_pa(points)
        assert speed_at(motor, level) * RPM < 600.0
        points.append(point(motor, level))
    assert speed_at(motor, level) * RPM > 500.0  # and gets there


def test_below_the_ambient_s_pressure_nothing_turns():
    assert GUARD.predict(1.0 * BAR, []).upper99_rpm == 0.0


def test_a_rotor_that_stands_at_a_low_pressure_is_taken_further_in_small_steps():
    guard = GUARD
    stood = Point(1.2 * BAR, 0.0, 0.05, 100.0)
    verdict = guard.verdict(1.25 * BAR, [stood])
    assert verdict.allowed
    assert not guard.verdict(2.0 * BAR, [stood]).allowed


def test_a_rotor_that_stands_where_it_should_turn_is_taken_no_further():
    verdict = GUARD.verdict(1.9 * BAR, [point(MOTOR, 1.3 * BAR), Point(1.8 * BAR, 0.0, 0.05, 100.0)])
    assert not verdict.allowed
    assert "the tachometer counts" in verdict.text


def test_a_rotor_that_stood_below_a_level_at_which_it_turned_is_no_fault():
    points = [Point(1.1 * BAR, 0.0, 0.05, 100.0), point(MOTOR, 1.3 * BAR)]
    assert GUARD.verdict(1.5 * BAR, points).allowed


@pytest.mark.parametrize("levels", [[1.3, 1.6, 1.9], [1.3, 1.9, 1.6]])
def test_a_rotor_that_stands_where_it_turned_before_or_below_is_doubted(levels):
    """Also on the way down, where a higher level was seen to turn."""
    *before, last = [level * BAR for level in levels]
    turning = [point(MOTOR, level) for level in before]
    assert GUARD.doubt([*turning, point(MOTOR, last)]) == ""
    said = GUARD.doubt([*turning, Point(last, 0.0, 0.05, 100.0)])
    assert said == (
        f"the rotor stands at {last / BAR:.2f} bar abs, where it should turn; check that it is free and that the "
        "tachometer counts"
    )


def test_a_rotor_that_stands_at_a_low_level_and_then_turns_is_not_doubted():
    low = Point(1.1 * BAR, 0.0, 0.05, 100.0)
    assert GUARD.doubt([low]) == GUARD.doubt([low, point(MOTOR, 1.3 * BAR)]) == GUARD.doubt([]) == ""


def test_a_display_that_hangs_is_doubted_and_one_that_is_coarse_is_not():
    first = Point(1.3 * BAR, speed_at(MOTOR, 1.3 * BAR), 0.0, 100.0)
    for scatter in (0.0, 0.05):  # where it hung between the two, and where it did amid the first
        before = dataclasses.replace(first, speed_sd=scatter)
        hung = dataclasses.replace(first, pressure_pa=1.6 * BAR, speed_rad_s=first.speed_rad_s + 2.0 * scatter)
        assert "rpm all the time at 1.60 bar abs, as at 1.30 bar abs before" in GUARD.doubt([before, hung])
        assert GUARD.doubt([before, dataclasses.replace(hung, speed_sd=0.01)]) == ""
    assert GUARD.doubt([first, dataclasses.replace(first, pressure_pa=1.305 * BAR)]) == ""


def test_the_same_question_gets_the_same_answer():
    points = [point(MOTOR, 1.3 * BAR), point(MOTOR, 1.5 * BAR)]
    other = Guard(MOTOR, 600.0, gauge_sd_pa=GAUGE_SD_PA)
    assert GUARD.predict(1.7 * BAR, points) == other.predict(1.7 * BAR, points)


@pytest.mark.parametrize("level", [float("nan"), 9.0 * BAR, -1.0])
def test_a_level_that_is_no_pressure_of_the_model_is_not_predicted(level):
    with pytest.raises(SafetyError, match="0 to 8 bar abs"):
        GUARD.predict(level, [])


def test_a_point_that_is_no_number_is_named():
    with pytest.raises(SafetyError, match="leave it out"):
        GUARD.predict(1.3 * BAR, [Point(float("nan"), 1.0, 0.1, 100.0)])
