"""What a recording can tell: from which size on each effect is seen, and told from its nearest rival.

Both in the linear model about the base model, with every nuisance free within its prior. D is the size of what an
effect does to the readings, in standard deviations, with the nuisances' share taken off; rho the correlation with what
a rival does. The right one of the two is chosen with a probability of Phi(D sqrt((1 - rho) / 2)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import linearize
from calibration.likelihood.mode import Mode
from calibration.likelihood.signatures import Signature, project

SEEN = 5.0  # D from which an effect is seen
TOLD = 7.0  # ... from which it is told from rivals, where these are unlike it
SURE = 0.99  # probability of the right choice between the two
LEAST_APART = 1e-6  # of 1 - rho: nearer ones are one


@dataclass(frozen=True)
class Resolved:
    """From which size on a recording shows an effect.

    `seen_from`: size that would be seen [own unit]; None where none that is believable would be.
    `nearest`: the effect whose signature is most like its own; empty where there is no other.
    `told_from`: size that would be told from it [own unit]; None where none that is believable would be.
    """

    effect: str
    parameter: str
    seen_from: float | None
    nearest: str
    rho: float
    told_from: float | None


def resolved(comparison: Compared, mode: Mode, u: np.ndarray, found: Sequence[Signature]) -> list[Resolved]:
    """What a recording can tell of each effect, the one that it sees soonest beside its ordinary size first.

    `u`, shape (k,): the noise [-].
    """
    here = linearize(comparison, mode, u)
    G = here.columns(np.column_stack([one.column for one in found])) if found else np.zeros((here.good.size, 0))
    P = G.T @ project(here.J, G)
    size = np.sqrt(np.maximum(np.diag(P), 0.0))
    made = []
    for name in dict.fromkeys(one.effect for one in found):
        amplitude = comparison.problem.amplitude(name)
        mine = [i for i, one in enumerate(found) if next(iter(one.unknowns)) == (name, amplitude.name)]
        i = mine[len(mine) // 2]  # its shape as it is expected
        unit = (amplitude.expected or amplitude.scale) / (size[i] or math.inf)  # of a size with D = 1
        nearest, rho = _nearest(found, i, P, size)
        wanted = max(TOLD, float(ndtri(SURE)) / math.sqrt(max(1.0 - rho, LEAST_APART) / 2.0))
        seen, told = (_believable(D * unit, amplitude.high) for D in (SEEN, wanted))
        order = SEEN / size[i] if size[i] > 0.0 else math.inf
        made.append((order, Resolved(name, amplitude.name, seen, nearest, rho, told)))
    return [one for _, one in sorted(made, key=lambda pair: pair[0])]


def _nearest(found: Sequence[Signature], i: int, P: np.ndarray, size: np.ndarray) -> tuple[str, float]:
    """The rival most like a signature, with its correlation; of two that cannot be negative it has to be positive."""
    name, rho = "", 0.0
    for j, other in enumerate(found):
        if other.effect == found[i].effect or size[i] * size[j] == 0.0:
            continue
        alike = float(P[i, j] / (size[i] * size[j]))
        alike = alike if found[i].one_sided and other.one_sided else abs(alike)
        if alike > rho:
            name, rho = other.effect, min(alike, 1.0)
    return name, rho


def _believable(value: float, most: float) -> float | None:
    return value if 0.0 < value <= most else None
