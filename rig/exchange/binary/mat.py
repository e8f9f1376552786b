"""MATLAB files up to version 7, with scipy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rig.exchange.binary.columns import (
    FEW,
    MAX_BYTES,
    Columns,
    Listed,
    Wanted,
    by_name,
    cells_of,
    of_one_length,
    refuse_unknown,
)
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain


def read(path: Path, group: str, wanted: Wanted) -> Columns:
    """The vectors of numbers. Raises RunError where they cannot be read."""
    found = _vectors(path)
    refuse_unknown(str(path), wanted, list(found))
    vectors = {name: array for name, array in found.items() if name in wanted} if by_name(wanted) else found
    vectors = vectors or found
    return of_one_length(
        str(path), list(vectors), [cells_of(array, f"{path}, {shown(name)}") for name, array in vectors.items()]
    )


def listed(path: Path) -> list[Listed]:
    """Every vector of numbers."""
    return [
        Listed("", name, "", array.size, cells_of(array[:FEW], f"{path}, {shown(name)}"), False)
        for name, array in _vectors(path).items()
        if array.dtype.kind in "biuf"
    ]


def _vectors(path: Path) -> dict[str, np.ndarray]:
    from scipy.io import loadmat

    with open_plain(path, MAX_BYTES) as stream:
        try:
            found: dict[str, Any] = loadmat(stream, chars_as_strings=False, struct_as_record=True)
        except NotImplementedError:
            raise RunError(f"{path}: a MATLAB 7.3 file; read it with reader = 'hdf5', or save it with -v7") from None
        except Exception as error:  # whatever a damaged file makes the package stumble over
            raise RunError(f"{path}: not a MATLAB file that can be read ({shown(str(error), 100)})") from None
    vectors = {
        name: array.ravel()
        for name, array in found.items()
        if not name.startswith("__")
        and isinstance(array, np.ndarray)
        and array.ndim == 2
        and 1 in array.shape
        and array.size > 1
        and np.issubdtype(array.dtype, np.number)
    }
    if not vectors:
        others = [f"'{shown(name)}' {np.shape(array)}" for name, array in found.items() if not name.startswith("__")]
        there = f"; there are {', '.join(others[:20])}" if others else ""
        raise RunError(f"{path}: no vector of numbers in it{there}; save each column as a variable of its own")
    return vectors
