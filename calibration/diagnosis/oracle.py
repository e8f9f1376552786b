"""How much better than the base model a set of effects that somebody knows predicts unseen readings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from calibration.diagnosis.steps.candidate import alone
from calibration.diagnosis.steps.confirm import cross_validate
from calibration.diagnosis.steps.misread import MISREAD
from calibration.likelihood.descent import find
from calibration.systems.look_up import compared
from rig.recording import read_recording


def held_out_gain(folder: Path, ids: Sequence[str]) -> float:
    """The gain in log predictive density of a given set over the base model, as the diagnosis takes it [-]."""
    comparison = compared(read_recording(folder))
    base = comparison.base()
    names = tuple(sorted(set(ids) - {MISREAD}))  # every fit looks for those
    best = max((find(comparison, names, start) for start in (base, None)), key=lambda mode: mode.log_evidence)
    # The oracle need not choose: it knows the set.
    return cross_validate(comparison, [alone(best), alone(base)], names, choose=False).gain
