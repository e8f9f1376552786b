"""The mapping file that is proposed, as text."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from pathlib import Path

from rig.exchange.guess.columns import Proposed, proposed_columns
from rig.exchange.guess.look import Source, look_at
from rig.exchange.mapping import FORMAT
from rig.recording.mistakes import shown
from rig.recording.units import UNITS

HEAD = f"""\
# Proposed from a look at {{name}}. Nothing was imported. Read every line. What is not sure is commented, with why: set
# it right and take the mark away, or take the line away. Then: spinbench runs import FILE --mapping THIS_FILE
format = "{FORMAT}"

# Unsure: no file tells these.
# title = ""                       # what was measured
# source = ""                      # who took the data, and where they are
# licence = ""
# motor = "ptm3600"                # a name in configs/motors; of another rig a table [motor]
# kind = "steady"                  # a row a plateau; or "transient": a row a sample; or "zero"
"""
_COMMA = re.compile(r"\s*[+-]?[0-9]+,[0-9]+\s*", re.ASCII)
_TEXT = "stored as text: turn them into numbers in the workbook"
MOST_WORDS = 8
MOST_UNKNOWN = 100  # columns that are listed
AMBIENT = """
# Unsure: the room is not in the file, and {why}.
# [ambient]
# pressure_bar_abs =
# temperature_c =
"""


def propose(path: Path) -> str:
    """The text of a mapping file for a source. Raises RunError when the source cannot be read, or holds no numbers."""
    source = look_at(path)
    columns, unknown = proposed_columns(source)
    parts = [HEAD.format(name=shown(path.name, 100)), *_ambient(columns), *_table(source)]
    parts += [_column(column) for column in columns]
    if not any(column.name == "time_s" for column in columns):
        parts.append(_column(Proposed("time_s", {}, ("no column is a time; a transient needs one",), "", _PERIOD)))
    if unknown:
        told = [*unknown[:MOST_UNKNOWN], *[f"and {len(unknown) - MOST_UNKNOWN} more"] * (len(unknown) > MOST_UNKNOWN)]
        parts.append(
            "\n# Not proposed, for nothing says what they are, or their cells are no numbers:\n"
            + "".join(f"#   {one}\n" for one in told)
        )
    return "".join(parts)


_PERIOD = {"sample_period_s": ""}


def _ambient(columns: list[Proposed]) -> list[str]:
    units = [UNITS.get(str(column.keys.get("unit", ""))) for column in columns]
    if any(column.name == "pressure_bar_gauge" for column in columns):
        return [AMBIENT.format(why="a gauge pressure needs it")]
    if any(unit is not None and unit.quantity in ("standard flow", "mass flow") for unit in units):
        return [AMBIENT.format(why="this flow needs its temperature, or the inlet's")]
    return []


def _table(source: Source) -> list[str]:
    parts = [f'\n[table]\nreader = "{source.reader}"\n']
    for said in source.table:
        lines = [f"{said.key} = {_toml(value)}" for value in said.values]
        parts += [_unsure([said.doubt], lines)] if said.doubt else [f"{line}\n" for line in lines]
    words = sorted({word for column in source.columns for word in _odd_words(column.cells, source)})
    as_text = [word for column in source.columns for word in map(str, column.cells) if _COMMA.fullmatch(word)]
    if source.reader == "xlsx" and as_text:
        words = [word for word in words if word not in as_text]
        parts.append(
            f"# Look at this: '{shown(as_text[0])}' and others look like numbers with a decimal comma, {_TEXT}\n"
        )
    if words:
        marks = [f"over_range = {_toml(words)}", f"invalid = {_toml(words)}"]
        parts.append(_unsure(["words among numbers; which say that the range ended, and which that it failed?"], marks))
    parts += [f"# Look at this: {shown(remark, 300)}\n" for remark in source.remarks]
    return parts


def _odd_words(cells: Iterable[str | float], source: Source) -> set[str]:
    """Words in a column of numbers that the import does not know; none where most are words."""
    found = [(cell, source.reads.reading(cell)) for cell in cells]
    numbers = sum(value is not None and math.isfinite(value[0]) for _, value in found)
    odd = [str(cell).strip() for cell, value in found if value is None]
    return set(odd) if numbers > len(odd) and len(set(odd)) <= MOST_WORDS else set()


def _column(column: Proposed) -> str:
    lines = [f"[columns.{column.name}]"]
    lines += [f"{key} = {_toml(value)}" for key, value in column.keys.items()]
    lines += [f"{key} = {value}".rstrip() for key, value in column.further.items()]
    seen = f"\n# {column.seen}\n" if column.seen else "\n"
    return seen + (_unsure(column.doubts, lines) if column.doubts else "".join(f"{line}\n" for line in lines))


def _unsure(doubts: Iterable[str], lines: Iterable[str]) -> str:
    return "".join(f"# Unsure: {doubt}\n" for doubt in doubts) + "".join(f"# {line}\n" for line in lines)


def _toml(value: object) -> str:
    """A value as TOML; text with all that could end it escaped."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_toml(key)} = {_toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str):
        text = value.encode("utf-8", "replace").decode("utf-8")
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value)
