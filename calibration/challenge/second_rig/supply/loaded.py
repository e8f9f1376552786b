"""A line under the motor's draught: where it stands when nothing changes any more."""

from __future__ import annotations

import functools

import numpy as np

from calibration.challenge.second_rig.machine import marches, motor
from calibration.challenge.second_rig.machine.slots import BAR
from calibration.challenge.second_rig.supply import line
from calibration.challenge.second_rig.supply.line import Supply

ROUNDS, SETTLED_PA = 30, 1.0  # in which line and motor agree on the flow
STEP_S = 5e-5  # of the march: the flow to a thousandth
KNOTS_PA = np.array([1.3, 1.6, 2.0, 2.5, 3.6]) * BAR  # the volume flow is nearly a straight line between


def under_load(p: np.ndarray, supply: Supply, target: float, locked: bool = False) -> tuple[float, float]:
    """Pressures of line and regulator [Pa] where the motor takes what they let through."""
    figures, at = supply.figures(), target
    found = (target, target)
    for _ in range(ROUNDS):
        flow = motor.leak_flow(p, at) if locked else draught(p, at)
        found = line.settled(p, figures, target, flow)
        if abs(found[0] - at) < SETTLED_PA:
            break
        at += 0.7 * (found[0] - at)
    return found


def set_for(p: np.ndarray, supply: Supply, pressure: float) -> float:
    """What the regulator is set to where the line stands at a pressure under the motor's draught [Pa]."""
    return line.needed(p, supply.figures(), pressure, draught(p, pressure))


def draught(p: np.ndarray, feed: float) -> float:
    """Mass flow that the motor takes at a pressure [kg/s]."""
    place = min(int(np.searchsorted(KNOTS_PA, feed)), KNOTS_PA.size - 1)
    low_pa, low = p[motor.PA], 0.0
    if place > 0:
        low_pa = KNOTS_PA[place - 1]
        low = _flow_at(p.tobytes(), low_pa) / low_pa
    high = _flow_at(p.tobytes(), KNOTS_PA[place]) / KNOTS_PA[place]
    return feed * float(np.interp(feed, [low_pa, KNOTS_PA[place]], [low, high]))


@functools.lru_cache(maxsize=256)
def _flow_at(figures: bytes, feed: float) -> float:
    """Mass flow at a knot [kg/s]."""
    return float(marches.steady(np.frombuffer(figures), np.array([feed]), STEP_S)[0, 1])
