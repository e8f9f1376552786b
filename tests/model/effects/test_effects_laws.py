"""What each effect does to speed, flow and readings: sign, growth with its amplitude, limits."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from model import layout as at
from model.effects import effects, laws
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.effect import State
from model.motor import Motor, read_motor
from model.solvers import steady
from model.solvers.transient import Supply, rest_state

MOTOR = read_motor("ptm3600")
PRESSURES = np.array([1.3e5, 1.6e5, 2.0e5, 3.0e5])
STATE = State(
    omega=np.array([1.0, 10.0, 20.0, 40.0, 80.0]),
    angle=np.full(5, np.nan),
    mass_flow=np.array([0.1, 0.5, 1.0, 2.0, 4.0]) * 1e-3,
    pressure=np.array([1.2e5, 1.5e5, 2.0e5, 2.5e5, 3.0e5]),
    temperature=np.full(5, 293.15),
    ambient=np.full(5, 101_325.0),
    gas_constant=np.full(5, 287.05),
    friction=np.full(5, 0.0625),
    load=np.array([2.0, 5.0, 10.0, 15.0, 20.0]),
    time=np.array([0.0, 100.0, 300.0, 900.0, 3000.0]),
)


def law(name: str, kind: str, state: State = STATE, **values: float) -> np.ndarray:
    """What a law of an effect gives."""
    return np.asarray(getattr(effects()[name], kind)(values, state))


def points(chosen: laws.Chosen, motor: Motor = MOTOR, time: float = 0.0) -> effect_steady.Points:
    """Steady points of a motor."""
    rows = np.tile(motor.vector(), (PRESSURES.size, 1))
    gas = steady.gas_table(motor, PRESSURES)
    at_time = np.full(PRESSURES.size, time)
    return effect_steady.solve(rows, motor.readings.vector(), PRESSURES, gas, chosen, at_time)


BARE = points({})


def run(chosen: laws.Chosen, motor: Motor = MOTOR, end: float = 0.7) -> effect_transient.Run:
    """From rest at 2 bar, vented after 0.5 s."""
    spans = [Supply(0.0, 2e5), Supply(0.5, 2e5, False)]
    time = np.arange(0.0, end, 0.02)
    return effect_transient.simulate(motor.vector(), motor.readings.vector(), spans, time, rest_state(motor), chosen)


# In a sweep: does the speed rise (+1) or fall (-1) with the amplitude, and the flow?
SWEEP = {
    "coulomb_friction": ("torque_nm", (0.05, 0.1, 0.2), -1, -1),
    "stribeck_friction": ("torque_nm", (0.05, 0.1, 0.2), -1, -1),
    "windage": ("drag_nm_s2", (5e-5, 1.5e-4, 5e-4), -1, -1),
    "load_friction": ("roller_factor", (0.005, 0.01, 0.03), -1, -1),
    "friction_warm_up": ("share_cold", (-0.3, 0.1, 0.5), -1, -1),
    "inlet_throttling": ("loss_pa_s2_m6", (5e8, 1.5e9, 1e10), -1, -1),
    "exhaust_back_pressure": ("rise_pa_s2_m6", (5e8, 1e9, 5e9), -1, -1),
    "leakage": ("conductance_kg_s_pa2", (5e-15, 2e-14, 1e-13), 0, +1),
    "wall_heat_exchange": ("extra_share", (1.0, 4.0, 12.0), None, None),
}
SHAPES = {"stribeck_friction": {"speed_rad_s": 20.0}, "friction_warm_up": {"time_s": 300.0}}


@pytest.mark.parametrize("name", SWEEP)
def test_its_mark_on_a_sweep_has_one_sign_and_grows_with_its_amplitude(name: str) -> None:
    key, amplitudes, with_speed, with_flow = SWEEP[name]
    found = [points({name: {key: amplitude, **SHAPES.get(name, {})}}) for amplitude in amplitudes]
    for channel, sign in (("speed", with_speed), ("flow", with_flow)):
        values = [getattr(one, channel) for one in found]
        for lower, higher in itertools.pairwise(values):
            if sign == 0:
                assert np.array_equal(lower, higher)
            elif sign is not None:
                assert np.all(sign * (higher - lower) > 0.0)
            else:  # of either sign, but there
                assert np.all(higher != lower)


def test_dry_friction_is_the_same_at_every_speed() -> None:
    assert np.all(law("coulomb_friction", "torque", torque_nm=0.1) == 0.1)


def test_dry_friction_costs_the_speed_that_its_torque_over_the_viscous_friction_is() -> None:
    """To 4 %: the gas's torque changes a little with speed too."""
    lost = BARE.speed - points({"coulomb_friction": {"torque_nm": 0.1}}).speed
    assert lost == pytest.approx(0.1 / MOTOR.si("f_overall"), rel=0.04)


def test_dry_friction_ends_a_coast_down_early() -> None:
    bare, dry = (run(chosen, end=1.5).reading for chosen in ({}, {"coulomb_friction": {"torque_nm": 0.3}}))
    assert np.argmax(dry[26:] < 3.0) < np.argmax(bare[26:] < 3.0)


def test_windage_quadruples_with_twice_the_speed() -> None:
    drag = law("windage", "torque", drag_nm_s2=1e-4)
    assert drag[2:] == pytest.approx(4.0 * drag[1:-1])


def test_windage_makes_a_coast_down_steeper_at_its_start_than_at_its_end() -> None:
    bare, dragged = (run(chosen).reading for chosen in ({}, {"windage": {"drag_nm_s2": 1e-3}}))
    early, late = slice(26, 29), slice(29, 32)
    loss = [-np.diff(np.log(one[part])).mean() for one in (bare, dragged) for part in (early, late)]
    assert loss[2] - loss[0] > loss[3] - loss[1] > 0.0


def test_stribeck_friction_is_whole_at_standstill_and_gone_at_high_speed() -> None:
    slow = replace(STATE, omega=np.zeros(5))
    assert np.all(law("stribeck_friction", "torque", slow, torque_nm=0.2, speed_rad_s=8.0) == 0.2)
    fast = replace(STATE, omega=np.full(5, 80.0))
    assert np.all(law("stribeck_friction", "torque", fast, torque_nm=0.2, speed_rad_s=8.0) < 1e-12)


def test_stribeck_friction_leaves_the_highest_levels_as_they_are() -> None:
    found = points({"stribeck_friction": {"torque_nm": 0.3, "speed_rad_s": 8.0}})
    assert found.speed[-1] == pytest.approx(BARE.speed[-1], rel=1e-9)
    assert found.speed[0] < BARE.speed[0] - 0.5


def test_load_friction_is_the_same_as_a_larger_roller_factor_configured() -> None:
    same = MOTOR.with_values({"roller_friction": MOTOR["roller_friction"].value + 0.02})
    chosen = {"load_friction": {"roller_factor": 0.02}}
    found, configured = points(chosen), points({}, same)
    assert found.speed == pytest.approx(configured.speed, rel=1e-7)
    assert found.flow == pytest.approx(configured.flow, rel=1e-7)
    assert run(chosen).angle == pytest.approx(run({}, same).angle, rel=1e-5, abs=1e-4)


def test_load_friction_works_where_none_is_configured() -> None:
    none, some = MOTOR.with_values({"roller_friction": 0.0}), MOTOR.with_values({"roller_friction": 0.02})
    found = points({"load_friction": {"roller_factor": 0.02}}, none)
    assert found.speed == pytest.approx(points({}, some).speed, rel=1e-7)


def test_warm_up_dies_away_with_its_time_constant() -> None:
    extra = law("friction_warm_up", "torque", replace(STATE, omega=np.ones(5)), share_cold=0.2, time_s=300.0)
    assert extra[0] == pytest.approx(0.2 * 0.0625)
    assert extra[2] == pytest.approx(extra[0] / np.e)
    assert extra[4] < 1e-4 * extra[0]
    warm = points({"friction_warm_up": {"share_cold": 0.5, "time_s": 30.0}}, time=3000.0)
    assert warm.speed == pytest.approx(BARE.speed, rel=1e-7)


@pytest.mark.parametrize("share", [-0.3, 0.25])
def test_cold_friction_is_the_same_as_that_much_viscous_friction_configured(share: float) -> None:
    same = MOTOR.with_values({"f_overall": MOTOR["f_overall"].value * (1.0 + share)})
    chosen = {"friction_warm_up": {"share_cold": share, "time_s": 3600.0}}
    assert points(chosen).speed == pytest.approx(points({}, same).speed, rel=1e-7)
    assert run(chosen).reading == pytest.approx(run({}, same).reading, abs=0.03)


def test_a_torque_of_the_shaft_angle_slows_a_slow_motor_most() -> None:
    lost = BARE.speed - points({"once_per_rev_torque": {"sine_nm": 0.1, "cosine_nm": 0.06}}).speed
    assert np.all(lost > 0.0) and np.all(np.diff(lost) < 0.0)
    assert lost[-1] < 1e-4 * BARE.speed[-1]
    turned = points({"once_per_rev_torque": {"sine_nm": -0.06, "cosine_nm": 0.1}})
    assert turned.speed == pytest.approx(BARE.speed - lost, rel=1e-7)


def test_a_torque_from_a_moment_on_is_none_before_it() -> None:
    late = replace(STATE, time=np.linspace(0.0, 800.0, STATE.omega.size))
    found = law("torque_step", "torque", late, torque_nm=0.1, moment_s=400.0)
    assert np.array_equal(found, np.where(late.time > 400.0, 0.1, 0.0)) and 0.0 < found.mean() < 0.1


def test_throttling_quadruples_with_twice_the_flow_and_is_nothing_without() -> None:
    for name, kind, key in (
        ("inlet_throttling", "inlet_drop", "loss_pa_s2_m6"),
        ("exhaust_back_pressure", "outlet_rise", "rise_pa_s2_m6"),
    ):
        one, two, none = (
            law(name, kind, replace(STATE, mass_flow=share * STATE.mass_flow), **{key: 1e9}) for share in (1, 2, 0)
        )
        assert two == pytest.approx(4.0 * one)
        assert not none.any()
        assert np.all(one > 0.0)


def test_the_same_mass_flow_loses_less_pressure_ahead_of_the_cylinders_where_the_air_is_denser() -> None:
    dense = law("inlet_throttling", "inlet_drop", replace(STATE, pressure=2.0 * STATE.pressure), loss_pa_s2_m6=1e9)
    assert dense == pytest.approx(0.5 * law("inlet_throttling", "inlet_drop", loss_pa_s2_m6=1e9))


def test_throttling_costs_speed_and_flow_most_at_the_highest_level() -> None:
    for chosen in ({"inlet_throttling": {"loss_pa_s2_m6": 2e9}}, {"exhaust_back_pressure": {"rise_pa_s2_m6": 5e8}}):
        found = points(chosen)
        assert np.all(np.diff(BARE.speed - found.speed) > 0.0)
        assert np.all(np.diff(BARE.flow - found.flow) > 0.0)


def test_a_leak_is_nothing_at_ambient_pressure() -> None:
    vented = replace(STATE, pressure=STATE.ambient)
    assert not law("leakage", "leak", vented, conductance_kg_s_pa2=1e-13).any()
    assert np.all(law("leakage", "leak", conductance_kg_s_pa2=1e-13) > 0.0)


def test_a_leak_through_a_hole_is_a_nozzle_s_and_hardly_changes_in_volume() -> None:
    pressure = np.array([1.3, 1.5, 2.0, 2.5, 3.0]) * 101_325.0
    state = replace(STATE, pressure=pressure)
    gap = law("leakage", "leak", state, conductance_kg_s_pa2=2e-14)
    assert law("leakage", "leak", state, conductance_kg_s_pa2=2e-14, exponent=1.0) == pytest.approx(gap, rel=1e-12)
    hole = law("leakage", "leak", state, conductance_kg_s_pa2=2e-14, exponent=0.4)
    assert hole / hole[2] == pytest.approx((gap / gap[2]) ** 0.4, rel=1e-12)
    assert hole[2] == pytest.approx(gap[2], rel=1e-12)  # at twice the ambient pressure they are the same
    # Saint-Venant and Wantzel's nozzle, per unit of area and at one temperature, over the same pressures.
    ratio = np.maximum(state.ambient / pressure, 0.528)
    nozzle = pressure * np.sqrt(ratio ** (2 / 1.4) - ratio ** (2.4 / 1.4))
    assert hole / hole[2] == pytest.approx(nozzle / nozzle[2], rel=0.02)


def test_a_leak_adds_its_flow_at_the_line_s_state_and_leaves_the_speed() -> None:
    found = points({"leakage": {"conductance_kg_s_pa2": 2e-14}})
    assert np.array_equal(found.speed, BARE.speed)
    density = PRESSURES / (steady.gas_table(MOTOR, PRESSURES)[:, 0] * MOTOR.si("inlet_temperature"))
    leak = 2e-14 * (PRESSURES**2 - MOTOR.si("ambient_pressure") ** 2)
    assert found.flow - BARE.flow == pytest.approx(leak / density, rel=1e-9)


def test_a_leak_behind_a_throttle_adds_to_what_the_throttle_takes() -> None:
    throttle = {"inlet_throttling": {"loss_pa_s2_m6": 5e9}}
    both = points(throttle | {"leakage": {"conductance_kg_s_pa2": 5e-14}})
    assert np.all(both.speed < points(throttle).speed)


def test_a_run_lets_in_what_leaks_too() -> None:
    bare, leaky = (run(chosen) for chosen in ({}, {"leakage": {"conductance_kg_s_pa2": 5e-14}}))
    leak = 5e-14 * (2e5**2 - MOTOR.si("ambient_pressure") ** 2)
    extra = leaky.inlet - bare.inlet
    assert extra[25] == pytest.approx(0.5 * leak, rel=1e-9)
    assert extra[-1] == pytest.approx(extra[25], rel=1e-9), "nothing leaks from a vented line"


def test_more_heat_traded_is_the_configured_heat_times_a_factor() -> None:
    """Of -1 the factor is 0: the gas trades no heat, as the article's reading without heat transfer."""
    none = points({"wall_heat_exchange": {"extra_share": -1.0}})
    adiabatic = points({}, MOTOR.with_readings(heat_transfer=False))
    assert none.speed == pytest.approx(adiabatic.speed, rel=1e-9)
    assert none.flow == pytest.approx(adiabatic.flow, rel=1e-9)


def test_heat_traded_changes_the_flow_most_where_the_motor_is_slow() -> None:
    share = np.abs(points({"wall_heat_exchange": {"extra_share": 8.0}}).flow / BARE.flow - 1.0)
    assert np.all(np.diff(share) < 0.0)


def test_another_inertia_is_the_same_as_configured() -> None:
    same = MOTOR.with_values({"inertia": MOTOR["inertia"].value * 1.5})
    chosen = {"inertia": {"share": 0.5}}
    assert np.array_equal(run(chosen).reading, run({}, same).reading)
    assert np.array_equal(points(chosen).speed, points({}, same).speed)


@pytest.mark.parametrize(
    ("name", "channel", "key"),
    [
        ("pressure_gauge_offset", "pressure", "offset_pa"),
        ("flow_offset", "flow", "offset_m3_s"),
        ("pressure_gauge_scale", "pressure", "scale"),
        ("flow_scale", "flow", "scale"),
        ("speed_scale", "speed", "scale"),
    ],
)
def test_a_sensor_s_error_shifts_its_own_channel_alone(name: str, channel: str, key: str) -> None:
    true = np.linspace(1.0, 5.0, 5)
    for amount in (-0.1, 0.2):
        chosen = {name: {key: amount}}
        shift = laws.readings_of(chosen, channel, true, STATE) - true
        assert shift == pytest.approx(amount * (true if key == "scale" else 1.0))
        for other in {"pressure", "flow", "speed"} - {channel}:
            assert np.array_equal(laws.readings_of(chosen, other, true, STATE), true)
        assert np.array_equal(points(chosen).speed, BARE.speed), "the motor does not know of it"


def test_a_rotameter_of_another_density_reads_the_root_of_the_density_ratio() -> None:
    true = np.full(5, 1e-3)
    read = laws.readings_of({"flow_density_correction": {"share": 1.0}}, "flow", true, STATE)
    assert read == pytest.approx(true * np.sqrt(STATE.pressure / 101_325.0))
    at_scale = replace(STATE, pressure=np.full(5, 101_325.0))
    assert laws.readings_of({"flow_density_correction": {"share": 1.0}}, "flow", true, at_scale) == pytest.approx(true)


def test_a_tachometer_s_lag_delays_a_ramp_by_its_time_constant() -> None:
    time = np.arange(0.0, 2.0, 0.001)
    lagged = effect_transient.read_with_lag(30.0 * time, time, {"speed_lag": {"time_s": 0.05}})
    assert lagged[-1] == pytest.approx(30.0 * (time[-1] - 0.05), rel=1e-3)


@pytest.mark.parametrize("tau", [0.003, 0.02, 0.2])
def test_means_behind_a_lag_are_those_of_what_it_shows_however_far_apart_they_are(tau: float) -> None:
    step = 1e-5
    fine = np.arange(100_001) * step
    true = 300.0 * (1.0 - np.exp(-fine / 0.3))
    middle, left = 0.5 * (true[1:] + true[:-1]), np.exp(-step / tau)
    shown = np.append(0.0, lfilter([1.0 - left], [1.0, -left], middle))
    time = np.linspace(0.0, 1.0, 51)

    def means(speed: np.ndarray) -> np.ndarray:
        turned = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step))
        return np.append(speed[0], np.diff(np.interp(time, fine, turned)) / np.diff(time))

    found = effect_transient.lagged(means(true), time, tau)
    assert np.max(np.abs(means(shown) - means(true))) > 2.0
    assert found == pytest.approx(means(shown), abs=0.1)


def test_a_tachometer_s_lag_leaves_the_rotor_and_a_steady_speed_alone() -> None:
    chosen = {"speed_lag": {"time_s": 0.03}}
    bare, lagged = run({}), run(chosen)
    assert np.array_equal(bare.angle, lagged.angle)
    assert np.all(lagged.reading[1:10] < bare.reading[1:10])
    assert lagged.reading[24] == pytest.approx(bare.reading[24], rel=2e-3)


@pytest.mark.parametrize("speed", [0.0, 1e-4, 0.5, 3.0, 40.0])
@pytest.mark.parametrize(
    "chosen",
    [
        {"coulomb_friction": {"torque_nm": 0.1}},
        {"windage": {"drag_nm_s2": 2e-3}},
        {"stribeck_friction": {"torque_nm": 0.1, "speed_rad_s": 8.0}},
        {"friction_warm_up": {"share_cold": 0.5, "time_s": 300.0}},
        {"load_friction": {"roller_factor": 0.05}},
    ],
    ids=lambda c: next(iter(c)),
)
def test_friction_never_drives_and_holds_its_value_at_the_present_speed(chosen: laws.Chosen, speed: float) -> None:
    one = State(*(np.array([1.0]) for _ in range(10)))
    state = replace(one, omega=np.array([speed]), friction=np.array([0.0625]), load=np.array([7.0]))
    row = MOTOR.vector()
    changed = laws.row_parameters(row[None, :], chosen, state)[0]
    slope, constant, roller = (changed[i] - row[i] for i in (at.F_OVERALL, at.EXTRA_TORQUE, at.F_R))
    assert slope * speed + constant + roller * 7.0 == pytest.approx(laws.torque(chosen, state)[0], abs=1e-8)
    if speed < laws.MAY_STOP:
        assert constant >= 0.0, "a rotor that comes to rest would start by itself"


def test_a_torque_that_drives_at_low_speed_is_a_constant_and_no_negative_friction() -> None:
    one = State(*(np.array([1.0]) for _ in range(10)))
    state = replace(one, omega=np.array([0.01]), angle=np.array([-np.pi / 2.0]))
    row = MOTOR.vector()
    chosen = {"once_per_rev_torque": {"sine_nm": 0.2, "cosine_nm": 0.0}}
    changed = laws.row_parameters(row[None, :], chosen, state)[0]
    assert changed[at.F_OVERALL] == row[at.F_OVERALL]
    assert changed[at.EXTRA_TORQUE] == pytest.approx(-0.2)
    at_rest = laws.row_parameters(row[None, :], chosen, replace(state, omega=np.zeros(1)))[0]
    assert at_rest[at.EXTRA_TORQUE] == 0.0


def test_a_torque_of_the_shaft_angle_helps_turning_back_where_it_opposes_turning_forward() -> None:
    state = replace(STATE, angle=np.full(5, np.pi / 2.0))
    chosen = {"once_per_rev_torque": {"sine_nm": 0.2, "cosine_nm": 0.0}}
    forward, back = laws.torque(chosen, state), laws.torque(chosen, replace(state, omega=-STATE.omega))
    assert forward == pytest.approx(0.2)
    assert back == pytest.approx(-0.2)
