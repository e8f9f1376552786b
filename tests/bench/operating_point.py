"""One steady operating point: the batched solver against the published march and against scipy."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy_peer
from results import Row
from timing import one_core, round_robin

from model import layout as at
from model.gas.cylinder import gas_state
from model.motor import Motor
from model.solvers import published, steady
from model.solvers.transient import periodic_state

TABLE_3 = np.array([1.60, 1.70, 1.80, 1.83, 1.85, 1.95, 2.00]) * 1e5  # Pa
NEAR_STALL = np.array([1.2, 1.3, 1.4]) * 1e5  # Pa, where the ripple is large
SCIPY_POINT = 2.0e5  # Pa
SCIPY_START = 30.0  # rad/s
REFERENCE_REFINE = 4
SPREAD = 0.05  # of f_overall over a batch, so that no two sets are the same
MICRO = 1e6
SPEED = "A steady operating point: time against the published march"
SCIPY = "A steady operating point: time against scipy at the same error"
ACCURACY = "A steady operating point: error of the speed"


def rows(motor: Motor, sets: int, rounds: int, tell: Callable[[str], None]) -> list[Row]:
    """Time and error of a point.

    Parameters
    ----------
    motor : Motor
        The motor.
    sets, rounds : int
        Parameter sets of a batch, and rounds of the timing [-].
    tell : callable
        Told what comes next.
    """
    tell("operating point: error against the converged transient")
    errors = speed_errors(motor, TABLE_3)
    near = speed_errors(motor, NEAR_STALL)
    tell("operating point: steady solver and published march in turn")
    timed = against_march(motor, sets, rounds)
    tell("operating point: scipy")
    return [*timed, *_accuracy_rows(errors, near), *against_scipy(motor, timed[0], timed[2])]


def speed_errors(motor: Motor, pressures: np.ndarray) -> tuple[float, float]:
    """Greatest relative error of the mean speed [-]: of the steady solver, and of the march's average.

    Parameters
    ----------
    motor : Motor
        The motor.
    pressures : ndarray, shape (n,)
        Absolute inlet pressures [Pa].
    """
    true = np.array([periodic_state(motor, P, refine=REFERENCE_REFINE)[1] for P in pressures])
    direct = steady.steady(motor, pressures).speed_rad_s[0]
    marched = np.array([published.march(motor, P).mean_speed_rpm for P in pressures]) * math.pi / 30.0
    return float(np.max(np.abs(direct / true - 1.0))), float(np.max(np.abs(marched / true - 1.0)))


def against_march(motor: Motor, sets: int, rounds: int) -> list[Row]:
    """Wall time of a point, batched, on one core and alone, against 9000 compiled steps of the march on one core.

    Parameters
    ----------
    motor : Motor
        The motor.
    sets, rounds : int
        Parameter sets of a batch, and rounds [-].
    """
    parameters, readings = motor.vector(), motor.readings.vector()
    gas = steady.gas_table(motor, TABLE_3)
    spread = np.repeat(parameters[None, :], sets, axis=0)
    spread[:, at.F_OVERALL] *= np.linspace(1.0 - SPREAD, 1.0 + SPREAD, sets)
    batch = spread, np.repeat(TABLE_3[None, :], sets, axis=0)
    marched = [gas_state(parameters, P, readings) for P in TABLE_3]
    history = np.empty((published.STEPS, 6))

    def solve() -> None:
        steady.solve(batch[0], readings, batch[1], gas)

    def solve_on_one_core() -> None:
        with one_core():
            solve()

    def solve_alone() -> None:
        with one_core():
            steady.solve(batch[0][:1], readings, batch[1][:1, -1:], gas[-1:])

    def march() -> None:
        for P, air in zip(TABLE_3, marched, strict=True):
            published.march_kernel(parameters, readings, air, P, published.TIME_STEP, published.STEPS, history)

    found = round_robin({"batch": solve, "one core": solve_on_one_core, "alone": solve_alone, "march": march}, rounds)
    points = sets * TABLE_3.size
    peer = MICRO * found["march"].median / TABLE_3.size
    size = f"{sets} sets x 7 pressures, slopes off"
    fair = "march: 9000 steps, one core; a march on every core is faster by their number, so the fair ratio is below"
    return [
        Row(SPEED, "in a batch, all cores", MICRO * found["batch"].median / points, peer, "µs", ratio_goal=300.0,
            note=f"{size}; {fair}"),
        Row(SPEED, "in a batch, one core", MICRO * found["one core"].median / points, peer, "µs",
            note=f"{size}; the same core for both: the fair ratio"),
        Row(SPEED, "a single point", MICRO * found["alone"].median, peer, "µs", note="2.0 bar, called from Python"),
    ]  # fmt: skip


def against_scipy(motor: Motor, batched: Row, alone: Row) -> list[Row]:
    """Wall time against `solve_ivp` at the tolerance that gives the error of the steady solver.

    Parameters
    ----------
    motor : Motor
        The motor.
    batched, alone : Row
        Of `against_march` [µs].
    """
    true = periodic_state(motor, SCIPY_POINT, refine=REFERENCE_REFINE)[1]
    most = abs(steady.steady(motor, [SCIPY_POINT]).speed_rad_s[0, 0] / true - 1.0)
    p = scipy_peer.problem(motor, SCIPY_POINT)
    found = []
    for method in scipy_peer.METHODS:
        tuned = scipy_peer.tune(
            lambda method, rtol: scipy_peer.steady_speed(p, SCIPY_START, method, rtol),
            lambda speed: abs(float(speed) / true - 1.0),
            most,
            method,
        )
        note = (
            f"2.0 bar, from 30 rad/s until turns repeat to 1e-6; rtol {tuned.rtol:g}: error {tuned.error:.1e}, "
            f"ours {most:.1e}{'' if tuned.reached else ' (not reached)'}"
        )
        seconds = MICRO * tuned.seconds
        found.append(Row(SCIPY, f"a single point, against solve_ivp {method}", alone.ours, seconds, "µs", note=note))
        if method == "LSODA":
            found.append(
                Row(
                    SCIPY,
                    "in a batch, all cores, against solve_ivp LSODA",
                    batched.ours,
                    seconds,
                    "µs",
                    note="as above",
                )
            )
    return found


def _accuracy_rows(errors: tuple[float, float], near: tuple[float, float]) -> list[Row]:
    note = (
        f"peer: the march's average from step 5000; true: the transient at refine {REFERENCE_REFINE}, ripple included"
    )
    return [
        Row(ACCURACY, "greatest at Table 3's seven pressures", *errors, "", most=1e-4, note=note),
        Row(ACCURACY, "greatest at 1.2, 1.3 and 1.4 bar", *near, "", most=1e-4, note="as above"),
    ]
