"""The motor in time: spin-up from rest, our integrator against scipy at the same error."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy_peer
from results import Row
from timing import Timing, round_robin

from model.motor import Motor
from model.solvers.transient import Supply, simulate

PRESSURE = 2.0e5  # Pa
REFERENCE_REFINE = 16
MILLI = 1e3
TOPIC = "Spin-up in time"


def rows(motor: Motor, duration_s: float, rounds: int, tell: Callable[[str], None]) -> list[Row]:
    """Time of a spin-up, at the tolerance that gives scipy our error.

    Parameters
    ----------
    motor : Motor
        The motor.
    duration_s : float
        Length of the run [s].
    rounds : int
        Rounds of the timing [-].
    tell : callable
        Told what comes next.
    """
    true = ours(motor, duration_s, REFERENCE_REFINE)
    most = error(ours(motor, duration_s), true)
    p = scipy_peer.problem(motor, PRESSURE)
    found = []
    for method in scipy_peer.METHODS:
        tell(f"spin-up: solve_ivp {method}")
        tuned = scipy_peer.tune(
            lambda method, rtol: scipy_peer.spin_up(p, duration_s, method, rtol),
            lambda end: error(end, true),
            most,
            method,
        )
        timed = _in_turn(motor, p, duration_s, tuned, rounds)
        note = (
            f"{duration_s:g} s at 2.0 bar; rtol {tuned.rtol:g}: error {tuned.error:.1e}, ours {most:.1e}"
            f"{'' if tuned.reached else ' (not reached)'}"
        )
        times = MILLI * timed["ours"].median, MILLI * timed["peer"].median
        goal = 50.0 if method == "LSODA" else None
        found.append(Row(TOPIC, f"against solve_ivp {method}", *times, "ms", ratio_goal=goal, note=note))
    return found


def ours(motor: Motor, duration_s: float, refine: int = 1) -> np.ndarray:
    """Angle and speed at the end, shape (2,) [rad, rad/s].

    Parameters
    ----------
    motor : Motor
        The motor.
    duration_s : float
        Length of the run [s].
    refine : int
        Steps between two edges [-].
    """
    return simulate(motor, [Supply(0.0, PRESSURE)], np.array([0.0, duration_s]), refine=refine).state[:2]


def error(end: np.ndarray, true: np.ndarray) -> float:
    """The greater of the relative errors of angle and speed [-].

    Parameters
    ----------
    end, true : ndarray, shape (2,)
        Angle and speed at the end [rad, rad/s].
    """
    return float(np.max(np.abs(end / true - 1.0)))


def _in_turn(
    motor: Motor, p: scipy_peer.Problem, duration_s: float, tuned: scipy_peer.Tuned, rounds: int
) -> dict[str, Timing]:
    return round_robin(
        {
            "ours": lambda: ours(motor, duration_s),
            "peer": lambda: scipy_peer.spin_up(p, duration_s, tuned.method, tuned.rtol),
        },
        rounds,
    )
