"""The trip rules, on readings as the acquisition gives them."""

import dataclasses
import itertools
import math
import re

import pytest

from rig.bench.bench import RolesTable, SafetyTable
from rig.bench.instrument import ChannelFile
from rig.instruments.codecs.values import Value, bounded
from rig.instruments.manual import decode_entry
from rig.interlock.limits import Limits
from rig.readings import NS, Quality, Reading

SAFETY = SafetyTable(highest_speed_rpm=600.0, highest_pressure_bar_abs=3.0, speed_stale_s=1.0)
ROLES = RolesTable(pressure="gauge.pressure_bar_abs", flow="meter.flow_l_min", speed="tach.speed_rpm")
GAUGE_ROLES = RolesTable(pressure="dial.pressure_bar_gauge", flow="meter.flow_l_min", speed="tach.speed_rpm")


def reading(name, value, at_s, quality=Quality.OK, censored=0):
    device, _, channel = name.partition(".")
    ns = int(at_s * NS)
    return Reading(device, channel, value, "", quality, ns, ns, ns, censored=censored)


class View(dict):
    """The latest readings by channel."""

    def __init__(self, *readings, before=()):
        super().__init__((one.name, one) for one in readings)
        self.before = before

    def last(self, channel):
        return self.get(channel)

    def since(self, channel, after_ns):
        return [one for one in (*self.before, self.get(channel)) if one.name == channel and one.reply_ns > after_ns]


def speed(value, at_s=0.0, **more):
    return reading("tach.speed_rpm", value, at_s, **more)


def pressure(value, at_s=0.0, **more):
    return reading("gauge.pressure_bar_abs", value, at_s, **more)


def test_readings_within_the_limits_do_not_trip():
    assert Limits(SAFETY, ROLES).trip(View(speed(599.0), pressure(2.9)), 0, True) is None


def test_a_speed_above_the_limit_trips_with_figure_and_limit():
    said = Limits(SAFETY, ROLES).trip(View(speed(612.5), pressure(2.0)), 0, True)
    assert said == "speed 612.5 rpm (tach.speed_rpm), limit 600 rpm"


def test_a_speed_above_the_limit_that_came_between_two_looks_trips():
    limits = Limits(SAFETY, ROLES)
    assert limits.trip(View(speed(500.0), pressure(2.0)), 0, True) is None
    between = (speed(500.0), speed(612.5, 0.1), speed(590.0, 0.15))
    view = View(speed(580.0, 0.2), pressure(2.0, 0.2), before=between)
    assert limits.trip(view, int(0.2 * NS), True) == "speed 612.5 rpm (tach.speed_rpm), limit 600 rpm"
    assert limits.trip(View(speed(580.0, 0.3), pressure(2.0, 0.3), before=between), int(0.3 * NS), True) is None


def looks(limits, *speeds):
    """What is said at the end of a row of looks, a reading at each."""
    return [limits.trip(View(one, pressure(2.0)), one.reply_ns, True) for one in speeds]


def test_an_edge_of_a_rotor_that_rocks_to_rest_is_no_overspeed():
    """It passes one tooth forth and back: two edges 1.55 ms apart."""
    assert looks(Limits(SAFETY, ROLES), speed(12.0), speed(645.0, 0.00155), speed(9.0, 0.4)) == [None] * 3


def off_scale(at_s):
    return speed(5000.0, at_s, quality=Quality.OVER_RANGE, censored=1)


def test_an_edge_of_a_rotor_that_turns_back_at_a_tooth_is_none_off_the_scale_either():
    assert looks(Limits(SAFETY, ROLES), speed(12.0), off_scale(0.00015), speed(9.0, 0.4)) == [None] * 3


def test_a_second_speed_off_the_scale_trips_however_fast_it_came():
    said = looks(Limits(SAFETY, ROLES), speed(12.0), off_scale(0.00015), off_scale(0.0003))
    assert said[:2] == [None] * 2
    assert "beyond the scale of tach.speed_rpm: 5000 rpm or more, limit 600 rpm" in said[2]


def test_a_speed_that_no_rotor_reaches_so_fast_trips_where_the_next_reading_has_it_too():
    limits = Limits(SAFETY, ROLES)
    jumped = speed(900.0, 0.001)
    assert looks(limits, speed(300.0), jumped, jumped) == [None] * 3  # looked at twice, it is one reading
    assert looks(limits, speed(890.0, 0.002))[0] == "speed 890 rpm (tach.speed_rpm), limit 600 rpm"


def test_a_runaway_from_rest_trips_at_its_first_edge_beyond_the_limit():
    """8 N m, twice what 4 bar gives, on 0.005 kg m2: 28 edges a turn, each looked at."""
    limits, acceleration, tooth = Limits(SAFETY, ROLES), 8.0 / 0.005, 2 * math.pi / 28
    times = [math.sqrt(2 * n * tooth / acceleration) for n in range(1, 200)]
    speeds = [speed(60 / (28 * (b - a)), b) for a, b in itertools.pairwise(times)]
    first = next(n for n, one in enumerate(speeds) if one.value > 600.0)
    said = looks(limits, speed(0.0, times[0]), *speeds[: first + 1])
    assert said[:-1] == [None] * (first + 1)
    assert "limit 600 rpm" in said[-1]


def test_a_speed_that_a_person_typed_trips_however_fast_it_came():
    manual = [speed(value, at, quality=Quality.MANUAL) for value, at in ((300.0, 0.0), (900.0, 0.001))]
    assert "limit 600 rpm" in looks(Limits(SAFETY, ROLES), *manual)[1]


@pytest.mark.parametrize("typed", [">500", ">600"])
def test_a_reading_that_a_person_typed_as_off_the_scale_trips(typed):
    ends = float(typed[1:])
    channels = {"pressure_bar_abs": ChannelFile(unit="bar"), "speed_rpm": ChannelFile(unit="rpm", highest=ends)}
    value = decode_entry(f"2.0 {typed}", channels)["speed_rpm"]
    view = View(speed(value.value, quality=value.quality, censored=value.censored), pressure(2.0))
    said = Limits(SAFETY, ROLES).trip(view, 0, True)
    assert said == f"speed beyond the scale of tach.speed_rpm: {ends:g} rpm or more, limit 600 rpm"


@pytest.mark.parametrize(
    ("lowest", "words"),
    [
        (None, "speed 900 rpm (tach.speed_rpm), limit 600 rpm; it reads -900 rpm: the rotor turns the other way"),
        (-500.0, "beyond the scale of tach.speed_rpm: 500 rpm or more, limit 600 rpm; it reads -500 rpm: the rotor"),
        (
            0.0,
            "signal lost: no usable reading of tach.speed_rpm for 1.10 s .* -900 rpm is below .* turns the other way",
        ),
    ],
)
def test_a_speed_the_other_way_trips_and_says_how_its_sign_is_turned(lowest, words):
    """Of a tachometer that shows the direction; one whose scale begins at zero reads nothing that way."""
    value = bounded(Value(-900.0), ChannelFile(unit="rpm", lowest=lowest, highest=5000.0))
    one = reading("tach.speed_rpm", value.value, 0.0, value.quality, value.censored)
    view, limits = View(dataclasses.replace(one, detail=value.detail), pressure(2.0)), Limits(SAFETY, ROLES)
    said = limits.trip(view, 0, True) or limits.trip(view, int(1.1 * NS), True)
    assert re.search(words.replace("(", r"\(").replace(")", r"\)"), said)
    assert "scale = -1" in said


def test_a_speed_that_nothing_verified_trips_too():
    view = View(speed(900.0, quality=Quality.UNVERIFIED), pressure(2.0))
    assert "limit 600 rpm" in Limits(SAFETY, ROLES).trip(view, 0, True)


def test_a_speed_above_the_limit_trips_without_pressure_too():
    assert Limits(SAFETY, ROLES).trip(View(speed(700.0), pressure(1.0)), 0, False)


def test_a_speed_off_the_top_of_its_scale_trips_even_where_the_scale_ends_below_the_limit():
    view = View(speed(500.0, quality=Quality.OVER_RANGE, censored=1), pressure(2.0))
    assert "beyond the scale" in Limits(SAFETY, ROLES).trip(view, 0, True)


def test_a_speed_below_the_bottom_of_its_scale_is_no_overspeed():
    limits = Limits(SAFETY, ROLES)
    assert limits.trip(View(speed(6.0, quality=Quality.OVER_RANGE, censored=-1), pressure(2.0)), 0, True) is None


def test_a_pressure_above_the_limit_trips():
    said = Limits(SAFETY, ROLES).trip(View(speed(100.0), pressure(3.2)), 0, True)
    assert said == "pressure 3.2 bar abs (gauge.pressure_bar_abs), limit 3 bar abs"


def test_a_gauge_that_counts_from_the_room_is_held_against_the_absolute_limit():
    limits = Limits(SAFETY, GAUGE_ROLES, ambient_bar_abs=1.0)
    assert limits.trip(View(speed(100.0), reading("dial.pressure_bar_gauge", 1.9, 0.0)), 0, True) is None
    assert "3.1 bar abs" in limits.trip(View(speed(100.0), reading("dial.pressure_bar_gauge", 2.1, 0.1)), 0, True)


@pytest.mark.parametrize("quality", [Quality.TIMEOUT, Quality.CRC, Quality.STALE, Quality.EXCEPTION])
def test_a_speed_without_a_usable_reading_for_too_long_trips(quality):
    limits = Limits(SAFETY, ROLES)
    assert limits.trip(View(speed(300.0, 0.0), pressure(2.0)), 0, True) is None
    view = View(speed(None, 0.9, quality=quality), pressure(2.0, 0.9))
    assert limits.trip(view, int(0.9 * NS), True) is None
    view = View(speed(None, 1.2, quality=quality), pressure(2.0, 1.2))
    said = limits.trip(view, int(1.2 * NS), True)
    assert said.startswith(
        "speed signal lost: no usable reading of tach.speed_rpm for 1.20 s under pressure, limit 1 s"
    )
    assert quality.value in said


def test_a_speed_reading_that_only_grows_old_trips():
    limits = Limits(SAFETY, ROLES)
    old = speed(300.0, 0.0)
    assert limits.trip(View(old, pressure(2.0, 0.5)), int(0.5 * NS), True) is None
    assert "speed signal lost" in limits.trip(View(old, pressure(2.0, 1.6)), int(1.6 * NS), True)


def test_a_signal_that_was_never_there_trips_a_while_after_the_pressure_comes():
    limits = Limits(SAFETY, ROLES)
    assert limits.trip(View(pressure(1.0, 50.0)), 50 * NS, False) is None
    assert limits.trip(View(pressure(1.5, 51.0)), 51 * NS, True) is None
    assert "nothing was ever read" in limits.trip(View(pressure(1.5, 52.5)), int(52.5 * NS), True)


def test_a_pressure_that_is_lost_trips():
    limits = Limits(SAFETY, ROLES)
    limits.trip(View(speed(300.0), pressure(2.0)), 0, True)
    view = View(speed(300.0, 1.5), pressure(None, 1.5, quality=Quality.TIMEOUT))
    assert "pressure signal lost" in limits.trip(view, int(1.5 * NS), True)


def test_silence_without_pressure_is_no_fault():
    limits = Limits(SAFETY, ROLES)
    limits.trip(View(speed(0.0), pressure(1.0)), 0, False)
    assert limits.trip(View(speed(0.0), pressure(1.0)), 100 * NS, False) is None


def test_a_rotor_at_rest_is_no_lost_signal():
    limits = Limits(SAFETY, ROLES)
    for at_s in (0.0, 1.0, 2.0, 3.0):
        view = View(speed(0.0, at_s, censored=-1), pressure(1.1, at_s))
        assert limits.trip(view, int(at_s * NS), True) is None


def test_on_a_fast_clock_a_pause_of_the_machine_is_no_lost_signal():
    limits = Limits(SAFETY, ROLES, rate=20.0)
    limits.trip(View(speed(300.0), pressure(2.0)), 0, True)
    assert limits.trip(View(speed(300.0), pressure(2.0)), 190 * NS, True) is None  # 9.5 s of the wall
    assert limits.trip(View(speed(300.0), pressure(2.0)), 210 * NS, True)


def test_a_speed_beyond_a_scale_whose_end_is_not_known_trips_at_once():
    view = View(speed(None, quality=Quality.OVER_RANGE), pressure(2.0))
    assert "speed beyond the scale of tach.speed_rpm, limit 600 rpm" in Limits(SAFETY, ROLES).trip(view, 0, True)


@pytest.mark.parametrize(("rpm", "bar", "trips"), [(600.0, 3.0, None), (600.1, 2.0, "speed"), (10.0, 3.01, "pressure")])
def test_a_limit_is_where_it_says(rpm, bar, trips):
    said = Limits(SAFETY, ROLES).trip(View(speed(rpm), pressure(bar)), 0, True)
    assert said is None if trips is None else said.startswith(trips)
