"""The base model of a recording, and the test of it: whether anything is missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.steps.detect import Detection, detect
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Force
from calibration.likelihood.signatures import Signature, signatures
from calibration.systems.look_up import compared
from calibration.systems.several.sharing import SHARED, Sharing
from calibration.work.step_clock import Tell
from calibration.work.threads import threads
from model.motor import Motor
from rig.recording import Recording, RecordingError


@dataclass(frozen=True)
class Detected:
    """What the base model and the test of it come to, before anything is looked for."""

    comparison: Compared
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

    `workers`: threads that simulate side by side; the result is the same [-].
    `motor`: the motor that it names, when left out.
    Raises RecordingError when the motor's model gives no reading of it at all.
    """
    comparison, base = fit_base(recording, tell, workers, motor)
    tell("detect")
    return test_base(comparison, base, rng)


def fit_base(
    recording: Recording | Sequence[Recording],
    tell: Tell,
    workers: int = 1,
    motor: Motor | None = None,
    sharing: Sharing = SHARED,
) -> tuple[Compared, Mode]:
    """The recording as a vector, and the base model at its most probable point.

    Raises RecordingError when the motor's model gives no reading of it at all.
    """
    tell("base model")
    with threads(workers):
        try:
            comparison = compared(recording, motor, sharing)
            return comparison, comparison.base()
        except RecordingError:
            raise
        except (ArithmeticError, ValueError) as problem:  # such as a pressure that no air has, or none at all
            folder = (recording if isinstance(recording, Recording) else recording[0]).folder
            raise RecordingError(
                f"{folder}: the model gives no reading of it ({problem}); are the pressures absolute or "
                "gauge as declared, was the gauge read in every run, and is it this motor?"
            ) from None


def test_base(comparison: Compared, base: Mode, rng: np.random.Generator) -> Detected:
    """Whether anything is missing from the base model."""
    found, free = signatures(comparison, base), comparison.places.forces(base)
    return Detected(comparison, base, found, free, detect(comparison, base, found, free, rng))
