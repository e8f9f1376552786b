"""Tests that nobody has made yet, and what each would read if an explanation holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode

MODEL_SD = 5e-3  # of flow and speed: what two solutions of a model's equations differ by


LEAST_OPEN = 1e-9  # of the most open direction's variance: what is less open is known


@dataclass(frozen=True)
class Expected:
    """What a test would read if an explanation holds.

    `mean`, shape (m,): at the most probable point, in standard deviations of the noise [-].
    `slopes`, shape (m, k): what the readings do along each direction in which the recording leaves the point open, by
        one sd [-].
    `inexact`, shape (m, m): covariance of what the model has wrong, the same in each repeat [-].
    `own`, shape (m, m): covariance of noise and of all that is new in each repeat [-].
    `at`: from a place along the directions, shape (k,) [-], to the readings there; nan where there are none. None: they
        are straight.
    `left`: from such a place to residuals: half the sum of their squares, less that at no step, is what the recording
        and the priors have against it [nats]. None: the place itself.
    """

    mean: np.ndarray
    slopes: np.ndarray
    inexact: np.ndarray
    own: np.ndarray
    at: Callable[[np.ndarray], np.ndarray] | None = None
    left: Callable[[np.ndarray], np.ndarray] | None = None


def directions(covariance: np.ndarray) -> np.ndarray:
    """Directions in which a point is open, each as long as its sd [-], shape (n, k)."""
    variance, unit = np.linalg.eigh(covariance)
    told = variance > LEAST_OPEN * float(variance.max(initial=0.0))
    found: np.ndarray = unit[:, told] * np.sqrt(variance[told])
    return found


class Taken(NamedTuple):
    """A test as if it had been taken.

    `read`: by itself, with readings as they are where each explanation is true.
    `at`: where a search for each explanation begins, the nuisances there, shape (k,) each [-].
    """

    read: Sequence[Compared]
    at: Sequence[np.ndarray]


@dataclass(frozen=True)
class Capture:
    """What is taken in a test, where the bench can take it by itself.

    `kind`: ``coast-down``, ``spin-up``, ``plateaus`` or ``zero``, as `spinbench capture` calls it.
    `level_bar_abs`: absolute pressure before or after the valve turns, or of the plateaus [bar]; None of a zero.
    `added_inertia_kg_m2`: of a flywheel on the shaft [kg m2].
    `bench`: BENCH where it is not known.
    `after`: options that name the run which it belongs to, whose readings the guard then knows.
    """

    kind: str
    level_bar_abs: float | None = None
    added_inertia_kg_m2: float = 0.0
    bench: str = field(default="BENCH", compare=False)
    after: str = field(default="", compare=False)

    @property
    def command(self) -> str:
        """The command that takes it."""
        words = ["spinbench capture", self.bench, f"--kind {self.kind}"]
        words += [f"--level-bar-abs {self.level_bar_abs:g}"] if self.level_bar_abs is not None else []
        words += [f"--added-inertia-kg-m2 {self.added_inertia_kg_m2:g}"] if self.added_inertia_kg_m2 else []
        return " ".join([*words, self.after]).strip()


@dataclass(frozen=True)
class Test:
    """A test.

    `words`: what to do.
    `needs`: the instrument that it needs and the bench may not have; empty otherwise.
    `expected`: from modes, one an explanation, to what it would read under each; an ArithmeticError where it has no
        reading.
    `capture`: what is taken; None where the bench cannot take it by itself.
    `taken`: from the same modes to the test as if it had been taken; None where nothing can be fitted to it.
    """

    __test__ = False  # no test of pytest's

    words: str
    needs: str
    expected: Callable[[Sequence[Mode]], list[Expected]]
    capture: Capture | None = None
    taken: Callable[[Sequence[Mode]], Taken | None] | None = None
