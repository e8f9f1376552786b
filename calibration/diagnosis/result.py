"""Everything that a diagnosis found."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from calibration.diagnosis.next_test.promised import Kept
from calibration.diagnosis.next_test.recommend import NextTest
from calibration.diagnosis.sizes.not_excluded import Undetected
from calibration.diagnosis.sizes.resolves import Resolved
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.confirm import HeldOut
from calibration.diagnosis.steps.correction import Correction
from calibration.diagnosis.steps.detect import Detection
from calibration.diagnosis.steps.discover import Term
from calibration.diagnosis.steps.locate import Place
from calibration.diagnosis.steps.misread import BadRow
from calibration.diagnosis.steps.verdict import Verdict
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode
from calibration.systems.several.comparison import Several


@dataclass(kw_only=True)
class Diagnosis:
    """Everything that was found.

    `residual_p`, `left`: of each set tested: the p-value of what it leaves, and the share of the mismatch that this is,
        where that is weighed [-].
    `held_out`: Cross-validation: of the set named, or of the smooth correction where no set explains the recording; or
        the prediction of an unseen run.
    `unseen_run`: the prediction of a run that was held out, whether the set is named after it or refused.
    `seconds`: time of each step [s].
    `correction`: a smooth torque or flow that stands for what no set explains.
    `nuisances_corrected`: the nuisances and their sd beside such a correction, whichever it is [-].
    `undetected`: for each set that f_overall is averaged over, the further effects that may be there unseen.
    `not_described`: how far the base model is off where it does not describe the readings at all, and nothing was
        looked for.
    `rivals`: the sets that the next tests are to tell apart.
    `promised`: what tests that were asked for before have given.
    """

    comparison: Compared
    base: Mode
    detection: Detection
    places: list[Place]
    candidates: list[Candidate]
    residual_p: dict[tuple[str, ...], float]
    left: dict[tuple[str, ...], float]
    verdict: Verdict
    held_out: HeldOut | None = None
    unseen_run: HeldOut | None = None
    term: Term | None = None
    next_tests: list[NextTest] = field(default_factory=list)
    bad_rows: list[BadRow] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    correction: Correction | None = None
    nuisances_corrected: tuple[np.ndarray, np.ndarray] | None = None
    misread: frozenset[tuple[str, ...]] = frozenset()
    undetected: dict[tuple[str, ...], list[Undetected]] = field(default_factory=dict)
    resolved: list[Resolved] = field(default_factory=list)
    not_described: str = ""
    rivals: list[Candidate] = field(default_factory=list)
    promised: list[Kept] = field(default_factory=list)


def several_of(found: Diagnosis) -> Several:
    """The recordings that were held against each other."""
    return cast(Several, found.comparison)


def of_each_recording(found: Diagnosis) -> dict[str, Diagnosis]:
    """What was found, as each of several recordings shows it, by their names; of one recording, as it is."""
    several = found.comparison
    if not isinstance(several, Several):
        return {several.problem.recording.folder.name: found}
    return {name: _of_one(found, several, k) for k, name in enumerate(several.names)}


def _of_one(found: Diagnosis, several: Several, k: int) -> Diagnosis:
    at, share = several.at[k], several.problem.share(k)

    def own(one: Candidate) -> Candidate:
        return replace(one, mode=several.of_part(k, one.mode))

    correction = found.correction
    if correction is not None:
        z, z_sd = share @ correction.z, np.sqrt(share**2 @ correction.z_sd**2)
        correction = replace(correction, column=correction.column[at], z=z, z_sd=z_sd)
    chosen = found.verdict.chosen
    nuisances = found.nuisances_corrected
    if nuisances is not None:
        nuisances = (share @ nuisances[0], np.sqrt(share**2 @ nuisances[1] ** 2))
    return replace(
        found,
        places=[one for one in found.places if one.recording in ("", several.names[k])],
        comparison=several.parts[k],
        base=several.of_part(k, found.base),
        detection=replace(found.detection, u=found.detection.u[several.noise.places(k)]),
        candidates=[own(one) for one in found.candidates],
        verdict=replace(found.verdict, chosen=None if chosen is None else own(chosen)),
        correction=correction,
        nuisances_corrected=nuisances,
    )
