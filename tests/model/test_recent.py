"""Results that are kept for the next who asks."""

from __future__ import annotations

import numpy as np
import pytest

from model import layout as at
from model.effects import averaged
from model.gas.cylinder import gas_state
from model.motor import read_motor
from model.solvers import steady
from model.solvers.recent import Recent
from model.solvers.transient import Supply


def test_what_is_asked_for_again_is_not_made_again() -> None:
    made: list[int] = []
    recent = Recent(2)

    def ask(key: int) -> float:
        return float(recent(key, lambda: np.array([made.append(key) or key]))[0])

    assert [ask(key) for key in (1, 2, 1, 3, 1, 2)] == [1, 2, 1, 3, 1, 2]
    assert made == [1, 2, 3, 2]  # 2 was not asked for longest when 3 came


def test_a_result_is_the_callers_own() -> None:
    recent = Recent(2)
    recent("a", lambda: np.zeros(3))[:] = 1.0
    assert np.array_equal(recent("a", lambda: np.ones(3)), np.zeros(3))


def test_a_solver_sees_that_what_it_is_given_has_changed() -> None:
    motor, pressure = read_motor("ptm3600"), np.array([2.0e5])
    rows, readings, gas = motor.vector()[None, :], motor.readings.vector(), steady.gas_table(motor, pressure)
    first = steady.solve_rows(rows, readings, pressure, gas)
    pressure[0] = 2.2e5
    other = steady.solve_rows(rows, readings, pressure, gas)
    pressure[0] = 2.0e5
    assert other[0, steady.SPEED_OUT] > first[0, steady.SPEED_OUT]
    assert np.array_equal(steady.solve_rows(rows, readings, pressure, gas), first)


def test_rows_that_start_from_states_close_by_end_where_they_would_from_nothing() -> None:
    motor, pressure = read_motor("ptm3600"), np.linspace(1.15e5, 3.0e5, 20)
    rows, readings, gas = (
        np.tile(motor.vector(), (20, 1)),
        motor.readings.vector(),
        steady.gas_table(motor, pressure),
    )
    known = np.zeros((20, steady.N_KNOWN))
    steady.solve_rows(rows, readings, pressure, gas, True, known)
    assert np.all(known[:, steady.KNOWN_T] > 100.0)
    rows[:, at.EXTRA_TORQUE] += 0.05
    rows[3, at.LAP] *= 1.1  # its tables are its own
    begun = known.copy()
    beside = steady.solve_rows(rows, readings, pressure, gas, True, known)
    assert not np.array_equal(known, begun)
    bare = steady.solve_rows(rows, readings, pressure, gas, True, np.zeros_like(known))
    assert np.array_equal(beside[:, steady.STATUS], bare[:, steady.STATUS])
    assert beside[:, : steady.SPEED_SLOPE] == pytest.approx(bare[:, : steady.SPEED_SLOPE], rel=1e-8)
    assert beside == pytest.approx(bare, rel=1e-4)  # near a stall slopes are differences
    for i in (2, 3, 4):
        alone = steady.solve_rows(rows[i : i + 1], readings, pressure[i : i + 1], gas[i : i + 1], True)
        assert alone[0, : steady.SPEED_SLOPE] == pytest.approx(bare[i, : steady.SPEED_SLOPE], rel=1e-6)


def test_the_gas_of_a_line_is_the_callers_own() -> None:
    motor = read_motor("ptm3600")
    first = gas_state(motor.vector(), 2.0e5, motor.readings.vector())
    kept = first.copy()
    first[:] = 0.0
    assert np.array_equal(gas_state(motor.vector(), 2.0e5, motor.readings.vector()), kept)
    assert not np.array_equal(gas_state(motor.vector(), 6.0e5, motor.readings.vector()), kept)


def test_the_mean_course_of_a_run_hangs_on_its_effects_and_its_line() -> None:
    motor, time = read_motor("ptm3600"), np.linspace(0.0, 0.5, 51)

    def speeds(pressure: float, chosen: dict[str, dict[str, float]]) -> np.ndarray:
        line = [Supply(0.0, pressure)]
        return averaged.speeds(motor.vector(), motor.readings.vector(), line, time, 20.0, chosen)

    bare = speeds(2.0e5, {})
    for other in (speeds(2.1e5, {}), speeds(2.0e5, {"windage": {"drag_nm_s2": 1e-4}})):
        assert not np.array_equal(other, bare)
    assert not np.array_equal(
        speeds(2.0e5, {"windage": {"drag_nm_s2": 1e-4}}), speeds(2.0e5, {"windage": {"drag_nm_s2": 2e-4}})
    )
    assert np.array_equal(speeds(2.0e5, {}), bare)
