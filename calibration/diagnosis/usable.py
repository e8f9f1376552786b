"""Recordings that nothing can be said of: refused before any search, in words, or found to be of something else."""

from __future__ import annotations

import numpy as np

from calibration.diagnosis.linear import FLOW, RUN, SPEED, Comparison
from calibration.diagnosis.mode import Mode
from calibration.priors import at_ambient
from model.motor import read_motor
from rig.recording import Recording, RecordingError

PASCAL_PER_BAR = 1e5
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
MOST_STARVED = 0.5  # share of the turning rows; fewer may be misread


def refuse_starved(recording: Recording) -> None:
    """Refuse absolute pressures that are not above the room's while the rotor turns: a gauge's, under a wrong name.

    Parameters
    ----------
    recording : Recording
        Of a motor by name.

    Raises
    ------
    RecordingError
        When this is so in more than half of the steady rows at which the rotor turns.
    """
    if not isinstance(recording.motor, str):
        return
    P_a = at_ambient(read_motor(recording.motor), recording).si("ambient_pressure") / PASCAL_PER_BAR
    turning, starved = 0, []
    for file in recording.files:
        pressure, speed = file.columns.get("pressure_bar_abs"), file.columns.get("speed_rpm")
        if file.kind != "steady" or pressure is None or speed is None:
            continue
        turns = (speed.censor == 0) & (speed.values > 0.0) & (pressure.censor == 0) & np.isfinite(pressure.values)
        turning += int(turns.sum())
        starved += [
            f"{file.file}, row {i + 1}, column pressure_bar_abs: '{pressure.values[i]:g}' is not above the room's "
            f"{P_a:.3f} bar, yet the rotor turns at {speed.values[i]:g} rpm"
            for i in np.flatnonzero(turns & (pressure.values <= P_a))
        ]
    if len(starved) > MOST_STARVED * turning:
        more = f", and so in {len(starved) - 1} rows more" if len(starved) > 1 else ""
        raise RecordingError(
            f"{recording.folder}/{starved[0]}{more}; if the gauge shows gauge pressure, name the column "
            "pressure_bar_gauge"
        )


def refuse_at_rest(recording: Recording) -> None:
    """Refuse plateaus at none of which the rotor turns, with no run in time beside them: there is no speed to compare.

    Parameters
    ----------
    recording : Recording
        Of a motor by name.

    Raises
    ------
    RecordingError
        When this is so. Rows in which no speed was read say nothing either way.
    """
    if not isinstance(recording.motor, str) or any(file.kind == "transient" for file in recording.files):
        return
    speeds = [file.columns["speed_rpm"] for file in recording.files if "speed_rpm" in file.columns]
    read = [speed.values[np.isfinite(speed.values)] for speed in speeds]
    if any(one.size for one in read) and not any(np.any(one > 0.0) for one in read):
        raise RecordingError(
            f"{recording.folder}: column speed_rpm is 0 in every row, so there is no speed to compare with the "
            "model; record plateaus at which the rotor turns, or a spin-up or coast-down"
        )


def not_described(comparison: Comparison, base: Mode) -> str:
    """How far the base model is from the readings where it does not describe them at all; empty where it does.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    base : Mode
        The base model at its most probable point.
    """
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
