"""The whole diagnosis of a recording, step after step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calibration.data.refusals import refuse_unusable
from calibration.diagnosis.linear_model.forces import Force, forces
from calibration.diagnosis.linear_model.signatures import Signature, signatures
from calibration.diagnosis.next_test.recommend import NextTest, propose
from calibration.diagnosis.not_described import not_described
from calibration.diagnosis.steps.abrupt import step_instead
from calibration.diagnosis.steps.base import base_of
from calibration.diagnosis.steps.confirm import HeldOut, cross_validate
from calibration.diagnosis.steps.correction import Correction, corrections, nuisances_beside
from calibration.diagnosis.steps.correction import hold_out as hold_out_smooth
from calibration.diagnosis.steps.detect import Detection, detect
from calibration.diagnosis.steps.discover import Term, discover
from calibration.diagnosis.steps.locate import Place, locate, rows_as_places
from calibration.diagnosis.steps.misread import MISREAD, BadRow, alone_at_an_end, bad_rows, by_chance, with_misread
from calibration.diagnosis.steps.name import Candidate, evidence_p
from calibration.diagnosis.steps.not_excluded import Faint, faint
from calibration.diagnosis.steps.resolves import Resolved, resolved
from calibration.diagnosis.steps.search import Search
from calibration.diagnosis.steps.unseen import predict_unseen, refuse_another_motor
from calibration.diagnosis.steps.verdict import (
    ERRORS,
    MISMATCH_P,
    RESIDUAL_P,
    SHARE,
    SUPERSET_ODDS,
    Verdict,
    is_small,
    judge,
    not_excluded,
)
from calibration.likelihood.descent import find
from calibration.likelihood.linear import Comparison
from calibration.likelihood.mode import Mode
from calibration.likelihood.noise import too_loud
from calibration.systems.radial_piston.problem import Problem
from calibration.work.side_by_side import SideBySide
from calibration.work.step_clock import StepClock, Tell
from calibration.work.threads import threads
from model.effects import effects
from model.motor import Motor
from rig.recording import Recording, RecordingError, read_recording

TESTED = 3  # sets whose residual is tested; more only where one of these passes
RESIDUAL_DRAWS, MORE_DRAWS = 100, 400
NEAR = 10.0  # factor about the threshold within which a residual is tested again, with more draws
FARTHER = -3.0  # nats in the linear model down to which effects are refitted, where the test saw nothing
CERTAIN_P = 1e-9  # of a mismatch so gross that no test need see it
NOT_DESCRIBED = "the model does not describe these readings at all"
WORTHLESS = 10.0  # nats a reading; a smooth correction that predicts worse by so much predicts nothing
TESTS = 2.0  # looks at a recording with runs in time: the straight test, and the refits


@dataclass
class Diagnosis:
    """Everything that was found.

    Attributes
    ----------
    comparison : Comparison
        The recording.
    base : Mode
        The base model.
    detection : Detection
        Of the base model.
    places : list of Place
        Where it does not close.
    candidates : list of Candidate
        Sets weighed, the most probable first.
    residual_p : dict
        p-values of the residuals of sets tested [-].
    verdict : Verdict
        What is said.
    held_out : HeldOut or None
        Cross-validation: of the set named, or of the smooth correction where no set explains the recording; or the
        prediction of an unseen run.
    term : Term or None
        A law found from the data.
    next_tests : list of NextTest
        Tests worth making.
    bad_rows : list
        (file, row, channel, probability) of bad readings.
    seconds : dict
        Time of each step [s].
    correction : Correction or None
        A smooth torque or flow that stands for what no set explains.
    beside : tuple of ndarray or None
        The nuisances and their sd beside such a correction, whichever it is [-].
    misread : frozenset of tuple of str
        Sets named or listed beside which readings are misread.
    resolved : list of Resolved
        What the recording can tell of each effect.
    faint : dict
        For each set that f_overall is averaged over, the further effects that may be there unseen.
    not_described : str
        How far the base model is off where it does not describe the readings at all, and nothing was looked for.
    """

    comparison: Comparison
    base: Mode
    detection: Detection
    places: list[Place]
    candidates: list[Candidate]
    residual_p: dict[tuple[str, ...], float]
    verdict: Verdict[Candidate]
    held_out: HeldOut | None = None
    term: Term | None = None
    next_tests: list[NextTest] = field(default_factory=list)
    bad_rows: list[BadRow] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    correction: Correction | None = None
    beside: tuple[np.ndarray, np.ndarray] | None = None
    misread: frozenset[tuple[str, ...]] = frozenset()
    faint: dict[tuple[str, ...], list[Faint]] = field(default_factory=dict)
    resolved: list[Resolved] = field(default_factory=list)
    not_described: str = ""


@dataclass(frozen=True)
class Detected:
    """What the base model and the test of it come to, before anything is looked for.

    Attributes
    ----------
    comparison : Comparison
        The recording.
    base : Mode
        The base model.
    found : list of Signature
        Of all effects that the recording could show.
    free : list of Force
        Free-form forces.
    detection : Detection
        Whether anything is missing.
    """

    comparison: Comparison
    base: Mode
    found: list[Signature]
    free: list[Force]
    detection: Detection


def detect_mismatch(
    recording: Recording,
    rng: np.random.Generator,
    tell: Tell = lambda _: None,
    workers: int = 1,
    motor: Motor | None = None,
) -> Detected:
    """The first steps of a diagnosis: fit the base model, and test whether anything is missing.

    Parameters
    ----------
    recording : Recording
        The recording, of a motor that `model.motor` knows.
    rng : numpy.random.Generator
        For the null law.
    tell : callable
        Told the step that begins.
    workers : int
        Threads that simulate side by side; the result is the same [-].
    motor : Motor or None
        The motor that it names, when left out.

    Raises
    ------
    RecordingError
        When the motor's model gives no reading of it at all.
    """
    comparison, base = _fit_base(recording, tell, workers, motor)
    tell("detect")
    return _test_base(comparison, base, rng)


def _fit_base(
    recording: Recording, tell: Tell, workers: int = 1, motor: Motor | None = None
) -> tuple[Comparison, Mode]:
    tell("base model")
    with threads(workers):
        try:
            comparison = Comparison(Problem(recording, motor))
            return comparison, base_of(comparison)
        except RecordingError:
            raise
        except (ArithmeticError, ValueError) as problem:  # such as a pressure that no air has, or none at all
            raise RecordingError(
                f"{recording.folder}: the model gives no reading of it ({problem}); are the pressures absolute or "
                "gauge as declared, was the gauge read in every run, and is it this motor?"
            ) from None


def _test_base(comparison: Comparison, base: Mode, rng: np.random.Generator) -> Detected:
    found, free = signatures(comparison, base), forces(comparison, base)
    return Detected(comparison, base, found, free, detect(comparison, base, found, free, rng))


def diagnose(
    recording: Recording,
    seed: int = 0,
    tell: Tell = lambda _: None,
    hold_out: Recording | None = None,
    workers: int = 1,
) -> Diagnosis:
    """Diagnose a recording.

    Parameters
    ----------
    recording : Recording
        The recording, of a motor that `model.motor` knows.
    seed : int
        Of the draws [-].
    tell : callable
        Told the step that begins.
    hold_out : Recording or None
        A run that nothing here has seen, to be predicted once a set is named or listed.
    workers : int
        Processes that refit sets side by side, of a recording with runs in time; the result is the same [-].

    Raises
    ------
    RecordingError
        When `refuse_unusable` says so, the run held out is of another motor, or the motor's model gives no reading of
        the recording at all.
    """
    refuse_unusable(recording)
    if hold_out is not None:
        refuse_another_motor(recording, hold_out)
        refuse_unusable(hold_out)
    in_time = any(file.kind == "transient" for file in recording.files)
    with SideBySide(workers if in_time else 1) as side_by_side:
        rng, clock = np.random.default_rng(seed), StepClock(tell)
        comparison, base = _fit_base(recording, clock, workers if in_time else 1)
        clock("detect")
        side_by_side.begin(["calibration.diagnosis.steps.name"])  # the base model's threads had all cores to themselves
        first = _test_base(comparison, base, rng)
        return _diagnose(first, rng, clock, hold_out, side_by_side)


def _diagnose(
    first: Detected,
    rng: np.random.Generator,
    clock: StepClock,
    hold_out: Recording | None,
    side_by_side: SideBySide,
) -> Diagnosis:
    comparison, base, found, free = first.comparison, first.base, first.found, first.free
    detection = first.detection
    candidates: list[Candidate] = [Candidate((), base, base.log_evidence, 1.0, "")]
    residual_p: dict[tuple[str, ...], float] = {(): detection.p_value}
    if off := not_described(comparison, base):
        if not detection.p_value < MISMATCH_P:
            detection = replace(detection, p_value=CERTAIN_P, extrapolated=True)
            residual_p[()] = CERTAIN_P
        clock("")
        verdict: Verdict[Candidate] = Verdict("unresolved", None, (), 0.0, f"{NOT_DESCRIBED}: {off}")
        return Diagnosis(
            comparison, base, detection, [], candidates, residual_p, verdict, seconds=clock.seconds, not_described=off
        )
    held_out, term, correction, beside, tests = None, None, None, None, []
    best: Candidate | None = None
    search = Search(comparison, base, side_by_side, clock.tell)
    if detection.p_value >= MISMATCH_P:
        # What is too small to be seen may still be there, and f_overall with it would be another.
        clock("look farther")
        search.singles(found, detection.u, FARTHER)
        base = search.modes[()]
        candidates = search.weighed()
        # With runs in time another explanation may lie far off, where the straight lines of the test do not reach.
        elsewhere = min(1.0, TESTS * evidence_p(comparison, search.modes)) if comparison.problem.blocks.runs else 1.0
        if elsewhere < MISMATCH_P:
            detection = replace(detection, p_value=elsewhere, extrapolated=True)
            residual_p[()] = elsewhere
    if detection.p_value < MISMATCH_P:
        clock("name")
        if len(search.modes) == 1:
            # Beside a nuisance far off or loud noise the straight lines of the screen say little.
            search.singles(found, detection.u, every=bool(detection.pulled or too_loud(base.u)))
        base = search.modes[()]  # with runs in time refitted from where the best effect led
        clock("test what is left")
        _test_residuals(comparison, _namable(search)[:1], residual_p, rng, side_by_side)
        clock("name")
        search.pairs(next((names for names, p in residual_p.items() if names and p >= RESIDUAL_P), None))
        candidates = search.weighed()
        clock("test what is left")
        ranked = _namable(search)[:TESTED]
        _test_residuals(comparison, ranked[:1], residual_p, rng, side_by_side)
        if ranked and residual_p[ranked[0].names] >= RESIDUAL_P:
            ranked = [one for one in ranked if one.probability > SHARE * ranked[0].probability]
        _test_residuals(comparison, ranked, residual_p, rng, side_by_side)
        _test_what_may_be_named(comparison, _namable(search), residual_p, rng, side_by_side)
        likeliest = [one for one in candidates if one.names][:1]
        _test_residuals(comparison, [one for one in likeliest if is_small(one)], residual_p, rng, side_by_side)
        clock("confirm")
        passing = (c for c in candidates if c.names and not c.refused)
        best = next((c for c in passing if residual_p.get(c.names, 0.0) >= RESIDUAL_P), None)
        if best is not None:
            held_out = cross_validate(comparison, candidates, best.names)
    verdict = judge(detection.p_value, candidates, residual_p, held_out)
    if best is not None and verdict.chosen is not None and verdict.chosen.names != best.names:
        held_out = cross_validate(comparison, candidates, verdict.chosen.names)  # it counts the folds that chose it
    if verdict.kind == "consistent":
        held_out = None  # it was of a set that is not said
    unseen_run: HeldOut | None = None
    if hold_out is not None and verdict.chosen is not None:
        clock("predict the unseen run")
        held_out = unseen_run = predict_unseen(comparison, base, verdict.chosen.mode, hold_out)
        if verdict.kind == "named" and held_out.gain <= ERRORS * held_out.gain_se:
            words = f"{' and '.join(verdict.chosen.names)} does not predict the unseen run better"
            verdict = Verdict("unresolved", None, (), 0.0, words)
    # Of a model that does not fit, no reading can be said to be off.
    unfit = verdict.kind == "unresolved"
    bad = [] if unfit else bad_rows(comparison, verdict.chosen.mode if verdict.chosen else base)
    misread = with_misread(comparison, verdict, candidates)
    if verdict.kind == "consistent" and bad:
        chance = by_chance(comparison, base)
        if chance < MISMATCH_P:
            detection = replace(detection, p_value=min(detection.p_value, chance))
            verdict = Verdict("named", None, (), min(row[3] for row in bad), "single readings that nothing explains")
            if end := alone_at_an_end(comparison, base):
                place = f"{end[0]}, row {end[1]}, is the only one at that end of the pressures"
                why = f"{place}: it may be misread, or the motor does something else there"
                verdict = Verdict("unresolved", None, (), 0.0, why)
                bad, misread = [], frozenset()
        else:
            verdict = replace(verdict, why=f"{verdict.why}; readings stand out no more than heavy tails would")
    step = None
    if verdict.kind in ("named", "confounded"):
        clock("a step in time instead")
        step = step_instead(comparison, verdict.chosen.mode if verdict.chosen else base)
        if step is not None and step.explains:
            instead = " and ".join(verdict.chosen.names) if verdict.chosen else "a misread row"
            verdict = Verdict("unresolved", None, (), 0.0, f"{step.text} explains it as well as {instead}")
            bad, misread = [], frozenset()
    clock("locate")
    acts_in = effects()[verdict.chosen.names[0]].acts_in if verdict.chosen and len(verdict.chosen.names) == 1 else ""
    if verdict.kind == "consistent":
        places = []
    elif verdict.kind == "named" and verdict.chosen is None:
        places = rows_as_places(bad)
    else:
        places = locate(comparison, base, detection, free, acts_in)
        if verdict.chosen and verdict.chosen.names in misread:
            places += rows_as_places(bad)
        if step is not None and step.explains:
            places.insert(0, step.place)
    if verdict.kind == "unresolved":
        if loud := too_loud(np.maximum(detection.u, base.u)):
            noise = f"the {loud[0]}'s noise would be {loud[1]:.1f} times as large as declared"
            verdict = replace(verdict, why=f"{verdict.why}; {noise}")
        if detection.pulled:
            verdict = replace(verdict, why=f"{verdict.why}; {detection.pulled} would be farther off than is believable")
        clock("look for a law")
        smooth = corrections(comparison, base, detection.u)
        correction, beside = (smooth[0], nuisances_beside(comparison, base, smooth)) if smooth else (None, None)
        term = discover(comparison, base, detection.u, rng, correction.balance) if correction else None
        held_out = unseen_run or hold_out_smooth(comparison, base, detection.u)
        if held_out is not None and held_out.gain < -WORTHLESS * int(comparison.known.sum()):
            held_out = None
    rivals = _rivals(candidates, verdict)
    if rivals:
        clock("next test")
        tests = propose(comparison, rivals)
    clock("weigh f_overall")
    chosen = verdict.chosen.names if verdict.chosen else ()
    unseen = {
        names: faint(comparison, search.modes[names], search.signatures_at(names), rng)
        for names in ([] if verdict.kind == "unresolved" else [chosen, *verdict.alternatives])
    }
    clock("")
    return Diagnosis(
        comparison,
        base,
        detection,
        places,
        candidates,
        residual_p,
        verdict,
        held_out,
        term,
        tests,
        bad,
        clock.seconds,
        correction,
        beside,
        misread,
        unseen,
        resolved(first.comparison, first.base, first.detection.u, found),
    )


def held_out_gain(folder: Path, ids: Sequence[str]) -> float:
    """The gain in log predictive density of a given set over the base model, as the diagnosis takes it [-].

    Parameters
    ----------
    folder : Path
        A recording.
    ids : sequence of str
        Effects.
    """
    comparison = Comparison(Problem(read_recording(folder)))
    base = base_of(comparison)
    names = tuple(sorted(set(ids) - {MISREAD}))  # every fit looks for those
    best = max((find(comparison, names, start) for start in (base, None)), key=lambda mode: mode.log_evidence)
    # The oracle need not choose: it knows the set.
    known = [Candidate(names, best, best.log_evidence, 1.0, ""), Candidate((), base, base.log_evidence, 0.0, "")]
    return cross_validate(comparison, known, names, choose=False).gain


def _namable(search: Search) -> list[Candidate]:
    return [one for one in search.weighed() if one.names and not one.refused]


def _test_residuals(
    comparison: Comparison,
    sets: Sequence[Candidate],
    residual_p: dict[tuple[str, ...], float],
    rng: np.random.Generator,
    side_by_side: SideBySide,
) -> None:
    """Test what sets leave that were not tested before."""
    untested = [one for one in sets if one.names not in residual_p]
    seeds = [int(seed) for seed in rng.integers(2**62, size=len(untested))]
    found = side_by_side(_residual, [(comparison, one.mode, seed) for one, seed in zip(untested, seeds, strict=True)])
    residual_p.update({one.names: p for one, p in zip(untested, found, strict=True)})


def _test_what_may_be_named(
    comparison: Comparison,
    namable: Sequence[Candidate],
    residual_p: dict[tuple[str, ...], float],
    rng: np.random.Generator,
    side_by_side: SideBySide,
) -> None:
    """Where some set passes: test those more probable, and its parts that may suffice."""
    if all(residual_p.get(one.names, 0.0) < RESIDUAL_P for one in namable):
        return
    for one in namable:
        _test_residuals(comparison, [one], residual_p, rng, side_by_side)
        if residual_p[one.names] >= RESIDUAL_P:
            parts = [c for c in namable if set(c.names) < set(one.names)]
            likely = [c for c in parts if one.probability < SUPERSET_ODDS * c.probability]
            _test_residuals(comparison, likely, residual_p, rng, side_by_side)
            return


def _residual(comparison: Comparison, mode: Mode, seed: int) -> float:
    found, free = signatures(comparison, mode), forces(comparison, mode)
    rng = np.random.default_rng(seed)
    p = detect(comparison, mode, found, free, rng, RESIDUAL_DRAWS).p_value
    if RESIDUAL_P / NEAR < p < RESIDUAL_P * NEAR:  # a tail of so few draws is too rough to decide it
        p = detect(comparison, mode, found, free, rng, MORE_DRAWS).p_value
    return p


def _rivals(candidates: list[Candidate], verdict: Verdict[Candidate]) -> list[Candidate]:
    """Sets that a next test should tell apart; none where nothing is open."""
    if verdict.kind == "named":
        return []
    if verdict.kind == "consistent":
        likely = not_excluded(candidates)
        return [*(c for c in candidates if not c.names), *likely] if likely else []
    if verdict.chosen is None:
        return sorted((c for c in candidates if c.names), key=lambda c: bool(c.refused))[:3]  # most probable first
    listed = set(verdict.alternatives)
    return [verdict.chosen, *(c for c in candidates if c.names in listed)]


__all__ = ["Detected", "Diagnosis", "detect_mismatch", "diagnose", "held_out_gain"]
