"""Forces and errors of instruments beyond those of the detection: looked at once a mismatch is certain, to place it.

The detection's statistic is the best of all that it tries, so each further force would cost it power. Here the search
has begun already; their p-values pay for their number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Force
from calibration.systems.radial_piston.places.coordinates import coordinates, same_coordinates, samples_a_turn
from calibration.systems.radial_piston.places.forces import TorqueAnswer, torque_column
from calibration.systems.radial_piston.places.terms import A_PERIOD, HARMONICS, harmonics

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison


def angle_force(comparison: Comparison, mode: Mode) -> Force | None:
    """A torque along the shaft's angle, as far as the samples of the runs resolve it; None where they do not."""
    along = coordinates(comparison, mode)
    answer = TorqueAnswer(comparison, torque_column(comparison, mode))
    waves = harmonics(comparison, along["angle"], along["speed"], answer)
    if not waves:
        return None
    columns = np.hstack([one.columns for one in waves])
    return Force("speed", "torque", "angle", "rad", columns, np.tile([0.0, 2.0 * np.pi], (columns.shape[1], 1)))


def not_observable(comparison: Comparison, mode: Mode) -> list[str]:
    """Coordinates along which this recording can show nothing, each in a sentence."""
    said, plateaus = [], comparison.problem.blocks.plateaus
    samples = samples_a_turn(comparison, mode)
    if samples == 0.0:
        said.append("Shaft angle: every row is a mean over many turns.")
    elif samples < A_PERIOD:
        said.append(f"Shaft angle: {samples:.2g} samples a turn do not resolve it.")
    elif samples < A_PERIOD * HARMONICS[-1]:
        said.append(
            f"Shaft angle: {samples:.2g} samples a turn show what comes {int(samples / A_PERIOD)} times a turn at most."
        )
    if not (np.any(plateaus.up > 0) and np.any(plateaus.up < 0)):
        said.append("Sweep direction: the pressure went one way only, or that was not noted.")
    if plateaus.size < 8 or np.ptp(plateaus.time) == 0.0:
        row = f": {plateaus.untimed}, has none" if plateaus.untimed else ""
        said.append(f"Running time: there are fewer than eight plateaus with a time{row}.")
    if not np.isfinite(plateaus.flow).any():
        said.append("Flow balance: no flow was read at a plateau.")
    alike = same_coordinates(comparison, mode, "pressure")
    if alike:
        said.append(f"Pressure apart from {' and '.join(alike)}: at the plateaus they move together.")
    return said
