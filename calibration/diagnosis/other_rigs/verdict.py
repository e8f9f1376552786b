"""What may be said of another rig: the verdict of the other diagnosis, with one doubt more.

Noise of foreign data is known less well than its declared figure says, and the test of what a set leaves hangs on it.
A set that fails only that test, and is nearly as probable as the one that passes, is therefore an alternative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from calibration.diagnosis.steps.candidate import Candidate, Fitted
from calibration.diagnosis.steps.confirm import HeldOut
from calibration.diagnosis.steps.verdict import SUPERSET_ODDS, Verdict, judge


def weigh(
    p_value: float,
    found: Sequence[Candidate[Fitted]],
    residual_p: dict[tuple[str, ...], float],
    held_out: HeldOut | None,
) -> Verdict[Fitted]:
    """What is said."""
    verdict = judge(p_value, found, residual_p, held_out)
    if verdict.kind not in ("named", "confounded") or verdict.chosen is None:
        return verdict
    best = verdict.chosen
    near = [
        c.names
        for c in found
        if c.names
        and not c.refused
        and c.names not in verdict.alternatives
        and not set(best.names) <= set(c.names)
        and c.probability * SUPERSET_ODDS > best.probability
    ]
    kept = {*near, *verdict.alternatives}
    alternatives = tuple(c.names for c in found if c.names in kept)  # the most probable first
    if not near:
        return replace(verdict, alternatives=alternatives)
    return replace(
        verdict,
        kind="confounded",
        alternatives=alternatives,
        set_probability=best.probability,
        why="other sets are as probable or nearly so, though they leave more",
    )
