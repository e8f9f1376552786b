"""What a test will give, by fitting each explanation to the recording and the test's readings together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calibration.diagnosis.next_test.information import SETTLED_NATS
from calibration.likelihood.compared import Compared
from calibration.likelihood.descent import find
from calibration.likelihood.expected import Test
from calibration.likelihood.mode import Mode
from calibration.systems.several.taken import begun_at, with_test
from calibration.work.side_by_side import SideBySide


def refitted(
    seen: Compared, test: Test, rivals: Sequence[Mode], base: Mode, side_by_side: SideBySide
) -> np.ndarray | None:
    """Log density of the test's readings where a rival is true, under each, shape (n, n) [-].

    A search may end short of the best: a rival that the readings seem to rule out is looked for from the base model's
    point too.

    `rivals`, `base`: at their most probable points in the recording.
    Returns None where nothing can be fitted to this test. Raises ArithmeticError when the model gives no reading of
    both together.
    """
    taken = test.taken([*rivals, base]) if test.taken else None
    if taken is None:
        return None
    n = len(rivals)

    def found(pairs: Sequence[tuple[int, int]], starts: Sequence[Mode], at: Sequence[np.ndarray]) -> np.ndarray:
        """Log densities, shape (k,), of the readings where the first of each pair is true, under the second."""
        wanted = [(seen, taken.read[i], rivals[j], starts[j], at[j]) for i, j in pairs]
        return np.array(side_by_side(_log_density, wanted))

    every = [(i, j) for i in range(n) for j in range(n)]
    density = found(every, rivals, taken.at[:n]).reshape(n, n)
    ruled_out = [(i, j) for i, j in every if density[i, i] - density[i, j] > SETTLED_NATS]
    for pair, again in zip(ruled_out, found(ruled_out, [base] * n, [taken.at[n]] * n), strict=True):
        density[pair] = max(density[pair], again)
    return density


def _log_density(seen: Compared, true: Compared, rival: Mode, start: Mode, at: np.ndarray) -> float:
    both = with_test(seen, true)
    return find(both, rival.names, begun_at(both, seen, start, at)).log_evidence - rival.log_evidence
