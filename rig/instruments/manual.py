"""A person as the instrument: one line an entry, ``2.00 72 394``, for dials, rotameters and tachometers without a port.

A number alone, with a dot; ``<10`` and ``>100`` off the scale; ``-`` for what was not read. Units are those of the file
and are never guessed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from configs import ConfigError
from rig.bench.instrument import ChannelFile, InstrumentFile
from rig.instruments.codecs.streaming import Stream, cut_lines
from rig.instruments.codecs.values import Times, Value, failures, printable, reading_of
from rig.instruments.polling import ChannelName
from rig.lines import BadReplyError, Line, NoReplyError
from rig.lines.line import MOST_REPLY_BYTES
from rig.readings import Quality, Reading

if TYPE_CHECKING:
    from rig.bench.bench import Place

NUMBER = re.compile(r"([<>]?)([+-]?\d{1,9}(?:\.\d{0,9})?|[+-]?\.\d{1,9})")
NOT_READ = "-"
MOST_CHARACTERS = 200
MOST_ATTEMPTS = 5  # then the poll fails, and the sweep decides what becomes of the plateau
PATIENCE_S = 600.0


class EntryError(ValueError):
    """An entry that a person typed cannot be used. The text says what to type instead."""


class Settings(InstrumentFile):
    """The keys of manual entry."""

    channels: Annotated[dict[ChannelName, ChannelFile], pydantic.Field(min_length=1, max_length=8)]
    columns: Annotated[list[str], pydantic.Field(min_length=1, max_length=8)]  # the channels, in the order of the entry

    @pydantic.model_validator(mode="after")
    def columns_fit(self) -> Settings:
        """Refuse columns that are not the channels."""
        if sorted(self.columns) != sorted(self.channels):
            raise ValueError(f"columns: {', '.join(self.columns)} are not the channels ({', '.join(self.channels)})")
        return self


def decode_entry(text: str, columns: Mapping[str, ChannelFile]) -> dict[str, Value]:
    """The values of an entry.

    By channel, quality manual; None where ``-`` was typed. Raises EntryError when the line cannot be read as meant
    beyond doubt.
    """
    if len(text) > MOST_CHARACTERS:
        raise EntryError(f"the line has {len(text)} characters; type {example(columns)}")
    words = text.split()
    if len(words) != len(columns):
        raise EntryError(f"{len(words)} entries where there are {len(columns)} columns; type {example(columns)}")
    return {name: _value(word, name, channel) for word, (name, channel) in zip(words, columns.items(), strict=True)}


def example(columns: Mapping[str, ChannelFile]) -> str:
    """What to type, for prompts and error texts."""
    return ", ".join(f"{name} [{channel.unit}]" for name, channel in columns.items()) + ", separated by spaces"


def _value(word: str, name: str, channel: ChannelFile) -> Value:
    if word == NOT_READ:
        return Value(None, Quality.MANUAL, word, "not read")
    match = NUMBER.fullmatch(word) if word.isascii() else None
    if match is None:
        if "," in word:
            raise EntryError(f"{name}: '{printable(word)}' has a comma; write the decimals after a dot, as in 2.00")
        raise EntryError(
            f"{name}: '{printable(word)}' is not a number alone; the unit is {channel.unit} and is not typed"
        )
    beyond, number = match[1], float(match[2])
    if beyond:
        return Value(number, Quality.MANUAL, word, "off the scale", -1 if beyond == "<" else 1)
    if channel.lowest is not None and number < channel.lowest:
        raise EntryError(f"{name}: {word} {channel.unit} is below the scale; type <{channel.lowest:g} if it reads less")
    if channel.highest is not None and number > channel.highest:
        raise EntryError(
            f"{name}: {word} {channel.unit} is above the scale; type >{channel.highest:g} if it reads more"
        )
    return Value(number, Quality.MANUAL, word)


class ManualEntry:
    """A person at a keyboard line."""

    failing = False

    def __init__(self, device: str, settings: Settings) -> None:
        self.device = device
        self.settings = settings
        self.channels = {name: settings.channels[name] for name in settings.columns}
        self._stream = Stream(cut_lines(b"\n", MOST_REPLY_BYTES))
        self._waiting: list[bytes] = []

    def open(self, line: Line) -> None:
        """Forget what was half typed."""
        self._stream.forget()
        self._waiting.clear()

    def identify(self, line: Line) -> str:
        """Whom to expect; nobody is asked."""
        return f"{self.settings.title}: entry by hand of {example(self.channels)}"

    def poll(self, line: Line) -> list[Reading]:
        """Ask for one line, and again while it cannot be read."""
        trouble = ""
        request_ns = time_ns = 0
        for attempt in range(MOST_ATTEMPTS):
            request_ns = line.tell(f"{trouble}{self.device}: {example(self.channels)}: ".encode())
            try:
                time_ns, typed = self._line(line)
            except (NoReplyError, BadReplyError) as error:
                times = Times(line.heard_ns, request_ns, line.heard_ns, attempt)
                return failures(self.device, self.channels, error, times)
            try:
                found = decode_entry(typed.decode("utf-8", errors="replace"), self.channels)
            except EntryError as error:
                trouble = f"{error}\n"
                continue
            times = Times(time_ns, request_ns, time_ns, attempt)
            return [reading_of(self.device, name, self.channels[name], found[name], times) for name in self.channels]
        fault = BadReplyError(
            f"{MOST_ATTEMPTS} entries could not be read; the last: {trouble.strip()}", Quality.EXCEPTION
        )
        return failures(self.device, self.channels, fault, Times(time_ns, request_ns, time_ns, MOST_ATTEMPTS - 1))

    def _line(self, line: Line) -> tuple[int, bytes]:
        """The next line typed; lines typed ahead are used one after the other."""
        if self._waiting:
            return line.heard_ns, self._waiting.pop(0)
        time_ns, self._waiting = self._stream.frames(line, self.settings.timeout_s or PATIENCE_S)
        return time_ns, self._waiting.pop(0)


def build(device: str, settings: InstrumentFile, place: Place) -> ManualEntry:
    """The driver of manual entry."""
    chosen = cast(Settings, settings)
    if place.line.kind != "keyboard":
        raise ConfigError(f"devices.{device}.line: manual entry needs a line of kind 'keyboard'")
    return ManualEntry(device, chosen)
