"""What a no-load sweep and its coast-down say of dry friction: nothing, until a flywheel is on the shaft."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from model import layout as at
from model.effects import steady, transient
from model.motor import read_motor
from model.solvers.crank_angle import OMEGA
from model.solvers.steady import gas_table
from model.solvers.transient import Supply, rest_state

MOTOR = read_motor("ptm3600")
READINGS = MOTOR.readings.vector()
SPEED_SD, FLOW_SD = 0.4 * 2.0 * np.pi / 60.0, 0.8 / 60e3  # 0.4 rpm [rad/s], 0.8 L/min [m3/s]
DRY = {"coulomb_friction": {"torque_nm": 0.1}}
TOP = 2.0e5  # Pa, from where it coasts
SAMPLE_S = 0.005


def with_friction(roller: float, f_overall: float, inertia: float, lap: float) -> np.ndarray:
    """Parameters of the motor [SI], some of them multiplied by an exponential, and the lap moved [0.01 rad]."""
    found = MOTOR.vector()
    found[[at.F_R, at.F_OVERALL, at.J]] *= np.exp([roller, f_overall, inertia])
    found[at.LAP] += 0.01 * lap
    return found


def plateaus(parameters: np.ndarray, chosen: dict) -> tuple[np.ndarray, np.ndarray]:
    """Speeds [rad/s] and flows [m3/s] from 1.2 to 2.3 bar."""
    pressure = np.linspace(1.2e5, 2.3e5, 12)
    rows = np.tile(parameters, (pressure.size, 1))
    found = steady.solve(rows, READINGS, pressure, gas_table(MOTOR, pressure), chosen, np.zeros(pressure.size))
    return found.speed, found.flow


def coast_down(parameters: np.ndarray, chosen: dict, added: float, angle: float) -> np.ndarray:
    """Speeds every 5 ms from when the line is vented [rad/s], with a flywheel [kg m2], every cylinder's pulse in it."""
    parameters = parameters.copy()
    parameters[at.J] += added
    pressure = np.array([TOP])
    omega = steady.solve(parameters[None], READINGS, pressure, gas_table(MOTOR, pressure), chosen, np.zeros(1)).speed[0]
    start = rest_state(MOTOR, angle - 0.3 * omega)
    start[OMEGA] = omega
    time = np.append(np.arange(-0.3, -0.01, 0.02), SAMPLE_S * np.arange(100))
    supply = [Supply(-0.3, TOP, True), Supply(0.0, TOP, False)]
    return transient.simulate(parameters, READINGS, supply, time, start, chosen).reading[-99:]


def apart(p: np.ndarray, *flywheels: float) -> np.ndarray:
    """Differences of a motor without dry friction from one with it, in an ordinary bench's noise [-].

    Parameters
    ----------
    p : ndarray, shape (5,)
        Logarithms of the factors on roller friction, f_overall and inertia; shifts of the lap [0.01 rad] and of the
        shaft's angle [0.1 rad].
    *flywheels : float
        With which it coasts down, 0 for none [kg m2].
    """
    true, rival = with_friction(0.0, 0.0, 0.0, 0.0), with_friction(*p[:4])
    (speed, flow), (other, other_flow) = plateaus(true, DRY), plateaus(rival, {})
    found = [(other - speed) / SPEED_SD, (other_flow - flow) / FLOW_SD]
    for added in flywheels:
        falling = coast_down(true, DRY, added, 0.0)
        found.append((coast_down(rival, {}, added, 0.1 * p[4]) - falling)[falling > 5.0] / SPEED_SD)
    return np.concatenate(found)


@pytest.mark.long
def test_more_roller_friction_passes_for_dry_friction_until_a_flywheel_is_added() -> None:
    """The rival is a motor as one may be: roller friction is known to a factor of two, the inertia to 10 %.

    All torques may be scaled together, and a part of roller friction hangs on no pressure. A flywheel of known inertia
    cannot be scaled along.
    """
    found = least_squares(apart, [1.1, -0.06, -0.06, 0.0, 0.0], diff_step=1e-4, args=(0.0,))
    roller, f_overall, inertia = np.exp(found.x[:3])
    assert 1.0 < roller < 4.0 and 0.9 < f_overall < 1.0 and 0.9 < inertia < 1.0 and abs(found.x[3]) < 1.75
    assert np.sqrt(np.mean(found.fun**2)) < 0.5
    both = least_squares(apart, found.x, diff_step=1e-4, ftol=1e-2, args=(0.0, 2.0 * MOTOR.si("inertia")))
    assert np.sqrt(np.mean(both.fun**2)) > 4.0
