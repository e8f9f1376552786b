"""What is said of a mismatch that no set of effects explains: a smooth correction, a law, what else is off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.steps.confirm import HeldOut
from calibration.diagnosis.steps.correction import Correction, corrections, hold_out, nuisances_beside
from calibration.diagnosis.steps.detect import Detection
from calibration.diagnosis.steps.discover import Term, discover
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode

WORTHLESS = 10.0  # nats a reading; a smooth correction that predicts worse by so much predicts nothing


@dataclass(frozen=True)
class Unexplained:
    """What stands in the place of a name.

    `why`: the verdict's reason, with what else speaks against the base model.
    `nuisances`: the nuisances and their sd beside the correction [-].
    """

    why: str
    correction: Correction | None = None
    nuisances: tuple[np.ndarray, np.ndarray] | None = None
    term: Term | None = None
    held_out: HeldOut | None = None


def unexplained(
    comparison: Compared,
    base: Mode,
    detection: Detection,
    why: str,
    unseen_run: HeldOut | None,
    rng: np.random.Generator,
) -> Unexplained:
    """A smooth correction and a law in the place of a name.

    `why`: the verdict's reason.
    `unseen_run`: what an unseen run said of the set that was named.
    """
    if loud := comparison.noise.too_loud(np.maximum(detection.u, base.u)):
        why = f"{why}; the {loud[0]}'s noise would be {loud[1]:.1f} times as large as declared"
    if detection.pulled:
        why = f"{why}; {detection.pulled} would be farther off than is believable"
    smooth = corrections(comparison, base, detection.u)
    correction, nuisances = (smooth[0], nuisances_beside(comparison, base, smooth)) if smooth else (None, None)
    term = discover(comparison, base, detection.u, rng, correction.balance) if correction else None
    held_out = unseen_run or hold_out(comparison, base, detection.u)
    if held_out is not None and held_out.gain < -WORTHLESS * int(comparison.known.sum()):
        held_out = None
    return Unexplained(why, correction, nuisances, term, held_out)
