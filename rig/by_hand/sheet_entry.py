"""Entry of a filled-in sheet: a run with the times that stand on it, through the bench's own driver."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, TypeVar

from rig import acquisition
from rig.acquisition import actions
from rig.acquisition.derived import DEVICE as DERIVED
from rig.acquisition.opening import line_of
from rig.acquisition.stage import Stage
from rig.bench.bench import Bench
from rig.bench.instrument import ChannelFile
from rig.by_hand import entry
from rig.by_hand.by_hand import faces_of, manual_device
from rig.by_hand.sheet import AT_ZERO, sheet_columns
from rig.clock import Clock
from rig.instruments.codecs.values import printable
from rig.instruments.manual import EntryError, decode_entry
from rig.lines.keyboard import KeyboardPort
from rig.plateaus.plan import DOWN, UP, Step, SweepError
from rig.plateaus.plateau import Mean, Plateau
from rig.readings import NS, Reading
from rig.runlog import columns_of
from rig.runlog.schema import ZERO
from rig.sweep.ambient import Ambient
from rig.sweep.orders import FINISHED
from rig.sweep.runner import Outcome, PlateauSink

MOST_BYTES = 1_000_000
MOST_ROWS = 2000
MOST_NOTE = 500
CLOCK_TIME = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}))?")
POINTED = re.compile(r"\d{1,2}\.[0-5]\d")
NUMBER = re.compile(r"\d{1,7}(?:\.\d{1,6})?")
DECIMAL = re.compile(r"[<>]?[+-]?\d+[.,]\d+")
DAY_S, DAY_H = 86_400.0, 24.0
APART_NS = 1_000_000  # between rows of the same minute: what is read at a zero's time is the zero's alone
T = TypeVar("T")


class SheetError(SweepError):
    """A sheet cannot be entered as it stands. The text names every row and column that is wrong."""


class Sink(acquisition.Sink, PlateauSink, Protocol):
    """`rig.runlog.RunWriter`."""


@dataclass(frozen=True)
class SheetRow:
    """One line of a sheet.

    `time_s`: after the first row [s].
    `level_bar_abs`: None for a zero [bar].
    `after`: the entry of the pressure read again; empty when it was not.
    `doubt`: why it may be a slip, though it was read so.
    """

    number: int
    time_s: float
    level_bar_abs: float | None
    direction: str
    entry: str
    after: str
    note: str
    doubt: str = ""


def read_sheet(text: str, bench: Bench) -> list[SheetRow]:
    """Read a filled-in sheet.

    `text`: CSV with the columns of `sheet_columns`; the times are of the clock (``14:05``) or seconds.
    Rows with an empty time and no reading are levels that were not taken, and are left out. Raises SheetError: a line
    for each mistake, with row and column.
    """
    rows, mistakes = rows_and_mistakes(text, bench)
    refuse(mistakes)
    return rows


def refuse(mistakes: Mapping[int, str]) -> None:
    """Raises SheetError, when there are mistakes. `mistakes`: by row."""
    if mistakes:
        raise SheetError("\n".join(f"row {number}: {mistakes[number]}" for number in sorted(mistakes)[:20]))


def rows_and_mistakes(text: str, bench: Bench) -> tuple[list[SheetRow], dict[int, str]]:
    """The rows of a sheet that can be read, and what is wrong with the others, by row.

    Raises SheetError, when it is no sheet of this bench, or empty.
    """
    if len(text) > MOST_BYTES:
        raise SheetError(f"longer than {MOST_BYTES} characters; this is no sheet")
    columns = sheet_columns(bench)
    lines = _lines(text.removeprefix("\ufeff"), [*columns.values()])
    _refuse_points(lines)
    if len(lines) > MOST_ROWS:
        raise SheetError(f"more than {MOST_ROWS} rows")
    typed = faces_of(bench)
    rows: list[SheetRow] = []
    mistakes: dict[int, str] = {}
    last_s: float | None = None
    first_s = 0.0
    for number, cells in enumerate(lines[1:], start=1):
        if not any(cell.strip() for i, cell in enumerate(cells) if i not in (1, 2)):
            continue
        if any("\n" in cell for cell in cells):
            mistakes[number] = "a cell of several lines; is there a quotation mark that is not closed?"
            continue
        try:
            row = _row(number, dict(zip(columns, [cell.strip() for cell in cells], strict=True)), typed, last_s)
        except ValueError as error:
            is_short = len(cells) != len(columns)
            mistakes[number] = f"{len(cells)} cells, expected {len(columns)}" if is_short else str(error)
            continue
        first_s = row.time_s if last_s is None else first_s
        last_s = row.time_s
        rows.append(row)
    if not rows and not mistakes:
        raise SheetError("no row has readings")
    return [replace(row, time_s=row.time_s - first_s) for row in rows], mistakes


def enter_sheet(bench: Bench, rows: Sequence[SheetRow], sink: Sink, ambient: Ambient) -> Outcome:
    """Write the readings of a sheet into a run, as if they had been typed at the times that stand on it.

    `sink`: the run, of kind ``manual``; its time 0 is the first row's.
    """
    keys = _Keys(bench, sink, ambient)
    plateaus: list[Plateau] = []
    time_ns = -APART_NS
    for row in rows:
        time_ns = max(round(row.time_s * NS), time_ns + APART_NS)
        if row.doubt:
            sink.event("doubted", time_ns, text=row.doubt)
        found = keys.enter(row.entry, time_ns)
        if row.level_bar_abs is None:
            channels = {reading.name: {"mean": reading.value, "se": None, "n": 1} for reading in found.values()}
            which = "end" if plateaus else "start"
            times = {"start_s": time_ns / NS, "end_s": time_ns / NS}
            sink.event(ZERO, time_ns, which=which, vented=True, channels=channels, **times)
            continue
        means = {role: entry.mean_of_entries([reading]) for role, reading in found.items()}
        if row.after:
            means["pressure"] = entry.with_drift(means["pressure"], keys.enter(row.after, time_ns)["pressure"])
        taken = plateau_of(len(plateaus) + 1, row, time_ns, means, bench, ambient)
        plateaus.append(taken)
        sink.plateau(taken.row(keys.columns))
    return Outcome(FINISHED, "", True, plateaus, [])


def _lines(text: str, columns: list[str]) -> list[list[str]]:
    """The cells of a sheet, whose header is `columns`; where semicolons part them, decimals may be after a comma."""
    head = text.partition("\n")[0]
    delimiter = ";" if ";" in head and "," not in head else ","
    try:
        lines = [
            [cell.strip() for cell in line] for line in csv.reader(io.StringIO(text), delimiter=delimiter, strict=True)
        ]
    except csv.Error as error:
        raise SheetError(f"not a table of CSV ({error}); is there a quotation mark that is not closed?") from None
    if not lines or lines[0] != columns:
        raise SheetError(
            f"header: expected {delimiter.join(columns)} (the sheet that is printed for this bench has it)"
        )
    if delimiter == ",":
        return lines
    numbers = [cell for line in lines for cell in line[: len(columns) - 1] if DECIMAL.fullmatch(cell)]
    if len({"," in cell for cell in numbers}) > 1:
        raise SheetError("decimals after a comma and after a point in one sheet; write all of them after a point")
    return [
        [cell.replace(",", ".") if DECIMAL.fullmatch(cell) else cell for cell in line[:-1]] + line[-1:]
        for line in lines
    ]


def _refuse_points(lines: list[list[str]]) -> None:
    """Raises SheetError, when every time could be hours and minutes with a point between: they would be seconds."""
    times = [cells[0] for cells in lines[1:] if cells and cells[0]]
    if times and all(POINTED.fullmatch(time) and float(time) < DAY_H for time in times):
        raise SheetError(f"time: '{times[0]}' may be a time of the clock; write 14:05, or whole seconds")


class _Keys:
    """Lays entries into the log through the bench's own driver."""

    def __init__(self, bench: Bench, sink: Sink, ambient: Ambient) -> None:
        self.device = manual_device(bench)
        self.driver = bench.build(self.device)
        self.columns = columns_of(bench.file.roles.model_dump())
        self._sink = sink
        self._stage = Stage(bench, False, ambient.pressure_bar_abs, ambient.temperature_c)
        name = bench.file.devices[self.device].line
        clock = Clock()
        self._port = KeyboardPort(clock, -1, -1)
        self._line = line_of(name, bench.file.lines[name], self._port, clock)
        self._port.open()
        self._roles = {getattr(bench.file.roles, role): role for role in ("pressure", "flow", "speed", "temperature")}

    def enter(self, text: str, time_ns: int) -> dict[str, Reading]:
        """Write one entry, and return its readings by role; a derived one stands for what it comes of."""
        self._port.feed(f"{text}\n".encode(), time_ns, time_ns)
        exchange, fault = actions.perform(self._line, self.device, self.driver, actions.POLL)
        if fault is not None:
            raise fault
        logged = self._stage(exchange)
        self._sink.exchange(logged)
        found = {self._roles[reading.name]: reading for reading in logged.readings if reading.name in self._roles}
        derived = [reading for reading in logged.readings if reading.device == DERIVED]
        return found | ({"flow": derived[0]} if derived else {})


def plateau_of(
    number: int, row: SheetRow, time_ns: int, means: dict[str, Mean], bench: Bench, ambient: Ambient
) -> Plateau:
    """The plateau that a row is. `means`: by role."""
    level = row.level_bar_abs or 0.0
    pressure = means["pressure"].mean
    if pressure is not None and bench.file.roles.pressure.endswith("_gauge"):
        pressure += ambient.pressure_bar_abs
    notes = [row.note, row.doubt and f"read so: {row.doubt}", *entry.remarks(pressure, level, row.direction)]
    text = "; ".join(note for note in notes if note)
    return Plateau(number, Step(level, row.direction, 1), time_ns, time_ns, True, means, text)


def _row(number: int, cells: dict[str, str], typed: dict[str, ChannelFile], last_s: float | None) -> SheetRow:
    """One row; a ValueError says all that is wrong with it."""
    direction = cells["direction"] or UP
    pressure = next(name for name in cells if name.endswith("_after")).removesuffix("_after")
    after = cells[f"{pressure}_after"]
    wrong: list[str] = []
    time_s = _or_told(wrong, partial(_time, cells["time"], last_s))
    level = None if cells["level_bar_abs"] == AT_ZERO else _or_told(wrong, partial(_level, cells["level_bar_abs"]))
    wrong += [f"direction: '{direction[:20]}' is neither up nor down"] if direction not in (UP, DOWN) else []
    for column in [*typed, f"{pressure}_after"]:
        _or_told(wrong, partial(_entry, column, cells[column] or "-", typed))
    if wrong or time_s is None:
        raise ValueError("; ".join(wrong))
    text = " ".join(cells[name] or "-" for name in typed)
    after_text = " ".join(after if name == pressure else "-" for name in typed) if after else ""
    return SheetRow(number, time_s, level, direction, text, after_text, cells["note"][:MOST_NOTE])


def _or_told(wrong: list[str], read: Callable[[], T]) -> T | None:
    """What is read; None where it cannot be, which is added to what is wrong."""
    try:
        return read()
    except ValueError as error:
        wrong.append(str(error))
        return None


def _entry(column: str, cell: str, typed: dict[str, ChannelFile]) -> None:
    """Look at the reading in a cell; a ValueError says what is wrong with it."""
    name = column.removesuffix("_after")
    if len(cell.split()) > 1:
        raise ValueError(f"{column}: '{printable(cell[:40])}' is not a number alone; the unit is not written")
    try:
        decode_entry(cell, {name: typed[name]})
    except EntryError as error:
        raise ValueError(f"{column}{str(error).removeprefix(name)}") from None


def _time(cell: str, last_s: float | None) -> float:
    match = CLOCK_TIME.fullmatch(cell)
    if match:
        hours, minutes, seconds = (int(part or 0) for part in match.groups())
        if hours > 23 or minutes > 59 or seconds > 59:
            raise ValueError(f"time: '{cell}' is no time of the day")
        time_s = hours * 3600.0 + minutes * 60.0 + seconds
        while last_s is not None and time_s < last_s - 0.5 * DAY_S:  # past midnight
            time_s += DAY_S
    elif NUMBER.fullmatch(cell):
        time_s = float(cell)
    else:
        raise ValueError(f"time: '{cell[:20]}': expected 14:05, 14:05:30 or seconds")
    if last_s is not None and time_s < last_s:
        raise ValueError(f"time: '{cell}' is before the row above")
    return time_s


def _level(cell: str) -> float:
    if not NUMBER.fullmatch(cell):
        raise ValueError(f"level_bar_abs: '{cell[:20]}': expected a number with a decimal point, or {AT_ZERO}")
    return float(cell)
