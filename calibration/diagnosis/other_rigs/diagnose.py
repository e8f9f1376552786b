"""The steps in order, for a recording whose motor is written out in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.diagnosis.diagnose import CERTAIN_P, NOT_DESCRIBED
from calibration.diagnosis.next_test.recommend import NextTest
from calibration.diagnosis.other_rigs.confirm import cross_validate, unseen
from calibration.diagnosis.other_rigs.detect import DRAWS, Detection, detect
from calibration.diagnosis.other_rigs.fit import RigFit, fit_rig
from calibration.diagnosis.other_rigs.linear import forces, linear, signatures
from calibration.diagnosis.other_rigs.name import search
from calibration.diagnosis.other_rigs.next_test import propose
from calibration.diagnosis.other_rigs.places import Force
from calibration.diagnosis.other_rigs.problem import RigProblem
from calibration.diagnosis.other_rigs.verdict import weigh
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.confirm import HeldOut
from calibration.diagnosis.steps.verdict import MISMATCH_P, RESIDUAL_P, Verdict, is_small
from calibration.work.step_clock import StepClock, Tell
from rig.recording import Recording, RecordingError

TESTED = 6  # most probable sets whose residual is tested
RESIDUAL_DRAWS, MORE_DRAWS = 200, 4000
NEAR = 10.0  # factor about the threshold within which a residual is tested again, with more draws
HOPELESS = 1e-3  # as probable as this beside one that passes, a set need not be tested
# Share of a reading by which the base model may miss it, at the median: a drive that all goes into dry friction is
# missed by half; units mixed up, or a drive of the other sign, are missed by nearly all of it and more.
MOST_MISSED = 0.8
LOUD = 5.0  # ... and how many times the declared noise that is
MOSTLY = 0.05  # of the mismatch: a set that leaves less explains it, be the rest as certain as it may


@dataclass(frozen=True)
class RigDiagnosis:
    """Everything that was found.

    Attributes
    ----------
    left : dict
        Share of the mismatch that each set tested leaves [-].
    seconds : dict
        Of each step [s].
    not_described : str
        How far the base model is off where it does not describe the readings at all, and nothing was looked for.
    """

    problem: RigProblem
    base: RigFit
    detection: Detection
    free: list[Force]
    candidates: list[Candidate]
    residual_p: dict[tuple[str, ...], float]
    left: dict[tuple[str, ...], float]
    verdict: Verdict[RigFit]
    held_out: HeldOut | None
    next_tests: list[NextTest]
    seconds: dict[str, float]
    not_described: str = ""

    def candidates_of(self, names: tuple[str, ...]) -> Candidate:
        """The candidate of a set that was weighed.

        Parameters
        ----------
        names : tuple of str
            Ids, sorted; empty for the base model.
        """
        return next(one for one in self.candidates if one.names == names)

    @property
    def chosen(self) -> Candidate | None:
        """The set that the verdict rests on."""
        return self.verdict.chosen


def look(recording: Recording, seed: int, tell: Tell, held_out: Recording | None = None) -> RigDiagnosis:
    """Diagnose a recording of another rig.

    Parameters
    ----------
    held_out : Recording or None
        An unseen run of the same rig; blocks of the recording are held out where there is none.

    Raises
    ------
    RecordingError
        When a recording does not hold what its kind of rig needs.
    """
    rng = np.random.default_rng(seed)
    clock = StepClock(tell)
    clock("base model")
    problem = RigProblem(recording)
    other = _other(problem, held_out)
    base = fit_rig(problem)
    clock("detect")
    view = linear(problem, base)
    free = forces(view)
    detection = detect(view, signatures(view), free, rng, DRAWS)
    candidates = [Candidate((), base, base.log_evidence, 1.0)]
    residual_p: dict[tuple[str, ...], float] = {(): detection.p_value}
    left: dict[tuple[str, ...], float] = {}
    found, best = None, None
    tests: list[NextTest] = []
    far = not_described(problem, base)
    if far:
        detection = replace(detection, p_value=min(detection.p_value, CERTAIN_P))
        residual_p[()] = detection.p_value
        verdict: Verdict[RigFit] = Verdict("unresolved", None, (), 0.0, f"{NOT_DESCRIBED}: {far}")
    elif detection.p_value < MISMATCH_P:
        clock("name")
        candidates = search(problem, base, tell)
        passes = 0.0  # probability of the first set that leaves nothing
        for one in [c for c in candidates if c.names and not c.refused][:TESTED]:
            if one.probability < HOPELESS * passes:
                break
            clock(f"test what {' and '.join(one.names)} leaves")
            residual_p[one.names], left[one.names] = _residual(problem, one, detection, rng)
            if not passes and (residual_p[one.names] >= RESIDUAL_P or left[one.names] < MOSTLY):
                passes = one.probability
        likeliest = next((c for c in candidates if c.names), None)
        if likeliest is not None and is_small(likeliest):
            residual_p[likeliest.names], left[likeliest.names] = _residual(problem, likeliest, detection, rng)
        clock("confirm")
        passing = {names: 1.0 if left.get(names, 1.0) < MOSTLY else p for names, p in residual_p.items()}
        allowed = (c for c in candidates if c.names and not c.refused)
        best = next((c for c in allowed if passing.get(c.names, 0.0) >= RESIDUAL_P), None)
        if best is not None:
            found = _confirm(problem, candidates, best, other)
        verdict = weigh(detection.p_value, candidates, passing, found)
    else:
        verdict = weigh(detection.p_value, candidates, residual_p, None)
    if verdict.chosen is not None and best is not None and verdict.chosen.names != best.names:
        found = _confirm(problem, candidates, verdict.chosen, other)
    if verdict.kind in ("confounded", "unresolved") and not far:
        clock("next test")
        tests = propose(problem, _rivals(candidates, verdict))
    clock("")
    return RigDiagnosis(
        problem, base, detection, free, candidates, residual_p, left, verdict, found, tests, clock.seconds, far
    )


def not_described(problem: RigProblem, base: RigFit) -> str:
    """How far the base model is from the readings where it does not describe them at all; empty where it does."""
    far = []
    for one, missed in zip(problem.readings, base.residuals, strict=True):
        read = np.abs(one.value)
        if not np.any(read > 0.0):
            continue
        share = float(np.median(np.abs(missed[read > 0.0]) / read[read > 0.0]))
        loud = base.noise_scale.get(one.label, np.inf)  # a reading that is all noise is missed too, and says nothing
        if not share <= MOST_MISSED and not loud <= LOUD:  # nan too: nothing is predicted there
            far.append(f"{one.label} is off by {100.0 * share:.0f} % at the median")
    return "; ".join(far)


def _other(problem: RigProblem, held_out: Recording | None) -> RigProblem | None:
    if held_out is None:
        return None
    other = RigProblem(held_out)
    if other.kind != problem.kind or other.slides != problem.slides:
        raise RecordingError(f"{held_out.folder}: held out is a {other.kind}, and diagnosed a {problem.kind}")
    return other


def _confirm(problem: RigProblem, candidates: Sequence[Candidate], one: Candidate, other: RigProblem | None) -> HeldOut:
    if other is None:
        return cross_validate(problem, candidates, one.names)
    base = next(c for c in candidates if not c.names)
    return unseen(problem, base.mode, one.mode, other)


def _residual(problem: RigProblem, one: Candidate, base: Detection, rng: np.random.Generator) -> tuple[float, float]:
    """p-value of what a set leaves, and how much of the mismatch that is."""
    view = linear(problem, one.mode)
    found = detect(view, signatures(view), forces(view), rng, RESIDUAL_DRAWS)
    if RESIDUAL_P / NEAR < found.p_value < RESIDUAL_P * NEAR:  # a tail of so few draws is too rough to decide it
        found = detect(view, signatures(view), forces(view), rng, MORE_DRAWS)
    return found.p_value, found.gain / max(base.gain, 1e-9)


def _rivals(candidates: Sequence[Candidate], verdict: Verdict[RigFit]) -> list[Candidate]:
    if verdict.chosen is None:
        return [c for c in candidates if c.names and not c.refused][:3]
    listed = set(verdict.alternatives)
    return [verdict.chosen, *(c for c in candidates if c.names in listed)]
