"""Which values of an HDF5 dataset stand for none: never written, a fill value, or out of its valid range."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.runlog.folder import RunError


def missing(data: Any, field: str, values: NDArray[Any], place: str) -> NDArray[np.bool_]:
    """Which of a dataset's first values stand for none, shape as `values`.

    `field`: of a compound dataset, the one that the values are of.
    Raises RunError where its valid range is none.
    """
    found = ~written(data)[: values.size]
    fills = [np.asarray(data.attrs[key]) for key in ("_FillValue", "missing_value") if key in data.attrs]
    fill = np.asarray(data.fillvalue[field] if field else data.fillvalue)
    fills += [fill] * bool(_is_stated(data) and fill != 0)
    for one in fills:
        one = one.astype(values.dtype) if values.dtype.kind == one.dtype.kind == "f" else one
        found |= np.isin(values, one)
    try:
        low, high = (float(end) for end in data.attrs.get("valid_range", (-np.inf, np.inf)))
        low, high = (
            float(np.squeeze(data.attrs.get(key, end))) for key, end in (("valid_min", low), ("valid_max", high))
        )
    except (TypeError, ValueError):
        raise RunError(f"{place}: its valid range is not two numbers") from None
    return found | (values < low) | (values > high)


def _is_stated(data: Any) -> bool:
    """Whether who made the dataset stated a fill value; h5py has no name for the answer 2."""
    return bool(data.id.get_create_plist().fill_value_defined() == 2)


def written(data: Any) -> NDArray[np.bool_]:
    """Which values of a dataset of one dimension lie in a place that was written, shape (size,).

    The library reads its fill value, 0 where none is stated, in the others.
    """
    if data.chunks is None:
        return np.full(data.size, data.size == 0 or data.id.get_storage_size() > 0)
    along = int(np.argmax(data.shape))
    step = data.chunks[along]
    if data.id.get_num_chunks() * step >= data.size:
        return np.ones(data.size, dtype=bool)
    found = np.zeros(data.size, dtype=bool)

    def see(chunk: Any) -> None:
        found[chunk.chunk_offset[along] : chunk.chunk_offset[along] + step] = True

    data.id.chunk_iter(see)
    return found
