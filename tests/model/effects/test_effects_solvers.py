"""Effects in the two solvers: switched off they change no bit, switched on both solvers say the same."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from model import layout as at
from model.effects import effects, laws
from model.effects import steady as effect_steady
from model.effects import transient as effect_transient
from model.effects.laws import Chosen
from model.motor import Motor, read_motor
from model.solvers import steady, transient
from model.solvers.crank_angle import OMEGA
from model.solvers.transient import Supply, rest_state

PRESSURES = np.array([1.2e5, 1.5e5, 2.0e5, 3.0e5, 5.0e5])
ORDINARY = {
    name: {parameter.name: parameter.scale for parameter in effect.parameters} for name, effect in effects().items()
}
OFF = {
    name: {parameter.name: parameter.scale if parameter.shape else 0.0 for parameter in effect.parameters}
    for name, effect in effects().items()
}
MOTOR = read_motor("ptm3600")


def points(chosen: Chosen, motor: Motor = MOTOR, pressures: np.ndarray = PRESSURES) -> effect_steady.Points:
    """Steady points of a motor, each at time 0."""
    rows = np.tile(motor.vector(), (pressures.size, 1))
    gas = steady.gas_table(motor, pressures)
    return effect_steady.solve(rows, motor.readings.vector(), pressures, gas, chosen, np.zeros(pressures.size), True)


def run(
    chosen: Chosen, motor: Motor = MOTOR, pressure: float = 2e5, end: float = 0.6, dt: float = 0.02, start: float = 30.0
) -> effect_transient.Run:
    """A run at constant pressure, then vented after 0.4 s where it lasts no longer than a second."""
    state = rest_state(motor)
    state[OMEGA] = start
    spans = [Supply(-1.0, pressure)]
    if end <= 1.0:
        spans.append(Supply(0.4, pressure, False))
    time = np.arange(0.0, end + 0.5 * dt, dt)
    return effect_transient.simulate(motor.vector(), motor.readings.vector(), spans, time, state, chosen)


def settled(chosen: Chosen, pressure: float, start: float = 40.0) -> tuple[float, float]:
    """Mean speed [rad/s] and volume flow [m3/s] at the end of a long run at constant pressure."""
    found = run(chosen, pressure=pressure, end=6.0, start=start)
    mass_flow = (found.inlet[-1] - found.inlet[-101]) / (found.time[-1] - found.time[-101])
    speed = (found.angle[-1] - found.angle[-101]) / (found.time[-1] - found.time[-101])
    gas = steady.gas_table(MOTOR, [pressure])[0]
    return float(speed), float(mass_flow * gas[at.GAS_R] * MOTOR.si("inlet_temperature") / pressure)


@pytest.mark.parametrize("name", [name for name, effect in effects().items() if not effect.transient_only])
def test_a_value_a_row_gives_each_row_what_that_value_alone_gives_it(name: str) -> None:
    other = {p.name: 0.7 * p.scale if p.low <= 0.7 * p.scale else p.scale for p in effects()[name].parameters}
    sizes = [ORDINARY[name], other, OFF[name]]
    rows = {key: np.repeat([one[key] for one in sizes], PRESSURES.size) for key in ORDINARY[name]}
    together = points({name: rows}, pressures=np.tile(PRESSURES, len(sizes)))
    for i, one in enumerate(sizes):
        alone, there = points({name: one}), slice(i * PRESSURES.size, (i + 1) * PRESSURES.size)
        for key in ("speed", "flow", "running"):
            np.testing.assert_allclose(getattr(together, key)[there], getattr(alone, key), rtol=1e-7)


@pytest.mark.parametrize("chosen", [{}, *({name: OFF[name]} for name in OFF), OFF], ids=lambda c: "+".join(c) or "none")
def test_switched_off_the_steady_solver_is_the_bare_one_to_the_bit(chosen: Chosen) -> None:
    found = points(chosen)
    for i, P in enumerate(PRESSURES):
        pressure = PRESSURES[i : i + 1]
        gas = steady.gas_table(MOTOR, PRESSURES)[i : i + 1]
        bare = steady.solve(MOTOR.vector()[None, :], MOTOR.readings.vector(), pressure[None, :], gas, True)[0, 0]
        assert found.speed[i] == bare[steady.SPEED_OUT]
        assert found.flow[i] == bare[steady.VOLUME_FLOW]
        assert found.speed_slope[i] == bare[steady.SPEED_SLOPE]
        assert found.flow_slope[i] == bare[steady.FLOW_SLOPE]
        assert found.state.pressure[i] == P


@pytest.mark.parametrize("chosen", [{}, *({name: OFF[name]} for name in OFF), OFF], ids=lambda c: "+".join(c) or "none")
def test_switched_off_a_run_is_the_bare_one_to_the_bit(chosen: Chosen) -> None:
    found = run(chosen)
    start = rest_state(MOTOR)
    start[OMEGA] = 30.0
    bare = transient.simulate(MOTOR, [Supply(-1.0, 2e5), Supply(0.4, 2e5, False)], found.time, start)
    assert np.array_equal(found.angle, bare.angle_rad)
    assert np.array_equal(found.speed, bare.speed_rad_s)
    assert np.array_equal(found.reading, bare.mean_speed_rad_s())
    assert np.array_equal(found.inlet, bare.inlet_kg)


IN_BOTH = [
    {"coulomb_friction": {"torque_nm": 0.3}},
    {"stribeck_friction": {"torque_nm": 1.0, "speed_rad_s": 8.0}},
    {"torque_step": {"torque_nm": 0.3, "moment_s": -1.0}},
    {"windage": {"drag_nm_s2": 1e-3}},
    {"load_friction": {"roller_factor": 0.05}},
    {"friction_warm_up": {"share_cold": 0.5, "time_s": 3600.0}},
    {"friction_warm_up": {"share_cold": -0.4, "time_s": 3600.0}},
    {"inlet_throttling": {"loss_pa_s2_m6": 2e10}},
    {"exhaust_back_pressure": {"rise_pa_s2_m6": 1e10}},
    {"leakage": {"conductance_kg_s_pa2": 5e-14}},
    {"wall_heat_exchange": {"extra_share": 8.0}},
    {
        "coulomb_friction": {"torque_nm": 0.2},
        "windage": {"drag_nm_s2": 5e-4},
        "load_friction": {"roller_factor": 0.02},
        "inlet_throttling": {"loss_pa_s2_m6": 5e9},
        "exhaust_back_pressure": {"rise_pa_s2_m6": 1e9},
        "leakage": {"conductance_kg_s_pa2": 2e-14},
    },
]


@pytest.mark.parametrize("chosen", IN_BOTH, ids=lambda c: "+".join(c))
def test_a_long_run_settles_where_the_steady_solver_says(chosen: Chosen) -> None:
    """To 1e-3 in speed and flow: what a sample's averaging over a part of a pulse leaves."""
    found = points(chosen, pressures=np.array([2.5e5]))
    speed, flow = settled(chosen, 2.5e5)
    assert found.running[0]
    assert speed == pytest.approx(found.speed[0], rel=1e-3)
    assert flow == pytest.approx(found.flow[0], rel=1e-3)


@pytest.mark.parametrize(("share", "bar_abs"), [(10.0, 1.185), (20.0, 1.22), (30.0, 1.3)])
def test_much_heat_from_the_wall_stalls_no_slow_motor(share: float, bar_abs: float) -> None:
    chosen = {"wall_heat_exchange": {"extra_share": share}}
    pressure = np.array([bar_abs * 1e5])
    found = points(chosen, pressures=pressure)
    speed, flow = settled(chosen, pressure[0])
    assert found.running[0]
    assert speed == pytest.approx(found.speed[0], rel=2e-3)
    assert flow == pytest.approx(found.flow[0], rel=2e-3)


def test_a_state_is_found_for_any_heat_that_an_engineer_would_believe() -> None:
    rng = np.random.default_rng(5)
    pressure = 1e5 * rng.uniform(1.05, 4.0, 2000)
    rows = np.repeat(MOTOR.vector()[None, :], pressure.size, axis=0)
    rows[:, at.HEAT_FACTOR] = 1.0 + rng.uniform(0.0, 30.0, pressure.size)
    rows[:, at.F_OVERALL] *= np.exp(rng.uniform(-1.0, 1.0, pressure.size))
    out = steady.solve_rows(rows, MOTOR.readings.vector(), pressure, steady.gas_table(MOTOR, pressure))
    assert not np.any(out[:, steady.STATUS] == steady.NOT_CONVERGED)


def test_an_unbalance_that_a_motor_just_cannot_lift_is_one_that_stands() -> None:
    pressures = 1e5 * np.arange(1.1, 1.6, 0.02)
    found = points({"once_per_rev_torque": {"sine_nm": -4.0 / 3.0, "cosine_nm": 4.0 / 3.0}}, pressures=pressures)
    assert np.array_equal(found.speed > 0.0, found.running)
    assert not found.running[0]


@pytest.mark.parametrize("torque_nm", [0.1, 0.3])
def test_a_torque_fixed_to_the_shaft_slows_a_steady_motor(torque_nm: float) -> None:
    """It turns unevenly, and the slow part of a turn takes longer."""
    chosen = {"once_per_rev_torque": {"sine_nm": torque_nm, "cosine_nm": 0.0}}
    pressure = np.array([1.4e5])
    even, uneven = points({}, pressures=pressure), points(chosen, pressures=pressure)
    found = run(chosen, pressure=pressure[0], end=8.0, start=even.speed[0])
    turns = 2.0 * np.pi * (found.angle[-1] // (2.0 * np.pi) - np.array([10.0, 0.0]))
    took = float(np.diff(np.interp(turns, found.angle, found.time))[0])
    lost = even.speed[0] - 20.0 * np.pi / took
    assert even.speed[0] - uneven.speed[0] == pytest.approx(lost, rel=0.1)
    # As sharply as with effects, which the bare solver leaves to those who ask for it.
    gas, start = steady.gas_table(MOTOR, pressure), np.zeros((1, steady.N_KNOWN))
    sharp = steady.solve_rows(MOTOR.vector()[None, :], MOTOR.readings.vector(), pressure, gas, True, start)[0]
    share = uneven.speed[0] / sharp[steady.SPEED_OUT]
    assert uneven.flow[0] / sharp[steady.VOLUME_FLOW] == pytest.approx(share, rel=1e-9)


def test_a_motor_that_cannot_lift_its_unbalance_stands() -> None:
    heavy = points({"once_per_rev_torque": {"sine_nm": 1.5, "cosine_nm": 0.0}}, pressures=np.array([1.2e5, 2.5e5]))
    assert heavy.running.tolist() == [False, True]
    assert heavy.speed[0] == 0.0


@pytest.mark.parametrize("dt", [0.005, 0.05])
def test_a_run_does_not_depend_on_how_often_it_is_sampled(dt: float) -> None:
    chosen = {name: ORDINARY[name] for name in ("windage", "inlet_throttling", "once_per_rev_torque", "load_friction")}
    often, run_dt = run(chosen, dt=0.001), run(chosen, dt=dt)
    every = round(dt / 0.001)
    before_rest = run_dt.time <= 0.45
    swing = np.abs(run_dt.angle - often.angle[::every][: run_dt.angle.size])[before_rest]
    assert swing.max() < 5e-3


def test_samples_between_two_looks_at_the_laws_are_the_same_run() -> None:
    chosen = {"coulomb_friction": {"torque_nm": 0.2}}
    state = rest_state(MOTOR)
    state[OMEGA] = 30.0
    time = np.arange(0.0, 1.0, 0.01)
    one, three = (
        effect_transient.simulate(
            MOTOR.vector(), MOTOR.readings.vector(), [Supply(-1.0, 2e5)], time, state, chosen, stride=stride
        )
        for stride in (1, 3)
    )
    assert three.reading == pytest.approx(one.reading, abs=1e-3)


def test_two_effects_give_the_same_to_the_bit_in_either_order() -> None:
    names = [name for name in effects() if name != "bad_reading"]
    for first, second in itertools.combinations(names, 2):
        there, back = {n: ORDINARY[n] for n in (first, second)}, {n: ORDINARY[n] for n in (second, first)}
        one, other = (points(chosen, pressures=np.array([2e5])) for chosen in (there, back))
        assert one.speed[0] == other.speed[0] and one.flow[0] == other.flow[0], (first, second)
        for channel in ("pressure", "flow", "speed"):
            true = np.array([2e5])
            assert laws.readings_of(there, channel, true, one.state) == laws.readings_of(back, channel, true, one.state)


def test_two_effects_give_the_same_run_to_the_bit_in_either_order() -> None:
    names = ("windage", "coulomb_friction", "exhaust_back_pressure", "inlet_throttling", "speed_lag", "inertia")
    one, other = (run({name: ORDINARY[name] for name in order}) for order in (names, names[::-1]))
    assert np.array_equal(one.reading, other.reading)


@pytest.mark.parametrize("coefficient", [1e8, 1e10, 2e10, 1e12])
def test_throttling_of_any_strength_is_solved_with_the_cycle(coefficient: float) -> None:
    """The speed is that of a motor whose configured pressure loss is what the law gives at the flow found."""
    chosen = {"inlet_throttling": {"loss_pa_s2_m6": coefficient}}
    found = points(chosen)
    assert found.running.all()
    for i, P in enumerate(PRESSURES):
        drop = effects()["inlet_throttling"].inlet_drop(chosen["inlet_throttling"], found.state)[i]  # type: ignore[misc]
        if drop + MOTOR.si("inlet_pressure_drop") > 1e5:
            continue  # no motor may be configured with more
        same = MOTOR.with_values({"inlet_pressure_drop": MOTOR["inlet_pressure_drop"].value + drop})
        bare = points({}, same, PRESSURES[i : i + 1])
        assert found.speed[i] == pytest.approx(bare.speed[0], rel=1e-6), P
        assert found.flow[i] == pytest.approx(bare.flow[0], rel=1e-6), P


def test_a_motor_that_an_effect_stalls_is_reported_as_not_running() -> None:
    found = points({"coulomb_friction": {"torque_nm": 1.0}})
    assert found.running.tolist() == [False, True, True, True, True]
    assert found.speed[0] == 0.0 and found.flow[0] == 0.0
    speed, _ = settled({"coulomb_friction": {"torque_nm": 1.0}}, PRESSURES[0])
    assert speed == 0.0


def test_a_stalled_motor_still_leaks() -> None:
    leak = {"leakage": {"conductance_kg_s_pa2": 2e-14}}
    alone = points(leak).flow - points({}).flow
    found = points({"coulomb_friction": {"torque_nm": 1.0}} | leak)
    assert found.flow[0] == pytest.approx(alone[0], rel=1e-9)


def test_a_motor_that_runs_on_though_it_would_not_start_is_found_running() -> None:
    """Stribeck friction as large as the gas's torque: at rest it holds, at speed it is gone."""
    chosen = {"stribeck_friction": {"torque_nm": 1.0, "speed_rad_s": 8.0}}
    found = points(chosen, pressures=np.array([1.5e5]))
    assert found.running[0]
    speed, _ = settled(chosen, 1.5e5, start=25.0)
    assert found.speed[0] == pytest.approx(speed, rel=1e-3)


def test_passes_that_do_not_agree_are_not_running_rather_than_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effect_steady, "MOST_PASSES", 2)
    found = points({"inlet_throttling": {"loss_pa_s2_m6": 2e10}})
    assert not found.running.any()
    assert not found.speed.any()


def test_an_imbalance_swings_the_speed_once_a_turn_and_keeps_its_mean() -> None:
    chosen = {"once_per_rev_torque": {"sine_nm": 0.5, "cosine_nm": 0.0}}
    bare, swung = (run(c, end=6.0, dt=0.01) for c in ({}, chosen))
    late = slice(300, 600)
    swing = swung.reading[late] - np.mean(swung.reading[late])
    amplitude = 2.0 * np.hypot(np.mean(swing * np.sin(swung.angle[late])), np.mean(swing * np.cos(swung.angle[late])))
    speed = np.mean(swung.reading[late])
    J, f = MOTOR.si("inertia"), MOTOR.si("f_overall")
    assert amplitude == pytest.approx(0.5 / np.hypot(J * speed, f), rel=0.05)
    assert speed == pytest.approx(np.mean(bare.reading[late]), rel=5e-3)


def test_an_imbalance_does_not_start_a_vented_motor() -> None:
    chosen = {"once_per_rev_torque": {"sine_nm": -0.2, "cosine_nm": -0.2}}
    found = effect_transient.simulate(
        MOTOR.vector(), MOTOR.readings.vector(), [], np.linspace(0.0, 0.5, 26), rest_state(MOTOR), chosen
    )
    assert not found.angle.any()


@pytest.mark.parametrize("name", ["coulomb_friction", "windage", "stribeck_friction", "friction_warm_up"])
def test_friction_takes_energy_whichever_way_the_rotor_turns(name: str) -> None:
    """A vented rotor turning back is slowed as one turning forward."""
    slowed = []
    for sense in (1.0, -1.0):
        ends = []
        for chosen in ({}, {name: {key: 2.0 * value for key, value in ORDINARY[name].items()}}):
            state = rest_state(MOTOR)
            state[OMEGA] = 12.0 * sense
            found = effect_transient.simulate(
                MOTOR.vector(), MOTOR.readings.vector(), [], np.linspace(0.0, 0.02, 11), state, chosen
            )
            ends.append(abs(found.speed[-1]))
        slowed.append(ends[0] - ends[1])
    assert slowed[0] > 0.0 and slowed[1] > 0.0
    assert slowed[1] == pytest.approx(slowed[0], rel=0.1)


def test_a_coast_down_with_any_friction_ends_at_rest() -> None:
    for name in ("coulomb_friction", "windage", "stribeck_friction", "friction_warm_up", "load_friction"):
        found = run({name: ORDINARY[name]}, end=1.0)
        assert abs(found.reading[-1]) < 1.0, name
