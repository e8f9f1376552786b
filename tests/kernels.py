"""Compile the kernels that most tests wait for, beside lint: each process of a test run would compile them anew."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from calibration.challenge.second_rig.machine import marches, slots
from calibration.fit.fit import prepare
from calibration.likelihood.function import Function
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict.problem import Problem
from model.effects import effects
from tests import diagnosis_recordings as recordings


def main() -> None:
    """Solve one sweep with two runs in time, without effects and with all; ask a fit and the second rig once."""
    marches.steady(slots.vector(), np.array([2e5]))
    with tempfile.TemporaryDirectory() as folder:
        likelihood = prepare(recordings.sweep(Path(folder), 3, {}))[2]
        middle = np.zeros((1, len(likelihood.unknowns)))
        likelihood.log_prob(middle)
        likelihood.bad_probability(middle)
        recordings.add_spin_up(Path(folder), 3, {})
        comparison = Comparison(Problem(recordings.add_coast_down(Path(folder), 3, {})))
    base_of(comparison)
    of = Function(comparison, tuple(effects()))
    for smooth in (False, True):
        of(np.zeros(of.k + len(comparison.problem.effect_unknowns(of.names))), smooth=smooth)


if __name__ == "__main__":
    main()
