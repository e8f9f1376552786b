"""Runs in time by the mean torque, held against the steady solver and against every pulse."""

from __future__ import annotations

import numpy as np
import pytest

from model import layout as at
from model.effects import averaged
from model.effects import transient as effect_transient
from model.gas.cylinder import gas_state
from model.motor import read_motor
from model.solvers import averaged as torque_only
from model.solvers.crank_angle import OMEGA
from model.solvers.steady import steady
from model.solvers.transient import Supply, rest_state

MOTOR = read_motor("ptm3600")
READINGS = MOTOR.readings.vector()
STEP_S = 0.005


def run(parameters: np.ndarray, start: float, chosen: dict, pulses: bool) -> np.ndarray:
    """A coast-down from 2 bar, vented after 50 ms [rad/s]."""
    time = np.arange(0.0, 0.30, STEP_S)
    supply = [Supply(-0.1, 2.0e5, True), Supply(0.05, float(parameters[at.P_A]), False)]
    if not pulses:
        return averaged.speeds(parameters, READINGS, supply, time, start, chosen)
    state = rest_state(MOTOR, 0.0)
    state[OMEGA] = start
    return effect_transient.simulate(parameters, READINGS, supply, time, state, chosen).reading


def changed(index: int, factor: float) -> np.ndarray:
    parameters = MOTOR.vector()
    parameters[index] *= factor
    return parameters


@pytest.mark.parametrize("bar", [1.4, 2.0, 2.4])
def test_the_mean_torque_balances_where_the_steady_solver_says(bar: float) -> None:
    found = steady(MOTOR, [bar * 1e5])
    speed = float(found.speed_rad_s[0, 0])
    parameters, out = MOTOR.vector(), np.empty((1, torque_only.N_OUT))
    gas = gas_state(parameters, bar * 1e5, READINGS)
    torque_only.torques(parameters, READINGS, gas, bar * 1e5, np.array([speed]), out)
    assert out[0, torque_only.NET] == pytest.approx(parameters[at.F_OVERALL] * speed, rel=2e-3)  # no ripple here
    assert out[0, torque_only.MASS_FLOW] == pytest.approx(float(found.mass_flow_kg_s[0, 0]), rel=2e-3)
    lost = parameters[at.F_R] * out[0, torque_only.LOAD]
    assert lost == pytest.approx(float(found.roller_torque_nm[0, 0]), rel=1e-2)


def test_slopes_of_the_torque_are_those_of_its_pressures() -> None:
    parameters = MOTOR.vector()
    gas = gas_state(parameters, 2e5, READINGS)
    found = []
    for drop, rise in ((0.0, 0.0), (500.0, 0.0), (0.0, 500.0)):
        row, out = parameters.copy(), np.empty((1, torque_only.N_OUT))
        row[at.DP_IN] += drop
        row[at.DP_OUT] += rise
        slopes = torque_only.torques(row, READINGS, gas, 2e5, np.array([40.0]), out)
        found.append(float(out[0, torque_only.NET]))
    assert found[1] - found[0] == pytest.approx(-500.0 * slopes[0], rel=0.02)
    assert found[2] - found[0] == pytest.approx(500.0 * slopes[1], rel=0.02)


@pytest.mark.parametrize(
    "chosen",
    [
        {},
        {"windage": {"drag_nm_s2": 1e-4}},
        {"coulomb_friction": {"torque_nm": 0.1}},
        {"inlet_throttling": {"loss_pa_s2_m6": 1.5e9}},
        {"exhaust_back_pressure": {"rise_pa_s2_m6": 5e8}},
    ],
    ids=lambda chosen: "+".join(chosen) or "nothing",
)
def test_a_coast_down_follows_the_one_with_pulses(chosen: dict) -> None:
    with_them, without = run(MOTOR.vector(), 40.0, chosen, True), run(MOTOR.vector(), 40.0, chosen, False)
    fast = without > 15.0  # below, single pulses are as large as what is left of the speed
    assert np.max(np.abs(with_them - without)[fast]) < 0.03 * 40.0


@pytest.mark.parametrize(
    "chosen",
    [{"inlet_throttling": {"loss_pa_s2_m6": 5e9}}, {"exhaust_back_pressure": {"rise_pa_s2_m6": 2e9}}],
    ids="+".join,
)
def test_a_loss_of_pressure_waits_for_nothing(chosen: dict) -> None:
    """At one speed the motor gathers speed alike, however fast it was a moment ago."""
    time, line = np.arange(0.0, 0.5, 0.001), [Supply(-1.0, 2e5)]
    gained = []
    for start in (1.0, 24.0):
        speeds = averaged.speeds(MOTOR.vector(), READINGS, line, time, start, chosen)[1:]
        gained.append(float(np.interp(26.0, speeds, np.gradient(speeds, 0.001))))
    assert gained[0] == pytest.approx(gained[1], rel=2e-3)


@pytest.mark.parametrize("chosen", [{}, {"inlet_throttling": {"loss_pa_s2_m6": 5e9}}], ids=["nothing", "throttled"])
def test_a_spin_up_follows_the_one_with_pulses(chosen: dict) -> None:
    time, line, start = np.arange(0.0, 0.6, 0.005), [Supply(-1.0, 2e5)], rest_state(MOTOR)
    start[OMEGA] = 2.0
    without = averaged.speeds(MOTOR.vector(), READINGS, line, time, 2.0, chosen)
    with_them = effect_transient.simulate(MOTOR.vector(), READINGS, line, time, start, chosen).reading
    assert np.max(np.abs(np.convolve(with_them - without, np.ones(9) / 9, "valid"))) < 0.5


@pytest.mark.parametrize(("index", "name"), [(at.F_OVERALL, "friction"), (at.J, "inertia")])
def test_what_a_change_does_is_the_same_without_the_pulses(index: int, name: str) -> None:
    found = [
        run(changed(index, 1.05), 40.0, {}, pulses) - run(changed(index, 0.95), 40.0, {}, pulses)
        for pulses in (True, False)
    ]
    fast = run(MOTOR.vector(), 40.0, {}, False) > 12.0
    a, b = found[0][fast], found[1][fast]
    assert float(a @ b) / float(b @ b) == pytest.approx(1.0, abs=0.05), name


def test_an_effect_that_is_off_changes_no_bit() -> None:
    off = {"windage": {"drag_nm_s2": 0.0}, "exhaust_back_pressure": {"rise_pa_s2_m6": 0.0}}
    assert np.array_equal(run(MOTOR.vector(), 40.0, off, False), run(MOTOR.vector(), 40.0, {}, False))


def test_the_rotor_stops_and_does_not_turn_back() -> None:
    time = np.arange(0.0, 3.0, STEP_S)
    supply = [Supply(-0.1, 2.0e5, True), Supply(0.0, float(MOTOR.vector()[at.P_A]), False)]
    dry = {"coulomb_friction": {"torque_nm": 0.3}}
    found = averaged.speeds(MOTOR.vector(), READINGS, supply, time, 40.0, dry)
    assert found[-1] == 0.0 and found.min() == 0.0 and np.all(np.diff(found) <= 1e-9)


def test_much_heat_at_little_speed_spoils_no_other_speed() -> None:
    """The passes over the cycle run away there; a diagnosis of a coast-down ended in an error."""
    parameters = changed(at.HEAT_FACTOR, 10.0)
    speeds, out = np.array([0.3, 0.64, 2.2, 6.5, 20.0, 32.0]), np.empty((6, torque_only.N_OUT))
    gas = gas_state(parameters, 1.8e5, READINGS)
    torque_only.torques(parameters, READINGS, gas, 1.8e5, speeds, out)
    alone = np.empty((1, torque_only.N_OUT))
    torque_only.torques(parameters, READINGS, gas, 1.8e5, speeds[-1:], alone)
    assert np.all(np.isfinite(out))
    assert out[-1] == pytest.approx(alone[0], rel=1e-6)
    assert np.all(np.diff(out[:, torque_only.MASS_FLOW]) > 0.0)
    assert np.all(np.isfinite(run(changed(at.HEAT_FACTOR, 10.0), 40.0, {}, False)))


def test_much_heat_spoils_no_start_from_rest() -> None:
    """At the slow speed of a start there is no cycle at all, and that was taken for all speeds."""
    time = np.arange(0.0, 1.0, STEP_S)
    parameters = changed(at.HEAT_FACTOR, 12.0)
    found = averaged.speeds(parameters, READINGS, [Supply(0.0, 2.0e5, True)], time, 0.0, {})
    assert np.all(np.isfinite(found)) and found[-1] > 10.0
