"""Which test would part explanations that this recording cannot tell apart.

A test's information is what it will give, as often more as less: how far it moves the log odds between two rivals for
the true one, the mean over the pairs of rivals, each for what it is probable. The other rival is fitted to the readings
of the true one, with all that the recording leaves open of motor, instruments and effects. It has no upper limit: 20
nats and 2000 are both certainty, but the larger forgives more that the model does not know.

All tests are reckoned about what the recording says of each rival. Far from there a rival may suit a test better than
that lets it, so the best test is checked where it may promise certainty: each rival is fitted anew to the recording and
the test's readings together. Then the next best, until the best one has been checked, or as many as are told.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from calibration.diagnosis.next_test.information import SETTLED_NATS, Given, given_nats, given_of, repeats_needed
from calibration.diagnosis.next_test.refitted import refitted
from calibration.diagnosis.steps.candidate import Candidate
from calibration.likelihood.compared import Compared
from calibration.likelihood.expected import Capture, Test
from calibration.likelihood.mode import Mode
from calibration.work.side_by_side import SideBySide
from calibration.work.step_clock import Tell

MOST = 4
MOST_APART = 2  # of those that need another instrument
MOST_RIVALS = 3  # explanations that a test is to tell apart; others may be open too
LEAST_NATS = 0.1


@dataclass(frozen=True)
class NextTest:
    """A test, and what it would tell.

    `separates`: sets of effects; the empty one is the base model.
    `repeats`: that bring odds of 150 to 1 between all that it separates [-]; None: no number does, or it was not asked.
    `needs`: the instrument that it needs and the bench may not have; empty otherwise.
    `capture`: what is taken; None where the bench cannot take it by itself.
    `range_nats`: where the rival is true for which it gives least, and most [-].
    """

    test: str
    separates: tuple[tuple[str, ...], ...]
    information_nats: float
    repeats: int | None = None
    needs: str = ""
    capture: Capture | None = None
    range_nats: tuple[float, float] | None = None


def propose(
    comparison: Compared,
    rivals: Sequence[Candidate],
    base: Mode,
    side_by_side: SideBySide | None = None,
    tell: Tell = lambda _: None,
) -> list[NextTest]:
    """Tests ranked by what they would tell between the most probable rivals, those with another instrument last.

    `base`: the base model at its most probable point.
    `side_by_side`: does the refits; this process alone when left out.
    """
    weighed = rivals[:MOST_RIVALS]
    if len(weighed) < 2:
        return []
    modes = [one.mode for one in weighed]
    told = {test.words: test for test in comparison.tests(modes)}  # of one level the middle one is the highest
    found = {words: one for words, test in told.items() if (one := weigh(test, weighed))}
    checked: set[str] = set()
    while (best := ranked([one for one, _ in found.values()])) and len(checked) < MOST:
        first, most = best[0].test, (best[0].range_nats or (0.0, 0.0))[1]
        if first in checked or most < SETTLED_NATS:
            break
        checked.add(first)
        tell(f"next test: check the {first}")
        with contextlib.suppress(ArithmeticError):  # no reading of both together: what was reckoned stands
            density = refitted(comparison, told[first], modes, base, side_by_side or SideBySide(0))
            if density is not None:
                found[first] = _as_refitted(told[first], weighed, found[first][1], density)
    return [replace(one, repeats=_repeats(found[one.test][1])) for one in best]


def _as_refitted(
    test: Test, rivals: Sequence[Candidate], reckoned: Callable[[int], Given], density: np.ndarray
) -> tuple[NextTest, Callable[[int], Given]]:
    """A test by what refits say of it once; with repeats it grows by the share that was reckoned."""
    once = given_of(density, [one.probability for one in rivals])

    def given(repeats: int) -> Given:
        first, more = reckoned(1).of_pair, reckoned(repeats).of_pair
        shares = {pair: max(more[pair] / first[pair], 1.0) if first[pair] > 0.0 else 1.0 for pair in first}
        return once._replace(of_pair={pair: nats * shares[pair] for pair, nats in once.of_pair.items()})

    return _told_of(test, rivals, once), given


def weigh(test: Test, rivals: Sequence[Candidate]) -> tuple[NextTest, Callable[[int], Given]] | None:
    """A test, and what a number of its repeats would give; None where it cannot be simulated."""
    try:
        read = test.expected([one.mode for one in rivals])
    except ArithmeticError:
        return None
    if not all(np.isfinite(one.mean).all() and np.isfinite(one.slopes).all() for one in read):
        return None  # a model far from the readings: no test follows from it
    given = cache(partial(given_nats, read, [one.probability for one in rivals]))
    return _told_of(test, rivals, given(1)), given


def _told_of(test: Test, rivals: Sequence[Candidate], once: Given) -> NextTest:
    separates = tuple(dict.fromkeys(rivals[i].names for pair in _told(once.of_pair) for i in pair))
    least_and_most = (round(once.lowest, 2), round(once.highest, 2))
    return NextTest(test.words, separates, round(once.whole, 2), None, test.needs, test.capture, least_and_most)


def _told(nats: Mapping[tuple[int, int], float]) -> list[tuple[int, int]]:
    return [pair for pair in nats if nats[pair] > LEAST_NATS]


def _repeats(given: Callable[[int], Given]) -> int | None:
    """How often a test has to be made to tell apart for certain what it separates; None where no number does."""
    told = _told(given(1).of_pair)
    return repeats_needed(lambda n: min(given(n).of_pair[pair] for pair in told)) if told else None


def ranked(found: Sequence[NextTest]) -> list[NextTest]:
    """The few tests that would tell most, then those of other instruments; what tells next to nothing is left out."""
    best = sorted(
        (t for t in found if t.separates and t.information_nats >= LEAST_NATS), key=lambda t: -t.information_nats
    )
    return [t for t in best if not t.needs][:MOST] + [t for t in best if t.needs][:MOST_APART]
