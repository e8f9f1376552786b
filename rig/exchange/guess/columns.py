"""The columns that are proposed: each with its unit, and with what is not sure of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

from rig.exchange.binary.columns import WAVEFORM_TIME
from rig.exchange.cells import DAY_S, Cell
from rig.exchange.doubts import in_thousands
from rig.exchange.guess.layout import DATE, TIME_OF_DAY
from rig.exchange.guess.look import Key, Seen, Source
from rig.exchange.units import known_units
from rig.recording.columns import MEASURED, PRESSURE
from rig.recording.header import INLET, Heading, another_in, read_heading
from rig.recording.mistakes import shown
from rig.recording.units import DATED, UNITS

DIRECTIONS = {"up": ("up", "auf", "rising", "increasing", "steigend"), "down": ("down", "ab", "falling", "fallend")}
EXCEL_DAYS = (20_000.0, 80_000.0)  # 1954 to 2119
ANOTHER_DAY_S = DAY_S / 2.0
DATES_ALONE, TIMES = "dates", "times"


@dataclass(frozen=True)
class Proposed:
    """A table [columns.NAME]: its keys and values, why it is not sure, and what was seen."""

    name: str
    keys: Mapping[str, object]
    doubts: tuple[str, ...] = ()
    seen: str = ""
    further: dict[str, str] = field(default_factory=dict)  # keys that a person has to fill in, as they stand in TOML


def proposed_columns(source: Source) -> tuple[list[Proposed], list[str]]:
    """What is proposed of a source, and in words the columns of which nothing is."""
    dated, used = _of_dates(source)
    found, unknown = list(dated), []
    for column in source.columns:
        if column.key in used:
            continue
        proposals = _of_column(column, source)
        found += proposals
        if not proposals:
            unknown.append(f"{_called(column)}: {_range(column, source)}")
    clocked = [column for column in source.columns if column.clocked]
    left_out = [one for one in found if _is_outdone(one, found, bool(clocked))]
    unknown += [one.seen for one in left_out if one.name != PRESSURE[1]]
    found = [one for one in found if one not in left_out]
    if clocked:
        others = len(clocked) < len(source.columns)
        doubt = ("not every column has a clock: which are taken?",) if others else ()
        found.insert(0, Proposed("time_s", {"column": WAVEFORM_TIME, "unit": "s"}, doubt, "the clock of the channels"))
    return _in_conflict(found), unknown


def _is_outdone(one: Proposed, found: Sequence[Proposed], has_clock: bool) -> bool:
    """Whether another column says its unit and this does not, or it is a time beside the channels' own clock."""
    if one.name == "time_s":
        return has_clock
    same = PRESSURE if one.name in PRESSURE else (one.name,)
    return not one.keys.get("unit") and any(other.name in same and other.keys.get("unit") for other in found)


def _of_dates(source: Source) -> tuple[list[Proposed], set[Key]]:
    """Columns of dates and times of day as the time; a date beside a time of day with it."""
    kinds = {column.key: kind_of(_without_words(column.cells)) for column in source.columns}
    dates = [column for column in source.columns if kinds[column.key] == DATES_ALONE]
    found, used = [], set()
    for column in (column for column in source.columns if kinds[column.key] == TIMES):
        cells, key, note = _without_words(column.cells), column.key, _called(column)
        words = sorted({str(cell) for cell in column.cells} - {str(cell) for cell in cells})
        also = [
            f"; '{shown(word)}' is none: leave its row out, with rows = [first, last] in [[files]]" for word in words
        ]
        used.add(column.key)
        if len(dates) == 1 and units_of(cells, source.reads) == ["hh:mm:ss"]:
            days = _without_words(dates[0].cells)
            cells = [f"{day} {time}" for day, time in zip(days, cells, strict=True)]
            key, note = [dates[0].key, column.key], f"{_called(dates[0])} and {note}"  # type: ignore[assignment]
            used.add(dates[0].key)
        units = units_of(cells, source.reads)
        first = next((str(cell) for cell in cells if str(cell).strip()), "")
        doubt = doubt_of(units, first)
        unit = " or ".join(unit for unit in units if unit in DATED) if doubt else units[0] if units else ""
        keys = {"column": key, "unit": unit}
        found.append(
            Proposed("time_s", keys, (doubt,) if doubt else (), f"{note}: such as '{shown(first)}'{''.join(also[:3])}")
        )
    return found, used


def _of_column(column: Seen, source: Source) -> list[Proposed]:
    heading = read_heading(column.heading, column.unit)
    seen, name = f"{_called(column)}: {_range(column, source)}", next(iter(heading.by_unit or heading.by_words), "")
    directions = _directions(column)
    if directions is not None:
        doubt = () if name == "direction" else ("its words look like directions, its heading does not say so",)
        return [Proposed("direction", {"column": column.key, "words": directions}, doubt, seen)]
    if not name or not _numbers(column, source):
        return []
    doubts = list(_doubts(column, heading, source))
    if name in ("supply_open", "rotor_locked"):
        doubts = [f"1 has to mean {name.replace('_', ' ')}, and 0 the contrary"]
        return [Proposed(name, {"column": column.key, "unit": "0/1"}, tuple(doubts), seen)]
    if name == "direction":
        return []
    if name == "pressure":
        return _of_pressure(column, heading, doubts, seen)
    unit = heading.unit or ("Excel days" if name == "time_s" and _excel_days(column, source) else "")
    further = {"pulses_per_rev": ""} if unit == "Hz" else {}
    if name == "flow_l_min" and _is_standard(column, heading):
        further = {"standard": "{pressure_bar_abs = , temperature_c = }"}
    return [Proposed(name, {"column": column.key, "unit": unit}, tuple(doubts), seen, further)]


def _of_pressure(column: Seen, heading: Heading, doubts: list[str], seen: str) -> list[Proposed]:
    unit, absolute = heading.unit.removesuffix(" abs").removesuffix(" gauge"), heading.is_absolute
    names = PRESSURE if absolute is None else PRESSURE[not absolute :][:1]
    if absolute is None:
        doubts = [*doubts, "nothing says whether it is absolute or gauge: take one of the two"]
    ends = {"pressure_bar_abs": "abs", "pressure_bar_gauge": "gauge"}
    return [
        Proposed(name, {"column": column.key, "unit": f"{unit} {ends[name]}" if unit else ""}, tuple(doubts), seen)
        for name in names
    ]


def _doubts(column: Seen, heading: Heading, source: Source) -> list[str]:
    name = next(iter(heading.by_unit or heading.by_words))
    doubts = []
    if heading.by_unit and heading.by_words and not set(heading.by_unit) & set(heading.by_words):
        doubts.append(f"its words say {heading.by_words[0]}, its unit {heading.by_unit[0]}")
    if not heading.unit:
        stated = f"'{shown(heading.unknown_unit)}' is no unit that the import knows" if heading.unknown_unit else ""
        known = ", ".join(known_units("pressure_bar_abs" if name == "pressure" else name)[:8])
        if name == "time_s" and _excel_days(column, source):
            stated, known = "its numbers look like days of Excel's calendar", "Excel days"
        if name not in ("supply_open", "rotor_locked", "direction"):
            doubts.append(f"{stated or 'its unit is not said'}: one of {known}, ..")
    if heading.unit == "Hz":
        doubts.append("Hz needs the pulses of a revolution")
    if word := another_in(column.heading):
        doubts.append(
            f"'{shown(word)}': is it a reading, and no set-point, limit or flow that refers to another state?"
        )
    if _is_standard(column, heading):
        doubts.append("to which state does it refer?")
    if name == "inlet_temperature_c" and not heading.words & set(INLET):
        doubts.append("is it the temperature of the air at the inlet?")
    values = _numbers(column, source)
    if name == "time_s" and any(later <= earlier for earlier, later in pairwise(values)):
        doubts.append("its numbers do not increase")
    return doubts


def _is_standard(column: Seen, heading: Heading) -> bool:
    """Whether the stated unit, or that in the heading beside it, is that of a standard flow."""
    units = (heading.unit, read_heading(column.heading).unit)
    return any(unit in UNITS and UNITS[unit].quantity == "standard flow" for unit in units)


def _numbers(column: Seen, source: Source) -> list[float]:
    """The finite numbers among the cells; none where most are words."""
    found = [source.reads.reading(cell) for cell in column.cells]
    numbers = [value[0] for value in found if value is not None and math.isfinite(value[0])]
    return numbers if 2 * len(numbers) > sum(value is None for value in found) else []


def _range(column: Seen, source: Source) -> str:
    numbers = _numbers(column, source)
    if numbers:
        return f"{min(numbers):.6g} to {max(numbers):.6g} in the rows looked at"
    first = next((str(cell) for cell in column.cells if str(cell).strip()), "")
    parted = next((str(cell) for cell in column.cells if in_thousands(str(cell), source.reads.decimal)), "")
    if parted:
        return f"such as '{shown(parted)}', whose thousands are parted; take these marks out, in a copy of the file"
    return f"such as '{shown(first)}'"


def _excel_days(column: Seen, source: Source) -> bool:
    numbers = _numbers(column, source)
    return source.reader == "xlsx" and all(EXCEL_DAYS[0] < number < EXCEL_DAYS[1] for number in numbers)


def _directions(column: Seen) -> dict[str, str] | None:
    """The words of a column that says up or down; None for another column."""
    words = {str(cell).strip() for cell in column.cells if str(cell).strip()}
    meant = {word: name for word in words for name, known in DIRECTIONS.items() if word.casefold() in known}
    return dict(sorted(meant.items())) if words and set(meant) == words else None


def _called(column: Seen) -> str:
    return f"'{shown(column.heading)}'" if column.heading else f"column {column.key}"


def _in_conflict(found: Sequence[Proposed]) -> list[Proposed]:
    """Two columns that could be one are both not sure."""
    names = [proposal.name for proposal in found]
    said = "more than one column could be {}: take one"
    return [
        replace(one, doubts=(*one.doubts, said.format(one.name)))
        if names.count(one.name) > 1 and (one.name in MEASURED or one.name == "time_s")
        else one
        for one in found
    ]


def _without_words(cells: Sequence[str | float]) -> list[str | float]:
    """Cells with the few words among them made empty, such as that of a mean below them: those without a digit."""
    filled = [cell for cell in cells if str(cell).strip()]
    words = [cell for cell in filled if not any(map(str.isdigit, str(cell)))]
    return ["" if cell in words else cell for cell in cells] if 2 * len(words) < len(filled) else list(cells)


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
    if "Y-M-D h:m:s" in units and len(set(units) & set(DATED)) > 1:
        return "which is the year, which the month, and which the day?"
    return "which is the day, and which the month?" if day_or_month and "." not in first.partition(" ")[0] else ""
