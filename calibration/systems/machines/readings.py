"""What a recording of another rig is compared in: readings with their noise, and unknowns of which nothing is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.unknowns.priors import OfRun
from rig.recording import Recording, RecordingFile
from rig.recording.columns import NUMERIC

TO_SI = {known.column: known.to_si for known in NUMERIC.values()}
SAME_SPEED, SAME_PRESSURE = 0.03, 0.005  # relative: rows closer than this are at one state
LEVEL = 0.02  # readings of pressure closer than this, relative, are one level
ROWS_EACH = 4  # on average, from which on rows are taken together
MOST_ALIKE = 0.9


@dataclass(frozen=True)
class Readings:
    """Readings that are compared, shape (n,).

    `value`, `sd`: [SI].
    `serial`: whether neighbours follow each other in time, and their noise may be correlated.
    `label`: names these readings: they share a noise level and a correlation.
    `whitener`, shape (n, n): what makes their noise independent and of deviation 1 where they share readings; else
        ``sd`` does.
    """

    channel: str
    value: np.ndarray
    sd: np.ndarray
    serial: bool
    label: str
    whitener: np.ndarray | None = None

    def white(self, residual: np.ndarray) -> np.ndarray:
        """Residuals in units of their noise [-]. `residual`, shape (n,) or (n, k): readings less predictions [SI]."""
        if self.whitener is not None:
            return self.whitener @ residual
        return residual / (self.sd if residual.ndim == 1 else self.sd[:, None])


@dataclass(frozen=True)
class Flat:
    """An unknown of which nothing is known: where a search starts, its size, its lower bound, and whose it is."""

    name: str
    unit: str
    start: float
    size: float
    low: float
    of: OfRun | None = None


def noise_sd(recording: Recording, column: str, file: RecordingFile) -> float:
    """Declared noise of one row, its resolution included [SI]."""
    figures = recording.channels[column]
    return float(np.hypot(figures.noise_sd * file.noise_scale, figures.resolution / np.sqrt(12.0)) * TO_SI[column])


def plateaus(speed: np.ndarray, pressure: np.ndarray, file: np.ndarray) -> np.ndarray:
    """Number of the plateau of each steady row, from 0: rows that follow each other at one state are one.

    A table logged row by row has its true noise from plateau to plateau, not from row to row. Where most rows are
    states of their own each stays one.

    `speed`, `pressure`, shape (n,): [rad/s], [Pa].
    `file`, shape (n,): number of the file.
    """
    found = np.zeros(speed.size, dtype=int)
    first = 0
    for i in range(1, speed.size):
        same = file[i] == file[first] and abs(pressure[i] - pressure[first]) <= SAME_PRESSURE * abs(pressure[first])
        if not (same and abs(speed[i] - speed[first]) <= SAME_SPEED * abs(speed[first])):
            first = i
            found[i] = found[i - 1] + 1
        else:
            found[i] = found[i - 1]
    return found if speed.size and speed.size >= ROWS_EACH * (found[-1] + 1) else np.arange(speed.size)


def means(values: np.ndarray, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of each group, and its noise in units of a row's: neighbours that are alike tell less.

    `values`, shape (n,): of the rows [SI]; nan where there is none.
    `group`, shape (n,): number of each row's group, from 0.
    """
    has = np.isfinite(values)
    n = int(group[-1]) + 1
    count = np.bincount(group[has], minlength=n)
    mean = np.bincount(group[has], values[has], minlength=n) / np.where(count, count, np.nan)
    rest = np.where(has, values - mean[group], 0.0)
    pairs = group[1:] == group[:-1]
    square = float(np.sum(rest**2))
    alike = float(np.sum((rest[1:] * rest[:-1])[pairs])) / square if square > 0.0 else 0.0
    rho = min(max(alike, 0.0), MOST_ALIKE)
    share = np.where(count > 1, (1.0 + rho) / (1.0 - rho), 1.0) / np.maximum(count, 1)
    return mean, np.sqrt(np.minimum(share, 1.0))
