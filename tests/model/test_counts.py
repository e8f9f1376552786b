"""Piston and lobe counts are the motor file's: what it may say, and the solvers with five pistons on three lobes."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest

from configs import ConfigError
from model import geometry, layout
from model.effects import averaged as averaged_runs
from model.effects import effects
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.gas.cylinder import gas_state
from model.motor import Motor, read_motor
from model.operation.performance import operating_points
from model.solvers import averaged, crank_angle, published, transient
from model.solvers.steady import gas_table, solve_rows, steady
from model.solvers.transient import Supply
from tests.five_on_three import text

PUBLISHED = read_motor("ptm3600")
FIVE = read_motor(tomllib.loads(text()))
READINGS = FIVE.readings.vector()
LOBE, PULSE, PULSES = math.radians(120.0), math.radians(24.0), 15


def counted(n_pistons: object = 7, n_lobes: object = 4, **values: float) -> Motor:
    """The article's motor with other counts, and with other values of some parameters."""
    told = PUBLISHED.model_dump() | {"n_pistons": n_pistons, "n_lobes": n_lobes}
    for name, value in values.items():
        told["parameters"][name]["value"] = value
    return read_motor(told)


# The motor file


def test_a_file_that_states_no_counts_has_seven_pistons_on_four_lobes() -> None:
    told = PUBLISHED.model_dump()
    del told["n_pistons"], told["n_lobes"]
    assert read_motor(told) == PUBLISHED
    assert (PUBLISHED.n_pistons, PUBLISHED.n_lobes) == (7, 4)


def test_the_counts_stand_behind_everything_else_in_the_solvers_vector() -> None:
    assert FIVE.vector()[[layout.N_PISTONS, layout.N_LOBES]].tolist() == [5.0, 3.0]
    assert FIVE.vector().shape == (layout.N_VECTOR,)


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ({"n_pistons": 2}, "'n_pistons' should be greater than or equal to 3 (given: 2)"),
        ({"n_pistons": 16}, "'n_pistons' should be less than or equal to 15 (given: 16)"),
        ({"n_lobes": 1}, "'n_lobes' should be greater than or equal to 2 (given: 1)"),
        ({"n_lobes": 9}, "'n_lobes' should be less than or equal to 8 (given: 9)"),
        ({"n_pistons": 5.0}, "'n_pistons' should be a valid integer (given: 5.0)"),
        ({"n_pistons": "5"}, "'n_pistons' should be a valid integer (given: '5')"),
        ({"n_lobes": True}, "'n_lobes' should be a valid integer (given: True)"),
        ({"n_pistons": 8}, "n_pistons: 8 pistons on 4 lobes share the divisor 4, so 4 pistons would move as one"),
        ({"n_pistons": 9, "n_lobes": 6}, "n_pistons: 9 pistons on 6 lobes share the divisor 3, so 3 pistons"),
        ({"n_lobes": 3}, "a cylinder volume that is not positive at 60 deg (-4.37 cm3)"),
        (
            {"n_pistons": 13},
            "parameters.cylinder_diameter: 13 cylinders of 24.03 mm do not fit side by side; each has room for 20.5 mm",
        ),
        (
            {"n_pistons": 15, "cylinder_diameter": 10.0, "roller_diameter": 24.0, "piston_length": 30.0},
            "parameters.roller_diameter: 15 rollers of 24 mm do not fit side by side; each has room for 21",
        ),
        (
            {"n_lobes": 6, "port_lap": 13.6, "piston_length": 30.0},
            "parameters.port_lap: 13.6 deg is outside 0.5..13.5 deg",
        ),
    ],
)
def test_counts_that_make_no_motor_are_refused(counts: dict[str, float], message: str) -> None:
    with pytest.raises(ConfigError) as refused:
        counted(**counts)
    assert message in str(refused.value)


def test_the_lap_has_the_article_s_bounds_up_to_four_lobes() -> None:
    assert [FIVE.quantity("port_lap").high, PUBLISHED.quantity("port_lap").high] == [20.0, 20.0]


# Kinematics


def test_a_stroke_repeats_with_every_lobe_and_is_its_own_mirror_image() -> None:
    psi = np.linspace(0.0, LOBE, 121)
    first = geometry.table(FIVE.vector(), psi)
    for name, values in geometry.table(FIVE.vector(), psi + 2.0 * LOBE).items():
        np.testing.assert_allclose(values, first[name], rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(first["L4_m"], first["L4_m"][::-1], rtol=1e-12)
    assert np.argmin(first["L4_m"]) == 60  # farthest in at half a lobe


def test_the_arcs_join_in_place_and_in_slope() -> None:
    c = np.empty(layout.N_CURVE)
    geometry.curve(FIVE.vector(), c)
    alpha, half = c[layout.ALPHA], 0.5 * LOBE
    assert 0.0 < alpha < half
    joined = geometry.reach_concave(alpha, c[layout.L1], c[layout.L5])
    assert geometry.reach_convex(alpha, c[layout.L2], c[layout.L6], half) == pytest.approx(joined, rel=1e-13)
    steep = geometry.sin_phi_concave(alpha, c[layout.L1], c[layout.L5])
    assert geometry.sin_phi_convex(alpha, c[layout.L2], c[layout.L6], half) == pytest.approx(steep, rel=1e-12)


def test_all_cylinders_together_repeat_after_a_pulse_and_not_before() -> None:
    def whole(theta: float) -> float:
        return float(np.sum(geometry.table(FIVE.vector(), theta + 2.0 * math.pi / 5 * np.arange(5))["V_m3"]))

    angles = np.linspace(0.0, PULSE, 10)
    assert [whole(theta + PULSE) for theta in angles] == pytest.approx([whole(theta) for theta in angles], rel=1e-12)
    assert max(abs(whole(theta + 0.5 * PULSE) / whole(theta) - 1.0) for theta in angles) > 1e-4


def test_a_turn_takes_in_what_five_pistons_sweep_on_three_lobes() -> None:
    """Adiabatic, by hand, as of the article's motor: the filling of the clearance and the stroke between the edges."""
    adiabatic = FIVE.with_readings(air="constant", heat_transfer=False)
    inmost, low, high, outmost = geometry.table(adiabatic.vector(), np.radians([60.0, 68.0, 112.0, 120.0]))["V_m3"]
    stroke = (outmost - inmost) / (0.25 * math.pi * 0.02403**2)
    assert stroke == pytest.approx(67.51e-3 - 41.27e-3, abs=1e-5)  # L1 + L5 less L2 - L6, by hand
    P_s, P_d = 1.99e5, 102_325.0
    filling = (P_s - P_d) * low / (1.4 * 287.055 * 293.15)
    taken = P_s * (high - low) / (287.055 * 293.15)
    found = steady(adiabatic, [2e5])
    turns_s = found.speed_rad_s[0, 0] / (2.0 * math.pi)
    assert found.mass_flow_kg_s[0, 0] == pytest.approx((filling + taken) * PULSES * turns_s, rel=1e-9)


# The solvers against each other, as the tests of the article's motor have them


@pytest.mark.parametrize("torque", ["published", "virtual_work"])
@pytest.mark.parametrize("P_in", [1.16e5, 1.2e5, 1.4e5, 1.6e5, 2e5, 2.485e5])
def test_the_steady_speed_is_where_the_transient_settles(torque: str, P_in: float) -> None:
    """As near as of the article's motor; less where the speed ripples by more than a quarter: the pulses are longer."""
    motor = FIVE.with_readings(torque=torque)
    found = steady(motor, [P_in])
    settled = transient.periodic_state(motor, P_in, refine=2)[1]
    is_rough = found.ripple_rad_s[0, 0] > settled / 4.0
    assert found.speed_rad_s[0, 0] == pytest.approx(settled, rel=1.5e-4 if is_rough else 5e-5)


def turn(motor: Motor, P_in: float, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One turn at constant pressure from angle 0, with nothing passed before: the state after it, its pulses' times."""
    y = y.copy()
    y[crank_angle.THETA] = 0.0
    y[crank_angle.M_IN : crank_angle.P0] = 0.0
    pulse_t, samples = np.full(PULSES, np.nan), np.empty((2, 6))
    parameters, readings = motor.vector(), motor.readings.vector()
    line = (np.array([0.0]), np.array([P_in]), np.array([1.0]))
    gas = gas_state(parameters, P_in, readings)
    transient.integrate(y, 0.0, *line, np.array([0.0, 9.0]), samples, pulse_t, parameters, gas, readings, 4)
    return y, pulse_t


@pytest.mark.parametrize("P_in", [1.3e5, 2e5])
def test_the_steady_torques_and_flow_are_those_of_a_turn_of_the_transient(P_in: float) -> None:
    found = steady(FIVE, [P_in])
    y, pulse_t = turn(FIVE, P_in, transient.periodic_state(FIVE, P_in, refine=4)[0])
    assert y[crank_angle.THETA] == pytest.approx(2.0 * math.pi, abs=PULSE)  # fifteen pulses are a turn
    assert np.diff(pulse_t) == pytest.approx(np.full(PULSES - 1, pulse_t[-1] / PULSES), rel=1e-6)
    assert found.gas_torque_nm[0, 0] == pytest.approx(y[crank_angle.W_GAS] / (2.0 * math.pi), rel=5e-5)
    assert found.roller_torque_nm[0, 0] == pytest.approx(y[crank_angle.W_ROLLER] / (2.0 * math.pi), rel=1e-4)
    assert found.mass_flow_kg_s[0, 0] == pytest.approx(y[crank_angle.M_IN] / pulse_t[-1], rel=5e-5)


@pytest.mark.parametrize("P_in", [1.3e5, 2.4e5])
def test_energy_and_mass_balance_over_a_turn_when_the_torque_is_virtual_work(P_in: float) -> None:
    motor = FIVE.with_readings(torque="virtual_work")
    y, _ = transient.periodic_state(motor, P_in, refine=4)
    for _ in range(4):
        y, _ = turn(motor, P_in, y)
    brought = y[crank_angle.H_IN] - y[crank_angle.H_OUT] + y[crank_angle.Q_IN]
    assert brought == pytest.approx(y[crank_angle.W_GAS], rel=1e-6)
    assert y[crank_angle.M_OUT] == pytest.approx(y[crank_angle.M_IN], rel=1e-6)


@pytest.mark.parametrize("P_in", [1.6e5, 2e5])
def test_the_published_algorithm_settles_at_the_steady_speed_but_for_its_step(P_in: float) -> None:
    settled = published.march(FIVE, P_in, steps=30_000).speed_rad_s[20_000:].mean()
    assert settled == pytest.approx(steady(FIVE, [P_in]).speed_rad_s[0, 0], rel=1.5e-3)


@pytest.mark.parametrize("bar", [1.6, 2.0, 2.4])
def test_the_mean_torque_balances_where_the_steady_solver_says(bar: float) -> None:
    found, parameters, out = steady(FIVE, [bar * 1e5]), FIVE.vector(), np.empty((1, averaged.N_OUT))
    speed = float(found.speed_rad_s[0, 0])
    gas = gas_state(parameters, bar * 1e5, READINGS)
    averaged.torques(parameters, READINGS, gas, bar * 1e5, np.array([speed]), out)
    assert out[0, averaged.NET] == pytest.approx(parameters[layout.F_OVERALL] * speed, rel=2e-3)
    assert out[0, averaged.MASS_FLOW] == pytest.approx(float(found.mass_flow_kg_s[0, 0]), rel=2e-3)
    lost = parameters[layout.F_R] * out[0, averaged.LOAD]
    assert lost == pytest.approx(float(found.roller_torque_nm[0, 0]), rel=1e-2)


@pytest.mark.parametrize("name", ["windage", "load_friction", "inlet_throttling", "once_per_rev_torque"])
def test_an_effect_does_the_same_in_both_solvers(name: str) -> None:
    chosen = {name: {one.name: one.scale for one in effects()[name].parameters}}
    pressure, gas = np.array([2e5]), gas_table(FIVE, [2e5])
    steadily = effect_steady.solve(FIVE.vector()[None, :], READINGS, pressure, gas, chosen, np.zeros(1)).speed[0]
    state = transient.rest_state(FIVE)
    state[crank_angle.OMEGA] = 37.0
    time = np.arange(0.0, 4.0, 0.02)
    run = effect_transient.simulate(FIVE.vector(), READINGS, [Supply(-1.0, 2e5)], time, state, chosen)
    assert (run.angle[-1] - run.angle[-51]) / (time[-1] - time[-51]) == pytest.approx(steadily, rel=1e-3)


def test_a_coast_down_by_the_mean_torque_follows_the_one_with_pulses() -> None:
    time = np.arange(0.0, 0.30, 0.005)
    supply = [Supply(-0.1, 2.0e5, True), Supply(0.05, FIVE.si("ambient_pressure"), False)]
    state = transient.rest_state(FIVE)
    state[crank_angle.OMEGA] = 37.3
    pulses = effect_transient.simulate(FIVE.vector(), READINGS, supply, time, state, {}).reading
    mean = averaged_runs.speeds(FIVE.vector(), READINGS, supply, time, 37.3, {})
    fast = mean > 15.0
    assert fast.sum() > 10
    assert np.max(np.abs(pulses - mean)[fast]) < 0.04 * 37.3


def test_it_starts_at_2_bar_from_every_angle() -> None:
    rested = steady(FIVE, [2e5]).speed_rad_s[0, 0]
    for angle in np.linspace(0.0, PULSE, 13)[:-1]:
        start = transient.rest_state(FIVE, float(angle))
        run = transient.simulate(FIVE, [Supply(0.0, 2e5)], np.array([0.0, 0.9, 1.0]), start)
        assert run.mean_speed_rad_s()[-1] == pytest.approx(rested, rel=0.01)


# Counts beside each other


def test_motors_with_other_counts_do_not_share_tables_in_a_batch() -> None:
    """Lengths and lap alike, as a batch asks: nine pistons between sevens."""
    seven, nine = PUBLISHED.vector(), counted(9).vector()
    rows, pressures = np.array([seven, nine, seven]), np.full(3, 2e5)
    gas = np.repeat(gas_table(PUBLISHED, [2e5]), 3, axis=0)
    found = solve_rows(rows, READINGS, pressures, gas)[:, 0]
    assert found[1] == pytest.approx(steady(counted(9), [2e5]).speed_rad_s[0, 0], rel=1e-9)
    assert found[0] == found[2] == pytest.approx(steady(PUBLISHED, [2e5]).speed_rad_s[0, 0], rel=1e-9)


def test_a_state_of_another_motor_is_refused() -> None:
    with pytest.raises(ValueError, match=r"a state of shape \(23,\) is not of a motor with 5 pistons"):
        transient.simulate(FIVE, [Supply(0.0, 2e5)], np.array([0.0, 0.1]), transient.rest_state(PUBLISHED))


def test_an_operating_point_closes_its_powers() -> None:
    (point,) = operating_points(FIVE, [2e5])
    assert point.speed_rpm == pytest.approx(355.94, abs=0.02)
    assert point.roller_loss_w + point.f_overall_loss_w == pytest.approx(point.indicated_power_w, rel=1e-3)
