"""The curved valley along which the motor's good fits lie."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.function import Function
from calibration.systems.radial_piston.predict.problem import Prediction

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

LEAST_ROTOR = 0.5  # share of the rotor's inertia that a step leaves, however heavy the flywheel
STRAIGHT = 0.002  # of f_overall's prior sd: after so small a correction a second is far below what a sweep can tell


def along_valley(
    comparison: Comparison, f: Function, z: np.ndarray, tried: np.ndarray, here: Prediction, D: np.ndarray
) -> np.ndarray:
    """A step with f_overall set anew, so that the plateaus' speeds do on average what was to be expected of it.

    What a sweep says of f_overall is a hundred times sharper than what it says of port lap or roller friction
    alone: the good fits lie along a curved valley, which a straight step leaves. The inertia, a flywheel's in it, goes
    with f_overall, for their ratio is what a coast-down shows.

    `z`, `tried`, shape (m,): where from, and the end of the straight step [-].
    `D`, shape (n, m): derivatives there [SI].
    """
    n, names = comparison.n, [u.name for u in comparison.problem.nuisances]
    speeds = slice(n, 2 * n)
    known = comparison.known[speeds]
    if not known.any() or "f_overall" not in names:
        return tried
    place, J = names.index("f_overall"), names.index("inertia")
    friction, inertia = comparison.problem.nuisances[place], comparison.problem.nuisances[J]
    flywheel = comparison.problem.recording.added_inertia_kg_m2
    g = np.where(known, D[speeds, place], 0.0)
    if not np.any(g):
        return tried
    expected = (here.speed + D[speeds] @ f.straight(z, tried))[known]
    found = tried.copy()
    for _ in range(2):
        missing = expected - f(found, here, ()).speed[known]
        before = float(friction.value(found[place]))
        by = float(np.clip(g[known] @ missing / (g @ g), -0.05, 0.05))
        found[place] += by
        share = float(friction.value(found[place])) / before
        rotor = float(inertia.value(found[J]))
        found[J] = float(inertia.z(max(share * (rotor + flywheel) - flywheel, LEAST_ROTOR * rotor)))
        if abs(by) < STRAIGHT:
            break
    return f.clip(found) if np.all(np.isfinite(found)) else tried
