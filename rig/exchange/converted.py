"""The cells of a foreign table as the columns of a recording: units converted, censored marks kept, gaps left gaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from configs.units import STANDARD_BAR, ZERO_C
from rig.exchange.cells import Cell
from rig.exchange.doubts import jumps, labelled, turning, uncounted
from rig.exchange.mapping import ColumnTable, FileTable, MappingFile, RotameterTable, StandardTable
from rig.exchange.source_columns import cells_of, heading_of, keys_of, read_column
from rig.exchange.tables import Table
from rig.exchange.units import MOLAR_MASS, unit_of
from rig.recording import Column
from rig.recording.columns import FIGURES
from rig.recording.contents import held
from rig.recording.mistakes import shown
from rig.recording.schema import ChannelTable, channel_of
from rig.runlog.folder import RunError

MOST_S = 5e9  # some 160 years; more nanoseconds than an integer holds are not far above
NORMAL = StandardTable(pressure_bar_abs=STANDARD_BAR, temperature_c=0.0)  # that `units` refers a flow of mass to
ZERO_NOISE, ZERO_BIAS = 6.0, 3.0  # of the declared errors, as for a flow near 0: how far below 0 rest may read
_HELD = ("time_s", "supply_open", "rotor_locked", "angle_rad")  # of averaged rows the last is taken


@dataclass
class Converted:
    """One file's columns.

    `columns`: in the units of their names, all of one length.
    `direction`: ``up``, ``down`` or empty.
    `cells`: the text behind each column, where rows were not averaged.
    `lines`: of the source, that each row ends at.
    `notes`: what a person should know of what was left out.
    """

    entry: FileTable
    columns: dict[str, Column]
    direction: NDArray[np.str_] | None = None
    cells: dict[str, list[str]] = field(default_factory=dict)
    lines: list[int] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def rows(self) -> int:
        """Number of rows [-]."""
        return len(next(iter(self.columns.values())).values)


def convert(mapping: MappingFile, entry: FileTable, table: Table) -> Converted:
    """A file's columns as those of a recording.

    Raises RunError: file, line and column of the first cell that cannot be used.
    """
    reads = Cell(mapping.table)
    rows = _read_rows(mapping, entry, table, _rows(entry, table, reads))
    if not rows:
        raise RunError(f"{table.place}: no row is left of what [[files]] takes")
    converted = Converted(entry, {}, notes=labelled(table, rows, reads))
    _read_all(mapping, converted, table, rows, reads)
    if not converted.columns:
        raise RunError(f"{table.place}: every cell that the mapping takes is empty")
    converted.lines = lines = [table.lines[row] for row in rows]
    _bring_to_inlet(mapping, converted, table.place)
    if isinstance(mapping.motor, str):
        _check(entry, converted, lines, table.place)
    if entry.kind == "transient" and "time_s" in converted.columns:
        converted.notes += jumps(converted.columns["time_s"].values, lines, table.place)
    if entry.kind == "zero" and "speed_rpm" in converted.columns:
        converted.notes += turning(converted.columns["speed_rpm"].values, lines, table.place)
    thinned = _thinned(mapping, converted, table.place)
    thinned.lines = lines[entry.average_rows - 1 :: entry.average_rows]
    return _at_rest(mapping, thinned, table.place)


def _read_all(mapping: MappingFile, converted: Converted, table: Table, rows: list[int], reads: Cell) -> None:
    """Add the columns of the rows that are taken, with their cells, and what is to be told of them."""
    for name, source in mapping.columns.items():
        if name == "direction":
            converted.direction = _directions(source, table, rows)
            if not converted.direction.astype(bool).any():
                converted.notes.append(f"{table.place}, column '{heading_of(source)}': no word in it")
            continue
        if source.sample_period_s is not None:
            times = source.sample_period_s * (np.array(rows, dtype=np.float64) - rows[0])
            converted.columns[name] = Column(times, np.zeros(len(rows), dtype=np.int8))
            converted.notes += uncounted(table, rows)
            continue
        column, cells = read_column(name, source, table, rows, reads, converted.notes)
        if np.isnan(column.values).all():
            converted.notes.append(
                f"{table.place}, column '{heading_of(source)}': no number in it, so there is no {name}"
            )
            continue
        converted.columns[name] = column
        if source.column is not None:
            converted.cells[name] = [str(cell) for cell in cells]


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


def _at_rest(mapping: MappingFile, converted: Converted, place: str) -> Converted:
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
        raise RunError(
            f"{place}, line {converted.lines[row]}: speed_rpm is {speed.values[row]:g} rpm; if it is "
            f"counted the other way round, give factor = -1; what is rest lies within {wanders:.3g} rpm below 0 "
            f"({ZERO_NOISE:g} noise_sd + {ZERO_BIAS:g} bias_sd + resolution): if the zero wanders farther, state its "
            "bias_sd"
        )
    converted.columns["speed_rpm"] = Column(np.where(speed.values < 0.0, 0.0, speed.values), speed.censor)
    return converted


def _rows(entry: FileTable, table: Table, reads: Cell) -> list[int]:
    """Which rows of the table are taken."""
    count = len(table.columns[0])
    first, last = entry.rows or (1, count)
    if entry.rows and not first <= last <= count:
        why = "the first comes behind the last" if first > last else f"the last of them is row {count}"
        raise RunError(f"{table.place}: rows = [{first}, {last}] of [[files]]: {why}; its rows count from 1")
    rows = range(max(first - 1, 0), min(last, count))
    if entry.only is None:
        return list(rows)
    cells, wanted = table.column(entry.only.column), entry.only.equals
    if isinstance(wanted, str):
        return [row for row in rows if str(cells[row]).strip() == wanted]
    return [row for row in rows if reads.flag(cells[row]) == (wanted, 0)]


def _read_rows(mapping: MappingFile, entry: FileTable, table: Table, rows: list[int]) -> list[int]:
    """The rows without those in which no column that is taken has anything, such as a note beside the table has.

    Where rows are counted, as by a period, all are kept.
    """
    sources = mapping.columns.values()
    if entry.average_rows > 1 or any(source.sample_period_s is not None for source in sources):
        return rows
    keys = [key for source in sources for key in keys_of(source)]
    columns = [table.column(key) for key in keys]
    return [row for row in rows if any(not isinstance(cells[row], str) or str(cells[row]).strip() for cells in columns)]


def _directions(source: ColumnTable, table: Table, rows: list[int]) -> NDArray[np.str_]:
    words = source.words or {"up": "up", "down": "down"}
    found = []
    for row, cell in zip(rows, cells_of(source, table, rows), strict=True):
        word = words.get(str(cell).strip(), "") if str(cell).strip() else "-"
        if word not in ("up", "down", "-"):
            place = f"{table.place}, line {table.lines[row]}, column '{heading_of(source)}'"
            raise RunError(f"{place}: '{shown(str(cell))}' is neither up nor down; say it in words = {{..}}")
        found.append(word.strip("-"))
    return np.array(found, dtype="<U4")


def _bring_to_inlet(mapping: MappingFile, converted: Converted, place: str) -> None:
    """The flow at the inlet's state, where it refers to another one.

    Of a standard flow, or one of mass, Q = Q_s (P_s/P)(T/T_s). A rotameter's float balances drag, so
    Q = Q_read sqrt(rho_s/rho), by the densities of the gas that its scale was made for and of the air at the inlet.
    """
    source = mapping.columns.get("flow_l_min")
    if source is None or "flow_l_min" not in converted.columns:
        return
    is_mass = unit_of("flow_l_min", source.unit).quantity == "mass flow"
    standard = NORMAL if is_mass else source.standard or source.rotameter
    if standard is None:
        return
    ambient = mapping.ambient
    if "pressure_bar_abs" in converted.columns:
        pressure = converted.columns["pressure_bar_abs"].values
    elif "pressure_bar_gauge" in converted.columns and ambient.pressure_bar_abs is not None:
        pressure = converted.columns["pressure_bar_gauge"].values + ambient.pressure_bar_abs
    else:
        raise RunError(f"{place}: the flow's unit needs the inlet's pressure (gauge: with [ambient] pressure_bar_abs)")
    if "inlet_temperature_c" in converted.columns:
        temperature = converted.columns["inlet_temperature_c"].values
    elif ambient.temperature_c is not None:
        temperature = np.full(pressure.size, ambient.temperature_c)
    else:
        raise RunError(f"{place}: the flow's unit needs inlet_temperature_c, or [ambient] temperature_c")
    if not (np.isnan(pressure) | (pressure > 0.0)).all():
        row = int((pressure <= 0.0).argmax())
        raise RunError(
            f"{place}, line {converted.lines[row]}: the inlet's pressure is {pressure[row]:g} bar abs, and the flow's "
            "unit needs one above 0; check the unit and the reading, and with a gauge the room's pressure"
        )
    ratio = (standard.pressure_bar_abs / pressure) * (temperature + ZERO_C) / (standard.temperature_c + ZERO_C)
    if isinstance(standard, RotameterTable):
        ratio = np.sqrt(ratio * MOLAR_MASS[standard.gas] / MOLAR_MASS["air"])
    flow = converted.columns["flow_l_min"]
    lost = np.flatnonzero(np.isnan(ratio) & ~np.isnan(flow.values))
    if lost.size:
        lines = ", ".join(str(converted.lines[row]) for row in lost[:5]) + ", ..." * (lost.size > 5)
        converted.notes.append(
            f"{place}, line {lines}, column '{heading_of(source)}': {lost.size} left out: the flow's unit needs the "
            "inlet's pressure and temperature, and a cell of these is empty there"
        )
    converted.columns["flow_l_min"] = Column(flow.values * ratio, np.where(np.isnan(ratio), 0, flow.censor))


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
    if count % size:
        converted.notes.append(
            f"{place}: left out at the end: {count % size} of the {size} rows that average_rows takes"
        )
    for name, column in converted.columns.items():
        if name in rates:
            columns[name] = _rate(converted, name, last, place)
        elif name in _HELD:
            values = held(column.values) if name == "supply_open" else column.values
            columns[name] = Column(values[last], column.censor[last])
        else:
            blocks = column.values[: last.size * size].reshape(-1, size)
            off = (column.censor[: last.size * size].reshape(-1, size) != 0).any(axis=1)
            known = ~np.isnan(blocks).any(axis=1) & ~(off & (size > 1))
            if lost := int((~np.isnan(blocks[~known])).sum()):
                converted.notes.append(
                    f"{place}: {lost} readings of {name} left out: others that average_rows takes with them are "
                    "missing or off scale"
                )
            values = np.where(known, np.where(np.isnan(blocks), 0.0, blocks).mean(axis=1), np.nan)
            columns[name] = Column(values, column.censor[last] if size == 1 else np.zeros(last.size, np.int8))
    direction = None if converted.direction is None else converted.direction[last]
    return Converted(converted.entry, columns, direction, {} if size > 1 else converted.cells, notes=converted.notes)


def _rate(converted: Converted, name: str, last: NDArray[np.intp], place: str) -> Column:
    if "time_s" not in converted.columns:
        raise RunError(f"{place}: {name} is made by differentiating, which needs time_s")
    time = converted.columns["time_s"].values[last]
    value = converted.columns[name].values[last]
    spans = np.diff(time)
    if not (spans > 0.0).all():
        raise RunError(f"{place}: the times do not increase, so that {name} cannot be made of them")
    off = converted.columns[name].censor[last] != 0
    lost = off[1:] | off[:-1]
    if lost.any():
        converted.notes.append(
            f"{place}: {lost.sum()} rates of {name} left out: a value that they are made of is off scale"
        )
    rate = np.concatenate(([np.nan], np.where(lost, np.nan, np.diff(value) / spans)))
    return Column(rate, np.zeros(last.size, dtype=np.int8))
