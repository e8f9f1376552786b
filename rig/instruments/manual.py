"""A person as the instrument: one line an entry, ``2.00 72 394``, for dials, rotameters and tachometers without a port.

A number alone, with a dot; ``<10`` and ``>100`` off the scale; ``-`` for what was not read. Units are those of the file
and are never guessed. They are what stands on the instrument's face: a reading becomes the unit of its column.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, ClassVar, cast

import pydantic

from configs import ConfigError
from configs.units import FACES, end_of
from rig.bench.instrument import ChannelFile, InstrumentFile
from rig.instruments.codecs.streaming import Stream, cut_lines
from rig.instruments.codecs.values import Times, Value, failures, joined, printable, reading_of
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
IN_THE_UNIT = ("lowest", "highest", "noise_sd", "bias_sd", "drift_sd", "resolution", "repeatability_sd")


class EntryError(ValueError):
    """An entry that a person typed cannot be used. The text says what to type instead."""


class Settings(InstrumentFile):
    """The keys of manual entry."""

    converts_units: ClassVar[bool] = True
    channels: Annotated[dict[ChannelName, ChannelFile], pydantic.Field(min_length=1, max_length=8)]
    columns: Annotated[list[str], pydantic.Field(min_length=1, max_length=8)]  # the channels, in the order of the entry

    @pydantic.model_validator(mode="after")
    def columns_fit(self) -> Settings:
        """Refuse columns that are not the channels."""
        if sorted(self.columns) != sorted(self.channels):
            raise ValueError(f"columns: {', '.join(self.columns)} are not the channels ({', '.join(self.channels)})")
        return self

    @pydantic.model_validator(mode="after")
    def units_become_those_of_the_columns(self) -> Settings:
        """Refuse a unit that the column's cannot be made of."""
        mistakes = [
            f"channels.{name}.unit: '{channel.unit}' is not known for {name}: one of {', '.join(FACES[end][2])}"
            for name, channel in self.channels.items()
            if (end := end_of(name)) and channel.unit not in FACES[end][2]
        ]
        if mistakes:
            raise ValueError("\n".join(mistakes))
        return self


def decode_entry(text: str, columns: Mapping[str, ChannelFile]) -> dict[str, Value]:
    """The values of an entry, in the units of the columns.

    `columns`: as they stand on the faces.
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
    return ", ".join(asked(name, channel) for name, channel in columns.items()) + ", separated by spaces"


def asked(name: str, channel: ChannelFile) -> str:
    """What a person is asked for, as it stands on the face: ``pressure [kPa gauge]``."""
    return f"{quantity(name)} [{unit_on_face(name, channel)}]"


def quantity(name: str) -> str:
    """What a column is called."""
    return name.removesuffix(end_of(name)).replace("_", " ")


def unit_on_face(name: str, channel: ChannelFile) -> str:
    """The unit on an instrument's face, and for a pressure from where it counts."""
    end = end_of(name)
    return channel.unit + (FACES[end][1] if end else "")


def is_other_unit(name: str, channel: ChannelFile) -> bool:
    """Whether another unit than the column's stands on the face."""
    end = end_of(name)
    return bool(end) and channel.unit != FACES[end][0]


def factor(name: str, channel: ChannelFile) -> float:
    """What one of the face's unit is in the column's."""
    end = end_of(name)
    return FACES[end][2][channel.unit] if end else 1.0


def _in_unit_of_column(name: str, channel: ChannelFile) -> ChannelFile:
    """A channel in its column's unit, with its limits and figures."""
    if not is_other_unit(name, channel):
        return channel
    figures = {key: getattr(channel, key) for key in IN_THE_UNIT}
    made = {key: value * factor(name, channel) for key, value in figures.items() if value is not None}
    return channel.model_copy(update={"unit": FACES[end_of(name)][0], **made})


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
    value = number * factor(name, channel)
    typed = f"typed in {channel.unit}" if is_other_unit(name, channel) else ""
    if beyond:
        return Value(value, Quality.MANUAL, word, joined("off the scale", typed), -1 if beyond == "<" else 1)
    if channel.lowest is not None and number < channel.lowest:
        raise EntryError(f"{name}: {word} {channel.unit} is below the scale; type <{channel.lowest:g} if it reads less")
    if channel.highest is not None and number > channel.highest:
        raise EntryError(
            f"{name}: {word} {channel.unit} is above the scale; type >{channel.highest:g} if it reads more"
        )
    return Value(value, Quality.MANUAL, word, typed)


class ManualEntry:
    """A person at a keyboard line.

    `faces`: the channels as they stand on the instruments' faces; `channels` are in the units of the columns.
    """

    failing = False

    def __init__(self, device: str, settings: Settings) -> None:
        self.device = device
        self.settings = settings
        self.faces = {name: settings.channels[name] for name in settings.columns}
        self.channels = {name: _in_unit_of_column(name, channel) for name, channel in self.faces.items()}
        # The log and the line show the columns' names.
        self._logged = ", ".join(f"{name} [{channel.unit}]" for name, channel in self.faces.items())
        self._stream = Stream(cut_lines(b"\n", MOST_REPLY_BYTES))
        self._waiting: list[bytes] = []

    def open(self, line: Line) -> None:
        """Forget what was half typed."""
        self._stream.forget()
        self._waiting.clear()

    def identify(self, line: Line) -> str:
        """Whom to expect; nobody is asked."""
        return f"{self.settings.title}: entry by hand of {self._logged}, separated by spaces"

    def poll(self, line: Line) -> list[Reading]:
        """Ask for one line, and again while it cannot be read."""
        trouble = ""
        request_ns = time_ns = 0
        for attempt in range(MOST_ATTEMPTS):
            request_ns = line.tell(f"{trouble}{self.device}: {self._logged}, separated by spaces: ".encode())
            try:
                time_ns, typed = self._line(line)
            except (NoReplyError, BadReplyError) as error:
                times = Times(line.heard_ns, request_ns, line.heard_ns, attempt)
                return failures(self.device, self.channels, error, times)
            try:
                found = decode_entry(typed.decode("utf-8", errors="replace"), self.faces)
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
