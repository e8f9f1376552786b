"""In which unit a column of dates and times of day is written."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rig.exchange.cells import DAY_S, Cell
from rig.exchange.guess.layout import DATE, TIME_OF_DAY
from rig.exchange.units import DATED

ANOTHER_DAY_S = DAY_S / 2.0
DATES_ALONE, TIMES = "dates", "times"


def kind_of(cells: Sequence[str | float]) -> str:
    """`TIMES` where every cell has a time of day, `DATES_ALONE` where every one is a date; empty otherwise."""
    words = [str(cell).strip() for cell in cells if str(cell).strip()]
    if not words:
        return ""
    if all(map(TIME_OF_DAY.search, words)):
        return TIMES
    return DATES_ALONE if all(map(DATE.fullmatch, words)) else ""


def units_of(cells: Sequence[str | float], reads: Cell) -> list[str]:
    """Units of which each reads every cell, and in which the times do not go back."""
    words = [str(cell) for cell in cells if str(cell).strip()]
    return [unit for unit in ("ISO", "hh:mm:ss", *DATED) if _reads_all(words, unit, reads)]


def _reads_all(words: Sequence[str], unit: str, reads: Cell) -> bool:
    read = reads.time(unit)
    last = -math.inf
    for word in words:
        found = read(word)
        if found is None or (found[0] < last and not (unit == "hh:mm:ss" and last - found[0] > ANOTHER_DAY_S)):
            return False
        last = found[0]
    return True


def doubt_of(units: Sequence[str], first: str) -> str:
    """Why it is not sure which of the units it is; empty where it is."""
    if not units:
        return "no unit of time that the import knows reads all of it, or the clock goes back"
    day_or_month = set(units) >= {"D.M.Y h:m:s", "M/D/Y h:m:s"}
    return "which is the day, and which the month?" if day_or_month and "." not in first.partition(" ")[0] else ""
