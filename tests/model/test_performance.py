"""Operating points, runs in time and the ranking of the parameters."""

import math

import numpy as np
import pytest

from model import layout as at
from model.motor import read_motor
from model.operation.performance import (
    OperatingPoint,
    OperatingPointError,
    check_pressures,
    isentropic_drop,
    operating_points,
)
from model.operation.runs import coast_down, spin_up
from model.operation.sensitivity import sensitivities
from model.solvers.crank_angle import H_IN, H_OUT, W_GAS
from model.solvers.steady import gas_table, steady
from model.solvers.transient import Supply, simulate


@pytest.fixture(scope="module")
def motor():
    return read_motor("ptm3600")


@pytest.fixture(scope="module")
def point(motor) -> OperatingPoint:
    return operating_points(motor, [2.0e5])[0]


def test_speed_flow_and_torque_are_those_of_the_steady_solver(motor, point):
    found = steady(motor, [2.0e5])
    assert point.speed_rpm == pytest.approx(found.speed_rad_s[0, 0] * 30.0 / math.pi, rel=1e-12)
    assert point.flow_l_min == pytest.approx(found.flow_m3_s[0, 0] * 60_000.0, rel=1e-12)
    assert point.gas_torque_nm == found.gas_torque_nm[0, 0]


@pytest.mark.parametrize("reading", ["published", "virtual_work"])
@pytest.mark.parametrize("bar", [1.2, 2.0, 6.0])
def test_the_power_is_accounted_for_from_the_line_to_the_last_friction(motor, bar, reading):
    one = operating_points(motor.with_readings(torque=reading), [bar * 1e5])[0]
    losses = one.inlet_drop_loss_w + one.outlet_drop_loss_w + one.blow_down_loss_w
    assert one.isentropic_power_w - losses == pytest.approx(one.gas_work_w)
    assert one.gas_work_w + one.torque_reading_surplus_w == pytest.approx(one.indicated_power_w)
    assert one.roller_loss_w + one.f_overall_loss_w == pytest.approx(one.indicated_power_w)
    assert min(one.inlet_drop_loss_w, one.outlet_drop_loss_w, one.roller_loss_w, one.f_overall_loss_w) > 0.0
    assert 0.0 < one.isentropic_efficiency_virtual_work < 1.0


def test_in_the_virtual_work_reading_the_torque_does_the_gas_work_and_adds_nothing(motor):
    one = operating_points(motor.with_readings(torque="virtual_work"), [2.0e5])[0]
    assert one.torque_reading_surplus_w == 0.0
    assert one.isentropic_efficiency == one.isentropic_efficiency_virtual_work


def test_the_gas_work_is_what_the_transient_takes_out_of_the_enthalpy(motor):
    adiabatic = motor.with_readings(torque="virtual_work", heat_transfer=False)
    one = operating_points(adiabatic, [2.0e5])[0]
    supply, turn = [Supply(0.0, 2.0e5)], 60.0 / one.speed_rpm
    start = simulate(adiabatic, supply, np.array([0.0, 2.5])).state
    end = simulate(adiabatic, supply, np.array([2.5, 2.5 + turn]), start).state
    passed = end - start
    assert passed[W_GAS] / turn == pytest.approx(one.gas_work_w, rel=3e-4)
    assert (passed[H_IN] - passed[H_OUT]) / turn == pytest.approx(one.gas_work_w, rel=1e-3)


def test_f_overall_takes_more_than_its_torque_at_the_mean_speed_when_the_speed_ripples(motor):
    one = operating_points(motor, [1.15e5])[0]
    omega = one.speed_rpm / at.RPM
    assert one.f_overall_loss_w > 1.01 * motor.si("f_overall") * omega**2


def test_the_isentropic_drop_is_the_textbook_one(motor):
    gas = gas_table(motor.with_readings(air="constant"), [2.0e5])[0]
    expected = 1004.6925 * 293.15 * (1.0 - (101325.0 / 2.0e5) ** (2.0 / 7.0))
    assert isentropic_drop(2.0e5, 101325.0, 293.15, gas) == pytest.approx(expected, rel=1e-9)


def test_a_motor_that_its_friction_holds_is_stalled_with_zeros_and_no_efficiency(motor):
    one = operating_points(motor, [1.02e5])[0]
    assert (one.state, one.speed_rpm, one.flow_l_min, one.indicated_power_w) == ("stalled", 0.0, 0.0, 0.0)
    assert one.isentropic_efficiency is None


@pytest.mark.parametrize(
    ("bar", "words"),
    [(0.4, "outside 0.5 to 8 bar"), (8.1, "outside"), (1.0, "below the ambient"), (math.nan, "outside")],
)
def test_pressures_out_of_reach_are_refused_in_words(motor, bar, words):
    with pytest.raises(OperatingPointError, match=words):
        check_pressures(motor, [bar * 1e5])


def test_the_spin_up_passes_the_reference_speeds(motor):
    run = spin_up(motor, 2.0e5, 0.4)
    for time_s, rpm in ((0.105, 285.0), (0.205, 364.0), (0.305, 388.0)):
        assert np.interp(time_s, run.time_s, run.speed_rad_s) * at.RPM == pytest.approx(rpm, rel=0.01)


def test_the_coast_down_passes_the_reference_speeds(motor):
    run = coast_down(motor, 2.0e5, 0.2)
    assert run.time_s[0] == -0.1
    for time_s, rpm in ((0.05, 209.0), (0.10, 111.0), (0.15, 49.0), (0.20, 0.0)):
        assert np.interp(time_s, run.time_s, run.mean_speed_rad_s()) * at.RPM == pytest.approx(rpm, abs=2.0)


def test_there_is_no_coast_down_from_a_stall(motor):
    with pytest.raises(OperatingPointError, match=r"stalls at 1\.02 bar"):
        coast_down(motor, 1.02e5, 0.2)


def test_one_per_cent_is_what_one_per_cent_does(motor):
    effects = {one.name: one for one in sensitivities(motor, [1.6e5, 2.0e5])}
    for name in ("f_overall", "cylinder_diameter", "ambient_pressure", "inlet_temperature"):
        value = motor[name].value
        low, high = (steady(motor.with_values({name: value * ratio}), [1.6e5, 2.0e5]) for ratio in (0.995, 1.005))
        speed = (high.speed_rad_s[0] - low.speed_rad_s[0]) * at.RPM
        flow = (high.flow_m3_s[0] - low.flow_m3_s[0]) * at.L_MIN
        assert effects[name].speed_rpm_per_percent == pytest.approx(speed, rel=2e-3, abs=2e-3)
        assert effects[name].flow_l_min_per_percent == pytest.approx(flow, rel=2e-3, abs=2e-3)


def test_one_standard_deviation_is_taken_on_the_priors_own_scale(motor):
    effects = {one.name: one for one in sensitivities(motor, [2.0e5])}
    low, high = (steady(motor.with_values({"roller_friction": f_r}), [2.0e5]).speed_rad_s[0] for f_r in (0.004, 0.016))
    assert effects["roller_friction"].speed_rpm_per_prior_sd == pytest.approx(0.5 * (high - low) * at.RPM)
    assert effects["port_lap"].prior_step == "± 1"
    assert effects["cylinder_diameter"].speed_rpm_per_prior_sd is None


def test_the_ranking_falls_and_leaves_out_what_enters_no_equation(motor):
    ranking = sensitivities(motor, [2.0e5])
    sizes = [abs(one.speed_rpm_per_percent[0]) for one in ranking]
    assert sizes == sorted(sizes, reverse=True)
    assert not {"housing_diameter", "speed_limit"} & {one.name for one in ranking}


def test_a_parameter_at_its_bound_is_stepped_inwards(motor):
    effects = {one.name: one for one in sensitivities(motor.with_values({"relative_humidity": 1.0}), [2.0e5])}
    assert np.isfinite(effects["relative_humidity"].speed_rpm_per_percent).all()


def test_nothing_is_ranked_where_the_motor_stalls(motor):
    with pytest.raises(OperatingPointError, match=r"stalls at 1\.02 bar"):
        sensitivities(motor, [1.02e5, 2.0e5])
