"""The rows of one CSV file, checked and turned into columns a stretch at a time."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from rig.recording.cells import Numbers, numbers, words
from rig.recording.columns import FLAGS, MEASURED, NUMERIC
from rig.recording.contents import Column, Kind
from rig.recording.header import check_names, check_separator, names_below, unknown
from rig.recording.lines import Block, UnreadableError, blocks
from rig.recording.mistakes import SHOWN_MISTAKES, Mistakes, shown

EXTRA_BYTES = 20_000_000  # unknown columns of a larger file are not kept: as text they would cost ten times its size
MAX_STEADY_ROWS = 100_000
FALLING = 3  # rows whose times fall are in reverse order


@dataclass(frozen=True)
class Plan:
    """What a file is read as: its kind, the columns it needs, the lowest plausible flow, whether to keep the rest."""

    kind: Kind
    needed: tuple[tuple[str, ...], ...]
    lowest_flow_l_min: float
    keep_extra: bool


@dataclass(frozen=True)
class Table:
    """The columns of one file."""

    names: list[str]
    rows: int
    columns: dict[str, Column]
    direction: NDArray[np.str_] | None
    extra: dict[str, NDArray[np.object_]]


def read_table(
    stream: BinaryIO, plan: Plan, place: str, mistakes: Mistakes, seen: Callable[[bytes], None]
) -> Table | None:
    """Read and check one CSV file in bounded memory.

    Returns None when the header is so wrong that the rows mean nothing. Of no use when mistakes were noted.
    """
    found: _Reading | None = None
    try:
        for block in blocks(stream, seen):
            if block.first == 0:
                found = _start(block, plan, place, mistakes)
            if found is None:
                return None
            found.take(block)
            if mistakes.enough or found.is_too_long():
                return None
    except UnreadableError as error:
        mistakes.add(f"{place}, {error.where}" if error.where else place, str(error))
        return None
    if found is None:
        mistakes.add(place, "the file is empty; write a header and at least one row")
        return None
    return found.table()


def _start(block: Block, plan: Plan, place: str, mistakes: Mistakes) -> _Reading | None:
    """Take the header off the first stretch; None when it cannot be one."""
    if 0 in dict(block.broken):
        mistakes.add(f"{place}, header", dict(block.broken)[0])
        return None
    names = [name.strip() for name in block.rows.pop(0)]
    block.first = 1
    lower = names_below(names, block.rows)
    if lower is not None:
        mistakes.add(f"{place}, header", f"the column names stand in line {lower}; take out the lines above them")
        return None
    if not names:
        mistakes.add(f"{place}, header", "the first line is blank; put the column names there")
        return None
    if not check_separator(names, place, mistakes):
        return None
    before = mistakes.count
    check_names(names, plan.needed, place, mistakes)
    doubles = len(set(names)) < len(names)
    return None if doubles and mistakes.count > before else _Reading(names, plan, place, mistakes)


class _Reading:
    """The columns of one file as far as they are read."""

    def __init__(self, names: list[str], plan: Plan, place: str, mistakes: Mistakes) -> None:
        self.names = names
        self.plan = plan
        self.place = place
        self.mistakes = mistakes
        self.rows = 0
        self.blank: list[int] = []
        # These grow in place; a list of parts, joined at the end, would hold every number twice.
        self.values = {name: array("d") for name in names if name in NUMERIC}
        self.censor = {name: array("b") for name in self.values}
        self.directions: list[NDArray[np.str_]] = []
        self.extra: dict[str, list[str]] = {name: [] for name in unknown(names)} if plan.keep_extra else {}
        self.last_time = -np.inf
        self.is_reversed = False
        self.misread: set[str] = set()  # columns that a mistake says already what is wrong with

    def is_too_long(self) -> bool:
        """Whether a steady file has more rows than plateaus can be; noted as a mistake."""
        if self.plan.kind != "steady" or self.rows <= MAX_STEADY_ROWS:
            return False
        self.mistakes.add(
            self.place,
            f"more than {MAX_STEADY_ROWS} rows in a steady file; average each plateau to one row, or write kind = "
            '"transient"',
        )
        return True

    def take(self, block: Block) -> None:
        """Check and keep the rows of one stretch."""
        rows, row_numbers = self._whole_rows(block)
        if not rows:
            return
        self.rows += len(rows)
        for name, cells in zip(self.names, zip(*rows, strict=True), strict=True):
            if name in self.values:
                self._take_numbers(name, cells, row_numbers)
            elif name == "direction":
                found, wrong = words(cells, ("up", "down"))
                self._note(name, wrong, row_numbers)
                self.directions.append(found)
            elif name in self.extra:
                self.extra[name].extend(cells)

    def table(self) -> Table:
        """The columns, joined; noting what only the whole file shows."""
        if not self.rows:
            self.mistakes.add(self.place, "a header and no rows; write at least one row under it")
        columns = {name: Column(np.asarray(self.values[name]), np.asarray(self.censor[name])) for name in self.values}
        if self.rows:
            self._check_sampled(columns)
            self._check_supply(columns)
        if self.plan.kind != "transient" and "time_s" in columns:
            self._check_unique(columns["time_s"].values)
        direction = np.concatenate(self.directions) if self.directions else None
        extra = {name: np.array(cells, dtype=object) for name, cells in self.extra.items()}
        return Table(self.names, self.rows, columns, direction, extra)

    def _whole_rows(self, block: Block) -> tuple[list[list[str]], Sequence[int]]:
        """The rows with as many cells as the header has, and their numbers."""
        row_numbers: Sequence[int] = range(block.first, block.first + len(block.rows))
        width = len(self.names)
        if not self.blank and all(len(row) == width for row in block.rows):
            return block.rows, row_numbers
        broken = dict(block.broken)
        whole, kept = [], []
        for number, row in zip(row_numbers, block.rows, strict=True):
            if not row and number not in broken:
                self.blank.append(number)
                continue
            self._note_blank()
            if number in broken:
                self.mistakes.add(f"{self.place}, row {number}", broken[number])
            elif len(row) != width:
                self._note_ragged(number, row)
            else:
                whole.append(row)
                kept.append(number)
        return whole, kept

    def _note_ragged(self, number: int, row: list[str]) -> None:
        hint = "; a decimal comma splits a number in two, write a point" if len(row) > len(self.names) else ""
        self.mistakes.add(
            f"{self.place}, row {number}",
            f"{len(row)} cells under {len(self.names)} columns ('{shown(','.join(row))}'); give each column a cell, "
            f"empty where nothing was sampled{hint}",
        )

    def _note_blank(self) -> None:
        """Blank lines are a mistake once a row follows them; at the end of a file they are nothing."""
        for number in self.blank:
            self.mistakes.add(f"{self.place}, row {number}", "a blank line between rows; take it out")
        self.blank.clear()

    def _take_numbers(self, name: str, cells: Sequence[str], row_numbers: Sequence[int]) -> None:
        found = numbers(cells)
        if name == "speed_rpm":
            found.values += 0.0  # -0 is 0
            found.censor[(found.values == 0.0) & (found.censor == 0)] = -1
        self.misread |= {name} if found.wrong else set()
        self._note(name, found.wrong, row_numbers)
        self._note_limits(name, found, cells, row_numbers)
        if name == "time_s":
            self._note_times(found.values, cells, row_numbers)
        self.values[name].frombytes(found.values.tobytes())
        self.censor[name].frombytes(found.censor.tobytes())

    def _note_limits(self, name: str, found: Numbers, cells: Sequence[str], row_numbers: Sequence[int]) -> None:
        known, values = NUMERIC[name], found.values
        low = self.plan.lowest_flow_l_min if name == "flow_l_min" else known.low
        beyond = (values < low) | (values > known.high)
        if name in FLAGS:
            beyond |= ~np.isnan(values) & (values != 0.0) & (values != 1.0)
        says = known.says
        if name == "flow_l_min":
            says += f", not below {low:.3g} (6 noise_sd + 3 bias_sd + resolution under zero)"
        what = f"expected {says}; check the unit and the reading"
        self._note(name, self._sentences(beyond, cells, what), row_numbers)
        if name not in MEASURED:
            what = "is off scale, which this column cannot be; write the number"
            self._note(name, self._sentences(found.censor != 0, cells, what), row_numbers)

    def _note_times(self, times: NDArray[np.float64], cells: Sequence[str], row_numbers: Sequence[int]) -> None:
        """A transient's times have to be there, and to increase, across stretches too."""
        if self.plan.kind != "transient" or self.is_reversed:
            return
        if self.last_time == -np.inf and times.size >= FALLING and (np.diff(times) < 0.0).all():
            self.is_reversed = True
            what = "the times fall throughout, and a transient's increase; reverse the order of the rows"
            self.mistakes.add(f"{self.place}, column time_s", what)
            return
        not_later = times <= np.concatenate(([self.last_time], times[:-1]))
        what = "not later than the row before; a transient's times increase, take the row out or correct it"
        self._note("time_s", self._sentences(not_later, cells, what), row_numbers)
        empty = np.array([not cell.strip() for cell in cells])
        self._note("time_s", self._sentences(empty, cells, "a transient needs a time in each row"), row_numbers)
        if not np.isnan(times).all():
            self.last_time = times[~np.isnan(times)][-1]

    @staticmethod
    def _sentences(where: NDArray[np.bool_], cells: Sequence[str], what: str) -> list[tuple[int, str]]:
        """One sentence for each cell that is wrong."""
        found = (int(index) for index in np.flatnonzero(where))
        return [(index, f"'{shown(cells[index].strip())}': {what}") for index in found]

    def _note(self, column: str, wrong: Sequence[tuple[int, str]], row_numbers: Sequence[int]) -> None:
        for index, what in wrong[:SHOWN_MISTAKES]:
            self.mistakes.add(f"{self.place}, row {row_numbers[index]}, column {column}", what)
        if len(wrong) > SHOWN_MISTAKES:
            self.mistakes.count += len(wrong) - SHOWN_MISTAKES

    def _check_sampled(self, columns: dict[str, Column]) -> None:
        """Each needed group has to hold a number somewhere."""
        for group in self.plan.needed:
            present = [name for name in group if name in columns]
            if (
                present
                and not self.misread & set(present)
                and all(np.isnan(columns[name].values).all() for name in present)
            ):
                what = "every cell is empty; this file needs readings there"
                self.mistakes.add(f"{self.place}, column {' or '.join(present)}", what)

    def _check_supply(self, columns: dict[str, Column]) -> None:
        """In a transient the supply holds until the next row that tells of it: the first has to."""
        flags = columns.get("supply_open")
        if self.plan.kind != "transient" or flags is None or self.mistakes.count or not np.isnan(flags.values[0]):
            return
        self.mistakes.add(
            f"{self.place}, row 1, column supply_open",
            "empty: the supply stays as it is until the next row that tells of it, and no row is before this one; "
            "write 1 (open) or 0 (closed) here, or take the column out",
        )

    def _check_unique(self, times: NDArray[np.float64]) -> None:
        order = np.argsort(times, kind="stable")
        doubled = order[1:][np.diff(times[order]) == 0.0]
        for index in np.sort(doubled):
            what = f"the time {times[index]:g} stands in an earlier row too; give each row its own, or none"
            self.mistakes.add(f"{self.place}, row {index + 1}, column time_s", what)
