"""What a heading that others write says of its column: words of a quantity, and a unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from rig.recording.units import PRESSURE_UNITS, QUANTITIES_OF, UNITS, unit_called

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
