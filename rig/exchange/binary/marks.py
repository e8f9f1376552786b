"""Quality and limits of the scale beside the values of a channel, as the export of a run writes them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np

from rig.exchange.binary.columns import Cells
from rig.readings import USABLE, Quality

BESIDE = ("quality", "censored")  # names of what stands beside `value`
Beside = Callable[[str], Cells | None]  # the cells of what stands beside a channel's values; None where there is none


def marked(cells: Cells, beside: Beside, place: str) -> tuple[Cells, str]:
    """Cells with a sign before what is off the scale, and without what is no usable reading; and what is to be told.

    Where nothing of the kind stands beside them, or not in the export's words, the cells are as they were.
    """
    quality, censored = (beside(name) for name in BESIDE)
    if quality is None or censored is None or not len(quality) == len(censored) == len(cells):
        return cells, ""
    if any(isinstance(cell, str) for cell in (*cells, *censored)) or not set(map(str, quality)) <= set(Quality):
        return cells, ""
    values, sign = np.array(cells, dtype=np.float64), np.array(censored, dtype=np.float64)
    known, off = np.isfinite(values), sign != 0.0
    unusable = known & ~off & ~np.isin(quality, sorted(USABLE))
    kinds = Counter(str(quality[at]) for at in np.flatnonzero(unusable))
    said = [f"{count} readings are {kind} and missing" for kind, count in kinds.items()]
    said += [f"{(known & off).sum()} are off the scale"] * bool((known & off).any())
    values[unusable] = np.nan
    found: Cells = values.tolist()
    if (known & off).any():
        found = [_text(value, at) for value, at in zip(values.tolist(), sign.tolist(), strict=True)]
    return found, f"{place}: by the marks of quality beside it {', '.join(said)}" if said else ""


def _text(value: float, sign: float) -> str:
    return "" if value != value else f"{'<' if sign < 0.0 else '>' if sign > 0.0 else ''}{value!r}"
