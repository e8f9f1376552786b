"""Step 2: where the mismatch is, by free-form forces tested one balance and one coordinate at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, rankdata

from calibration.diagnosis.detect import Detection
from calibration.diagnosis.linear import Comparison
from calibration.diagnosis.mode import Mode
from calibration.diagnosis.signatures import Force

FOUND_P = 0.01  # after the number of forces tested is priced
STANDS_OUT = 0.5  # share of the largest score that a piece needs to belong to the place
SAME = 0.98  # rank correlation above which two coordinates are one
NAMES = {"torque": "torque balance", "mass": "flow balance", "sensor": "instrument's reading"}


@dataclass(frozen=True)
class Place:
    """One place, as in diagnosis/1; numbers SI."""

    channel: str
    balance: str
    coordinate: str
    where: tuple[float, float]
    unit: str
    p_value: float
    sentence: str
    same_as: tuple[str, ...]


def locate(
    comparison: Comparison, mode: Mode, detection: Detection, free: Sequence[Force], acts_in: str = ""
) -> list[Place]:
    """Places of a mismatch, the clearest first.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The base model.
    detection : Detection
        Of it.
    free : sequence of Force
        The forces tested.
    acts_in : str
        Where the effect that explains it acts, when one does: then a flow is the instrument's or the balance's.
    """
    found = []
    for force, log_p, scores in zip(free, detection.force_log_p, detection.force_scores, strict=True):
        p = min(1.0, len(free) * math.exp(max(log_p, -690.0)))
        if p >= FOUND_P:
            continue
        size = np.abs(scores)
        out = np.flatnonzero(size >= max(STANDS_OUT * size.max(), float(norm.isf(0.01))))
        if not out.size:
            out = np.array([int(np.argmax(size))])
        where = (float(force.places[out, 0].min()), float(force.places[out, 1].max()))
        balance = "sensor" if acts_in == "sensor" else force.balance
        channel = force.channel
        same = same_coordinates(comparison, mode, force.coordinate)
        sentence = (
            f"The {NAMES[balance]} does not close along {force.coordinate}, most between {where[0]:.3g} and "
            f"{where[1]:.3g} {force.unit} (seen in the {channel})."
        )
        found.append(Place(channel, balance, force.coordinate, where, force.unit, p, sentence, same))
    return sorted(found, key=lambda place: place.p_value)


def same_coordinates(comparison: Comparison, mode: Mode, coordinate: str) -> tuple[str, ...]:
    """Coordinates that the plateaus of this recording cannot tell from one.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The base model.
    coordinate : str
        The one.
    """
    plateaus = comparison.problem.blocks.plateaus
    if plateaus.size < 4:
        return ()
    along = {
        "speed": mode.prediction.speed,
        "pressure": plateaus.pressure,
        "flow": mode.prediction.flow,
        "time": plateaus.time,
        "direction": plateaus.up,
    }
    if coordinate not in along:
        return ()
    if comparison.problem.blocks.runs and coordinate == "speed":
        return ()  # a run in time parts speed from pressure and flow
    mine = rankdata(np.nan_to_num(along[coordinate]))
    found = []
    for name, values in along.items():
        if name == coordinate or np.ptp(np.nan_to_num(values)) == 0.0 or np.ptp(mine) == 0.0:
            continue
        if abs(float(np.corrcoef(mine, rankdata(np.nan_to_num(values)))[0, 1])) > SAME:
            found.append(name)
    return tuple(found)


def rows_as_places(bad: Sequence[tuple[str, int, str, float]]) -> list[Place]:
    """Single readings that nothing explains, as places.

    Parameters
    ----------
    bad : sequence of (str, int, str, float)
        File, row, channel and the probability that the reading is bad.
    """
    found = []
    for file, row, channel, probability in bad:
        sentence = f"The {channel} in {file}, row {row}, stands out from everything else."
        found.append(Place(channel, "sensor", "row", (float(row), float(row)), "1", 1.0 - probability, sentence, ()))
    return found
