"""What changed between two recordings of one motor, by the engine of the diagnosis.

A change is to the engine an effect like any other: a parameter of the motor that is another in the second recording, or
an effect with a size in each. "Nothing changed" is every set without one, the base model first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.f_overall import of_solvers
from calibration.diagnosis.result import Diagnosis, several_of
from calibration.diagnosis.sizes.sizes import LAW
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.verdict import VerdictKind, is_small
from calibration.likelihood.function import Function
from calibration.likelihood.tails import log_ratio
from calibration.systems.several.sharing import OF_THE_MOTOR_CHANGED, Sharing
from calibration.unknowns.effects import is_change, unchanged
from calibration.unknowns.priors import Unknown
from calibration.work.step_clock import Tell
from rig.recording import Recording

DRAWS = 20_000


class Answer(StrEnum):
    """What is said of two recordings."""

    UNCHANGED = "unchanged"
    CHANGED = "changed"  # and by what
    CONFOUNDED = "confounded"  # something changed, and several changes explain it
    OPEN = "open"  # a change explains them, and so does none
    UNRESOLVED = "unresolved"  # no set of changes and effects does


@dataclass(frozen=True)
class Moved:
    """A quantity in both recordings.

    `before`, `after`, `change`, shape (n,): draws of the posterior [the quantity's unit].
    """

    quantity: Unknown
    before: np.ndarray
    after: np.ndarray

    @property
    def change(self) -> np.ndarray:
        """The later value less the earlier one."""
        return self.after - self.before


def compare(
    before: Recording, after: Recording, seed: int = 0, tell: Tell = lambda _: None, workers: int = 1
) -> Diagnosis:
    """Weigh what may have changed from one recording to another of the same motor.

    `workers`: processes that refit sets side by side, where there are runs in time; the result is the same [-].
    Raises RecordingError when one cannot be used, or they are not of one motor.
    """
    return diagnose([before, after], seed, tell, None, workers, sharing=Sharing(changes=True))


def changes_in(names: Sequence[str]) -> tuple[str, ...]:
    """The members of a set that are changes."""
    return tuple(name for name in names if is_change(name))


def answer(found: Diagnosis) -> Answer:
    """What the verdict on the sets says of a change."""
    verdict = found.verdict
    if verdict.kind == VerdictKind.CONSISTENT or (verdict.kind == VerdictKind.NAMED and verdict.chosen is None):
        return Answer.UNCHANGED  # single readings that are off are no change
    if verdict.kind == VerdictKind.UNRESOLVED or verdict.chosen is None:
        return Answer.UNRESOLVED
    said = [changes_in(names) for names in (verdict.chosen.names, *verdict.alternatives)]
    if not any(said):
        return Answer.UNCHANGED
    if not all(said):
        return Answer.OPEN
    return Answer.CHANGED if len(set(said)) == 1 else Answer.CONFOUNDED


def unchanged_probability(found: Diagnosis) -> float:
    """Probability of all sets without a change, among those weighed [-]: an instrument that is off by no more than it
    is declared to be is none.
    """
    return min(1.0, sum(one.probability for one in found.candidates if not changes_in(one.names) or is_small(one)))


def probability_of(found: Diagnosis, change: str) -> float:
    """Probability of all sets with a change, among those weighed [-]."""
    return min(1.0, sum(one.probability for one in found.candidates if change in one.names))


def best_with(found: Diagnosis, change: str) -> Candidate | None:
    """The set with a change that its figures are taken from: the verdict's, or the most probable one."""
    chosen = found.verdict.chosen
    if chosen is not None and change in chosen.names:
        return chosen
    return next((one for one in found.candidates if change in one.names), None)


def moved(found: Diagnosis, one: Candidate, change: str) -> list[Moved]:
    """The quantities of a change before and after, by the posterior of a set that holds it.

    What is not known of the laws is the same on both days, and moves both values alike.
    """
    problem, rng = several_of(found).problem, np.random.default_rng(0)
    f, mode = Function(found.comparison, one.names), one.mode
    z = rng.multivariate_normal(mode.z, mode.covariance, DRAWS, method="cholesky")
    inside = np.all((z >= f.low) & (z <= f.high), axis=1)
    sizes = [
        f.k + i
        for i, (name, unknown) in enumerate(problem.effect_unknowns(one.names))
        if not problem.parameter(name, unknown.name).shape
    ]
    weight = np.where(inside, np.exp(np.minimum(log_ratio(z[:, sizes]).sum(axis=1), 50.0)), 0.0)
    z = z[rng.choice(DRAWS, DRAWS, p=weight / weight.sum())]
    share = of_solvers(found) if unchanged(change) == "f_overall" else LAW
    off = 1.0 + share * rng.standard_normal(DRAWS)
    made = []
    for quantity, before, after in problem.of_change(change, one.names, z):
        of_shape = quantity.kind == "lognormal" and change not in OF_THE_MOTOR_CHANGED
        made.append(Moved(quantity, before, after) if of_shape else Moved(quantity, before * off, after * off))
    return made
