"""Step 6: which test would part explanations that this recording cannot tell apart.

A test's information is what it will give, as often more as less: how far it moves the log odds between two rivals for
the true one, the mean over the pairs of rivals, each for what it is probable. Readings are drawn from the rivals, with
all that the recording leaves open of motor, instruments and effects carried along. It has no upper limit: 20 nats and
2000 are both certainty, but the larger forgives more that the model does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from calibration.diagnosis.next_test.information import given_nats, repeats_needed
from calibration.diagnosis.steps.candidate import Candidate
from calibration.likelihood.compared import Compared
from calibration.likelihood.expected import Capture, Test

MOST = 4
MOST_APART = 2  # of those that need another instrument
MOST_RIVALS = 3
LEAST_NATS = 0.1
NOTHING = "nothing missing"  # the base model, among what a test separates


@dataclass(frozen=True)
class NextTest:
    """A test, and what it would tell.

    Attributes
    ----------
    repeats : int or None
        That bring odds of 150 to 1 between all that it separates [-]; None: no number does, or it was not asked.
    needs : str
        The instrument that it needs and the bench may not have; empty otherwise.
    capture : Capture or None
        What is taken; None where the bench cannot take it by itself.
    """

    test: str
    separates: tuple[str, ...]
    information_nats: float
    repeats: int | None = None
    needs: str = ""
    capture: Capture | None = None


def propose(comparison: Compared, rivals: Sequence[Candidate]) -> list[NextTest]:
    """Tests ranked by what they would tell between the most probable rivals, those with another instrument last."""
    weighed = rivals[:MOST_RIVALS]
    if len(weighed) < 2:
        return []
    modes = [one.mode for one in weighed]
    told = {test.words: test for test in comparison.tests(modes)}  # of one level the middle one is the highest
    found = [weigh(test, weighed) for test in told.values()]
    return ranked([one for one in found if one])


def weigh(test: Test, rivals: Sequence[Candidate]) -> NextTest | None:
    """What a test would tell; None where it cannot be simulated."""
    try:
        read = test.expected([one.mode for one in rivals])
    except ArithmeticError:
        return None
    if not all(np.isfinite([*one.mean, *np.diag(one.shared)]).all() for one in read):
        return None  # a model far from the readings: no test follows from it
    given = partial(given_nats, read, [one.probability for one in rivals])
    whole, nats = given()
    told = [pair for pair in nats if nats[pair] > LEAST_NATS]
    separates = tuple(dict.fromkeys("+".join(rivals[i].names) or NOTHING for pair in told for i in pair))

    def least(repeats: int) -> float:
        each = given(repeats)[1]
        return min(each[pair] for pair in told)

    return NextTest(
        test.words, separates, round(whole, 2), repeats_needed(least) if told else None, test.needs, test.capture
    )


def ranked(found: Sequence[NextTest]) -> list[NextTest]:
    """The few tests that would tell most, then those of other instruments; what tells next to nothing is left out."""
    best = sorted(
        (t for t in found if t.separates and t.information_nats >= LEAST_NATS), key=lambda t: -t.information_nats
    )
    return [t for t in best if not t.needs][:MOST] + [t for t in best if t.needs][:MOST_APART]
