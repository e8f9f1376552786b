"""Readings that a model takes for bad: which they are, and whether noise with heavy tails would explain them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import stdtr

from calibration.data.blocks import LEVEL_PA
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.verdict import MISMATCH_P, Verdict
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode

MISREAD = "bad_reading"  # the effect
BAD_ROW = 0.99  # probability beyond which a reading is named as bad
TAILS = 4.0  # of Student's t: noise with so few degrees of freedom has outliers that nobody has misread

BadRow = tuple[str, int, str, float]  # file, row, channel, probability


def bad_rows(comparison: Compared, mode: Mode) -> list[BadRow]:
    """Readings of the plateaus that a mode takes for bad: file, row, channel and probability [-]."""
    rows = comparison.rows
    return [(*rows[i][:3], float(mode.bad[i])) for i in _bad(comparison, mode)]


def by_chance(comparison: Compared, mode: Mode) -> float:
    """How often one of all readings would lie as far out as the worst, of noise with heavy tails [-].

    `mode`: the model; 1 where it takes no reading for bad.
    """
    bad = _bad(comparison, mode)
    if not bad.size:
        return 1.0
    farthest = float(np.max(np.abs(mode.r[bad])))
    return float(min(1.0, len(comparison.rows) * 2.0 * stdtr(TAILS, -farthest * math.sqrt(TAILS / (TAILS - 2.0)))))


def alone_at_an_end(comparison: Compared, mode: Mode) -> BadRow | None:
    """A row taken for bad as a whole at the lowest or highest level, where no other was taken; None if none is.

    Nothing tells there whether it is misread, or the motor does something that it does nowhere else.
    """
    places, rows = _bad(comparison, mode), comparison.rows
    good = comparison.known[: len(rows)].copy()
    good[places] = False
    for rank, place in enumerate(places):
        mine = rows[place]
        others = [row for row, is_good in zip(rows, good, strict=True) if is_good]
        apart = np.array([row.pressure_pa - mine.pressure_pa for row in others if row.channel == mine.channel])
        beside = np.abs(apart) < LEVEL_PA
        confirmed = any((row.file, row.row) == (mine.file, mine.row) for row in others)  # by the row's other reading
        if not confirmed and not beside.any() and (np.all(apart > 0.0) or np.all(apart < 0.0)):
            return bad_rows(comparison, mode)[rank]
    return None


def with_misread(comparison: Compared, verdict: Verdict, candidates: Sequence[Candidate]) -> frozenset[tuple[str, ...]]:
    """Sets that a verdict rests on or lists and beside which readings are misread."""
    if verdict.chosen is None:
        return frozenset()
    said = {verdict.chosen.names, *verdict.alternatives}
    modes = {one.names: one.mode for one in candidates if one.names in said}
    return frozenset(names for names, mode in modes.items() if by_chance(comparison, mode) < MISMATCH_P)


def _bad(comparison: Compared, mode: Mode) -> np.ndarray:
    """Where they are among the residuals."""
    return np.flatnonzero(mode.bad[: len(comparison.rows)] > BAD_ROW)
