"""Runs in time that a bench makes: spin-up from rest, and coast-down when the supply is shut."""

from __future__ import annotations

import numpy as np

from configs.units import BAR
from model.motor import Motor
from model.operation.performance import NotSettledError, OperatingPointError, check_pressures
from model.solvers.transient import Supply, Transient, periodic_state, simulate

SAMPLE_S = 1e-3
LEAD_S = 0.1  # at speed before the supply is shut, so that a record shows where it started


def spin_up(motor: Motor, P_in: float, duration_s: float, sample_s: float = SAMPLE_S) -> Transient:
    """From rest at angle 0, the supply opened at time 0.

    Returns samples from time 0 on. Raises OperatingPointError when the pressure is out of the model's reach.

    Parameters
    ----------
    duration_s, sample_s : float
        Length of the run and distance of its samples [s].
    """
    check_pressures(motor, [P_in])
    return simulate(motor, [Supply(0.0, P_in)], _times(0.0, duration_s, sample_s))


def coast_down(motor: Motor, P_in: float, duration_s: float, sample_s: float = SAMPLE_S) -> Transient:
    """From the steady state at a pressure, the supply shut and the line vented at time 0.

    Returns samples from 0.1 s before the supply is shut (there at angle 0) on. Raises OperatingPointError when the
    pressure is out of the model's reach or the motor does not run at it, NotSettledError when the speed before does not
    settle.

    Parameters
    ----------
    P_in : float
        Absolute inlet pressure before [Pa].
    duration_s, sample_s : float
        Length of the run after the supply is shut, and distance of the samples [s].
    """
    check_pressures(motor, [P_in])
    try:
        state, mean = periodic_state(motor, P_in)
    except ArithmeticError as error:
        raise NotSettledError(str(error)) from error
    if mean == 0.0:
        raise OperatingPointError(f"the motor stalls at {P_in / BAR:g} bar, so there is nothing to coast down from")
    return simulate(
        motor, [Supply(-LEAD_S, P_in), Supply(0.0, P_in, False)], _times(-LEAD_S, duration_s, sample_s), state
    )


def _times(start_s: float, end_s: float, sample_s: float) -> np.ndarray:
    """Sample times from start to end, the end included [s]."""
    return np.linspace(start_s, end_s, max(2, round((end_s - start_s) / sample_s) + 1))
