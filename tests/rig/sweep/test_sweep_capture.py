"""Whether a run in time can be resolved: the model's duration against what the speed channel gives."""

import math
import re

import pytest

from model.motor import read_motor
from rig.sweep.ambient import Given, at_start
from rig.sweep.capture import CaptureError, Expected, Rate, check, expected, rate_of
from rig.sweep.planning import capture_course
from tests.sweep_lab import LabBench

MOTOR = read_motor("ptm3600")
DISPLAY = Rate("tach.speed_rpm", period_s=0.2, update_s=0.5)
POLLED = Rate("tach.speed_rpm", period_s=0.2, update_s=0.0)


@pytest.fixture(scope="module")
def coast():
    return expected(MOTOR, "coast-down", 2.0)


def room(bench):
    return at_start(bench, Given(minutes_running=0.0))


def test_a_coast_down_takes_about_two_time_constants(coast):
    time_constant_s = MOTOR.si("inertia") / MOTOR.si("f_overall")
    assert 1.5 * time_constant_s < coast.duration_s < math.log(10.0) * time_constant_s
    assert coast.speed_rpm == pytest.approx(396.0, abs=2.0)
    assert 0.3 < coast.turns < 0.6


def test_a_spin_up_takes_about_as_long():
    up = expected(MOTOR, "spin-up", 2.0)
    assert up.duration_s == pytest.approx(0.186, abs=0.02)
    assert up.speed_rpm == pytest.approx(396.0, abs=2.0)


def test_a_heavier_rotor_takes_longer():
    heavy = expected(MOTOR.with_values({"inertia": 0.5}), "spin-up", 2.0)
    assert heavy.duration_s == pytest.approx(100.0 * 0.186, rel=0.1)


def test_a_motor_that_does_not_run_is_refused_in_words():
    with pytest.raises(CaptureError, match=r"stalls at 1\.03 bar"):
        expected(MOTOR, "coast-down", 1.03)


def test_a_display_is_refused_with_the_reason_and_what_would_do(coast):
    with pytest.raises(CaptureError) as caught:
        check(coast, DISPLAY)
    text = str(caught.value)
    assert "takes 0.17 s" in text
    assert "a new value every 0.5 s, so that 0 samples" in text
    assert "an edge counter on a wheel with 45 teeth or more" in text
    assert "0.5 s is too slow" in text


def test_a_polled_instrument_is_told_the_period_that_would_do(coast):
    with pytest.raises(CaptureError) as caught:
        check(coast, POLLED)
    period_s = float(re.search(r"period_s of ([0-9.]+) or less", str(caught.value))[1])
    assert check(coast, Rate("tach.speed_rpm", period_s, 0.0)) >= 20


def test_a_wheel_with_too_few_teeth_is_told_how_many_would_do(coast):
    with pytest.raises(CaptureError) as caught:
        check(coast, Rate("tach.speed_rpm", 0.1, 0.0, teeth=20))
    teeth = int(re.search(r"a wheel with (\d+) teeth", str(caught.value))[1])
    assert check(coast, Rate("tach.speed_rpm", 0.1, 0.0, teeth=teeth)) >= 20
    with pytest.raises(CaptureError):
        check(coast, Rate("tach.speed_rpm", 0.1, 0.0, teeth=teeth - 1))


def test_a_slow_event_is_resolved_by_a_slow_display():
    assert check(Expected("coast-down", 2.0, 30.0, 400.0, 100.0), DISPLAY) == 60


def test_the_rate_of_a_bench_is_that_of_its_speed_channel():
    assert rate_of(LabBench(update_s=0.5)) == Rate("tach.speed_rpm", 0.2, 0.5)
    assert rate_of(LabBench(teeth=60)).teeth == 60


def test_a_capture_goes_through_zero_capture_and_zero():
    bench = LabBench(teeth=60)
    course = capture_course(bench, room(bench), "coast-down", 2.0)
    assert [task.kind for task in course.captures] == ["coast-down"]
    assert (course.steps, course.zeros) == ([], ("start", "end"))


def test_a_capture_without_a_level_takes_the_bench_s():
    bench = LabBench(teeth=60, capture_level_bar_abs=2.1)
    assert capture_course(bench, room(bench), "spin-up").captures[0].level_bar_abs == 2.1


def test_a_zero_needs_no_event_and_is_never_refused():
    bench = LabBench(update_s=0.5)
    assert capture_course(bench, room(bench), "zero").zeros == ("start",)


def test_an_unknown_kind_names_those_that_are_known():
    bench = LabBench()
    with pytest.raises(CaptureError, match="coast-down, spin-up, zero"):
        capture_course(bench, room(bench), "sideways")


def test_the_room_changes_what_is_expected():
    thin = LabBench(teeth=60)
    thin.file = thin.file.model_copy(update={"ambient": thin.file.ambient.model_copy(update={"pressure_bar_abs": 0.9})})
    low = capture_course(thin, room(thin), "coast-down", 2.0).captures[0].expected_s
    bench = LabBench(teeth=60)
    assert low != capture_course(bench, room(bench), "coast-down", 2.0).captures[0].expected_s
