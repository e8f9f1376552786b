"""Operating points close to a known solution: what a solution in full says to first order, and it where they stall."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from model import layout as at
from model.effects import effects
from model.effects import steady as effect_steady
from model.effects.laws import Chosen
from model.effects.neighbourhood import Neighbourhood
from model.motor import read_motor
from model.solvers import steady

MOTOR = read_motor("ptm3600")
PRESSURES = np.array([1.2e5, 1.3e5, 1.5e5, 2.0e5, 3.0e5, 5.0e5])
TIME = 40.0 * np.arange(PRESSURES.size)
READINGS, GAS = MOTOR.readings.vector(), steady.gas_table(MOTOR, PRESSURES)
ROWS = np.tile(MOTOR.vector(), (PRESSURES.size, 1))
SETS = [
    ("coulomb_friction",),
    ("stribeck_friction",),
    ("windage",),
    ("load_friction",),
    ("friction_warm_up",),
    ("inlet_throttling",),
    ("exhaust_back_pressure",),
    ("exhaust_back_pressure", "leakage"),
    ("inlet_throttling", "load_friction", "windage"),
    ("exhaust_back_pressure", "inlet_throttling", "wall_heat_exchange"),
]
FOUND = ("speed", "flow")


def ordinary(names: tuple[str, ...], share: float = 1.0) -> dict[str, dict[str, float]]:
    """Effects of their ordinary sizes, times a share."""
    return {
        name: {p.name: p.scale if p.shape else share * p.scale for p in effects()[name].parameters} for name in names
    }


def in_full(chosen: Chosen, rows: np.ndarray = ROWS, pressures: np.ndarray = PRESSURES) -> effect_steady.Points:
    return effect_steady.solve(rows, READINGS, pressures, GAS, chosen, TIME, True)


def around(chosen: Chosen) -> Neighbourhood:
    return Neighbourhood(in_full(chosen).state, ROWS, READINGS, PRESSURES, GAS, chosen, TIME)


def same(one: effect_steady.Points, other: effect_steady.Points, rows: np.ndarray | slice = slice(None)) -> None:
    """That every number of some rows is the same to the bit."""
    for name in (*FOUND, "speed_slope", "flow_slope", "running"):
        assert np.array_equal(getattr(one, name)[rows], getattr(other, name)[rows]), name
    for field in fields(one.state):
        found, expected = getattr(one.state, field.name)[rows], getattr(other.state, field.name)[rows]
        assert np.array_equal(found, expected, equal_nan=True), field.name


def changed(name: str, by: float) -> np.ndarray:
    rows = ROWS.copy()
    rows[:, getattr(at, name)] *= 1.0 + by
    return rows


@pytest.mark.parametrize("names", SETS, ids="+".join)
def test_differences_are_those_of_solutions_in_full(names: tuple[str, ...]) -> None:
    chosen, step = ordinary(names), 1e-4
    near, here = around(chosen), in_full(chosen)
    for rows, pressures, tried in (
        (changed("F_OVERALL", step), PRESSURES, chosen),
        (changed("F_R", step), PRESSURES, chosen),
        (changed("T_IN", step), PRESSURES, chosen),
        (ROWS, PRESSURES * (1.0 + step), chosen),
        (ROWS, PRESSURES, ordinary(names, 1.0 + step)),
    ):
        found, full = near.points(rows, pressures, tried), in_full(tried, rows, pressures)
        assert np.array_equal(found.running, full.running)
        assert found.speed_slope == pytest.approx(full.speed_slope, rel=1e-3)
        assert found.flow_slope == pytest.approx(full.flow_slope, rel=1e-3)
        for one, other, start in (
            *((getattr(found, name), getattr(full, name), getattr(here, name)) for name in FOUND),
            *(
                (getattr(found.state, field.name), getattr(full.state, field.name), getattr(here.state, field.name))
                for field in fields(here.state)
                if field.name != "angle"
            ),
        ):
            assert (
                np.linalg.norm((one - other) / start.max())
                <= 1e-3 * np.linalg.norm((other - start) / start.max()) + 1e-9
            )


def test_a_point_itself_is_found_again() -> None:
    chosen = ordinary(("exhaust_back_pressure", "leakage"))
    here, found = in_full(chosen), around(chosen).points(ROWS, PRESSURES, chosen)
    assert found.speed == pytest.approx(here.speed, rel=1e-14)
    assert found.flow == pytest.approx(here.flow, rel=1e-14)


@pytest.mark.parametrize("other", ["exhaust_back_pressure", "inlet_throttling", "leakage"])
def test_rows_that_stall_are_solved_in_full(other: str) -> None:
    chosen = ordinary((other,)) | {"coulomb_friction": {"torque_nm": 1.0}}
    rows = changed("F_OVERALL", 1e-4)
    found, full = around(chosen).points(rows, PRESSURES, chosen), in_full(chosen, rows)
    stalled = ~full.running
    assert stalled.any() and not stalled.all()
    same(found, full, stalled)
    assert np.all(found.speed[stalled] == 0.0)


def test_a_row_that_comes_to_stall_is_solved_in_full() -> None:
    chosen = {"exhaust_back_pressure": {"rise_pa_s2_m6": 2e9}, "coulomb_friction": {"torque_nm": 0.2}}
    more = chosen | {"coulomb_friction": {"torque_nm": 1.0}}
    assert in_full(chosen).running[0] and not in_full(more).running[0]
    found, full = around(chosen).points(ROWS, PRESSURES, more), in_full(more)
    same(found, full, ~full.running)
    same(found, full, np.abs(full.speed / in_full(chosen).speed - 1.0) > 0.02)  # to first order is not good enough


def test_a_motor_that_starts_is_solved_in_full() -> None:
    more = {"exhaust_back_pressure": {"rise_pa_s2_m6": 2e9}, "coulomb_friction": {"torque_nm": 1.0}}
    less = more | {"coulomb_friction": {"torque_nm": 0.2}}
    found, full = around(more).points(ROWS, PRESSURES, less), in_full(less)
    assert full.running[0] and not in_full(more).running[0]
    same(found, full, ~in_full(more).running)


@pytest.mark.parametrize("names", [(), ("leakage",), ("flow_density_correction", "wall_heat_exchange")], ids="+".join)
def test_where_one_pass_is_the_solution_it_is_that(names: tuple[str, ...]) -> None:
    chosen, rows = ordinary(names), changed("F_OVERALL", 0.01)
    same(around(chosen).points(rows, PRESSURES, chosen), in_full(chosen, rows))


def test_a_point_costs_one_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = ordinary(("exhaust_back_pressure",))
    near, passes = around(chosen), []
    solve_rows = steady.solve_rows
    monkeypatch.setattr(steady, "solve_rows", lambda *given, **kept: (passes.append(1), solve_rows(*given, **kept))[1])
    near.points(changed("F_OVERALL", 1e-4), PRESSURES, chosen)
    assert len(passes) == 1
