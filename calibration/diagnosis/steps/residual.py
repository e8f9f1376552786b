"""What sets of effects leave unexplained: the test of the base model, repeated for each set that matters."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.detect import TAIL, detect
from calibration.diagnosis.steps.verdict import RESIDUAL_P, SHARE, SUPERSET_ODDS, is_small
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode
from calibration.likelihood.signatures import signatures
from calibration.unknowns.effects import holds
from calibration.work.side_by_side import SideBySide

TESTED = 3  # sets whose residual is tested; more only where one of these passes
RESIDUAL_DRAWS = (100, 400, 1600, 3200)  # each only where those before it left the threshold in doubt
IN_DOUBT = 2.3  # sds of a p-value's logarithm within which of the threshold's it does not decide
MAY_BE_LEFT = 0.05  # of the mismatch, where that is weighed: with enough rows no model is exact


class Residuals:
    """Tests of what sets leave.

    `p`, `left`: by set: the p-value of what it leaves, and the share of the mismatch that this is, where that is
        weighed [-].
    `mismatch`: what free forces take off the base model's sum of squares [-].
    """

    def __init__(self, comparison: Compared, rng: np.random.Generator, side_by_side: SideBySide) -> None:
        self._comparison, self._rng, self._side_by_side = comparison, rng, side_by_side
        self.p: dict[tuple[str, ...], float] = {}
        self.left: dict[tuple[str, ...], float] = {}
        self.mismatch = 0.0

    def passes(self, one: Candidate) -> bool:
        """Whether a set was tested and leaves nothing, or as little of the mismatch as any model may."""
        return self.weighed().get(one.names, 0.0) >= RESIDUAL_P

    def weighed(self) -> dict[tuple[str, ...], float]:
        """The p-values by set, 1 where as little of the mismatch is left as any model may leave."""
        little = {names for names, left in self.left.items() if left < MAY_BE_LEFT}
        return {names: 1.0 if names in little else p for names, p in self.p.items()}

    def test(self, sets: Sequence[Candidate]) -> None:
        """Test sets that were not tested before."""
        untested = [one for one in sets if one.names not in self.p]
        seeds = [int(seed) for seed in self._rng.integers(2**62, size=len(untested))]
        arguments = [(self._comparison, one.mode, seed) for one, seed in zip(untested, seeds, strict=True)]
        found = self._side_by_side(_residual, arguments)
        for one, (p, gain) in zip(untested, found, strict=True):
            self.p[one.names] = p
            if self.mismatch:
                self.left[one.names] = gain / self.mismatch

    def test_all_that_matter(self, weighed: Sequence[Candidate]) -> None:
        """Test the most probable sets; where one passes, also what is more probable, and parts of it that may do."""
        namable = [one for one in weighed if one.names and not one.refused]
        ranked = namable[:TESTED]
        self.test(ranked[:1])
        if ranked and self.passes(ranked[0]):
            ranked = [one for one in ranked if one.probability > SHARE * ranked[0].probability]
        self.test(ranked)
        if any(self.passes(one) for one in namable):
            self._test_up_to_the_first_that_passes(namable)
        self.test([one for one in [one for one in weighed if one.names][:1] if is_small(one)])

    def _test_up_to_the_first_that_passes(self, namable: Sequence[Candidate]) -> None:
        for one in namable:
            self.test([one])
            if self.passes(one):
                parts = [c for c in namable if holds(c.names) < holds(one.names)]
                self.test([c for c in parts if one.probability < SUPERSET_ODDS * c.probability])
                return


def _residual(comparison: Compared, mode: Mode, seed: int) -> tuple[float, float]:
    found, free = signatures(comparison, mode), comparison.places.forces(mode)
    rng = np.random.default_rng(seed)
    for draws in RESIDUAL_DRAWS:
        left = detect(comparison, mode, found, free, rng, draws)
        if abs(math.log(left.p_value / RESIDUAL_P)) > IN_DOUBT * _sd_of_log_p(draws):
            break
    return left.p_value, left.gain


def _sd_of_log_p(draws: int) -> float:
    """Standard deviation of the logarithm of a p-value at the threshold, by an exponential tail of some draws [-]."""
    return math.log(TAIL / RESIDUAL_P) / math.sqrt(TAIL * draws)
