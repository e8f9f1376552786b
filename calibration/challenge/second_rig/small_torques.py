"""What small torques on the shaft do to plateaus, to first order: two marches serve all laws of friction.

A torque that depends on speed, pressure and time alone changes speed and flow of a plateau as a constant torque of its
size there does. A torque that swings once a turn or twice has no mean, and changes neither.
"""

from __future__ import annotations

import numpy as np

from calibration.challenge.second_rig import bench
from calibration.challenge.second_rig.machine.losses import EXTRA, F, drag
from calibration.challenge.second_rig.machine.slots import AT, NAMES

PROBE_NM = 0.02  # either way
FIRST, LAST = AT["dry_nm"], AT["extra_nm"]  # the slots of torques on the shaft lie between these, and f_overall's
ON_SHAFT = np.array([FIRST <= i <= LAST or i == F for i in range(len(NAMES))])


class SmallTorques:
    """Plateaus near those of a base: marched, unless a torque on the shaft is all that is changed."""

    def __init__(self, base: bench.Rig, asked: bench.Plateaus) -> None:
        self.rows, self.lines = bench.figures_of(base, asked)
        self.here = bench.marched(self.rows, self.lines)
        more, less = self.rows.copy(), self.rows.copy()
        more[:, EXTRA] += PROBE_NM
        less[:, EXTRA] -= PROBE_NM
        self.slope = (bench.marched(more, self.lines) - bench.marched(less, self.lines)) / (2.0 * PROBE_NM)

    def __call__(self, rows: np.ndarray, lines: np.ndarray) -> np.ndarray:
        """Speed [rad/s], mass flow [kg/s] and gas torque [N m] of plateaus, shape (n, 3)."""
        changed = np.any(rows != self.rows, axis=0)
        if np.any(changed & ~ON_SHAFT) or not np.array_equal(lines, self.lines):
            return bench.marched(rows, lines)
        more = [
            lost(row, speed, line) - lost(own, speed, line)
            for row, own, speed, line in zip(rows, self.rows, self.here[:, 0], lines, strict=True)
        ]
        return self.here + np.array(more)[:, None] * self.slope


def lost(p: np.ndarray, speed: float, line: float) -> float:
    """Mean torque that is lost on the shaft at a speed [N m]."""
    viscous, dry = drag(p, speed, line - p[AT["ambient_pa"]])
    return float(viscous * speed + dry)
