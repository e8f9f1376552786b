"""A rotor that nothing drives: J domega/dt = -f omega - T, the article's Eq. 25 without gas."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from model.effects import laws
from model.effects.transient import read_with_lag
from model.rigs.state import inertia_factor, state_of

SPEED_SHARE = 0.05  # the torques' tangents are taken anew when the speed has changed by so much of the first,
ANGLE_STEP = 0.3  # rad; ... or, where a torque follows the angle, when the shaft has turned so far
MOST_STEPS = 1000  # between two samples


@dataclass(frozen=True)
class Coast:
    """A coast-down, arrays of shape (n,).

    Attributes
    ----------
    speed, angle : ndarray
        At the samples [rad/s], [rad].
    reading : ndarray
        Speed as the tachometer has it: the mean since the sample before, with its lag [rad/s].
    """

    speed: np.ndarray
    angle: np.ndarray
    reading: np.ndarray


def coast(
    inertia: float, friction: float, time: np.ndarray, first: float, chosen: laws.Chosen, clock: float = 0.0
) -> Coast:
    """Speed and angle at the sample times.

    Between two steps the torques are their tangents, for which the solution is an exponential; it ends at rest.

    Parameters
    ----------
    inertia : float
        J [kg m2].
    friction : float
        Viscous coefficient [N m s].
    time : ndarray, shape (n,)
        Increasing sample times [s].
    first : float
        Speed at the first sample [rad/s].
    chosen : mapping
        Effect id to the values of its parameters.
    clock : float
        Time of the recording's clock at time 0 [s].
    """
    chosen = laws.switched_on(chosen)
    those = laws.members(chosen)
    J = inertia * inertia_factor(chosen)
    turns = any(effect.torque for effect, _ in those)
    follows = any(effect.periodic for effect, _ in those)
    speed, angle = np.zeros(time.size), np.zeros(time.size)
    omega, theta = first, 0.0
    speed[0] = first
    state = state_of(np.zeros(3), friction)
    a, constant = friction, 0.0
    for k in range(1, time.size):
        t, left = float(time[k - 1]), float(time[k] - time[k - 1])
        steps = 0
        while left > 0.0 and omega > 0.0:
            dt = left
            if turns:
                state.omega[:] = (omega, omega + laws.step_of(omega), omega)
                state.angle[:] = theta
                state.time[:] = clock + t + 0.5 * left
                T = laws.sum_of_torques(those, state, np.zeros(3, dtype=bool))
                slope, constant, _ = laws.tangent(T[0], T[1], T[2], omega, 0.0)
                a = friction + slope
                change = abs(constant + a * omega) / J
                dt = min(dt, SPEED_SHARE * abs(first) / max(change, 1e-300))
                dt = min(dt, ANGLE_STEP / omega) if follows else dt
                dt = max(dt, (time[k] - time[k - 1]) / MOST_STEPS)
                dt = min(dt, left)
                if follows:
                    state.angle[:] = theta + 0.5 * omega * dt
                    T = laws.sum_of_torques(those, state, np.zeros(3, dtype=bool))
                    slope, constant, _ = laws.tangent(T[0], T[1], T[2], omega, 0.0)
                    a = friction + slope
            omega, turned, taken = _step(omega, a, constant, J, dt)
            theta += turned
            t += dt
            left -= dt if taken == dt else left  # at rest it stays
            steps += 1
        speed[k], angle[k] = omega, theta
    mean = speed.copy()
    mean[1:] = np.diff(angle) / np.diff(time)
    return Coast(speed, angle, read_with_lag(mean, time, chosen))


def _step(omega: float, a: float, c: float, J: float, dt: float) -> tuple[float, float, float]:
    """Speed after a time, angle turned and time in motion for J domega/dt = -a omega - c."""
    if abs(a) * dt < 1e-9 * J:
        end = omega - c / J * dt
        moving = dt if end >= 0.0 else omega * J / c
        return max(end, 0.0), omega * moving - 0.5 * c / J * moving**2, moving
    end = (omega + c / a) * math.exp(-a * dt / J) - c / a
    moving = dt
    if end < 0.0:
        moving, end = J / a * math.log1p(a * omega / c), 0.0
    return end, (J * (omega - end) - c * moving) / a, moving
