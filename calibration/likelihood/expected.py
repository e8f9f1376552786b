"""Tests that nobody has made yet, and what each would read if an explanation holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.likelihood.mode import Mode

MODEL_SD = 5e-3  # of flow and speed: what two solutions of a model's equations differ by


@dataclass(frozen=True)
class Expected:
    """What a test would read if an explanation holds.

    Attributes
    ----------
    mean : ndarray, shape (m,)
        Expected, in standard deviations of the noise [-].
    shared : ndarray, shape (m, m)
        Covariance of what the recording leaves open, the same in each repeat [-].
    own : ndarray, shape (m, m)
        Covariance of noise and of all that is new in each repeat [-].
    """

    mean: np.ndarray
    shared: np.ndarray
    own: np.ndarray


@dataclass(frozen=True)
class Capture:
    """What is taken in a test, where the bench can take it by itself.

    Attributes
    ----------
    kind : str
        ``coast-down``, ``spin-up``, ``plateaus`` or ``zero``, as `spinbench capture` calls it.
    level_bar_abs : float or None
        Absolute pressure before or after the valve turns, or of the plateaus [bar]; None of a zero.
    added_inertia_kg_m2 : float
        Of a flywheel on the shaft [kg m2].
    """

    kind: str
    level_bar_abs: float | None = None
    added_inertia_kg_m2: float = 0.0

    @property
    def command(self) -> str:
        """The command that takes it, with BENCH for the bench file."""
        words = f"spinbench capture BENCH --kind {self.kind}"
        if self.level_bar_abs is not None:
            words += f" --level-bar-abs {self.level_bar_abs:g}"
        return f"{words} --added-inertia-kg-m2 {self.added_inertia_kg_m2:g}" if self.added_inertia_kg_m2 else words


@dataclass(frozen=True)
class Test:
    """A test.

    Attributes
    ----------
    words : str
        What to do.
    needs : str
        The instrument that it needs and the bench may not have; empty otherwise.
    expected : callable
        From modes, one an explanation, to what it would read under each; an ArithmeticError where it has no reading.
    capture : Capture or None
        What is taken; None where the bench cannot take it by itself.
    """

    __test__ = False  # no test of pytest's

    words: str
    needs: str
    expected: Callable[[Sequence[Mode]], list[Expected]]
    capture: Capture | None = None
