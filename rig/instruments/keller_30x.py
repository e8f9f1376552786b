"""Keller 30X/33X/35X pressure transmitter over Modbus: floats from 0x0002, NaN for a faulty channel.

The maker's integer maps differ between versions of the document, so only the floats are read. Whether P1 is absolute or
above ambient is a property of the sensor: the file's channel says it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from rig.bench.instrument import ChannelFile, IdentityError, InstrumentFile
from rig.instruments.codecs.registers import number_of
from rig.instruments.codecs.values import Value, bounded
from rig.instruments.placing import modbus_unit
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, repeated, timing_of
from rig.lines import Line
from rig.lines.modbus import registers_of
from rig.readings import Quality

if TYPE_CHECKING:
    from rig.bench.bench import Place

FIRST, COUNT = 0x0002, 6  # P1, P2, T: two registers each, high word first
OFFSETS = {"pressure_bar_abs": 0, "pressure_bar_gauge": 0, "temperature_c": 4}  # within the block


class Settings(PolledFile):
    """The keys of a Keller transmitter."""

    channels: Annotated[dict[ChannelName, ChannelFile], pydantic.Field(min_length=1)]

    @pydantic.model_validator(mode="after")
    def known_channels(self) -> Settings:
        """Refuse channels that the transmitter does not have."""
        unknown = sorted(set(self.channels) - set(OFFSETS))
        if unknown:
            raise ValueError(f"channels.{unknown[0]}: a Keller 30X has {', '.join(OFFSETS)}")
        if {"pressure_bar_abs", "pressure_bar_gauge"} <= set(self.channels):
            raise ValueError("channels: P1 is either absolute or gauge, not both; the sensor's label says which")
        return self


def decode(words: Sequence[int], channels: Sequence[str]) -> dict[str, Value]:
    """The values of the block. In bar and degree Celsius; NaN and infinities as they came."""
    found = {}
    for name in channels:
        number = float(number_of(words[OFFSETS[name] : OFFSETS[name] + 2], "f32"))
        found[name] = Value(number, raw=repr(number))
    return found


class Keller30X(Polled):
    """A Keller transmitter at a unit of a Modbus line."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings = settings
        self._unit = modbus_unit(device, place)

    def ask(self, line: Line) -> Answer:
        """Read the block once."""
        words, reply = self._unit.read(line, FIRST, COUNT, timing_of(self.settings, line))
        found = decode(words, list(self.channels))
        return Answer(found, registers_of(words), reply.request_ns, reply.reply_ns)

    def identify(self, line: Line) -> str:
        """Tell a transmitter by a block that reads as one: numbers on its scale, or its own marks for a fault."""
        answer = repeated(lambda: self.ask(line), 1)
        for name, value in answer.found.items():
            channel = self.channels[name]
            highest = channel.highest or 1000.0
            if value.value is not None and highest * 10.0 < abs(value.value) < float("inf"):
                raise IdentityError(
                    f"{self.device}: unit {self._unit.unit} gives {value.value:g} {channel.unit} where "
                    f"{self.settings.title} keeps its floats; another device answers, or its word order was changed"
                )
        judged = {name: bounded(value, self.channels[name]) for name, value in answer.found.items()}
        faults = [name for name, value in judged.items() if value.quality is not Quality.OK]
        note = f"; faulty: {', '.join(faults)}" if faults else ""
        return f"{self.settings.title} at unit {self._unit.unit} (its floats read; it does not tell who it is{note})"


def build(device: str, settings: InstrumentFile, place: Place) -> Keller30X:
    """The driver of a Keller transmitter."""
    chosen = cast(Settings, settings)
    return Keller30X(device, chosen, place)
