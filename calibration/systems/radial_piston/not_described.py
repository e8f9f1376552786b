"""Whether the base model describes a recording at all: where it does not, nothing is looked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.predict.kinds import FLOW, RUN, SPEED

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

# Share of a reading by which the base model may miss it, at the median. Of effects as large as the list allows speeds
# are missed by 3 % and flows, beside a leak, by 22 %; where units are mixed up, by 40 % and more.
MOST_MISSED = {"speed": 0.2, "flow": 0.5}
CHECK = (
    "the units of each column",
    "which motor it is, and its file",
    "the clock, and the times of supply_open",
    "the tachometer's pulses per turn",
    "whether the pressures are absolute or gauge",
)


def not_described(comparison: Comparison, base: Mode) -> str:
    """How far the base model is from the readings where it does not describe them at all; empty where it does."""
    missed = np.abs(comparison.read - comparison.raw(base.prediction))
    runs = comparison.problem.blocks.runs
    parts = [("flow", FLOW, "the flows of the plateaus"), ("speed", SPEED, "the speeds of the plateaus")]
    parts += [("speed", RUN + i, f"the speeds of {run.file}") for i, run in enumerate(runs)]
    far = []
    for channel, kind, words in parts:
        mine = (comparison.kind == kind) & comparison.known & (np.abs(comparison.read) > 0.0)
        if not mine.any():
            continue
        share = float(np.median(missed[mine] / np.abs(comparison.read[mine])))
        if not share <= MOST_MISSED[channel]:  # nan too: nothing is predicted there
            far.append((share, words))
    if not far:
        return ""
    share, words = max(far, key=lambda one: np.nan_to_num(one[0], nan=np.inf))
    return (
        f"{words} are off by {100.0 * share:.0f} % at the median"
        if np.isfinite(share)
        else f"{words} have no prediction"
    )
