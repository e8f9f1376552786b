"""The linear problem at a point: whitened derivatives with the nuisances, and whitened readings to explain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration.likelihood.compared import Compared, Whitener
from calibration.likelihood.mode import Mode

FREE = 20.0  # whitened size at which a column's coefficient, a standard normal number, is anything
GOOD = 0.5  # readings that are more probably bad than this are left aside


@dataclass(frozen=True)
class Linearized:
    """A recording as y = J z + noise, standard normal both; what is added are further columns.

    `mode`: the point; no reading of it is bad where bad ones count.
    `good`, shape (m,): 1, or 0 where a reading is bad [-].
    `J`, shape (m, k): derivatives with the unknowns of the mode [-].
    `y`, shape (m,): what is to be explained [-].
    """

    comparison: Compared
    mode: Mode
    white: Whitener
    good: np.ndarray
    J: np.ndarray
    y: np.ndarray

    def columns(self, changes: np.ndarray) -> np.ndarray:
        """Whitened columns of changes of the readings [-], shape (m, k).

        `changes`, shape (m, k): of the readings [SI].
        """
        found: np.ndarray = self.white(changes) * self.good[:, None]
        return found


def freed(white: np.ndarray) -> np.ndarray:
    """Whitened columns, each of a size that leaves its coefficient free [-], shape (m, k).

    `white`, shape (m, k): the columns [-].
    """
    found: np.ndarray = white * (FREE / np.maximum(np.linalg.norm(white, axis=0), 1e-12))
    return found


def linearize(comparison: Compared, mode: Mode, u: np.ndarray, every: bool = False) -> Linearized:
    """The linear problem at a mode. `u`, shape (k,): the noise [-]."""
    if every:
        mode = replace(mode, bad=np.zeros(mode.bad.size))
    white = comparison.whitener(mode.prediction, u)
    good = (mode.bad < GOOD).astype(float)
    y = white(np.nan_to_num(comparison.read - comparison.raw(mode.prediction)) + mode.D @ mode.z) * good
    return Linearized(comparison, mode, white, good, white(mode.D) * good[:, None], y)
