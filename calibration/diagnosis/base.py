"""Step 1: the base model of a recording, what everything else is held against."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.diagnosis.descent import find, opened
from calibration.diagnosis.function import Function
from calibration.diagnosis.linear import Comparison
from calibration.diagnosis.mode import Mode

OFF = 5.0  # sds beyond which a reading that stands out from its neighbours says nothing of their noise


def base_of(comparison: Comparison) -> Mode:
    """The base model at its most probable point; found once more with runs in time, with the pulses' swing taken there.

    Parameters
    ----------
    comparison : Comparison
        The recording; its problem's angles and its swing are changed.
    """
    base = find(comparison, (), roughly=True)
    misread = _standing_out(comparison, base)
    if misread.any():
        comparison.noise.leave_alone(misread)
    if comparison.problem.blocks.runs:
        turned = set_angles(comparison, base)
        return find(comparison, (), turned, None) if misread.any() else find(comparison, (), turned)
    return find(comparison, (), base) if misread.any() else base


def _standing_out(comparison: Comparison, mode: Mode) -> np.ndarray:
    """Plateaus of which a reading is far off while those before and after are not, shape (n,)."""
    n = comparison.n
    sd = np.linalg.norm(comparison.whitener(mode.prediction, mode.u).plateaus, axis=1)
    far = np.abs(np.nan_to_num(comparison.read - comparison.raw(mode.prediction))[: 2 * n] / sd).reshape(2, n)
    beside = np.pad(far, ((0, 0), (1, 1)))
    found: np.ndarray = np.any((far > OFF) & (far > 2.0 * np.maximum(beside[:, :-2], beside[:, 2:])), axis=0)
    return found


def set_angles(comparison: Comparison, mode: Mode) -> Mode:
    """Take the starting angles of a mode, and the swing of its pulses, as those to deviate from.

    Parameters
    ----------
    comparison : Comparison
        The recording; its problem's angles and its swing are changed.
    mode : Mode
        The point.

    Returns
    -------
    Mode
        The point with the angles' deviations set to 0: a start for `find`.
    """
    problem = comparison.problem
    k = len(problem.nuisances)
    z = mode.z.copy()
    for i, unknown in enumerate(problem.nuisances):
        if unknown.name.endswith(".angle"):
            problem.start_angle[unknown.name.removesuffix(".angle")] += float(unknown.value(z[i]))
            z[i] = 0.0
    comparison.see_pulses(z[:k])
    return replace(mode, z=opened(Function(comparison, mode.names), comparison, z, np.zeros(mode.u.size)))
