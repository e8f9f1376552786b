"""What one recording says of the unknowns of another of the same motor, before that is looked at."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.unknowns.priors import figures_of

OF_THE_MOTOR = ("port_lap", "roller_friction", "f_overall", "inertia")


def of_any_day(problem: Problem) -> set[str]:
    """Nuisances that another day's recording has too: the motor's, and the errors of what has a serial number."""
    found = set(OF_THE_MOTOR)
    for i, one in enumerate(problem.nuisances):
        figures = figures_of(problem.recording, one)
        if figures is not None and figures.serial and problem.run_of(i) is None:
            found.add(one.name)
    return found


def carried(
    seen: Problem, mode: Mode, there: Problem, names: Collection[str] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point and covariance of a recording's unknowns as another one leaves them [-], and which it does not tell.

    `names`: nuisances that are carried over, all if left out; the effects' unknowns always are.
    Returns `z`: the point [-]; `covariance`: of it [-]; `new`: unknowns that have their prior.
    """
    k, size = len(seen.nuisances), len(there.nuisances) + mode.z.size - len(seen.nuisances)
    old = {unknown.name: i for i, unknown in enumerate(seen.nuisances)}
    both = {u.name: i for i, u in enumerate(there.nuisances) if u.name in old and (names is None or u.name in names)}
    z, covariance, new = np.zeros(size), np.eye(size), np.ones(size, dtype=bool)
    of_old = np.array([*(old[name] for name in both), *range(k, mode.z.size)], dtype=int)
    of_new = np.array([*both.values(), *range(len(there.nuisances), size)], dtype=int)
    z[of_new], new[of_new] = mode.z[of_old], False
    covariance[np.ix_(of_new, of_new)] = mode.covariance[np.ix_(of_old, of_old)]
    return z, covariance, new
