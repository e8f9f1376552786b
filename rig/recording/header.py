"""The names of a CSV file's columns: those of each kind of file, and what one that others write says of its column."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from rig.recording.columns import MEASURED, NAMES, PRESSURE, nearest, other_spelling, siblings
from rig.recording.contents import Kind
from rig.recording.mistakes import Mistakes, shown
from rig.recording.units import PRESSURE_UNITS, QUANTITIES_OF, UNITS, advice, unit_called

# Words, in lower case, that name a column; a word counts where it stands alone, and of four letters or more within one.
WORDS = {
    "time_s": ("time", "zeit", "uhrzeit", "datum", "date", "timestamp", "zeitstempel", "clock", "elapsed", "t"),
    "pressure": ("pressure", "druck", "press", "überdruck", "absolutdruck", "p"),
    "flow_l_min": ("flow", "durchfluss", "volumenstrom", "massenstrom", "flowrate", "q"),
    "speed_rpm": ("speed", "drehzahl", "rpm", "rotation", "tacho", "n"),
    "inlet_temperature_c": ("temperature", "temperatur", "temp"),
    "torque_nm": ("torque", "drehmoment", "moment"),
    "force_n": ("force", "kraft"),
    "velocity_m_s": ("velocity", "geschwindigkeit"),
    "angle_rad": ("angle", "winkel"),
    "direction": ("direction", "richtung"),
    "supply_open": ("valve", "ventil", "supply"),
    "rotor_locked": ("locked", "blockiert"),
}
ABSOLUTE, GAUGE = ("abs", "absolute", "absolut", "absolutdruck"), ("gauge", "rel", "relative", "überdruck", "gage")
INLET = ("inlet", "in", "eintritt", "einlass", "zuluft")
# Words that say no more than that a quantity was measured at this motor.
_MORE = {
    "measured", "meas", "actual", "ist", "mean", "avg", "average", "mittel", "mittelwert", "motor", "rotor",
    "shaft", "welle", "inlet", "in", "eintritt", "air", "luft", "supply", "volume", "rate", "line", "value",
    "wert", "abs", "absolute", "gauge", "rel",
}  # fmt: skip
# Words that say that it is no measurement of the motor, or one that refers to another state.
_OTHER = {
    "set", "sp", "max", "min", "pmax", "pmin", "nmax", "nmin", "std", "nom", "ref", "cmd", "sd", "stdev", "alarm",
    "error",
}  # fmt: skip
_OTHER_WITHIN = (
    "setpoint", "soll", "target", "maxim", "minim", "limit", "grenz", "norm", "standard", "nominal", "nenn", "demand",
    "command", "vorgabe", "reference", "abweichung", "deviation",
)  # fmt: skip
_ELAPSED = {"time", "zeit", "elapsed"}  # a clock's time, such as a timestamp's, may be a note
_NO_UNIT_AT_THE_END = {"in", "rev", "m"}  # P_in, rev: words as well
_BRACKETS = (
    re.compile(r"(.*?)\s*\[([^\[\]]{1,20})\]\s*(.*)"),
    re.compile(r"(.*?)\s*\(([^()]{1,20}(?:\([ag]\))?)\)\s*(.*)"),
)
_SEPARATOR = re.compile(r"\s+in\s+|\s*[/,;:]\s*|[\s_]+")


@dataclass(frozen=True)
class Heading:
    """What a heading says.

    `unit`: as the import knows it, but for a pressure perhaps without `abs` or `gauge`; empty where none is stated.
    `unknown_unit`: what stands in the unit's place and is none that the import knows.
    `by_unit`, `by_words`: columns of a recording that it could be, by the unit and by the words.
    """

    unit: str
    unknown_unit: str
    by_unit: tuple[str, ...]
    by_words: tuple[str, ...]
    words: frozenset[str]

    @property
    def is_absolute(self) -> bool | None:
        """Whether a pressure is absolute, as the unit or the words say; None where they do not."""
        if self.unit.endswith((" abs", " gauge")):
            return self.unit.endswith(" abs")
        said = {True: bool(self.words & set(ABSOLUTE)), False: bool(self.words & set(GAUGE))}
        return None if said[True] == said[False] else said[True]


def read_heading(text: str, stated_unit: str = "") -> Heading:
    """What a heading says, with the unit that the source states beside it, if any."""
    words, unit, unknown = (text, stated_unit, "") if stated_unit.strip() else _parted(text.strip())
    known = unit_called(unit)
    own = unit_called(_parted(text.strip())[1])
    if own in (f"{known} abs", f"{known} gauge"):  # the heading says more of a pressure than the unit beside it
        known = own
    unknown = unknown if known else unit.strip() or unknown
    found = frozenset(re.findall(r"[^\W\d_]+", words.casefold()))
    by_unit = _columns_of(known)
    return Heading(known, "" if known else unknown, by_unit, _named_by(found, bool(by_unit)), found)


def plainly_named(text: str) -> str:
    """The quantity that a heading names and nothing beside it, as in `WORDS`; empty where it may be another thing.

    `n [1/min]`, `rpm` and `Drehzahl` are speeds; `n_samples`, `speed_set` and `flow in %` may be anything.
    """
    heading, is_unit = read_heading(text), len(text) > 1 and bool(unit_called(text))
    name = next(iter(heading.by_unit or heading.by_words), "")
    if not name or heading.unknown_unit or "%" in text:
        return ""
    if is_unit:
        return "" if name == "time_s" or heading.unit == "Hz" else name
    if name == "time_s" and not heading.words & ({"t", *_ELAPSED} if heading.unit else _ELAPSED):
        return ""
    return name if all(word in _MORE or _says(word, name) for word in heading.words) else ""


def another_in(text: str) -> str:
    """The word of a heading that says that it is no reading, such as a set-point or a limit; empty for none."""
    if unit_called(text):
        return ""
    words = sorted(read_heading(text).words)
    return next((word for word in words if word in _OTHER or any(other in word for other in _OTHER_WITHIN)), "")


def _says(word: str, name: str) -> bool:
    return any(word == one or (len(one) >= 4 and one in word) for one in WORDS[name])


def _parted(text: str) -> tuple[str, str, str]:
    """Words, unit, and what stands in brackets and is no unit."""
    if len(text) > 1 and unit_called(text):
        return text, text, ""
    unknown = ""
    for bracket in _BRACKETS:
        match = bracket.fullmatch(text)
        if match and unit_called(match[2]):
            return f"{match[1]} {match[3]}", match[2], ""
        unknown = unknown or (match[2] if match and bracket is _BRACKETS[0] else "")
    for separator in _SEPARATOR.finditer(text):  # the first leaves the longest unit
        end = text[separator.end() :]
        if unit_called(end) and end not in _NO_UNIT_AT_THE_END and separator.start():
            return text[: separator.start()], end, ""
    return text, "", unknown


def _columns_of(unit: str) -> tuple[str, ...]:
    if unit in PRESSURE_UNITS:
        return ("pressure",)
    quantity = UNITS[unit].quantity if unit else ""
    if quantity in ("absolute pressure", "gauge pressure"):
        return ("pressure",)
    return tuple(name for name, quantities in QUANTITIES_OF.items() if quantity in quantities)


def _named_by(words: frozenset[str], has_unit: bool) -> tuple[str, ...]:
    """Columns that words name; beside a unit a single letter says nothing."""
    alone = {name: words & set(known) for name, known in WORDS.items() if words & set(known)}
    within = [
        name for name, known in WORDS.items() if any(len(one) >= 4 and one in word for one in known for word in words)
    ]
    if has_unit:
        alone = {name: said for name, said in alone.items() if any(len(word) > 1 for word in said)}
    return tuple(alone) or tuple(within)


MAX_COLUMNS = 256
_TITLE_LINES = 50  # that may stand above the names
_MOTION = ("speed_rpm", "flow_l_min")
_NEEDS = {
    "radial_piston": (PRESSURE, _MOTION),
    "displacement_machine": (PRESSURE, _MOTION),
    "free_rotor": (("speed_rpm", "angle_rad"),),
    "turning_axis": (("torque_nm",), ("speed_rpm", "angle_rad")),
    "sliding_axis": (("force_n",), ("velocity_m_s",)),
}


def needed_columns(kind: Kind, motor: str | dict[str, Any]) -> tuple[tuple[str, ...], ...]:
    """The columns that a file has to hold: of each group, one.

    `motor`: the recording's motor; a name stands for a radial piston motor.
    """
    if kind == "zero":
        return (MEASURED,)
    name = "radial_piston" if isinstance(motor, str) else str(motor.get("kind"))
    if name == "driven_axis" and isinstance(motor, dict):
        name = "sliding_axis" if "mass_kg" in motor else "turning_axis"
    groups = _NEEDS.get(name, (MEASURED,))
    return (("time_s",), *groups) if kind == "transient" else groups


def names_below(first: list[str], rows: list[list[str]]) -> int | None:
    """The line, from 1, of the column names where the first line holds none of them and a later one several.

    `first`, `rows`: the cells of the first line, and of those behind it.
    """
    if set(first) & set(NAMES):
        return None
    below = (len({cell.strip() for cell in row} & set(NAMES)) for row in rows[:_TITLE_LINES])
    return next((line for line, count in enumerate(below, start=2) if count > 1), None)


def check_separator(names: list[str], place: str, mistakes: Mistakes) -> bool:
    """Whether the first line looks like a header at all; False with one mistake noted when it does not."""
    line = ",".join(names)
    for letter, word in ((";", "semicolons"), ("\t", "tabs")):
        if letter in line:
            mistakes.add(
                f"{place}, header",
                f"'{shown(line)}' has {word} between the columns; separate them with commas and write decimals with a "
                "point (1.5)",
            )
            return False
    if all(_is_number(name) for name in names):
        mistakes.add(f"{place}, header", f"'{shown(line)}' holds numbers; put the column names into the first line")
        return False
    if len(names) > MAX_COLUMNS:
        mistakes.add(f"{place}, header", f"{len(names)} columns; at most {MAX_COLUMNS} are read, leave out the others")
        return False
    return True


def check_names(names: list[str], needed: tuple[tuple[str, ...], ...], place: str, mistakes: Mistakes) -> None:
    """Check the column names of one file: no doubles, no other units, nothing missing."""
    header = f"{place}, header"
    for name in sorted({name for name in names if names.count(name) > 1}):
        mistakes.add(header, f"column '{shown(name)}' stands {names.count(name)} times; keep one, or rename the others")
    if "" in names:
        mistakes.add(header, f"column {names.index('') + 1} has no name; give it one, or take the column out")
    if set(PRESSURE) <= set(names):
        mistakes.add(header, f"both {' and '.join(PRESSURE)}; keep the one that the gauge shows")
    renamed: set[str] = set()
    for name in unknown(names):
        spelling = other_spelling(name)
        if spelling is not None and not set(siblings(name)) & set(names):
            mistakes.add(header, f"column '{shown(name)}': expected {spelling[0]} ({spelling[1]})")
            renamed |= set(siblings(name))
        elif (columns := _meant(name, needed)) and not columns & set(names):
            mistakes.add(header, _looks_like(name, columns))
            renamed |= columns
    for group in needed:
        if not set(group) & (set(names) | renamed):
            near = next((name for name in unknown(names) if nearest(name, group)), None)
            meant = f"; is '{shown(near)}' meant? Rename it" if near else "; add it"
            mistakes.add(header, f"no column {_listed(group)}, which this file needs{meant}")


def _meant(name: str, needed: tuple[tuple[str, ...], ...]) -> set[str]:
    """The columns that a heading plainly says it is, of those that a file may need or that order and mark its rows.

    The air's temperature is no such: a heading does not tell which one of several it is.
    """
    said = plainly_named(name)
    columns = set(PRESSURE) if said == "pressure" else {said}
    asked = {column for group in needed for column in group} - {"inlet_temperature_c"}
    return columns & (asked | {"time_s", "rotor_locked"})


def _looks_like(name: str, meant: set[str]) -> str:
    """What to do with a column whose heading says that it is one of a recording's."""
    heading = read_heading(name)
    unit = UNITS.get(heading.unit) or UNITS.get(f"{heading.unit} abs")
    numbers = f" ({advice(unit)})" if unit else ""
    likely = meant & {PRESSURE[not heading.is_absolute]} if heading.is_absolute is not None else meant
    return (
        f"column '{shown(name)}' looks like {' or '.join(sorted(likely or meant))}; rename it{numbers}, or let its "
        "name say what else it is; or import the file: spinbench runs import FILE --guess"
    )


def unknown(names: list[str]) -> list[str]:
    """The columns that this tool does not know by name."""
    return [name for name in names if name and name not in NAMES]


def unknown_warning(names: list[str], place: str, kept: bool) -> list[str]:
    """One sentence on the columns of a file that are not used, each with what may have been meant."""
    columns = [f"'{shown(name)}'{nearest(name)}" for name in unknown(names)]
    fate = "kept as text, not used" if kept else "not used, and not kept: the file is large"
    return [f"{place}: unknown {'column' if len(columns) == 1 else 'columns'} {', '.join(columns)} ({fate})"] * bool(
        columns
    )


def _listed(group: tuple[str, ...]) -> str:
    return " or ".join(f"'{name}'" for name in group)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
