"""The base model of a recording, what everything else is held against."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.descent import find
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, starting_at
from calibration.systems.radial_piston.predict.carried import carried
from calibration.systems.radial_piston.predict.problem import Problem
from calibration.systems.radial_piston.run_starts import with_lines

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

OFF = 5.0  # sds beyond which a reading that stands out from its neighbours says nothing of their noise


def base_of(comparison: Comparison) -> Mode:
    """The base model at its most probable point; found once more with runs in time, with the pulses' swing taken there.

    `comparison`: the recording; what its pulses do, and their swing, are changed.
    """
    begun = _by_plateaus(comparison)
    base = find(comparison, (), begun)
    standing_out = _standing_out(comparison, base)
    count = np.count_nonzero(standing_out, axis=0)
    misread: np.ndarray = count > 0
    if misread.any():
        comparison.noise.leave_alone(misread, count == 1)
    if comparison.problem.blocks.runs:
        comparison.see_pulses(base.z)
        return find(comparison, (), base, None)  # where the plateaus led, a line may be caught far off
    return find(comparison, (), base) if misread.any() else base


def _by_plateaus(comparison: Comparison) -> Mode | None:
    """A start: what the plateaus say, and the lines of the runs in time by what was found so; None without both."""
    problem, recording = comparison.problem, comparison.problem.recording
    if not problem.blocks.runs or not comparison.n:
        return None
    files = tuple(file for file in recording.files if file.kind != "transient")
    steady = type(comparison)(Problem(replace(recording, files=files)))
    mode = find(steady, ())
    f, u = Function(comparison, ()), np.zeros(mode.u.size)
    z = with_lines(comparison, f, carried(steady.problem, mode, problem)[0], u)
    comparison.see_pulses(z)
    return starting_at(f, z, mode.u)


def _standing_out(comparison: Comparison, mode: Mode) -> np.ndarray:
    """Flows, then speeds, of plateaus that are far off while those before and after are not, shape (2, n)."""
    n = comparison.n
    sd = np.linalg.norm(comparison.whitener(mode.prediction, mode.u).plateaus, axis=1)
    far = np.abs(np.nan_to_num(comparison.read - comparison.raw(mode.prediction))[: 2 * n] / sd).reshape(2, n)
    beside = np.pad(far, ((0, 0), (1, 1)))
    return (far > OFF) & (far > 2.0 * np.maximum(beside[:, :-2], beside[:, 2:]))
