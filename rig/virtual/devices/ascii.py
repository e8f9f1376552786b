"""A device that answers in text: the line is made from the pattern of its file, with the truth where the groups are."""

from __future__ import annotations

import itertools
import math
import re
import re._constants as known  # type: ignore[import-not-found]
import re._parser as parser  # type: ignore[import-not-found]
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rig.bench.bench import Place
from rig.virtual.devices.base import Sender, World

UNASKED_S = 1.0  # between two lines of a device without a query, when the file does not say
FORMATS = ("{:.{d}f}", "{:+.{d}f}", "{:08.{d}f}", "{:+08.{d}f}", "{:8.{d}f}", "{:.0f}", "{:+.0f}", "{:.3e}", "{:+.3E}")
SERIAL = "V00001"
EXAMPLES = "0 aA_.-+:/,;=#*"
MOST_DECIMALS = 6
MOST_TRIES = 5000
PRINTABLE = "".join(map(chr, range(32, 127)))


def serve(device: str, settings: Any, place: Place, world: World) -> TextDevice:
    """A device after its file. Raises ValueError when no line can be made of the pattern."""
    return TextDevice(device, settings, place.table.serial_number or SERIAL, world)


class TextDevice(Sender):
    """Answers its query, or sends a line now and then where it has none."""

    def __init__(self, device: str, settings: Any, serial: str, world: World) -> None:
        super().__init__(device, settings, UNASKED_S)
        self.identity = settings.identity_query.encode("ascii")
        self.terminator = (self.query or self.identity)[-1:] or b"\n"
        self.end = settings.terminator.encode("ascii")
        self._sensors = {
            name: world.sensor(device, name, channel, settings.update_s) for name, channel in settings.channels.items()
        }
        self._who = b""
        if settings.identity_pattern:
            self._who = line_of(settings.identity_pattern, {"serial": [serial]})
        self._line(0)  # refuses a pattern at the start, not at the first question

    def answer(self, line: bytes, time_ns: int) -> bytes | None:
        """The line of values, or who it is."""
        asked = line + self.terminator
        if self.identity and asked == self.identity:
            return self._who + self.end
        return self._line(time_ns) + self.end if self.query and asked == self.query else None

    def _sent(self, time_ns: int) -> list[bytes]:
        return [self._line(time_ns) + self.end]

    def _line(self, time_ns: int) -> bytes:
        numbers = {}
        for name, channel in self.settings.channels.items():
            value = (self._sensors[name].read(time_ns) - channel.offset) / channel.scale
            numbers[name] = [text.replace(".", self.settings.decimal) for text in _texts(value, channel)]
        return line_of(self.settings.pattern, numbers)


def _texts(value: float, channel: Any) -> list[str]:
    """Ways to write a number; the pattern decides for one of them."""
    if math.isnan(value):
        return [*channel.invalid[:1], "nan", "NaN", "----"]
    resolution = (channel.resolution or 0.001) / abs(channel.scale)
    decimals = min(MOST_DECIMALS, max(0, math.ceil(-math.log10(resolution) - 1e-9)))
    return [form.format(value, d=decimals) for form in FORMATS]


def line_of(pattern: str, values: Mapping[str, Sequence[str]]) -> bytes:
    """A line that fits a pattern.

    `values`: for each named group the texts to try in its place, best first.
    It is without an end of line. Raises ValueError when none fits.
    """
    tree = parser.parse(pattern)
    names = {number: name for name, number in tree.state.groupdict.items()}
    compiled = re.compile(pattern)
    alike = itertools.zip_longest(*values.values())  # most devices write all their numbers in one way
    for texts in itertools.chain(alike, itertools.islice(itertools.product(*values.values()), MOST_TRIES)):
        chosen = dict(zip(values, (text or "" for text in texts), strict=True))
        line = _example(tree, names, chosen)
        if compiled.fullmatch(line):
            return line.encode("ascii", errors="replace")
    raise ValueError(f"the virtual bench finds no line that fits the pattern {pattern}")


def _example(tree: Iterable[Any], names: Mapping[int, str], chosen: Mapping[str, str]) -> str:
    """The shortest text of a parsed pattern, with chosen texts in its named groups."""
    text = ""
    for kind, content in tree:
        if kind is known.LITERAL:
            text += chr(content)
        elif kind in (known.IN, known.NOT_LITERAL, known.ANY, known.CATEGORY):
            text += _character(kind, content)
        elif kind in (known.MAX_REPEAT, known.MIN_REPEAT, known.POSSESSIVE_REPEAT):
            text += _example(content[2], names, chosen) * content[0]
        elif kind is known.SUBPATTERN:
            name = names.get(content[0], "")
            text += chosen[name] if name in chosen else _example(content[3], names, chosen)
        elif kind is known.ATOMIC_GROUP:
            text += _example(content, names, chosen)
        elif kind is known.BRANCH:
            text += _example(content[1][0], names, chosen)
    return text


def _character(kind: Any, content: Any) -> str:
    """A character of a set."""
    if kind is known.ANY:
        return "0"
    if kind is known.NOT_LITERAL:
        return next(character for character in EXAMPLES if ord(character) != content)
    one = re.compile(_source_of(content if kind is known.IN else [(kind, content)]))
    return next((character for character in EXAMPLES + PRINTABLE if one.fullmatch(character)), "")


def _source_of(items: Iterable[Any]) -> str:
    """A set of characters as a pattern again."""
    parts = ""
    classes = {known.CATEGORY_DIGIT: r"\d", known.CATEGORY_SPACE: r"\s", known.CATEGORY_WORD: r"\w"}
    classes |= {known.CATEGORY_NOT_DIGIT: r"\D", known.CATEGORY_NOT_SPACE: r"\S", known.CATEGORY_NOT_WORD: r"\W"}
    for kind, content in items:
        if kind is known.NEGATE:
            parts += "^"
        elif kind is known.LITERAL:
            parts += re.escape(chr(content))
        elif kind is known.RANGE:
            parts += f"{re.escape(chr(content[0]))}-{re.escape(chr(content[1]))}"
        else:
            parts += classes[content]
    return f"[{parts}]"
