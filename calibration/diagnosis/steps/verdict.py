"""What may be said. A wrong name costs more than an honest refusal, so every doubt leads away from a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from calibration.diagnosis.steps.candidate import Candidate, Reason
from calibration.diagnosis.steps.confirm import HeldOut
from calibration.diagnosis.steps.detect import MISMATCH_P
from calibration.unknowns.effects import holds, unchanged
from model.effects import effects

RESIDUAL_P = 0.003  # a set whose own residual is below this leaves something unexplained; several sets are tried
NAMED = 0.95  # probability that a set needs to be named alone
LISTED = 0.99  # probability that the sets listed as confounded have together
LEAST_PROBABLE = 0.005  # of an effect over all sets weighed; what would be told as 0.00 is nothing to rest on
SHARE = 0.01  # a set less probable than this beside the best is no alternative
UNSETTLED = 0.2  # probability from which a set counts as not excluded where the base model explains the recording
SUPERSET_ODDS = 20.0  # odds that a further effect needs before it is said beside those that suffice
NEARLY = 10.0  # factor below the threshold within which what a smaller set leaves is no proof that a member is missing
LEAST_GAIN = 4.0  # in log predictive density: smaller differences decide nothing
ERRORS = 1.0  # of the gain's standard error, itself rough over so few folds


class VerdictKind(StrEnum):
    """What may be said, as in diagnosis/1."""

    CONSISTENT = "consistent"
    NAMED = "named"
    CONFOUNDED = "confounded"
    UNRESOLVED = "unresolved"


@dataclass(frozen=True)
class Verdict:
    """What is said.

    `chosen`: what the verdict rests on; None when consistent or unresolved, or where misread readings alone are named.
    `alternatives`: sets that cannot be told from it; the empty one is the base model.
    `set_probability`: of the chosen set, or of the base model [-].
    """

    kind: VerdictKind
    chosen: Candidate | None
    alternatives: tuple[tuple[str, ...], ...]
    set_probability: float
    why: str


def not_excluded(found: Sequence[Candidate]) -> list[Candidate]:
    """Sets of effects that may be there although the base model explains the recording, the most probable first."""
    return [c for c in found if c.names and not c.refused and c.probability > UNSETTLED]


def is_small(candidate: Candidate) -> bool:
    """Whether all that a set says is that instruments have errors as large as declared."""
    of_instruments = _are_of_instruments(candidate.names)
    refused = candidate.refused
    return bool(candidate.names) and of_instruments and refused is not None and refused.reason is Reason.NO_LARGER


def _are_of_instruments(names: Sequence[str]) -> bool:
    known = effects()
    return all((name := unchanged(one)) in known and known[name].nuisance for one in names)


def judge(
    p_value: float,
    found: Sequence[Candidate],
    residual_p: dict[tuple[str, ...], float],
    held_out: HeldOut | None,
) -> Verdict:
    """Weigh everything.

    Where an instrument's error as large as declared explains the recording, its `set_probability` is of that.
    """
    base = next((c for c in found if not c.names), None)
    if p_value >= MISMATCH_P:
        why = "the base model explains the recording"
        return Verdict(VerdictKind.CONSISTENT, None, (), base.probability if base else 1.0, why)
    allowed = [c for c in found if not c.refused and c.names]
    passing = [c for c in allowed if residual_p.get(c.names, 1.0) >= RESIDUAL_P]  # a rival not tested may pass
    tested = [c for c in passing if c.names in residual_p]  # what is named has passed
    excluded = [c for c in tested if _least_of(c, found) < LEAST_PROBABLE]
    tested = [c for c in tested if c not in excluded]
    if not tested:
        return _nothing_passes(found, excluded, residual_p)
    if base is None or base.probability <= 1.0 - NAMED:
        return _of_those_that_pass(found, allowed, passing, tested, residual_p, held_out)
    if base.probability <= 0.5:
        likely = [c for c in found if (c is base or c in allowed) and c.probability > SHARE and c is not tested[0]]
        names, share = tuple(c.names for c in likely), tested[0].probability
        return Verdict(VerdictKind.CONFOUNDED, tested[0], names, share, "the base model is not excluded")
    if p_value >= RESIDUAL_P:
        return Verdict(VerdictKind.CONSISTENT, None, (), base.probability, "no effect explains more than chance would")
    # Held to what any set is held to.
    why = "what is left out is no listed effect: none is more probable than that nothing is left out"
    return Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, why)


def _nothing_passes(
    found: Sequence[Candidate],
    excluded: Sequence[Candidate],
    residual_p: dict[tuple[str, ...], float],
) -> Verdict:
    """Where no set leaves little enough, but for those that are far too improbable."""
    likeliest = next((c for c in found if c.names), None)
    if likeliest and is_small(likeliest) and residual_p.get(likeliest.names, 0.0) >= RESIDUAL_P:
        why = "an instrument's error, no larger than declared"
        return Verdict(VerdictKind.CONSISTENT, None, (), likeliest.probability, why)
    why = "no set of listed effects explains what is left"
    if excluded:
        why += f"; {' and '.join(excluded[0].names)} would, and others are far more probable that do not"
    return Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, why)


def _of_those_that_pass(
    found: Sequence[Candidate],
    allowed: Sequence[Candidate],
    passing: Sequence[Candidate],
    tested: Sequence[Candidate],
    residual_p: dict[tuple[str, ...], float],
    held_out: HeldOut | None,
) -> Verdict:
    """One set by name, or several: the base model is excluded."""
    best, total = tested[0], sum(c.probability for c in passing)
    blocked = [c for c in allowed if c.probability > best.probability]
    larger = [c for c in found if holds(best.names) < holds(c.names)]
    core = best if all(c.probability < SUPERSET_ODDS * best.probability for c in larger) else None
    smaller = [
        c for c in tested if holds(c.names) < holds(best.names) and best.probability < SUPERSET_ODDS * c.probability
    ]
    if smaller:  # the further members are not certain: what they add is left unsaid
        best = core = min(smaller, key=lambda c: (len(c.names), -c.probability))
        blocked = []
    share = best.probability / total
    if core is not None:
        share = sum(c.probability for c in passing if holds(core.names) <= holds(c.names)) / total
        passing = [best, *(c for c in passing if not holds(core.names) <= holds(c.names))]
        blocked = [c for c in allowed if c.probability > best.probability and not holds(core.names) <= holds(c.names)]
    rivals = [c for c in passing if c is not best and c.probability > SHARE * best.probability]
    if share < NAMED and not rivals:  # none of them is likely, and all together they are
        rivals = [c for c in passing if c is not best]
    # The model itself is not perfect to the last digit: a further member must be needed by more than a hair.
    rivals += [c for c in allowed if holds(c.names) < holds(best.names) and c not in passing and _nearly(c, residual_p)]
    listed, sum_of = [], best.probability
    for c in rivals:
        if c not in passing or sum_of < LISTED * total:
            listed.append(c.names)
            sum_of += c.probability
    listed += [c.names for c in blocked if c.names not in listed]
    if listed:
        return Verdict(VerdictKind.CONFOUNDED, best, tuple(listed), share, "several sets explain it")
    if _gained(held_out):
        return Verdict(VerdictKind.NAMED, best, (), share, "one set explains it alone")
    return Verdict(
        VerdictKind.UNRESOLVED, None, (), 0.0, f"{' and '.join(best.names)} predicts no better what it has not seen"
    )


def _gained(held_out: HeldOut | None) -> bool:
    """Whether a set predicts what it has not seen better than the base model: readings and declared figures together.

    Readings alone must not be predicted worse. The base model predicts them as well with an instrument, or an inertia,
    far beyond its declared figures: then those speak.
    """
    if held_out is None:
        return True
    least = max(LEAST_GAIN, ERRORS * held_out.gain_se)
    return held_out.gain > -least and held_out.gain + held_out.declared > least


def _least_of(candidate: Candidate, found: Sequence[Candidate]) -> float:
    """Probability of a set's least probable effect, over all sets weighed [-]."""
    return min(sum(c.probability for c in found if name in c.names) for name in candidate.names)


def _nearly(candidate: Candidate, residual_p: dict[tuple[str, ...], float]) -> bool:
    """Whether what a set leaves unexplained is little enough for doubt."""
    return residual_p.get(candidate.names, 0.0) >= RESIDUAL_P / NEARLY


def with_open(verdict: Verdict, rivals: Sequence[Candidate]) -> Verdict:
    """A consistent verdict that says what may be there all the same. `rivals`: what a next test should tell apart."""
    likely = [f"{' + '.join(c.names)} ({c.probability:.2f})" for c in rivals if c.names]
    if verdict.kind != VerdictKind.CONSISTENT or not likely:
        return verdict
    return replace(verdict, why=f"{verdict.why}; not excluded: {', '.join(likely)}")


def with_near(verdict: Verdict, found: Sequence[Candidate]) -> Verdict:
    """A verdict with one doubt more, where noise is known less well than its declared figures say.

    The test of what a set leaves hangs on the noise. A set that fails only that test, and is nearly as probable as the
    one that passes, is therefore an alternative.
    """
    if verdict.kind not in (VerdictKind.NAMED, VerdictKind.CONFOUNDED) or verdict.chosen is None:
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
        kind=VerdictKind.CONFOUNDED,
        alternatives=alternatives,
        set_probability=best.probability,
        why="other sets are as probable or nearly so, though they leave more",
    )
