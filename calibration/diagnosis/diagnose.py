"""The whole diagnosis of a recording, step after step."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.data.joined import by_flywheel
from calibration.data.refusals import refuse_unusable
from calibration.data.together import refuse_another
from calibration.diagnosis.mismatch import Detected, fit_base, test_base
from calibration.diagnosis.next_test.promised import Promise, kept
from calibration.diagnosis.next_test.recommend import MOST_RIVALS, NextTest, propose
from calibration.diagnosis.result import Diagnosis
from calibration.diagnosis.sizes.not_excluded import Undetected, behind_friction, undetected
from calibration.diagnosis.sizes.resolves import resolved
from calibration.diagnosis.steps.abrupt import Step, step_instead
from calibration.diagnosis.steps.candidate import Candidate, alone
from calibration.diagnosis.steps.confirm import HeldOut, cross_validate
from calibration.diagnosis.steps.detect import Detection
from calibration.diagnosis.steps.locate import Place, locate, rows_as_places
from calibration.diagnosis.steps.misread import BadRow, alone_at_an_end, bad_rows, by_chance, with_misread
from calibration.diagnosis.steps.name import evidence_p
from calibration.diagnosis.steps.residual import Residuals
from calibration.diagnosis.steps.search import Search
from calibration.diagnosis.steps.unexplained import Unexplained, unexplained
from calibration.diagnosis.steps.unseen import predict_unseen
from calibration.diagnosis.steps.verdict import (
    ERRORS,
    MISMATCH_P,
    RESIDUAL_P,
    Verdict,
    VerdictKind,
    judge,
    not_excluded,
    with_near,
    with_open,
)
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode
from calibration.systems.several.sharing import SHARED, Sharing
from calibration.work.side_by_side import SideBySide
from calibration.work.step_clock import StepClock, Tell
from rig.recording import Recording, RecordingError

FARTHER = -3.0  # nats in the linear model down to which effects are refitted, where the test saw nothing
CERTAIN_P = 1e-9  # of a mismatch so gross that no test need see it
NOT_DESCRIBED = "the model does not describe these readings at all"
TESTS = 2.0  # looks at a recording with runs in time: the linear test, and the refits


@dataclass(frozen=True)
class _Searched:
    """The base model with the runs' lines as the best effect found them, the test of it, and the sets weighed."""

    base: Mode
    detection: Detection
    candidates: list[Candidate]


@dataclass(frozen=True)
class _Said:
    """What is said so far."""

    verdict: Verdict
    detection: Detection
    bad: list[BadRow]
    misread: frozenset[tuple[str, ...]]
    step: Step | None = None

    def unresolved(self, why: str) -> _Said:
        """The same with a refusal in the verdict's place."""
        return replace(self, verdict=Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, why), bad=[], misread=frozenset())


def diagnose(
    recording: Recording | Sequence[Recording],
    seed: int = 0,
    tell: Tell = lambda _: None,
    hold_out: Recording | None = None,
    workers: int = 1,
    promises: Sequence[Promise] = (),
    sharing: Sharing = SHARED,
) -> Diagnosis:
    """Diagnose a recording, or several of one motor: the motor and the effects are shared, the rest is each one's own.

    `hold_out`: a run that nothing here has seen, to be predicted once a set is named or listed.
    `workers`: processes that refit sets side by side, of a recording with runs in time; the result is the same [-].
    `promises`: of tests that an earlier diagnosis asked for and that are among the recordings now.
    `sharing`: of which effects each of several recordings has its own sizes.
    Raises RecordingError when `refuse_unusable` says so, the run held out is of another motor, or the motor's model
    gives no reading of the recording at all.
    """
    several = [recording] if isinstance(recording, Recording) else list(recording)
    for one in several:
        refuse_unusable(one)
    if hold_out is not None:
        refuse_another(several[0], hold_out)
        refuse_unusable(hold_out)
        (hold_out,) = _one_each(several, hold_out)
    of_the_motor = several[0].is_of_radial_piston
    in_time = of_the_motor and any(file.kind == "transient" for one in several for file in one.files)
    with SideBySide(workers if in_time else 1) as side_by_side:
        rng, clock = np.random.default_rng(seed), StepClock(tell)
        comparison, base = fit_base(recording, clock, workers if in_time else 1, sharing=sharing)
        clock("detect")
        side_by_side.begin(["calibration.diagnosis.diagnose"])  # the base model's threads had all cores to themselves
        first = test_base(comparison, base, rng)
        return _explain(first, rng, clock, hold_out, side_by_side, promises)


def _one_each(several: Sequence[Recording], hold_out: Recording) -> list[Recording]:
    """The run held out, with its flywheel; one run is predicted from one recording."""
    for what, all_of_it in (("predicted from", several), ("held out of", [hold_out])):
        if sum(len(by_flywheel(one)) for one in all_of_it) > 1:
            raise RecordingError(
                f"{hold_out.folder}: a run is {what} one recording with one flywheel, and these are several; name one"
            )
    return by_flywheel(hold_out)


def _explain(
    first: Detected,
    rng: np.random.Generator,
    clock: StepClock,
    hold_out: Recording | None,
    side_by_side: SideBySide,
    promises: Sequence[Promise] = (),
) -> Diagnosis:
    comparison = first.comparison
    if off := comparison.not_described(first.base):
        return _of_something_else(first, off, clock)
    search = Search(comparison, first.base, side_by_side, clock.tell)
    residuals = Residuals(comparison, rng, side_by_side)
    asked = list(dict.fromkeys(names for one in promises for names in one.rivals))
    searched = _search(first, search, residuals, clock, asked)
    base, candidates = searched.base, searched.candidates
    said, held_out, unseen_run = _said(searched, comparison, residuals, hold_out, clock)
    clock("locate")
    places = _places(comparison, first, said, base)
    verdict, unnamed = said.verdict, Unexplained(said.verdict.why, held_out=held_out)
    if verdict.kind == VerdictKind.UNRESOLVED:
        clock("look for a law")
        unnamed = unexplained(comparison, base, said.detection, verdict.why, unseen_run, rng)
    rivals = _rivals(comparison, candidates, verdict)
    verdict = with_open(replace(verdict, why=unnamed.why), rivals)
    tests = _next_tests(comparison, base, rivals, clock, side_by_side)
    clock("average f_overall")
    unseen = _not_seen(search, verdict, rng)
    clock("")
    return Diagnosis(
        comparison=comparison,
        base=base,
        detection=said.detection,
        places=places,
        candidates=candidates,
        residual_p=residuals.p,
        left=residuals.left,
        verdict=verdict,
        held_out=unnamed.held_out,
        unseen_run=unseen_run,
        term=unnamed.term,
        next_tests=tests,
        bad_rows=said.bad,
        seconds=clock.seconds,
        correction=unnamed.correction,
        nuisances_corrected=unnamed.nuisances,
        misread=said.misread,
        undetected=unseen,
        resolved=resolved(comparison, first.base, first.detection.u, first.found),
        rivals=rivals,
        promised=[one for promise in promises if (one := kept(promise, candidates))],
    )


def _said(
    searched: _Searched, comparison: Compared, residuals: Residuals, hold_out: Recording | None, clock: StepClock
) -> tuple[_Said, HeldOut | None, HeldOut | None]:
    """What is said, what held-out readings say of it, and what an unseen run does."""
    verdict, held_out = _judge(searched, comparison, residuals, clock)
    unseen_run = None
    if hold_out is not None and verdict.chosen is not None:
        clock("predict the unseen run")
        held_out = unseen_run = predict_unseen(comparison, searched.base, verdict.chosen.mode, hold_out)
        verdict = _held_against(verdict, unseen_run)
    said = _single_readings(comparison, verdict, searched)
    if said.verdict.kind in (VerdictKind.NAMED, VerdictKind.CONFOUNDED):
        clock("a step in time instead")
        said = _held_against_a_step(comparison, said, searched.base)
    return said, held_out, unseen_run


def _not_seen(search: Search, verdict: Verdict, rng: np.random.Generator) -> dict[tuple[str, ...], list[Undetected]]:
    """Effects too small to be seen beside each of the sets that are said."""
    chosen = verdict.chosen.names if verdict.chosen else ()
    averaged = [] if verdict.kind == VerdictKind.UNRESOLVED else [chosen, *verdict.alternatives]
    if search.comparison.rig:  # a machine's friction is no figure of its own: it is that of the sets that are said
        return {names: [] for names in averaged}
    return {
        names: undetected(search.comparison, search.modes[names], search.signatures_at(names), rng)
        for names in averaged
    }


def _of_something_else(first: Detected, off: str, clock: StepClock) -> Diagnosis:
    """The diagnosis of readings that the base model does not describe at all: nothing is looked for."""
    detection = first.detection
    if not detection.p_value < MISMATCH_P:
        detection = replace(detection, p_value=CERTAIN_P, extrapolated=True)
    clock("")
    verdict = Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, f"{NOT_DESCRIBED}: {off}")
    return Diagnosis(
        comparison=first.comparison,
        base=first.base,
        detection=detection,
        places=[],
        candidates=[alone(first.base)],
        residual_p={(): detection.p_value},
        left={},
        verdict=verdict,
        seconds=clock.seconds,
        not_described=off,
    )


def _search(
    first: Detected, search: Search, residuals: Residuals, clock: StepClock, asked: Collection[tuple[str, ...]] = ()
) -> _Searched:
    """Sets of effects refitted and weighed, those asked for among them, and what they leave tested."""
    found, detection = _Searched(first.base, first.detection, [alone(first.base)]), first.detection
    if detection.p_value >= MISMATCH_P:
        # What is too small to be seen may still be there, and f_overall with it would be another.
        clock("look farther")
        search.singles(first.found, detection.u, FARTHER)
        search.also(asked)
        # With runs in time another explanation may lie far off, where the linear test does not reach.
        in_time = first.comparison.in_time
        elsewhere = min(1.0, TESTS * evidence_p(first.comparison, search.modes)) if in_time else 1.0
        if elsewhere < MISMATCH_P:
            detection = replace(detection, p_value=elsewhere, extrapolated=True)
        found = _Searched(search.modes[()], detection, search.weighed())
    residuals.p[()], residuals.mismatch = detection.p_value, detection.gain
    if detection.p_value >= MISMATCH_P:
        return found
    clock("name")
    if len(search.modes) == 1:
        # Beside a nuisance far off or loud noise the linear screen says little.
        far = detection.pulled or first.comparison.rig
        search.singles(first.found, detection.u, every=bool(far or first.comparison.noise.too_loud(found.base.u)))
    base = search.modes[()]  # with runs in time refitted from where the best effect led
    clock("test what is left")
    residuals.test([one for one in search.weighed() if one.names and not one.refused][:1])
    clock("name")
    search.also(asked)
    search.pairs(next((names for names, p in residuals.weighed().items() if names and p >= RESIDUAL_P), None))
    candidates = search.weighed()
    clock("test what is left")
    residuals.test_all_that_matter(candidates)
    return _Searched(base, detection, candidates)


def _judge(
    searched: _Searched, comparison: Compared, residuals: Residuals, clock: StepClock
) -> tuple[Verdict, HeldOut | None]:
    """The verdict, and the cross-validation of the set that it rests on."""
    best, held_out, candidates = None, None, searched.candidates
    if searched.detection.p_value < MISMATCH_P:
        clock("confirm")
        best = next((c for c in candidates if c.names and not c.refused and residuals.passes(c)), None)
        if best is not None:
            held_out = cross_validate(comparison, candidates, best.names)
    verdict = judge(searched.detection.p_value, candidates, residuals.weighed(), held_out)
    if comparison.rig:
        verdict = with_near(verdict, candidates)
    if best is not None and verdict.chosen is not None and verdict.chosen.names != best.names:
        held_out = cross_validate(comparison, candidates, verdict.chosen.names)  # it counts the folds that chose it
    return verdict, None if verdict.kind == VerdictKind.CONSISTENT else held_out  # ... it was of a set that is not said


def _held_against(verdict: Verdict, unseen_run: HeldOut) -> Verdict:
    """The verdict, where a set that is named predicts an unseen run better; else a refusal."""
    if verdict.kind != VerdictKind.NAMED or verdict.chosen is None or unseen_run.gain > ERRORS * unseen_run.gain_se:
        return verdict
    words = f"{' and '.join(verdict.chosen.names)} does not predict the unseen run better"
    return Verdict(VerdictKind.UNRESOLVED, None, (), 0.0, words)


def _single_readings(comparison: Compared, verdict: Verdict, searched: _Searched) -> _Said:
    """What single readings do to the verdict: misread ones may be all that is wrong."""
    base = searched.base
    # Of a model that does not fit, no reading can be said to be off.
    unfit = verdict.kind == VerdictKind.UNRESOLVED
    bad = [] if unfit else bad_rows(comparison, verdict.chosen.mode if verdict.chosen else base)
    said = _Said(verdict, searched.detection, bad, with_misread(comparison, verdict, searched.candidates))
    if verdict.kind != VerdictKind.CONSISTENT or not bad:
        return said
    chance = by_chance(comparison, base)
    if chance >= MISMATCH_P:
        why = f"{verdict.why}; readings stand out no more than heavy tails would"
        return replace(said, verdict=replace(verdict, why=why))
    said = replace(said, detection=replace(said.detection, p_value=min(said.detection.p_value, chance)))
    if end := alone_at_an_end(comparison, base):
        place = f"{end[0]}, row {end[1]}, is the only one at that end of the pressures"
        return said.unresolved(f"{place}: it may be misread, or the motor does something else there")
    probability = min(row[3] for row in bad)
    return replace(
        said, verdict=Verdict(VerdictKind.NAMED, None, (), probability, "single readings that nothing explains")
    )


def _held_against_a_step(comparison: Compared, said: _Said, base: Mode) -> _Said:
    """A name, unless a step in time explains the recording as well."""
    chosen = said.verdict.chosen
    step = step_instead(comparison, chosen.mode if chosen else base)
    if step is None or not step.explains:
        return replace(said, step=step)
    instead = " and ".join(chosen.names) if chosen else "a misread row"
    return replace(said.unresolved(f"{step.text} explains it as well as {instead}"), step=step)


def _places(comparison: Compared, first: Detected, said: _Said, base: Mode) -> list[Place]:
    """Where the base model does not close."""
    verdict, chosen = said.verdict, said.verdict.chosen
    if verdict.kind == VerdictKind.CONSISTENT:
        return []
    if verdict.kind == VerdictKind.NAMED and chosen is None:
        return rows_as_places(said.bad)
    acts_in = comparison.problem.effect(chosen.names[0]).acts_in if chosen and len(chosen.names) == 1 else ""
    places = locate(comparison, base, said.detection, first.free, acts_in)
    if chosen and chosen.names in said.misread:
        places += rows_as_places(said.bad)
    if said.step is not None and said.step.explains:
        places.insert(0, said.step.place)
    return places


def _next_tests(
    comparison: Compared, base: Mode, rivals: Sequence[Candidate], clock: StepClock, side_by_side: SideBySide
) -> list[NextTest]:
    if not rivals:
        return []
    clock("next test")
    return propose(comparison, rivals, base, side_by_side, clock.tell)


def _rivals(comparison: Compared, candidates: list[Candidate], verdict: Verdict) -> list[Candidate]:
    """Sets that stay open, the most probable ones; none where nothing is open.

    Beside a base model that explains the recording they are all that may be there.
    """
    if verdict.kind == VerdictKind.NAMED:
        return []
    if verdict.kind == VerdictKind.CONSISTENT:
        base = [c for c in candidates if not c.names]
        hidden = behind_friction(comparison, base[0], candidates) if base else []
        likely = [*hidden, *(c for c in not_excluded(candidates) if c not in hidden)]
        return [*base, *sorted(likely, key=lambda c: -c.log_probability)] if likely else []
    if verdict.chosen is None:
        sets = [c for c in candidates if c.names]  # most probable first
        return sorted(sets, key=lambda c: bool(c.refused))[:MOST_RIVALS]
    listed = set(verdict.alternatives)
    return [verdict.chosen, *(c for c in candidates if c.names in listed)][:MOST_RIVALS]
