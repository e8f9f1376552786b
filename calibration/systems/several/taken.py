"""A recording and a test that nobody has taken yet, as if both had been taken."""

from __future__ import annotations

import numpy as np

from calibration.likelihood.compared import Compared
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, starting_at
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.several.comparison import Several
from calibration.systems.several.sharing import SHARED

TEST = "the test"


def with_test(seen: Compared, test: Compared) -> Several:
    """The recordings of one motor, and a test of it behind them.

    Raises TypeError for a system of which no two recordings go together.
    """
    if not isinstance(test, Comparison) or not isinstance(seen, Comparison | Several):
        raise TypeError("no two recordings of this system go together")
    if isinstance(seen, Several):
        return Several([*seen.parts, test], [*seen.names, TEST], seen.problem.sharing)
    return Several([seen, test], ["the recording", TEST], SHARED)


def begun_at(both: Several, seen: Compared, mode: Mode, own: np.ndarray) -> Mode:
    """Where a search in both begins, from what was found without the test.

    `mode`: of the recordings. `own`, shape (k,): the test's nuisances [-].
    """
    modes = [seen.of_part(k, mode) for k in range(len(seen.parts))] if isinstance(seen, Several) else [mode]
    points = [*(one.z[: len(part.problem.nuisances)] for one, part in zip(modes, both.parts, strict=False)), own]
    z = np.zeros(len(both.problem.nuisances))
    for k in reversed(range(len(points))):  # what is shared is as the recordings say
        z[both.problem.at[k]] = points[k]
    for k, before in enumerate(both.problem.before):
        z[both.problem.at[k][list(before)]] = 0.0  # a drift begins at 0
    z = np.append(z, mode.z[len(seen.problem.nuisances) :])
    u = both.noise.joined([*(one.u for one in modes), modes[-1].u])
    return starting_at(Function(both, mode.names), z, u)
