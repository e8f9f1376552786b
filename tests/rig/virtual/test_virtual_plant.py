"""Line, motor and sensors of the virtual bench, without a wire."""

from __future__ import annotations

import math

import numpy as np
import pytest

from configs import ConfigError
from model.layout import L_MIN, RPM
from model.motor import read_motor
from model.solvers.steady import steady
from rig.bench.instrument import ChannelFile, Reference
from rig.readings import NS
from rig.virtual.devices.edge_counter import crossing_ns, wheel
from rig.virtual.devices.faults import Faults, Place
from rig.virtual.devices.sensors import Sensor, generator, truth_of
from rig.virtual.plant.air_line import AirLine
from rig.virtual.plant.plant import Plant
from rig.virtual.plant.truth import LineTruth, read_truth
from tests.person import FLOW_L_MIN, PRESSURE_BAR_ABS, SPEED_RPM, answer, read_dial

MOTOR = read_motor("ptm3600")


def mean_speed_rpm(plant, span_s=2.0):
    start_ns, start = plant.time_ns, plant.angle_rad
    plant.advance(start_ns + int(span_s * NS))
    return (plant.angle_rad - start) / span_s * RPM


@pytest.fixture(scope="module")
def running():
    plant = Plant(MOTOR)
    plant.order(2.0)
    plant.advance(5 * NS)
    return plant


def sensor(figures, truth=lambda: 2.0, seed=1, faults=None, **more):
    place = Place({"line": ["device"]}, frozenset())
    faults = faults or Faults(generator(1), place)
    return Sensor("device", "channel", ChannelFile(unit="bar", **figures), truth, faults, seed, **more)


def test_a_step_of_the_regulator_ends_at_the_steady_operating_point_of_the_model(running):
    found = steady(MOTOR, [2.0e5])
    assert running.pressure_bar == pytest.approx(2.0, abs=1e-6)
    assert mean_speed_rpm(running) == pytest.approx(float(found.speed_rad_s[0, 0]) * RPM, rel=2e-3)
    flow = np.mean([point[3] for point in running.history if point[0] > 4.0])
    assert flow == pytest.approx(float(found.mass_flow_kg_s[0, 0]), rel=5e-3)


def test_the_pressure_follows_the_regulator_with_its_lag():
    plant = Plant(MOTOR, LineTruth(regulator_lag_s=0.3))
    plant.order(2.0)
    plant.advance(int(0.3 * NS))
    rise = 2.0 - plant.ambient_bar
    assert plant.pressure_bar == pytest.approx(plant.ambient_bar + rise * (1.0 - math.exp(-1.0)), rel=1e-6)


def test_without_a_set_point_the_line_is_vented_the_motor_stops_and_nothing_passes_the_meter():
    plant = Plant(MOTOR)
    plant.order(1.8)
    plant.advance(3 * NS)
    plant.order(0.0)
    plant.advance(8 * NS)
    assert plant.vented
    assert plant.pressure_bar == pytest.approx(plant.ambient_bar, abs=1e-6)
    assert plant.speed_rpm == 0.0
    assert plant.flow_kg_s == pytest.approx(0.0, abs=1e-9)


def test_how_often_the_plant_is_asked_does_not_change_where_it_goes():
    often, once = Plant(MOTOR), Plant(MOTOR)
    for plant in (often, once):
        plant.order(1.9)
    for step in range(1, 900):
        often.advance(step * NS // 300)
    often.advance(3 * NS)
    once.advance(3 * NS)
    assert often.angle_rad == pytest.approx(once.angle_rad, rel=1e-3)


def a_line(volume_l=1.0, valve_time_s=0.02, area_mm2=50.0, lag_s=1e-3, droop=0.0):
    return AirLine(volume_l, valve_time_s, area_mm2, lag_s, droop, 1.0, 287.05 * 293.15)


def time_to(plant, pressure_bar, span_s=3.0):
    """How long until the line has passed a pressure [s]."""
    start, rises = plant.time_ns, plant.pressure_bar < pressure_bar
    while (plant.pressure_bar < pressure_bar) == rises and plant.time_ns - start < span_s * NS:
        plant.advance(plant.time_ns + 2_000_000)
    return (plant.time_ns - start) / NS


def test_a_closed_line_keeps_its_mass_balance():
    line = a_line(valve_time_s=0.0)
    line.step(2.0, True, 0.0, 1.0)
    kept_kg = (line.pressure_bar - 1.0) * 1e5 * 1e-3 / (287.05 * 293.15)
    assert line.entered_kg == pytest.approx(kept_kg, rel=1e-9)
    assert line.pressure_bar == pytest.approx(2.0, abs=1e-4)


def test_a_line_empties_by_choked_flow_at_first():
    line = a_line(valve_time_s=0.0)
    line.step(3.0, True, 0.0, 1.0)
    line.step(1.0, False, 0.0, 0.01)  # 3 bar to 1: choked, so exponential with V / (0.6847 A sqrt(R T))
    time_constant_s = 1e-3 / (0.6847 * 50e-6 * math.sqrt(287.05 * 293.15))
    assert line.pressure_bar == pytest.approx(3.0 * math.exp(-0.01 / time_constant_s), rel=2e-2)


def test_a_larger_line_fills_and_empties_more_slowly():
    took = []
    for volume_l in (0.1, 1.0, 5.0):
        plant = Plant(MOTOR, LineTruth(regulator_lag_s=0.01, line_volume_l=volume_l, valve_time_s=0.005))
        plant.order(2.0)
        rise = time_to(plant, 1.8)
        plant.advance(3 * NS)
        plant.order(0.0)
        took.append((rise, time_to(plant, 1.2)))
    assert took == sorted(took)
    assert took[-1][0] > 5.0 * took[0][0]
    assert took[-1][1] > 0.2 > 0.02 > took[0][1]


def test_a_valve_that_takes_its_time_vents_later():
    took = []
    for valve_time_s in (0.005, 0.1):
        plant = Plant(MOTOR, LineTruth(regulator_lag_s=0.01, line_volume_l=0.2, valve_time_s=valve_time_s))
        plant.order(2.0)
        plant.advance(3 * NS)
        plant.order(0.0)
        took.append(time_to(plant, 1.5))
    assert took[1] - took[0] > 0.02


def test_a_regulator_with_droop_loses_pressure_with_the_flow():
    plant = Plant(MOTOR, LineTruth(line_volume_l=0.5, regulator_droop_bar_min_l=0.002))
    plant.order(2.0)
    plant.advance(5 * NS)
    flow_l_min = plant.volume_flow_l_min(plant.pressure_bar, plant.inlet_k)
    assert 2.0 - plant.pressure_bar == pytest.approx(0.002 * flow_l_min, abs=0.01)
    assert plant.pressure_bar < 1.95


def test_a_line_that_holds_air_runs_the_motor_as_one_that_does_not_at_the_same_pressure():
    plant = Plant(MOTOR, LineTruth(line_volume_l=0.5, valve_time_s=0.02))
    plant.order(2.0)
    plant.advance(5 * NS)
    found = steady(MOTOR, [plant.pressure_bar * 1e5])
    assert mean_speed_rpm(plant) == pytest.approx(float(found.speed_rad_s[0, 0]) * RPM, rel=3e-3)


def test_a_tachometer_with_a_window_tells_the_mean_over_it():
    plant = Plant(MOTOR, LineTruth(tachometer_window_s=0.1))
    tells = truth_of(plant, "speed_rpm", None)
    plant.order(2.0)
    plant.advance(int(0.2 * NS))
    start_rad = plant.angle_rad
    plant.advance(int(0.3 * NS))
    assert tells() == pytest.approx((plant.angle_rad - start_rad) / 0.1 * RPM, rel=1e-3)
    assert tells() < 0.95 * plant.speed_rpm  # it still rises


def test_the_errors_of_a_wheel_are_its_own_and_the_same_for_the_same_seed():
    pitch = 2.0 * math.pi / 60
    found = wheel(60, 0.05, 1, "tach")
    errors = found / pitch - np.arange(60)
    assert np.array_equal(found, wheel(60, 0.05, 1, "tach"))
    assert not np.array_equal(found, wheel(60, 0.05, 2, "tach"))
    assert 0.03 < np.std(errors) < 0.07
    assert np.all(np.diff(wheel(60, 0.3, 1, "tach")) > 0.0)


def test_the_truth_changes_motor_and_line():
    motor, line = read_truth(MOTOR, {"f_overall": 0.07, "vent_lag_s": 0.1}, "bench.toml")
    assert motor["f_overall"].value == 0.07
    assert line.vent_lag_s == 0.1


@pytest.mark.parametrize(
    ("truth", "said"),
    [
        ({"f_overal": 0.07}, "bench.toml: virtual.truth.f_overal: no such parameter; did you mean 'f_overall'?"),
        ({"vent_lag_s": 0.0}, "bench.toml: virtual.truth.vent_lag_s: 0 is outside 0.001..100"),
        ({"line_volume_l": 99.0}, "bench.toml: virtual.truth.line_volume_l: 99 is outside 0..50"),
        ({"pitch_error_sd": 0.5}, "bench.toml: virtual.truth.pitch_error_sd: 0.5 is outside 0..0.3"),
        ({"f_overall": 99.0}, "parameters.f_overall: 99 N m s is outside"),
    ],
)
def test_a_truth_that_cannot_be_is_refused_in_one_line(truth, said):
    with pytest.raises(ConfigError) as error:
        read_truth(MOTOR, truth, "bench.toml")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_standard_volume_meter_reads_the_mass_flow_at_its_state(running):
    at_0_c = truth_of(
        running, "flow_sl_min", Reference(kind="standard_volume", pressure_bar_abs=1.01325, temperature_c=0.0)
    )
    density = 1.01325e5 / (running.gas_constant * 273.15)
    assert at_0_c() == pytest.approx(running.flow_kg_s / density * L_MIN, rel=1e-9)


def test_a_rotameter_s_scale_is_right_at_its_own_state_and_low_in_denser_air(running):
    inlet = truth_of(running, "flow_l_min", None)()
    own = Reference(kind="rotameter_scale", pressure_bar_abs=running.pressure_bar, temperature_c=20.0)
    ambient = Reference(kind="rotameter_scale", pressure_bar_abs=1.0, temperature_c=20.0)
    assert truth_of(running, "flow_l_min", own)() == pytest.approx(inlet, rel=1e-9)
    assert truth_of(running, "flow_l_min", ambient)() == pytest.approx(inlet * math.sqrt(2.0), rel=1e-6)


def test_a_channel_that_the_bench_cannot_know_is_refused(running):
    with pytest.raises(ValueError, match="knows no quantity for the channel 'torque_nm'"):
        truth_of(running, "torque_nm", None)


def test_errors_of_a_sensor_are_drawn_once_and_again_the_same_for_the_same_seed():
    figures = {"bias_sd": 0.01, "scale_sd": 0.01}
    first, again, other = (sensor(figures, seed=seed).read(0) for seed in (1, 1, 2))
    assert first == again != other
    assert abs(first - 2.0) < 0.15


def test_noise_has_the_size_that_the_file_says_and_readings_its_resolution():
    noisy = sensor({"noise_sd": 0.02, "resolution": 0.001})
    values = np.array([noisy.read(i) for i in range(4000)])
    assert np.std(values) == pytest.approx(0.02, rel=0.1)
    assert np.allclose(values, np.round(values, 3))


def test_an_instrument_has_a_new_value_no_more_often_than_its_file_says():
    slow = sensor({"noise_sd": 0.02}, update_s=0.5)
    assert slow.read(0) == slow.read(int(0.4 * NS)) != slow.read(int(0.6 * NS))


def test_the_time_of_a_tooth_is_that_of_the_cubic_between_two_samples():
    speed, acceleration, span = 40.0, -900.0, 1e-3
    angles = np.array([0.0, speed * span + 0.5 * acceleration * span**2])
    speeds = np.array([speed, speed + acceleration * span])
    middle = 0.4 * span
    angle = speed * middle + 0.5 * acceleration * middle**2
    assert crossing_ns(np.array([0.0, span * NS]), angles, speeds, angle) == pytest.approx(middle * NS, abs=1e-3)


@pytest.mark.parametrize("beyond", [1e-9, 1e-7, 1e-5])
@pytest.mark.parametrize("turns_at", [0.999, 1.0, 1.001])
def test_a_rotor_that_turns_back_just_behind_a_tooth_passes_it_twice_at_the_right_times(beyond, turns_at):
    """Its angle is a parabola, which a cubic is exactly: its top at `turns_at` ms, `beyond` rad above the tooth."""
    pull = 300.0  # rad/s2
    times = np.arange(4.0)  # ms
    away = (times - turns_at) * 1e-3
    angles, speeds = beyond - 0.5 * pull * away**2, -pull * away
    half = np.sqrt(2.0 * beyond / pull) * 1e3
    for crossing in (turns_at - half, turns_at + half):
        span = slice(int(crossing), int(crossing) + 2)
        found = crossing_ns(times[span] * 1e6, angles[span], speeds[span], 0.0)
        assert found == pytest.approx(crossing * 1e6, abs=1.0)


def test_a_person_answers_a_plateau_in_one_line():
    assert answer(2.003, 72.2, 394.4) == "2.00 72 394"


def test_a_person_says_which_end_of_the_scale_the_pointer_is_beyond():
    assert read_dial(123.0, FLOW_L_MIN) == ">100"
    assert read_dial(3.0, FLOW_L_MIN) == "<10"
    assert answer(1.2, 8.0, 0.0) == "1.20 <10 <5"


def test_a_person_reads_to_the_division_with_some_parallax():
    chance = generator(1, "person")
    said = np.array([float(read_dial(2.0, PRESSURE_BAR_ABS, chance)) for _ in range(500)])
    assert 0.004 < np.std(said) < 0.02
    assert np.allclose(said / PRESSURE_BAR_ABS.division, np.round(said / PRESSURE_BAR_ABS.division))
    assert read_dial(-0.2, SPEED_RPM) == "<5"
