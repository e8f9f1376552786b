"""What a torque fixed to the shaft's angle does to a steady motor's mean speed: it turns unevenly, and so more slowly.

The slow part of a turn takes longer than the fast part. J d(omega^2/2)/dtheta = -f (omega - omega_0) - T(theta) about
the speed omega_0 of the mean torque, whose slope with the speed is taken to be that of the viscous friction f. The
tachometer reads 2 pi over the time of the turn, and the air per turn hardly changes.
"""

from __future__ import annotations

import numpy as np

from configs.compiled import njit
from model import layout as at
from model.effects import laws
from model.effects.effect import unknown_state

ANGLES = 180  # of a turn, even
TURNS = 8  # most, until the speed repeats
REPEATS = 1e-9  # of itself
MOST_KEPT = 0.95
STANDS = 0.02  # of the mean torque's speed; a rotor that comes so low stays where it is


def around(those: laws.Members) -> np.ndarray:
    """Torque that opposes the motion over a turn of the shaft, its first value again at the end [N m], or one zero.

    `those`: effects that follow the shaft, with their values.
    """
    if not those:
        return np.zeros(1)
    angle = np.linspace(0.0, 2.0 * np.pi, ANGLES + 1)
    state = unknown_state(angle).changed(angle=angle)
    return laws.sum_of_torques(those, state, np.zeros(angle.size, dtype=bool))


def share_of_speed(parameters: np.ndarray, chosen: laws.Chosen, speed: np.ndarray) -> np.ndarray | None:
    """Mean speed over that of the mean torque, shape (n,); 0 where the rotor does not come round.

    None where nothing follows the shaft.

    `chosen`: effect id to the values of its parameters, one value for all rows.
    `speed`, shape (n,): of the mean torque [rad/s].
    """
    torque = around([(effect, values) for effect, values in laws.members(chosen) if effect.periodic])
    if not np.any(torque):
        return None
    return _shares(np.ascontiguousarray(speed), parameters[:, at.F_OVERALL].copy(), parameters[:, at.J].copy(), torque)


@njit(cache=True, nogil=True)
def _shares(speed: np.ndarray, f: np.ndarray, J: np.ndarray, torque: np.ndarray) -> np.ndarray:
    out = np.ones(speed.size)
    steps = (torque.size - 1) // 2
    h = 2.0 * np.pi / steps
    for i in range(speed.size):
        mean = speed[i]
        if not mean > 0.0:
            continue
        E, least = 0.5 * mean * mean, 0.5 * (STANDS * mean) ** 2
        begun_before = ended_before = 0.0
        for turn in range(TURNS):
            begun, slow = E, 0.0
            stands = False
            for k in range(steps):
                slow += 1.0 / np.sqrt(2.0 * E)
                a = -(f[i] * (np.sqrt(2.0 * E) - mean) + torque[2 * k]) / J[i]
                b = -(f[i] * (np.sqrt(2.0 * max(E + 0.5 * h * a, least)) - mean) + torque[2 * k + 1]) / J[i]
                c = -(f[i] * (np.sqrt(2.0 * max(E + 0.5 * h * b, least)) - mean) + torque[2 * k + 1]) / J[i]
                d = -(f[i] * (np.sqrt(2.0 * max(E + h * c, least)) - mean) + torque[2 * k + 2]) / J[i]
                E += h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                stands = bool(least >= E)
                if stands:
                    break
            if stands:
                out[i] = 0.0
                break
            out[i] = steps / slow / mean
            if abs(E - begun) < REPEATS * E:
                break
            ended, kept = E, 0.0  # share of a difference at the start that is left after a turn
            if turn > 0 and begun != begun_before:
                kept = min(max((ended - ended_before) / (begun - begun_before), 0.0), MOST_KEPT)
            begun_before, ended_before = begun, ended
            E = max(begun + (ended - begun) / (1.0 - kept), 2.0 * least)
    return out
