"""What a test will give, by fitting explanations to the recording and the test's readings together."""

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


def gained(
    seen: Compared,
    test: Test,
    rivals: Sequence[Mode],
    base: Mode,
    pairs: Sequence[tuple[int, int]],
    side_by_side: SideBySide,
) -> np.ndarray | None:
    """What a test's readings add to the log odds of a rival that is true against another one, shape (k,) [-].

    A search may end short of the best: a rival that the readings seem to rule out is looked for from the base model's
    point too.

    `rivals`, `base`: at their most probable points in the recording.
    `pairs`: the rival that is true, and the other one.
    Returns None where nothing can be fitted to this test. Raises ArithmeticError when the model gives no reading of
    both together.
    """
    taken = test.taken([*rivals, base]) if test.taken else None
    if taken is None:
        return None
    starts = [*rivals, base]

    def found(which: Sequence[tuple[int, int]], starting: Sequence[int]) -> np.ndarray:
        """Log densities of the readings where the first of each pair is true, under the second; where each begins."""
        wanted = [
            (seen, taken.read[i], rivals[j], starts[k], taken.at[k]) for (i, j), k in zip(which, starting, strict=True)
        ]
        return np.array(side_by_side(_log_density, wanted))

    true = sorted({i for i, _ in pairs})
    density = found([*((i, i) for i in true), *pairs], [*true, *(j for _, j in pairs)])
    of_true, of_other = density[[true.index(i) for i, _ in pairs]], density[len(true) :]
    far = np.flatnonzero(of_true - of_other > SETTLED_NATS).tolist()
    of_other[far] = np.maximum(of_other[far], found([pairs[one] for one in far], [len(rivals)] * len(far)))
    return of_true - of_other


def _log_density(seen: Compared, true: Compared, rival: Mode, start: Mode, at: np.ndarray) -> float:
    both = with_test(seen, true)
    return find(both, rival.names, begun_at(both, seen, start, at)).log_evidence - rival.log_evidence
