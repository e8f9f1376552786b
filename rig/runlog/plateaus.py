"""plateaus.csv: one row a plateau, the means of its dwell.

A row whose number stood before replaces it, and `used` 0 takes a plateau back: the file is only ever appended to.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.recording.columns import OF_CHANNEL, PRESSURE, ROLES
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError
from rig.runlog.lines import whole_lines
from rig.runlog.rows import csv_line, harmless, seconds, unescaped

QUANTITIES = (*PRESSURE, "flow_l_min", "speed_rpm", "inlet_temperature_c")
PARTS = ("", "_se", "_n_eff", "_n")
_OWN = ("n", "level_bar_abs", "direction", "repeat", "start_s", "end_s", "settled", "used")
COLUMNS = (*_OWN, *(f"{name}{part}" for name in QUANTITIES for part in PARTS), "note")
HEADER = (",".join(COLUMNS) + "\n").encode()
MAX_PLATEAUS = 100_000
_WHOLE = {"n", "repeat", "settled", "used", *(f"{name}_n" for name in QUANTITIES)}
_CENSOR = {"<": -1, "": 0, ">": 1}
_CELL = re.compile(r"([<>]?)([+-]?[0-9]+\.?[0-9]*(?:e[+-]?[0-9]+)?)", re.ASCII)


@dataclass(frozen=True, slots=True)
class Mean:
    """The mean of one quantity over a plateau.

    `mean`: in the unit of the quantity's name; the scale's limit when censored.
    `se`: its standard error; None where one reading does not show it.
    `n`: usable samples [-]; 0 where it was not noted.
    `censored`: -1 when the true value is below `mean`, 1 when it is above [-].
    """

    mean: float
    se: float | None = None
    n_eff: float | None = None
    n: int = 1
    censored: int = 0


@dataclass(frozen=True, slots=True)
class PlateauRow:
    """One row of plateaus.csv.

    `direction`: ``up``, ``down``, or empty where it was not noted.
    `start_s`, `end_s`: the dwell, on the bench's clock [s].
    """

    n: int
    level_bar_abs: float | None
    direction: str
    repeat: int
    start_s: float
    end_s: float
    settled: bool
    means: Mapping[str, Mean] = field(default_factory=dict)
    note: str = ""
    used: bool = True


def columns_of(roles: Mapping[str, str | None]) -> dict[str, str]:
    """The column of each role that has a channel.

    `roles`: ``pressure``, ``flow``, ``speed``, ``temperature`` to ``device.channel``, as the bench file says.
    """
    pressure = roles.get("pressure") or ""
    columns = {role: OF_CHANNEL[role].column for role in ROLES}
    if pressure.endswith("_gauge"):
        columns["pressure"] = "pressure_bar_gauge"
    return {role: column for role, column in columns.items() if roles.get(role)}


def line(row: Mapping[str, Any]) -> bytes:
    """A line of plateaus.csv.

    `row`: some of `COLUMNS`, ``n`` among them; what is left out or None becomes an empty cell, but for ``repeat``,
        ``settled`` and ``used``, which become 1. A mean beyond the scale is ``<10`` or ``>100``.
    Raises RunError for a key that is no column, or a value that is none of its kind.
    """
    unknown = sorted(set(row) - set(COLUMNS))
    if unknown:
        raise RunError(f"plateau {row.get('n')}: no column is called {', '.join(unknown)}; see docs/runs.md")
    full = {"repeat": 1, "settled": True, "used": True} | dict(row)
    return csv_line([_cell(name, full.get(name)) for name in COLUMNS])


def _cell(name: str, value: Any) -> str:
    if name in ("direction", "note"):
        return harmless(value or "")
    if value is None:
        return ""
    if isinstance(value, str):
        if name in QUANTITIES and _CELL.fullmatch(value):
            return value
        raise RunError(f"plateau column {name}: '{shown(value)}' is not a number")
    if name in _WHOLE:
        return str(int(value))
    if not math.isfinite(value):
        return ""
    return seconds(round(value * 1e9)) if name in ("start_s", "end_s") else repr(float(value))


def read(path: Path) -> list[PlateauRow]:
    """All rows of plateaus.csv, in order; none when there is no file. Raises RunError: file, line and what is wrong."""
    plateaus = []
    for number, data in whole_lines(path):
        place = f"{path}, line {number}"
        if number > MAX_PLATEAUS:
            raise RunError(f"{place}: more than {MAX_PLATEAUS} plateaus")
        if number == 1:
            if data + b"\n" != HEADER:
                raise RunError(f"{place}: not the header of a run's plateaus; this is no run/1 file, or it is damaged")
            continue
        try:
            cells = next(csv.reader([data.decode("utf-8")], strict=True))
        except (UnicodeDecodeError, csv.Error):
            raise RunError(f"{place}: not a row of CSV in UTF-8; the file is damaged") from None
        if len(cells) != len(COLUMNS):
            raise RunError(f"{place}: {len(cells)} cells, expected {len(COLUMNS)}")
        plateaus.append(_plateau(dict(zip(COLUMNS, cells, strict=True)), place))
    return plateaus


def in_use(plateaus: Iterable[PlateauRow]) -> list[PlateauRow]:
    """The plateaus that count: the last row of each number, unless it takes the plateau back."""
    last = {plateau.n: plateau for plateau in plateaus}
    return [plateau for _, plateau in sorted(last.items()) if plateau.used]


def _plateau(cells: dict[str, str], place: str) -> PlateauRow:
    means = {}
    for name in QUANTITIES:
        if cells[name]:
            value, censored = _signed(cells[name], f"{place}, column {name}")
            se, n_eff = (_float(cells[f"{name}{part}"], f"{place}, column {name}{part}") for part in ("_se", "_n_eff"))
            means[name] = Mean(
                value, se, n_eff, _integer(cells[f"{name}_n"] or "0", f"{place}, column {name}_n"), censored
            )
    level = _float(cells["level_bar_abs"], f"{place}, column level_bar_abs")
    start, end = (_float(cells[name], f"{place}, column {name}") for name in ("start_s", "end_s"))
    flags = {name: _integer(cells[name], f"{place}, column {name}") != 0 for name in ("settled", "used")}
    direction = unescaped(cells["direction"])
    if direction not in ("", "up", "down"):
        raise RunError(f"{place}, column direction: '{shown(direction)}': expected up, down or an empty cell")
    return PlateauRow(
        _integer(cells["n"], f"{place}, column n"),
        level,
        direction,
        _integer(cells["repeat"], f"{place}, column repeat"),
        start or 0.0,
        end or 0.0,
        flags["settled"],
        means,
        unescaped(cells["note"]),
        flags["used"],
    )


def _signed(cell: str, place: str) -> tuple[float, int]:
    match = _CELL.fullmatch(cell)
    if match is None:
        raise RunError(f"{place}: '{shown(cell)}' is not a number")
    return float(match[2]), _CENSOR[match[1]]


def _float(cell: str, place: str) -> float | None:
    if not cell:
        return None
    value, censored = _signed(cell, place)
    if censored or not math.isfinite(value):
        raise RunError(f"{place}: '{shown(cell)}' is not a number")
    return value


def _integer(cell: str, place: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", cell, re.ASCII):
        raise RunError(f"{place}: '{shown(cell)}' is not a whole number")
    return int(cell)
