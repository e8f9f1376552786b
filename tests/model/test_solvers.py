"""The three solvers: against the reference figures, against each other, and as a motor has to behave.

The reference figures come from two independent implementations of the same equations, with dry air of constant cp.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model import geometry, layout, motor
from model.gas.cylinder import gas_state
from model.solvers import crank_angle, published, transient
from model.solvers.steady import gas_table, solve, steady, unpack
from model.solvers.transient import Supply

RPM, L_MIN = layout.RPM, layout.L_MIN
MOIST = motor.read_motor("ptm3600")
DRY = MOIST.with_readings(air="constant")
ADIABATIC = DRY.with_readings(heat_transfer=False)
VIRTUAL = {"torque": "virtual_work"}

PRESSURES = np.array([1.60, 1.70, 1.80, 1.83, 1.85, 1.95, 2.00]) * 1e5
SPEEDS = {
    "adiabatic": (ADIABATIC, [229.99, 271.82, 313.66, 326.21, 334.57, 376.41, 397.33]),
    "with heat transfer": (DRY, [229.43, 271.37, 313.28, 325.85, 334.23, 376.12, 397.06]),
    "f 0.0633": (
        ADIABATIC.with_values({"f_overall": 0.0633}),
        [227.08, 268.39, 309.69, 322.08, 330.35, 371.65, 392.30],
    ),
    "f 0.0640": (
        ADIABATIC.with_values({"f_overall": 0.0640}),
        [224.60, 265.45, 306.31, 318.56, 326.73, 367.59, 388.01],
    ),
    "virtual work": (ADIABATIC.with_readings(**VIRTUAL), [227.78, 269.22, 310.67, 323.10, 331.39, 372.84, 393.56]),
    "cylinder 25.8 mm": (
        DRY.with_values({"cylinder_diameter": 25.8}),
        [264.5, 312.9, 361.2, 375.7, 385.3, 433.6, 457.7],
    ),
}
PULSE = 2.0 * math.pi / 28  # rad
REPEATS = np.r_[1, crank_angle.P0 : crank_angle.P0 + 14]  # the state but for the angle and what has passed
START_ANGLES = np.linspace(0.0, PULSE, 15)[:-1]  # at rest all cylinders hold the same gas


def steady_rpm(motor_then, P_in):
    return steady(motor_then, [P_in]).speed_rad_s[0, 0] * RPM


def turn(motor_then, P_in, state, refine=1):
    """One turn at constant pressure from angle 0, with nothing passed before; the state after it and its time."""
    y = state.copy()
    y[crank_angle.THETA] = 0.0
    y[crank_angle.M_IN : crank_angle.P0] = 0.0
    pulse_t = np.full(28, np.nan)
    parameters, readings = motor_then.vector(), motor_then.readings.vector()
    gas = gas_state(parameters, P_in, readings)
    line = (np.array([0.0]), np.array([P_in]), np.array([1.0]))
    samples = np.empty((2, 6))
    transient.integrate(y, 0.0, *line, np.array([0.0, 9.0]), samples, pulse_t, parameters, gas, readings, refine)
    return y, pulse_t[-1]


def periodic(motor_then, P_in, refine=1):
    """The periodic state at angle 0, turned until it repeats."""
    y, _ = transient.periodic_state(motor_then, P_in, refine=refine)
    for _ in range(100):
        before, (y, _) = y, turn(motor_then, P_in, y, refine)
        if np.allclose(y[REPEATS], before[REPEATS], rtol=1e-12):
            break
    y[crank_angle.THETA] = 0.0
    y[crank_angle.M_IN : crank_angle.P0] = 0.0
    return y


def rpm_at(motor_then, supply, times, state=None, refine=1):
    return transient.simulate(motor_then, supply, np.array(times), state, refine).speed_rad_s * RPM


# The published algorithm


@pytest.mark.parametrize(("P_in", "rpm"), [(1.6e5, 229.28), (2.0e5, 396.14)])
def test_the_published_algorithm_gives_the_reference_average(P_in, rpm):
    assert published.march(ADIABATIC, P_in).mean_speed_rpm == pytest.approx(rpm, rel=3e-4)


@pytest.mark.parametrize("P_in", [1.6e5, 2.0e5])
def test_most_of_the_published_average_s_error_is_unfinished_spin_up(P_in):
    true = steady_rpm(ADIABATIC, P_in)
    assert published.march(ADIABATIC, P_in).mean_speed_rpm / true - 1.0 == pytest.approx(-3e-3, abs=5e-4)
    settled = published.march(ADIABATIC, P_in, steps=30_000).speed_rad_s[20_000:].mean() * RPM
    assert settled / true - 1.0 == pytest.approx(-1e-3, abs=3e-4)


def test_the_published_peak_of_the_outlet_flow_is_made_by_the_step():
    """A blow-down takes one step, whatever its length."""
    coarse = published.march(ADIABATIC, 2e5).outlet_kg_s.max()
    fine = published.march(ADIABATIC, 2e5, steps=18_000, dt=37.5e-6).outlet_kg_s.max()
    assert fine / coarse == pytest.approx(2.0, abs=0.05)


def test_the_published_algorithm_loses_no_gas():
    """Over 2.4 s, 7 g go through; in and out differ by no more than a cylinder holds."""
    run = published.march(DRY, 2e5, steps=40_000)
    through_inlet = np.sum(run.inlet_kg_s[8_000:]) * published.TIME_STEP
    through_outlet = np.sum(run.outlet_kg_s[8_000:]) * published.TIME_STEP
    assert through_inlet > 6e-3
    assert abs(through_outlet - through_inlet) < run.mass_kg[8_000:].max()


@pytest.mark.parametrize(("steps", "dt"), [(1, 75e-6), (100, 0.0), (100, -1e-6), (100, math.nan)])
def test_a_march_that_goes_nowhere_is_refused(steps, dt):
    with pytest.raises(ValueError, match="needs at least 2 steps of positive length"):
        published.march(MOIST, 2e5, steps=steps, dt=dt)


# The steady solver against the reference figures


@pytest.mark.parametrize("case", SPEEDS)
def test_steady_speed_meets_the_reference(case):
    motor_then, rpm = SPEEDS[case]
    np.testing.assert_allclose(steady(motor_then, PRESSURES).speed_rad_s[0] * RPM, rpm, rtol=1.6e-4)


def test_inlet_flow_meets_the_reference():
    flow = steady(ADIABATIC, PRESSURES).flow_m3_s[0] * L_MIN
    np.testing.assert_allclose(flow, [41.62, 49.40, 57.21, 59.56, 61.12, 68.98, 72.91], rtol=1.5e-4)


def test_mean_gas_torque_meets_the_reference():
    torque = steady(ADIABATIC, [1.6e5, 2e5]).gas_torque_nm[0]
    np.testing.assert_allclose(torque, [1.5994, 2.7283], rtol=3e-5)


@pytest.mark.parametrize(("P_in", "rpm"), [(1.2e5, 60.47), (1.3e5, 103.19), (1.4e5, 145.36), (2.4e5, 564.51)])
def test_the_ripple_s_lower_mean_speed_meets_the_reference(P_in, rpm):
    assert steady_rpm(DRY, P_in) == pytest.approx(rpm, rel=3e-4)


def test_at_1_15_bar_both_our_solvers_stand_a_quarter_per_cent_above_the_reference():
    """37.45 against 37.36 rpm: a known difference, in the one figure near the lowest pressure.

    There the speed ripples by a third of its mean. The transient and the steady solver share little there, and agree.
    """
    ours = steady_rpm(DRY, 1.15e5)
    assert ours == pytest.approx(transient.periodic_state(DRY, 1.15e5)[1] * RPM, rel=2e-5)
    assert ours == pytest.approx(37.452, abs=2e-3)
    assert ours == pytest.approx(37.36, rel=3e-3)


@pytest.mark.parametrize(
    ("P_in", "rpm"), [(1.15e5, 39.82), (1.2e5, 61.10), (1.3e5, 103.36), (1.4e5, 145.45), (2.4e5, 564.53)]
)
def test_a_heavy_rotor_runs_without_ripple_at_the_reference_speed(P_in, rpm):
    heavy = DRY.with_values({"inertia": 10.0})
    assert steady_rpm(heavy, P_in) == pytest.approx(rpm, rel=4e-4)


def test_the_ripple_at_2_bar_meets_the_reference():
    assert steady(ADIABATIC, [2e5]).ripple_rad_s[0, 0] * RPM == pytest.approx(2.9, abs=0.1)


# The steady solver against the transient one


@pytest.mark.parametrize("air", ["moist", "constant"])
@pytest.mark.parametrize("torque", ["published", "virtual_work"])
@pytest.mark.parametrize("P_in", [1.16e5, 1.2e5, 1.4e5, 1.6e5, 2e5, 2.485e5])
def test_the_steady_speed_is_where_the_transient_settles_from_40_to_600_rpm(air, torque, P_in):
    motor_then = MOIST.with_readings(air=air, torque=torque)
    settled = transient.periodic_state(motor_then, P_in)[1]
    assert steady(motor_then, [P_in]).speed_rad_s[0, 0] == pytest.approx(settled, rel=5e-5)


@pytest.mark.parametrize("P_in", [1.3e5, 2e5])
def test_the_steady_torques_and_flow_are_those_of_a_turn_of_the_transient(P_in):
    found = steady(MOIST, [P_in])
    y, time = turn(MOIST, P_in, periodic(MOIST, P_in, refine=4), refine=4)
    assert found.gas_torque_nm[0, 0] == pytest.approx(y[crank_angle.W_GAS] / (2.0 * math.pi), rel=5e-5)
    assert found.roller_torque_nm[0, 0] == pytest.approx(y[crank_angle.W_ROLLER] / (2.0 * math.pi), rel=1e-4)
    assert found.mass_flow_kg_s[0, 0] == pytest.approx(y[crank_angle.M_IN] / time, rel=5e-5)


# Balances


@pytest.mark.parametrize("heat_transfer", [True, False])
@pytest.mark.parametrize("P_in", [1.3e5, 2e5, 2.4e5])
def test_energy_and_mass_balance_over_a_turn_when_the_torque_is_virtual_work(P_in, heat_transfer):
    motor_then = MOIST.with_readings(heat_transfer=heat_transfer, **VIRTUAL)
    y, _ = turn(motor_then, P_in, periodic(motor_then, P_in, refine=4), refine=4)
    brought = y[crank_angle.H_IN] - y[crank_angle.H_OUT] + y[crank_angle.Q_IN]
    assert brought == pytest.approx(y[crank_angle.W_GAS], rel=1e-6)
    assert y[crank_angle.M_OUT] == pytest.approx(y[crank_angle.M_IN], rel=1e-6)


def test_the_published_torque_takes_nine_thousandths_more_work_than_the_gas_gives():
    """Erratum 4, with the default lap."""
    y, _ = turn(MOIST, 2e5, periodic(MOIST, 2e5, refine=4), refine=4)
    brought = y[crank_angle.H_IN] - y[crank_angle.H_OUT] + y[crank_angle.Q_IN]
    assert y[crank_angle.W_GAS] / brought - 1.0 == pytest.approx(0.009, abs=2e-4)


def test_what_the_gas_gives_is_what_friction_takes():
    """Without ripple the mean torques balance at the mean speed."""
    heavy = MOIST.with_values({"inertia": 10.0})
    found = steady(heavy, PRESSURES)
    taken = found.roller_torque_nm + heavy.si("f_overall") * found.speed_rad_s
    np.testing.assert_allclose(found.gas_torque_nm, taken, rtol=1e-6)


def test_the_flow_meter_s_volume_is_the_mass_at_the_line_s_state():
    found = steady(DRY, PRESSURES)
    np.testing.assert_allclose(
        found.flow_m3_s * PRESSURES, found.mass_flow_kg_s * 287.055 * DRY.si("inlet_temperature"), rtol=1e-13
    )


@pytest.mark.parametrize(("P_in", "share"), [(1.6e5, 0.035), (2e5, 0.047)])
def test_a_cylinder_takes_in_what_fills_its_clearance_and_its_stroke(P_in, share):
    """Adiabatic, by hand: filled from P_d to P_s at the edge, then P_s dV / (R T_in) until the inlet shuts."""
    low, high = geometry.table(ADIABATIC.vector(), np.radians([53.0, 82.0]))["V_m3"]
    P_s, P_d = P_in - 1000.0, 102_325.0
    filling = (P_s - P_d) * low / (1.4 * 287.055 * 293.15)
    stroke = P_s * (high - low) / (287.055 * 293.15)
    found = steady(ADIABATIC, [P_in])
    turns_s = found.speed_rad_s[0, 0] / (2.0 * math.pi)
    assert found.mass_flow_kg_s[0, 0] == pytest.approx((filling + stroke) * 28.0 * turns_s, rel=1e-9)
    assert filling / (filling + stroke) == pytest.approx(share, abs=5e-4)


# The steady solver as a function


pressures = st.floats(1.5e5, 4e5)  # all of `motors` run there


@st.composite
def motors(draw):
    return draw(st.sampled_from([MOIST, DRY, ADIABATIC, MOIST.with_readings(**VIRTUAL)])).with_values(
        {
            "f_overall": draw(st.floats(0.03, 0.12)),
            "port_lap": draw(st.floats(5.0, 10.0)),
            "roller_friction": draw(st.floats(0.0, 0.02)),
            "cylinder_diameter": draw(st.floats(20.0, 26.0)),
        }
    )


@settings(deadline=None, max_examples=50)
@given(motors(), pressures)
def test_speed_and_flow_rise_with_pressure(motor_then, P_in):
    found = steady(motor_then, [P_in, 1.005 * P_in])
    assert found.running.all()
    assert found.speed_rad_s[0, 1] > found.speed_rad_s[0, 0] > 0.0
    assert found.flow_m3_s[0, 1] > found.flow_m3_s[0, 0] > 0.0


@pytest.mark.parametrize("name", ["f_overall", "roller_friction"])
@settings(deadline=None, max_examples=50)
@given(motors(), pressures)
def test_speed_falls_with_friction(name, motor_then, P_in):
    more = motor_then.with_values({name: motor_then[name].value * 1.01 + 1e-5})
    assert steady_rpm(more, P_in) < steady_rpm(motor_then, P_in)


@settings(deadline=None, max_examples=50)
@given(
    st.lists(motors().map(lambda m: m.vector()), min_size=1, max_size=6), st.lists(pressures, max_size=4, min_size=1)
)
def test_many_motors_at_once_are_each_alone_to_the_bit(sets, P):
    gas, readings = gas_table(MOIST, P), MOIST.readings.vector()
    together = solve(np.array(sets), readings, np.tile(P, (len(sets), 1)), gas, slopes=True)
    for parameters, row in zip(sets, together, strict=True):
        alone = solve(parameters[None], readings, np.array([P]), gas, slopes=True)
        np.testing.assert_array_equal(alone[0], row)


@pytest.mark.parametrize("motor_then", [DRY, MOIST], ids=["constant air", "moist air"])
def test_a_pressure_has_the_same_answer_alone_and_among_others(motor_then):
    """A point's first guess is its neighbour's result, so the last digits that the passes leave open may differ."""
    together = steady(motor_then, PRESSURES).speed_rad_s[0]
    alone = [steady(motor_then, [P]).speed_rad_s[0, 0] for P in PRESSURES]
    np.testing.assert_allclose(together, alone, rtol=1e-7)


def test_the_same_question_has_the_same_answer_to_the_bit():
    sets = np.array([MOIST.with_values({"f_overall": f}).vector() for f in np.linspace(0.05, 0.08, 40)])
    arguments = (sets, MOIST.readings.vector(), np.tile(PRESSURES, (40, 1)), gas_table(MOIST, PRESSURES))
    np.testing.assert_array_equal(solve(*arguments), solve(*arguments))


@pytest.mark.parametrize("P_in", [1.3e5, 1.6e5, 2e5, 3e5])
def test_slopes_are_the_derivatives_with_pressure(P_in):
    found = steady(MOIST, [P_in], slopes=True)
    low, high = steady(MOIST, [P_in - 100.0]), steady(MOIST, [P_in + 100.0])
    speed_slope = (high.speed_rad_s - low.speed_rad_s) / 200.0
    flow_slope = (high.flow_m3_s - low.flow_m3_s) / 200.0
    np.testing.assert_allclose(found.speed_slope, speed_slope, rtol=4e-3)  # the solver promises 1e-2
    np.testing.assert_allclose(found.flow_slope, flow_slope, rtol=4e-3)


def test_slopes_are_zero_when_not_asked_for():
    found = steady(MOIST, [2e5])
    assert found.speed_slope[0, 0] == found.flow_slope[0, 0] == 0.0


@pytest.mark.parametrize(
    ("n_parameters", "n_sets", "n_gas"), [(19, 2, 7), (22, 3, 7), (22, 2, 6)], ids=["parameters", "sets", "gas"]
)
def test_shapes_that_do_not_fit_are_refused(n_parameters, n_sets, n_gas):
    sets = np.tile(MOIST.vector()[:n_parameters], (n_sets, 1))
    gas = gas_table(MOIST, PRESSURES)[:n_gas]
    with pytest.raises(ValueError, match=r"steady\.solve: parameters \(\d, \d+\), pressures \(2, 7\) and gas"):
        solve(sets, MOIST.readings.vector(), np.tile(PRESSURES, (2, 1)), gas)


def test_a_result_is_named_by_its_columns():
    out = np.arange(18.0).reshape(1, 2, 9)
    named = unpack(out)
    assert named.speed_rad_s.shape == named.running.shape == (1, 2)
    assert named.flow_m3_s[0, 1] == 11.0


# The transient solver: convergence


def spin_up_errors(motor_then):
    """Largest error of the speed at six times of a spin-up with 1, 2 and 4 steps between edges, against 16."""
    ends = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)

    def speeds(refine):
        return np.array([rpm_at(motor_then, [Supply(0.0, 2e5)], [0.0, end], refine=refine)[-1] for end in ends])

    exact = speeds(16)
    return np.array([np.abs(speeds(refine) / exact - 1.0).max() for refine in (1, 2, 4)])


def test_without_heat_the_transient_converges_in_fourth_order_or_better():
    errors = spin_up_errors(ADIABATIC)
    assert errors[0] < 4e-5
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 4.0)


def test_with_heat_the_transient_converges_in_second_order():
    """Eq. 19 has a kink where the piston turns: Vp^0.8 at the dead centres."""
    errors = spin_up_errors(DRY)
    assert errors[0] < 3e-5
    assert 0.5 * np.log2(errors[0] / errors[2]) == pytest.approx(2.0, abs=0.4)


def test_the_periodic_state_repeats_after_a_turn():
    y, _ = transient.periodic_state(MOIST, 2e5)
    after, _ = turn(MOIST, 2e5, y)
    np.testing.assert_allclose(after[REPEATS], y[REPEATS], rtol=1e-8)


def test_a_run_goes_on_from_the_state_it_ended_in():
    supply = [Supply(0.0, 2e5)]
    first = transient.simulate(MOIST, supply, np.array([0.0, 0.1]))
    second = transient.simulate(MOIST, supply, np.array([0.1, 0.2]), first.state)
    whole = transient.simulate(MOIST, supply, np.array([0.0, 0.2]))
    assert second.speed_rad_s[-1] == pytest.approx(whole.speed_rad_s[-1], rel=1e-6)
    assert second.inlet_kg[-1] == pytest.approx(whole.inlet_kg[-1], rel=1e-5)


def test_the_mean_speed_between_samples_is_the_angle_passed():
    run = transient.simulate(MOIST, [Supply(0.0, 2e5)], np.linspace(0.0, 0.3, 31))
    assert run.mean_speed_rad_s()[0] == run.speed_rad_s[0] == 0.0
    assert np.sum(run.mean_speed_rad_s()[1:] * 0.01) == pytest.approx(run.angle_rad[-1], rel=1e-12)


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [0.1, 0.0], [[0.0, 0.1]]])
def test_sample_times_that_do_not_increase_are_refused(times):
    with pytest.raises(ValueError, match="must be at least two and increase"):
        transient.simulate(MOIST, [Supply(0.0, 2e5)], np.array(times))


# The transient solver: the motor in time


@pytest.mark.parametrize("motor_then", [DRY, MOIST], ids=["constant air", "moist air"])
def test_spin_up_at_2_bar_meets_the_reference(motor_then):
    rpm = rpm_at(motor_then, [Supply(0.0, 2e5)], [0.0, 0.105, 0.205, 0.305])
    np.testing.assert_allclose(rpm[1:], [285.0, 364.0, 388.0], rtol=0.01)


def test_spin_up_over_all_start_angles_spans_the_reference():
    """Reference 286-294, 364-368, 387-390 rpm."""
    runs = np.array(
        [
            rpm_at(DRY, [Supply(0.0, 2e5)], [0.0, 0.105, 0.205, 0.305], transient.rest_state(DRY, angle))[1:]
            for angle in START_ANGLES
        ]
    )
    np.testing.assert_allclose(runs.min(axis=0), [286.0, 364.0, 387.0], atol=1.0)
    np.testing.assert_allclose(runs.max(axis=0), [294.0, 368.0, 390.0], atol=2.0)


def coast_down(after_s):
    """Speed 0.05, 0.10, 0.15 and 0.20 s after the supply is shut, ``after_s`` after angle 0 at 397 rpm."""
    supply = [Supply(0.0, 2e5), Supply(after_s, 2e5, is_open=False)]
    times = [0.0, *(after_s + np.array([0.05, 0.10, 0.15, 0.20]))]
    return rpm_at(DRY, supply, times, periodic(DRY, 2e5))[1:]


@pytest.fixture(scope="module")
def coast_down_phases():
    """Coast-downs with the supply shut at 28 instants of a pulse."""
    pulse_s = PULSE / steady(DRY, [2e5]).speed_rad_s[0, 0]
    return np.array([coast_down(0.1 + pulse_s * i / 28) for i in range(28)])


def test_coast_down_from_0_10_s_on_meets_the_reference():
    np.testing.assert_allclose(coast_down(0.1)[1:], [111.0, 49.0, 0.0], atol=2.0)


def test_coast_down_s_reference_after_0_05_s_lies_within_our_spread_over_the_instant_of_the_shut_off(coast_down_phases):
    """209 rpm; ours is 206.5 at the instant stated, half an rpm outside the 2 rpm that the others keep.

    The instant within a pulse moves it by more: from 205.5 to 210.3 rpm.
    """
    first = coast_down_phases[:, 0]
    assert first[0] == pytest.approx(206.5, abs=0.1)
    assert first.min() < 207.0 < 209.0 < first.max()
    assert (first.min(), first.max()) == pytest.approx((205.5, 210.3), abs=0.2)


def test_with_the_supply_shut_the_motor_comes_to_rest_and_stays():
    supply = [Supply(0.0, 2e5), Supply(0.1, 2e5, is_open=False)]
    run = transient.simulate(MOIST, supply, np.array([0.0, 1.1, 2.0, 20.0]), periodic(MOIST, 2e5))
    np.testing.assert_array_equal(run.speed_rad_s[1:], 0.0)
    np.testing.assert_allclose(run.angle_rad[2:], run.angle_rad[1], rtol=1e-15)
    np.testing.assert_allclose(run.inlet_kg[2:], run.inlet_kg[1], rtol=1e-15)


@pytest.mark.parametrize("angle", START_ANGLES)
def test_with_both_ports_at_one_pressure_it_stays_at_rest(angle):
    """2 kPa above the ambient: the drops leave P_s = P_d. The shut cylinders' gas may give by a few microradians."""
    run = transient.simulate(MOIST, [Supply(0.0, 103_325.0)], np.array([0.0, 0.5]), transient.rest_state(MOIST, angle))
    assert run.speed_rad_s[-1] == 0.0
    assert run.angle_rad[-1] == pytest.approx(angle, abs=1e-5)


@pytest.mark.parametrize("angle", START_ANGLES)
def test_at_1_05_bar_it_may_shift_but_does_not_run(angle):
    run = transient.simulate(MOIST, [Supply(0.0, 1.05e5)], np.array([0.0, 1.0]), transient.rest_state(MOIST, angle))
    assert run.speed_rad_s[-1] == 0.0
    assert abs(run.angle_rad[-1] - angle) < PULSE


@pytest.mark.parametrize("angle", START_ANGLES)
def test_at_1_6_bar_it_starts_from_every_angle(angle):
    run = transient.simulate(MOIST, [Supply(0.0, 1.6e5)], np.array([0.0, 1.0, 2.0]), transient.rest_state(MOIST, angle))
    assert run.mean_speed_rad_s()[-1] * RPM == pytest.approx(steady_rpm(MOIST, 1.6e5), rel=2e-3)


@pytest.mark.parametrize("P_in", [1.14e5, 1.16e5])
def test_near_the_lowest_pressure_a_spinning_motor_runs_on_where_a_resting_one_does_not_start(P_in):
    assert transient.periodic_state(MOIST, P_in)[1] * RPM > 30.0
    assert steady(MOIST, [P_in]).running.all()
    for angle in START_ANGLES:
        run = transient.simulate(MOIST, [Supply(0.0, P_in)], np.array([0.0, 2.0]), transient.rest_state(MOIST, angle))
        assert run.speed_rad_s[-1] == 0.0


@pytest.mark.parametrize("P_in", [1.0e5, 1.05e5, 1.12e5])
def test_below_the_lowest_pressure_both_solvers_stall(P_in):
    found = steady(MOIST, [P_in])
    assert not found.running[0, 0]
    assert found.speed_rad_s[0, 0] == found.flow_m3_s[0, 0] == 0.0
    assert transient.periodic_state(MOIST, P_in)[1] == 0.0
