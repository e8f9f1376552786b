"""The search: single effects that the linear model finds promising are refitted, then pairs grown from them.

An effect that hides from the linear model is refitted whatever that says of it, from its ordinary size too: alone, and
with runs in time beside the best of the others.

Sets are refitted side by side; what one knows of those before it does not hang on the number of processes, so neither
does the result. What is far behind the best set so far is not searched to its end.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.name import WORTH, screen, weigh
from calibration.likelihood.compared import Compared, Problem
from calibration.likelihood.descent import find
from calibration.likelihood.mode import Mode, cost_of
from calibration.likelihood.signatures import Signature, signatures
from calibration.unknowns.effects import is_size, unchanged
from calibration.work.side_by_side import SideBySide
from calibration.work.step_clock import Tell

SINGLES = 6  # most single effects refitted at first
# Nats that an effect may promise less than the best single one gained, to be refitted too: it may be a hundredth as
# probable, and the linear model is off by two.
BESIDE = 6.6
PAIRS = 4  # most pairs refitted
SEEDS = 2  # singles that pairs are grown from
NEAR_BEST = 30.0  # nats; where one effect leaves nothing unexplained, no pair is grown from one that is farther behind
SHARED = 4  # sets in which an effect that changed is tried as one that did not
SWAPS = 4  # sets with runs in time tried in the place of the best, one member changed
CLOSE = 10.0  # nats behind the best set within which another is looked for from the best's point too
# Not tried is what promises less than half of what the member is worth, and is this far behind it in nats. The linear
# model is seldom off by more than 15; at a wrong pair it was by 26. With runs in time a refit takes seconds.
HOPELESS_SHARE, HOPELESS, HOPELESS_IN_TIME = 0.5, 40.0, 15.0
ASTRAY = 1.0  # nats by which a set may fit worse than a part of it, or its search went astray
AT_ONCE = 3  # refits that a further one does not wait for: two processes then never wait for each other

Names = tuple[str, ...]
First = dict[tuple[str, str], float]  # values of effects' unknowns to start from


@dataclass(frozen=True)
class _Job:
    """A set to refit: from the mode of another set, and from the prior's middle too unless `near_alone`.

    With runs in time a search takes seconds, and from so far away it ends behind that from the other set.
    """

    names: Names
    near: Mode
    near_alone: bool
    first: First = field(default_factory=dict)

    @property
    def starts(self) -> tuple[Mode | None, ...]:
        return (self.near,) if self.near_alone else (self.near, None)


class Search:
    """The sets of effects of a recording that were refitted.

    `side_by_side`: does the refits; this process alone when left out.
    """

    def __init__(
        self, comparison: Compared, base: Mode, side_by_side: SideBySide | None = None, tell: Tell = lambda _: None
    ) -> None:
        self.comparison, self._tell = comparison, tell
        self._side_by_side = side_by_side or SideBySide(0)
        self.modes: dict[Names, Mode] = {(): base}
        self._signatures: dict[Names, list[Signature]] = {}

    def singles(self, found: Sequence[Signature], u: np.ndarray, worth: float = WORTH, every: bool = False) -> None:
        """Refit the most promising single effects and all that may stand beside the best, then the base model.

        Those that hide are refitted too.

        `u`, shape (k,): the noise that the detection found [-].
        `worth`: log evidence gained in the linear model below which an effect is not refitted [-].
        `every`: whether all effects are refitted, whatever the linear model says.
        """
        base, comparison = self.modes[()], self.comparison
        self._signatures[()] = list(found)
        in_time = comparison.in_time
        ranked = screen(comparison, base, found, u, -math.inf)
        jobs = [_Job((name,), base, in_time, first) for name, _, first in ranked]
        chosen = (
            jobs
            if every or comparison.thorough
            else [job for job, one in zip(jobs, ranked, strict=True) if one[1] > worth][:SINGLES]
        )
        hidden = [job for job in jobs if comparison.problem.effect(job.names[0]).hidden]
        chosen += [job for job in hidden if job not in chosen]
        self._refit([*chosen, *(self._at_its_size(job, *job.names) for job in hidden)])
        gained = self.modes[self._best()].log_evidence - base.log_evidence
        if gained > worth:
            near = [job for job, one in zip(jobs, ranked, strict=True) if one[1] > gained - BESIDE]
            self._refit([job for job in near if job not in chosen])
        if in_time and len(self.modes) > 1:
            self._tell("refit the base model again")
            best = self._best()
            if best:
                with contextlib.suppress(ArithmeticError):  # no reading from there
                    again = find(comparison, (), self.modes[best])
                    self.modes[()] = max(base, again, key=lambda mode: mode.log_evidence)
                if self.modes[()] is not base:
                    del self._signatures[()]

    def also(self, sets: Iterable[Names]) -> None:
        """Refit sets that were asked for, as far as they were not."""
        base, in_time = self.modes[()], self.comparison.in_time
        self._refit([_Job(names, base, in_time) for names in sets if names not in self.modes])

    def pairs(self, closed: Names | None) -> None:
        """Refit pairs grown from the best single effects, then what may stand in the best set's place."""
        order = sorted((key for key in self.modes if key), key=lambda key: -self.modes[key].log_evidence)
        if not order:
            return
        enough = self.modes[closed].log_evidence - NEAR_BEST if closed else -math.inf
        seeds = [key for key in order[:SEEDS] if self.modes[key].log_evidence >= enough]
        jobs: list[_Job] = []
        for seed in seeds:
            mode = self.modes[seed]
            screened = screen(self.comparison, mode, self.signatures_at(seed), mode.u, -math.inf)
            chosen = [one for one in screened if one[1] > WORTH][: PAIRS // SEEDS]
            if self.comparison.in_time and seed == order[0]:
                chosen += [
                    one for one in screened if self.comparison.problem.effect(one[0]).hidden and one not in chosen
                ]
            for name, _, first in chosen:
                names = tuple(sorted((*seed, name)))
                if all(job.names != names for job in jobs):
                    start = {**values_of(self.comparison.problem, mode), **first}
                    jobs.append(_Job(names, mode, self.comparison.in_time, start))
                    if self.comparison.problem.effect(name).hidden:
                        jobs.append(self._at_its_size(jobs[-1], name))
        self._refit(jobs)
        self.share()
        self.swap()
        self.share()
        if self.comparison.in_time and not self.comparison.noise.too_loud(self.modes[self._best()].u):
            self.again()  # where the best leaves too much to noise, its parts leave more

    def again(self) -> None:
        """Refit from the points of the best sets their parts, and what is close behind or holds the best set.

        A search may end short of the best. A second effect is not to be needed because the first alone was not
        followed as far, and no set explains less than a part of it.
        """
        order = sorted(self.modes, key=lambda key: -self.modes[key].log_evidence)
        least = self.modes[order[0]].log_evidence - CLOSE
        near = [names for names in order if self.modes[names].log_evidence > least]
        jobs = [self._from(near[0], names) for names in near[1:] if names]
        for names in order[len(near) :]:
            whole = next((one for one in near if set(names) < set(one)), near[0] if set(near[0]) < set(names) else None)
            if names and whole is not None:
                jobs.append(self._from(whole, names))
        self._refit(jobs)

    def _from(self, start: Names, names: Names) -> _Job:
        """A set that was refitted, to be refitted from another's point, in which what that one lacks begins small."""
        problem, mode = self.comparison.problem, self.modes[start]
        own = {} if set(start) < set(names) else values_of(problem, self.modes[names])
        values = {one: z for one, z in (own | values_of(problem, mode)).items() if one[0] in names}
        return _Job(names, mode, self.comparison.in_time, values)

    def _at_its_size(self, job: _Job, name: str) -> _Job:
        """The same set, from where one effect of it is as large as it ordinarily is."""
        problem = self.comparison.problem
        amplitude = problem.amplitude(name)
        sizes = [one for _, one in problem.effect_unknowns([name]) if is_size(one.name, amplitude)]
        return replace(job, first=job.first | {(name, one.name): float(one.z(amplitude.scale)) for one in sizes})

    def share(self) -> None:
        """Refit the best sets with an effect that changed in them as one that is the same in all recordings."""
        could = {effect.id for effect in self.comparison.problem.effects_that_could()}
        jobs: list[_Job] = []
        for best in sorted(self.modes, key=lambda key: -self.modes[key].log_evidence)[:SHARED]:
            problem, mode = self.comparison.problem, self.modes[best]
            for member in best:
                names = tuple(sorted({*best, unchanged(member)} - {member}))
                if unchanged(member) == member or unchanged(member) not in could or names in self.modes:
                    continue
                start = {one: z for one, z in values_of(problem, mode).items() if one[0] != member}
                start |= _mean_of_each(problem, mode, member)
                jobs.append(_Job(names, mode, self.comparison.in_time, start))
        self._refit(list({job.names: job for job in jobs}.values()))

    def swap(self) -> None:
        """Refit what may stand in the place of a member of the best set.

        Each member is left out, and each other effect weighed instead of it in the linear model; those that were not
        refitted yet are, if they come near what the member is worth. Where nothing runs in time all of them are, until
        nothing better is found: far from a good fit the linear model orders poorly.
        """
        best = self._best()
        if not best:
            return
        mode, problem, in_time = self.modes[best], self.comparison.problem, self.comparison.in_time
        found = self.signatures_at(best)
        tried: list[tuple[float, float, _Job]] = []
        for member in best:
            rest = {one: z for one, z in values_of(problem, mode).items() if one[0] != member}
            without = self.modes.get(tuple(name for name in best if name != member))
            worth = mode.log_evidence - without.log_evidence if without is not None else 0.0
            least = min(HOPELESS_SHARE * worth, worth - (HOPELESS_IN_TIME if in_time else HOPELESS))
            for name, gain, first in screen(self.comparison, mode, found, mode.u, -math.inf, without=member):
                names = tuple(sorted({*best, name} - {member}))
                if names not in self.modes:
                    tried.append((gain, least, _Job(names, mode, True, {**rest, **first})))
        promising = sorted(tried, key=lambda one: -one[0])[: SWAPS if in_time else None]
        self._refit([job for gain, least, job in promising if gain >= least])
        if not in_time and self._best() != best:
            self.swap()

    def weighed(self) -> list[Candidate]:
        """All sets with their probabilities, the most probable first; the base model is among them."""
        return weigh(self.comparison, self.modes)

    def _best(self) -> Names:
        return max(self.modes, key=lambda key: self.modes[key].log_evidence)

    def signatures_at(self, names: Names) -> list[Signature]:
        """Signatures of the effects that a refitted set does not hold."""
        if names not in self._signatures:
            self._signatures[names] = signatures(self.comparison, self.modes[names])
        return self._signatures[names]

    def _refit(self, jobs: Sequence[_Job]) -> None:
        """Refit sets, a few side by side; a set with which the model gives no reading at all is left out."""

        def ask(turn: int) -> tuple[Compared, _Job, float]:
            self._tell("refit " + " and ".join(jobs[turn].names))
            return self.comparison, jobs[turn], cost_of(self.comparison, self.modes[self._best()])

        def take(turn: int, mode: Mode | None) -> None:
            names = jobs[turn].names
            before = self.modes.get(names)
            if mode is not None and (before is None or mode.log_evidence > before.log_evidence):
                self.modes[names] = mode
                self._signatures.pop(names, None)

        self._side_by_side.in_turn(_found, len(jobs), ask, take, AT_ONCE)


def _found(comparison: Compared, job: _Job, best: float) -> Mode | None:
    """The most probable point of a set; from the other set's own point where a further effect led away from it.

    There the noise is as loud as it was: near what is declared, a point that nothing describes well pulls a search off.
    """
    found = _sought(comparison, job, best)
    if found is None or not set(job.near.names) < set(job.names):
        return found
    if cost_of(comparison, found) <= cost_of(comparison, job.near) + ASTRAY:
        return found
    again = _sought(comparison, replace(job, first=values_of(comparison.problem, job.near)), best, loud=True)
    return max(found, again or found, key=lambda mode: mode.log_evidence)


def _sought(comparison: Compared, job: _Job, best: float, loud: bool = False) -> Mode | None:
    try:
        return find(comparison, job.names, *job.starts, first=job.first, best=best, loud=loud)
    except ArithmeticError:  # nothing of it can be simulated
        return None


def _mean_of_each(problem: Problem, mode: Mode, member: str) -> First:
    """Values of an effect that all recordings share, from those that each has of it."""
    each: dict[str, list[float]] = {}
    unknowns = problem.effect_unknowns(mode.names)
    for (name, one), z in zip(unknowns, mode.z[len(problem.nuisances) :], strict=True):
        if name == member:
            each.setdefault(one.own, []).append(float(z))
    return {(unchanged(member), own): float(np.mean(z)) for own, z in each.items()}


def values_of(problem: Problem, mode: Mode) -> First:
    """Values of a mode's effects' unknowns by (effect, parameter), to start another search from [-]."""
    k = len(problem.nuisances)
    return {
        (name, unknown.name): float(mode.z[k + i])
        for i, (name, unknown) in enumerate(problem.effect_unknowns(mode.names))
    }
