"""The cells of a foreign table as the columns of a recording: units converted, censored marks kept, gaps left gaps."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from configs.units import ZERO_C
from rig.exchange.mapping import ColumnTable, FileTable, MappingFile
from rig.exchange.tables import Cells, Table
from rig.exchange.units import unit_of
from rig.recording import Column
from rig.recording.columns import FIGURES
from rig.recording.mistakes import shown
from rig.recording.schema import ChannelTable, channel_of
from rig.runlog.folder import RunError

DAY_S = 86_400.0
MOST_S = 5e9  # some 160 years; more nanoseconds than an integer holds are not far above
ZERO_NOISE, ZERO_BIAS = 6.0, 3.0  # of the declared errors, as for a flow near 0: how far below 0 rest may read
_NUMBER = re.compile(r"\s*([<>]?)\s*([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)\s*", re.ASCII)
_CLOCK = re.compile(r"\s*([0-9]{1,2}):([0-9]{2}):([0-9]{2}(?:\.[0-9]+)?)\s*", re.ASCII)
_SIGN = {"": 0, "<": -1, ">": 1}
_HELD = ("time_s", "supply_open", "rotor_locked", "angle_rad")  # of averaged rows the last is taken


@dataclass
class Converted:
    """One file's columns.

    Attributes
    ----------
    columns : dict of str to Column
        In the units of their names, all of one length.
    direction : ndarray of str, or None
        ``up``, ``down`` or empty.
    cells : dict of str to list of str
        The text behind each column, where rows were not averaged.
    """

    entry: FileTable
    columns: dict[str, Column]
    direction: NDArray[np.str_] | None = None
    cells: dict[str, list[str]] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of rows [-]."""
        return len(next(iter(self.columns.values())).values)


def convert(mapping: MappingFile, entry: FileTable, table: Table) -> Converted:
    """A file's columns as those of a recording.

    Raises
    ------
    RunError
        File, line and column of the first cell that cannot be used.
    """
    rows = _rows(entry, table, mapping.table.decimal or ".")
    if not rows:
        raise RunError(f"{table.place}: no row is left of what [[files]] takes")
    converted = Converted(entry, {})
    for name, source in mapping.columns.items():
        if name == "direction":
            converted.direction = _directions(source, table, rows)
            continue
        cells = [source.constant] * len(rows) if source.column is None else _taken(table.column(source.column), rows)
        column = _column(name, source, cells, table, rows, mapping.table.decimal or ".")
        if not np.isnan(column.values).all():
            converted.columns[name] = column
            if source.column is not None:
                converted.cells[name] = [str(cell) for cell in cells]
    if not converted.columns:
        raise RunError(f"{table.place}: every cell that the mapping takes is empty")
    _bring_to_inlet(mapping, converted, table.place)
    for name, source in mapping.columns.items():
        if name in converted.columns and not source.differentiate and source.factor != 1.0:
            column = converted.columns[name]
            censor = column.censor if source.factor > 0.0 else -column.censor
            converted.columns[name] = Column(column.values * source.factor, censor)
    if isinstance(mapping.motor, str):
        _check(entry, converted, [table.lines[row] for row in rows], table.place)
    return _at_rest(mapping, _thinned(mapping, converted, table.place), [table.lines[row] for row in rows], table.place)


def _check(entry: FileTable, converted: Converted, lines: Sequence[int], place: str) -> None:
    """What no run of this motor can hold: the times order its rows."""
    time = converted.columns.get("time_s")
    if time is not None:
        if np.isnan(time.values).any():
            raise RunError(f"{place}, line {lines[int(np.isnan(time.values).argmax())]}: time_s is empty")
        far = np.abs(time.values + entry.start_s) > MOST_S
        if far.any():
            at = int(far.argmax())
            raise RunError(f"{place}, line {lines[at]}: time_s is {time.values[at]:g} s; is its unit right?")
        back = np.diff(time.values) <= 0.0
        if entry.kind != "steady" and back.any():
            raise RunError(
                f"{place}, line {lines[int(back.argmax()) + 1]}: time_s does not increase from the row before"
            )


def _at_rest(mapping: MappingFile, converted: Converted, lines: Sequence[int], place: str) -> Converted:
    """Speeds below 0 as what they are: a tachometer's zero within its declared error, and otherwise a mistake."""
    speed, source = converted.columns.get("speed_rpm"), mapping.columns.get("speed_rpm")
    if speed is None or source is None or not (speed.values < 0.0).any():
        return converted
    figures = channel_of("speed_rpm", ChannelTable(**{key: getattr(source, key) for key in FIGURES}))
    scale = converted.entry.noise_scale
    wanders = ZERO_NOISE * figures.noise_sd * scale + ZERO_BIAS * figures.bias_sd + figures.resolution
    far = speed.values < -wanders
    if far.any():
        row = int(far.argmax())
        line = lines[min((row + 1) * converted.entry.average_rows, len(lines)) - 1]
        raise RunError(
            f"{place}, line {line}: speed_rpm is {speed.values[row]:g} rpm; if it is counted the other way round, give "
            f"factor = -1; what is rest lies within {wanders:.3g} rpm below 0 ({ZERO_NOISE:g} noise_sd + "
            f"{ZERO_BIAS:g} bias_sd + resolution): if the zero wanders farther, state its bias_sd"
        )
    converted.columns["speed_rpm"] = Column(np.where(speed.values < 0.0, 0.0, speed.values), speed.censor)
    return converted


def _taken(cells: Cells, rows: list[int]) -> list[str | float]:
    return [cells[row] for row in rows]


def _rows(entry: FileTable, table: Table, decimal: str) -> list[int]:
    """Which rows of the table are taken."""
    count = len(table.columns[0])
    first, last = entry.rows or (1, count)
    rows = range(max(first - 1, 0), min(last, count))
    if entry.only is None:
        return list(rows)
    cells, wanted = table.column(entry.only.column), entry.only.equals
    if isinstance(wanted, str):
        return [row for row in rows if str(cells[row]).strip() == wanted]
    return [row for row in rows if _number(cells[row], decimal) == (wanted, 0)]


def _number(cell: str | float, decimal: str) -> tuple[float, int] | None:
    """A cell's value and whether it is off scale; (nan, 0) when empty, None when it is no number."""
    if not isinstance(cell, str):
        return (cell, 0) if not math.isinf(cell) else None
    if not cell.strip():
        return math.nan, 0
    if decimal == ",":
        if "." in cell:
            return None
        cell = cell.replace(",", ".")
    match = _NUMBER.fullmatch(cell)
    if match is None or math.isinf(float(match[2])):
        return None
    return float(match[2]), _SIGN[match[1]]


def _column(
    name: str,
    source: ColumnTable,
    cells: list[str | float] | list[float | None],
    table: Table,
    rows: list[int],
    decimal: str,
) -> Column:
    """The cells in the column's unit, before any averaging; a length or an angle stays one."""
    unit = unit_of(name, source.unit, source.differentiate)
    read: Callable[[str | float], tuple[float, int] | None]
    read = _TIMES[source.unit] if unit.quantity == "time of day" else lambda cell: _number(cell, decimal)
    values, censor = np.empty(len(cells)), np.zeros(len(cells), dtype=np.int8)
    for index, cell in enumerate(cells):
        found = read(cell if cell is not None else "")
        if found is None:
            place = f"{table.place}, line {table.lines[rows[index]]}, column '{shown(str(source.column))}'"
            expected = "a number" if unit.quantity != "time of day" else f"a time ({source.unit})"
            raise RunError(f"{place}: '{shown(str(cell))}' is not {expected}, decimals with '{decimal}'")
        values[index], censor[index] = found
    if unit.quantity == "time of day":
        values = _from_the_first(values, days=source.unit == "hh:mm:ss")
    values = values * unit.factor / (source.pulses_per_rev or 1.0) + unit.offset
    return Column(values, censor)


def _clock_time(cell: str | float) -> tuple[float, int] | None:
    match = _CLOCK.fullmatch(str(cell))
    if match is None or int(match[1]) > 23 or int(match[2]) > 59 or float(match[3]) >= 61.0:
        return None
    return int(match[1]) * 3600.0 + int(match[2]) * 60.0 + float(match[3]), 0


def _iso_time(cell: str | float) -> tuple[float, int] | None:
    try:
        time = datetime.datetime.fromisoformat(str(cell).strip())
        zone = time.tzinfo or datetime.UTC
        return (time.replace(tzinfo=zone) - datetime.datetime(2000, 1, 1, tzinfo=datetime.UTC)).total_seconds(), 0
    except ValueError:
        return None


_TIMES = {"ISO": _iso_time, "hh:mm:ss": _clock_time}


def _from_the_first(values: NDArray[np.float64], days: bool) -> NDArray[np.float64]:
    """Times of day counted from the first row; a clock that falls back by half a day has passed midnight."""
    if days:
        values = values + DAY_S * np.cumsum(np.diff(values, prepend=values[0]) < -DAY_S / 2.0)
    return values - values[0]


def _directions(source: ColumnTable, table: Table, rows: list[int]) -> NDArray[np.str_]:
    words = source.words or {"up": "up", "down": "down"}
    found = []
    for row, cell in zip(rows, _taken(table.column(source.column or 0), rows), strict=True):
        word = words.get(str(cell).strip(), "") if str(cell).strip() else "-"
        if word not in ("up", "down", "-"):
            place = f"{table.place}, line {table.lines[row]}, column '{shown(str(source.column))}'"
            raise RunError(f"{place}: '{shown(str(cell))}' is neither up nor down; say it in words = {{..}}")
        found.append(word.strip("-"))
    return np.array(found, dtype="<U4")


def _bring_to_inlet(mapping: MappingFile, converted: Converted, place: str) -> None:
    """Q = Q_s (P_s/P)(T/T_s) where the flow refers to a standard state."""
    source = mapping.columns.get("flow_l_min")
    if source is None or source.standard is None or "flow_l_min" not in converted.columns:
        return
    ambient = mapping.ambient
    if "pressure_bar_abs" in converted.columns:
        pressure = converted.columns["pressure_bar_abs"].values
    elif "pressure_bar_gauge" in converted.columns and ambient.pressure_bar_abs is not None:
        pressure = converted.columns["pressure_bar_gauge"].values + ambient.pressure_bar_abs
    else:
        raise RunError(f"{place}: a standard flow needs the inlet's pressure (gauge: with [ambient] pressure_bar_abs)")
    if "inlet_temperature_c" in converted.columns:
        temperature = converted.columns["inlet_temperature_c"].values
    elif ambient.temperature_c is not None:
        temperature = np.full(pressure.size, ambient.temperature_c)
    else:
        raise RunError(f"{place}: a standard flow needs inlet_temperature_c, or [ambient] temperature_c")
    standard = source.standard
    ratio = (standard.pressure_bar_abs / pressure) * (temperature + ZERO_C) / (standard.temperature_c + ZERO_C)
    flow = converted.columns["flow_l_min"]
    converted.columns["flow_l_min"] = Column(flow.values * ratio, flow.censor)


def _thinned(mapping: MappingFile, converted: Converted, place: str) -> Converted:
    """Rows averaged, and rates of change made, each the mean over the time since the row before."""
    size, count = converted.entry.average_rows, converted.rows
    rates = {name for name, source in mapping.columns.items() if source.differentiate and name in converted.columns}
    if size == 1 and not rates:
        return converted
    if count < 2 * size:
        raise RunError(f"{place}: {count} rows are too few to average {size} of them, or to take differences")
    last = np.arange(size - 1, count, size)
    columns = {}
    for name, column in converted.columns.items():
        if name in rates:
            columns[name] = _rate(converted, name, mapping.columns[name].factor, last, place)
        elif name in _HELD:
            columns[name] = Column(column.values[last], column.censor[last])
        else:
            blocks = column.values[: last.size * size].reshape(-1, size)
            off = (column.censor[: last.size * size].reshape(-1, size) != 0).any(axis=1)
            known = ~np.isnan(blocks).any(axis=1) & ~(off & (size > 1))
            values = np.where(known, np.where(np.isnan(blocks), 0.0, blocks).mean(axis=1), np.nan)
            columns[name] = Column(values, column.censor[last] if size == 1 else np.zeros(last.size, np.int8))
    direction = None if converted.direction is None else converted.direction[last]
    return Converted(converted.entry, columns, direction, {} if size > 1 else converted.cells)


def _rate(converted: Converted, name: str, factor: float, last: NDArray[np.intp], place: str) -> Column:
    if "time_s" not in converted.columns:
        raise RunError(f"{place}: {name} is made by differentiating, which needs time_s")
    time = converted.columns["time_s"].values[last]
    value = converted.columns[name].values[last] * factor
    spans = np.diff(time)
    if not (spans > 0.0).all():
        raise RunError(f"{place}: the times do not increase, so that {name} cannot be made of them")
    rate = np.concatenate(([np.nan], np.diff(value) / spans))
    return Column(rate, np.zeros(last.size, dtype=np.int8))
