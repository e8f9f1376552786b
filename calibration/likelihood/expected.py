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
    command : str
        That takes it, with BENCH for the bench file; empty where there is none.
    """

    __test__ = False  # no test of pytest's

    words: str
    needs: str
    expected: Callable[[Sequence[Mode]], list[Expected]]
    command: str = ""
