"""How a cell of a foreign table is read: numbers with a limit's sign, marks, dates and times of day."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable

from rig.exchange.mapping import TableTable
from rig.readings import scpi_number
from rig.recording.units import DATED

DAY_S = 86_400.0
_NUMBER = re.compile(r"\s*([<>]?)\s*([+-]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*", re.ASCII)
_CLOCK = re.compile(
    r"\s*([0-9]{1,2}):([0-9]{2}):([0-9]{2}(?:[.,][0-9]+|:[0-9]{3})?)\s*(?:([AaPp])\.?[Mm]\.?)?\s*", re.ASCII
)
_DAY_S_END = re.compile(r"(.+[T ])24:00(?::00(?:[.,]0+)?)?((?:Z|[+-].*)?)", re.ASCII)
_DATE = re.compile(r"([0-9]{1,4})[-./]([0-9]{1,2})[-./]([0-9]{1,4})", re.ASCII)
_SIGN = {"": 0, "<": -1, ">": 1}


class Cell:
    """How a cell of a table is read.

    Each method gives a value and whether it is off scale, or None for what it cannot read. (nan, 0) is an empty cell
    or one without a reading, (inf, 1) one whose range ended.
    """

    def __init__(self, table: TableTable) -> None:
        self.decimal = table.decimal or "."
        self._over = {mark.casefold() for mark in table.over_range}
        self._invalid = {mark.casefold() for mark in table.invalid}

    def reading(self, cell: str | float) -> tuple[float, int] | None:
        """A number, or what a logger writes in its place."""
        word = str(cell).strip().casefold()
        if word in self._over:
            return math.inf, 1
        if word in self._invalid:
            return math.nan, 0
        found = self.number(cell)
        if found is None:
            return None
        number = scpi_number(found[0])
        return (math.inf, 1) if number == math.inf else (number, found[1]) if number > -math.inf else (math.nan, 0)

    def number(self, cell: str | float) -> tuple[float, int] | None:
        """A number, which a limit's sign may precede."""
        if not isinstance(cell, str):
            return (cell, 0) if not math.isinf(cell) else None
        if not cell.strip():
            return math.nan, 0
        if self.decimal == ",":
            if "." in cell:
                return None
            cell = cell.replace(",", ".")
        match = _NUMBER.fullmatch(cell)
        value = float("".join(match[2].split())) if match else math.inf  # such as +  2.00
        return (value, _SIGN[match[1]]) if match and not math.isinf(value) else None

    def flag(self, cell: str | float) -> tuple[float, int] | None:
        """0 or 1, as a number or as a workbook writes it."""
        word = str(cell).strip().casefold()
        return (float(word == "true"), 0) if word in ("true", "false") else self.number(cell)

    def time(self, unit: str) -> Callable[[str | float], tuple[float, int] | None]:
        """What reads a date, a time of day or both, in seconds from some moment."""
        if unit in DATED:
            return lambda cell: _dated(cell, DATED[unit])
        return {"ISO": _iso_time, "hh:mm:ss": _clock_time, "Excel days": self._excel}[unit]

    def _excel(self, cell: str | float) -> tuple[float, int] | None:
        parts = cell.split() if isinstance(cell, str) else [cell]  # a date and a time of two columns are added
        days = [self.number(part) for part in parts[:3]]
        known = [day[0] for day in days if day is not None and not math.isnan(day[0])]
        return (sum(known) * DAY_S, 0) if 1 <= len(known) == len(days) <= 2 else None


def _clock_time(cell: str | float) -> tuple[float, int] | None:
    match = _CLOCK.fullmatch(str(cell))
    if match is None:
        return None
    hour, minute, second = int(match[1]), int(match[2]), float(re.sub("[,:]", ".", match[3]))
    if match[4]:
        if not 1 <= hour <= 12:
            return None
        hour = hour % 12 + (12 if match[4] in "pP" else 0)
    if minute > 59 or second >= 61.0 or hour > 24 or (hour == 24 and (minute or second)):
        return None
    return hour * 3600.0 + minute * 60.0 + second, 0


def _dated(cell: str | float, places: tuple[int, int, int]) -> tuple[float, int] | None:
    date, _, clock = str(cell).strip().replace("T", " ").partition(" ")
    parts, time = _DATE.fullmatch(date), _clock_time(clock)
    if parts is None or time is None or len(parts[1 + places[0]]) not in (2, 4):
        return None
    year, month, day = (int(parts[1 + place]) for place in places)
    try:
        days = datetime.date(year, month, day).toordinal()
    except ValueError:
        return None
    return days * DAY_S + time[0], 0


def iso(cell: str | float) -> datetime.datetime | None:
    """A date and a time of ISO 8601; None for another text, such as a number of milliseconds."""
    text = str(cell).strip()
    ended = _DAY_S_END.fullmatch(text)  # which not every Python reads
    try:
        if ended:
            return datetime.datetime.fromisoformat(f"{ended[1]}00:00{ended[2]}") + datetime.timedelta(days=1)
        return None if text.isdigit() and len(text) > 8 else datetime.datetime.fromisoformat(text)
    except (ValueError, OverflowError):
        return None


def date_in(cell: str | float, unit: str) -> datetime.date | None:
    """The day that a time tells in a unit; None where it tells none, or a year of two digits."""
    time = iso(cell) if unit == "ISO" else None
    if time is not None:
        return time.date()
    found = _dated(cell, DATED[unit]) if unit in DATED else None
    day = None if found is None else datetime.date.fromordinal(int(found[0] // DAY_S))
    return day if day is not None and day.year >= 100 else None


def _iso_time(cell: str | float) -> tuple[float, int] | None:
    time = iso(cell)
    if time is None:
        return None
    zone = time.tzinfo or datetime.UTC
    return (time.replace(tzinfo=zone) - datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)).total_seconds(), 0
