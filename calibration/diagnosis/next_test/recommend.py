"""Which test would part explanations that this recording cannot tell apart.

A test's information is what it will give, as often more as less: how far it moves the log odds between two rivals for
the true one, the mean over the pairs of rivals, each for what it is probable. The other rival is fitted to the readings
of the true one, with all that the recording leaves open of motor, instruments and effects. It has no upper limit: 20
nats and 2000 are both certainty, but the larger forgives more that the model does not know.

All tests are reckoned about what the recording says of each rival. Far from there a rival may suit a test better than
that lets it, so the best test is checked where it may rule one out: such a rival is fitted anew to the recording and
the test's readings together. Then the next best, until the best one has been checked, or as many as are told.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, partial

import numpy as np

from calibration.diagnosis.next_test.information import SETTLED_NATS, Given, densities, given_of, repeats_needed
from calibration.diagnosis.next_test.refitted import gained
from calibration.diagnosis.steps.candidate import Candidate
from calibration.likelihood.compared import Compared
from calibration.likelihood.expected import Capture, Test
from calibration.likelihood.mode import Mode
from calibration.work.side_by_side import SideBySide
from calibration.work.step_clock import Tell

MOST = 4
MOST_APART = 3  # of those that need something which the bench may not have
MOST_RIVALS = 3  # explanations that a test is to tell apart; others may be open too
LEAST_NATS = 0.1


@dataclass(frozen=True)
class NextTest:
    """A test, and what it would tell.

    `separates`: sets of effects; the empty one is the base model.
    `repeats`: that bring odds of 150 to 1 between all that it separates [-]; None: no number does, or it was not asked.
    `needs`: what it needs and the bench may not have; empty otherwise.
    `capture`: what is taken; None where the bench cannot take it by itself.
    `nats_where_true`: by explanation, where that one is true [-].
    """

    test: str
    separates: tuple[tuple[str, ...], ...]
    information_nats: float
    repeats: int | None = None
    needs: str = ""
    capture: Capture | None = None
    nats_where_true: Mapping[tuple[str, ...], float] = field(default_factory=dict)

    @property
    def range_nats(self) -> tuple[float, float] | None:
        """Where the explanation is true for which it gives least, and most [-]; None where that is not known."""
        nats = self.nats_where_true.values()
        return (min(nats), max(nats)) if nats else None


def propose(
    comparison: Compared,
    rivals: Sequence[Candidate],
    base: Mode,
    side_by_side: SideBySide | None = None,
    tell: Tell = lambda _: None,
) -> list[NextTest]:
    """Tests ranked by what they would tell between the most probable rivals, those that need something else last.

    `base`: the base model at its most probable point.
    `side_by_side`: does the refits; this process alone when left out.
    """
    weighed = rivals[:MOST_RIVALS]
    if len(weighed) < 2:
        return []
    modes = [one.mode for one in weighed]
    tests = {test.words: test for test in comparison.tests(modes)}  # of one level the middle one is the highest
    found = {words: one for words, test in tests.items() if (one := weigh(test, weighed))}
    checked: set[str] = set()
    while (best := ranked([one.told for one in found.values()])) and len(checked) < MOST:
        first = found[best[0].test]
        pairs = first.told_for_certain()
        if best[0].test in checked or not pairs:
            break
        checked.add(best[0].test)
        tell(f"next test: check the {best[0].test}")
        with contextlib.suppress(ArithmeticError):  # no reading of both together: what was reckoned stands
            gain = gained(comparison, first.test, modes, base, pairs, side_by_side or SideBySide(0))
            if gain is not None:
                found[best[0].test] = first.checked(pairs, gain)
    return [replace(one, repeats=_repeats(found[one.test])) for one in best]


@dataclass(frozen=True)
class Weighed:
    """A test, and what it will give.

    `reckoned`: `densities` of a number of its repeats.
    `density`, shape (n, n): of the test once, as far as it was checked [-].
    """

    test: Test
    probabilities: Sequence[float]
    names: Sequence[tuple[str, ...]]
    reckoned: Callable[[int], np.ndarray]
    density: np.ndarray

    def given(self, repeats: int) -> Given:
        """What a number of repeats will give: by each pair the share more that was reckoned."""
        once = given_of(self.density, self.probabilities)
        if repeats == 1:
            return once
        first, more = (given_of(self.reckoned(n), self.probabilities).of_pair for n in (1, repeats))
        shares = {pair: max(more[pair] / first[pair], 1.0) if first[pair] > 0.0 else 1.0 for pair in first}
        return once._replace(of_pair={pair: nats * shares[pair] for pair, nats in once.of_pair.items()})

    @cached_property
    def told(self) -> NextTest:
        """What is told of it."""
        once, test = self.given(1), self.test
        separates = tuple(dict.fromkeys(self.names[i] for pair in _told(once.of_pair) for i in pair))
        where_true = {names: round(nats, 2) for names, nats in zip(self.names, once.where_true, strict=True)}
        return NextTest(test.words, separates, round(once.whole, 2), None, test.needs, test.capture, where_true)

    def told_for_certain(self) -> list[tuple[int, int]]:
        """Explanations that are true, each with another that the test would rule out then."""
        gain = np.diag(self.density)[:, None] - self.density
        return [(int(i), int(j)) for i, j in np.argwhere(gain > SETTLED_NATS)]

    def checked(self, pairs: Sequence[tuple[int, int]], gain: np.ndarray) -> Weighed:
        """The same with what refits say of some pairs: a search that ends short of the best says too much, no less.

        `gain`, shape (k,): of `gained` [-].
        """
        density = self.density.copy()
        for (i, j), nats in zip(pairs, gain, strict=True):
            density[i, j] = max(density[i, i] - nats, density[i, j])
        return replace(self, density=density)


def weigh(test: Test, rivals: Sequence[Candidate]) -> Weighed | None:
    """A test, and what it will give; None where it cannot be simulated."""
    try:
        read = test.expected([one.mode for one in rivals])
    except ArithmeticError:
        return None
    if not all(np.isfinite(one.mean).all() and np.isfinite(one.slopes).all() for one in read):
        return None  # a model far from the readings: no test follows from it
    reckoned = cache(partial(densities, read))
    return Weighed(test, [one.probability for one in rivals], [one.names for one in rivals], reckoned, reckoned(1))


def _told(nats: Mapping[tuple[int, int], float]) -> list[tuple[int, int]]:
    return [pair for pair in nats if nats[pair] > LEAST_NATS]


def _repeats(one: Weighed) -> int | None:
    """How often a test has to be made to tell apart for certain what it separates; None where no number does."""
    told = _told(one.given(1).of_pair)
    return repeats_needed(lambda n: min(one.given(n).of_pair[pair] for pair in told)) if told else None


def ranked(found: Sequence[NextTest]) -> list[NextTest]:
    """The few tests that tell most, then those that need something else; without those that tell next to nothing."""
    best = sorted(
        (t for t in found if t.separates and t.information_nats >= LEAST_NATS), key=lambda t: -t.information_nats
    )
    return [t for t in best if not t.needs][:MOST] + [t for t in best if t.needs][:MOST_APART]
