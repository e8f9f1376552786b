"""Alicat meters and controllers over Modbus: a block of status bits and floats, and a set-point.

The manual counts registers from 1, and the wire from 0; whether its numbers are meant so is not said, so the file has a
key for it, to be verified on a device whose pressure is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, cast

import pydantic

from rig.bench.instrument import ChannelFile, InstrumentError, InstrumentFile
from rig.instruments.alicat import NO_FAILSAFE, Scaled, Setpoint, judge
from rig.instruments.codecs.registers import number_of, words_of
from rig.instruments.codecs.values import Value
from rig.instruments.placing import modbus_unit
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, repeated, timing_of
from rig.instruments.setting import set_and_read_back
from rig.lines import Line
from rig.lines.modbus import WRITE_MANY, registers_of

if TYPE_CHECKING:
    from rig.bench.bench import Place

STATUS = 1201  # as the manual counts: status, pressure, temperature, volume flow, mass flow, two registers each
BLOCK = 10
SETPOINT = 1010
PLACE_IN_BLOCK = {"pressure": 2, "temperature": 4, "flow_l": 6, "flow_sl": 8}  # by the name's beginning
STATUS_FLAGS = {
    **{0: "TOV", 1: "TOV", 2: "VOV", 3: "VOV", 4: "MOV", 5: "MOV", 6: "POV", 7: "OVR"},  # over, and under, where two
    **{8: "HLD", 9: "ADC", 10: "EXH", 11: "OPL", 12: "TMF", 13: "measurement aborted"},
}


class ScaledChannel(ChannelFile, Scaled):
    """A float of the block."""


class Settings(PolledFile):
    """The keys of an Alicat device that speaks Modbus."""

    numbering: Literal["from 1", "from 0"]  # of the manual's registers
    channels: Annotated[dict[ChannelName, ScaledChannel], pydantic.Field(min_length=1, max_length=4)]
    setpoint: Setpoint | None = None

    @pydantic.model_validator(mode="after")
    def known_channels(self) -> Settings:
        """Refuse channels that are not in the block."""
        unknown = [name for name in self.channels if _quantity(name) is None]
        if unknown:
            raise ValueError(f"channels.{unknown[0]}: the names begin with {', '.join(PLACE_IN_BLOCK)}")
        return self


def flags_of(status: int) -> list[str]:
    """The flags of the status bits; a bit without a name here is named by its number, and counts as a fault."""
    raised = [STATUS_FLAGS.get(bit, f"status bit {bit}") for bit in range(32) if status >> bit & 1]
    return list(dict.fromkeys(raised))


def decode(words: Sequence[int], channels: dict[str, ScaledChannel]) -> dict[str, Value]:
    """The values of the block. By channel, limits not yet looked at."""
    raw, numbers = {}, {}
    for name, channel in channels.items():
        first = PLACE_IN_BLOCK[cast(str, _quantity(name))]
        number = float(number_of(words[first : first + 2], "f32"))
        raw[name], numbers[name] = repr(number), channel.scale * number + channel.offset
    return judge(numbers, raw, flags_of(int(number_of(words[:2], "u32"))))


def _quantity(name: str) -> str | None:
    return next((quantity for quantity in PLACE_IN_BLOCK if name.startswith(f"{quantity}_")), None)


class AlicatModbus(Polled):
    """An Alicat device at a unit of a Modbus line."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings = settings
        self._less = 1 if settings.numbering == "from 1" else 0
        self._unit = modbus_unit(device, place)

    def ask(self, line: Line) -> Answer:
        """Read the block once."""
        words, reply = self._unit.read(line, STATUS - self._less, BLOCK, timing_of(self.settings, line))
        return Answer(decode(words, self.settings.channels), registers_of(words), reply.request_ns, reply.reply_ns)

    def identify(self, line: Line) -> str:
        """See that the block can be read."""
        answer = repeated(lambda: self.ask(line), 1)
        raised = next(iter(answer.found.values())).detail
        note = f"; flags {raised}" if raised else ""
        return f"{self.settings.title} at unit {self._unit.unit} (its block reads; it is not asked who it is{note})"


class AlicatModbusController(AlicatModbus):
    """An Alicat controller over Modbus. `settings`: its file, with a ``[setpoint]``."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings, place)
        self.setpoint = cast(Setpoint, settings.setpoint)
        self.unit, self.lowest, self.highest = self.setpoint.unit, self.setpoint.lowest, self.setpoint.highest

    def write(self, line: Line, value: float) -> float:
        """Order a set-point and return what its registers hold then."""
        table, timing, first = self.setpoint, timing_of(self.settings, line), SETPOINT - self._less

        def order() -> None:
            words = words_of((value - table.offset) / table.scale, "f32")
            self._unit.write(line, first, words, WRITE_MANY, timing)

        def read_back() -> float:
            words, _ = self._unit.read(line, first, 2, timing)
            return table.scale * float(number_of(words, "f32")) + table.offset

        return set_and_read_back(self, value, order, read_back, table.tolerance)

    def set_failsafe(self, line: Line) -> str:
        """There is none in the documents."""
        raise InstrumentError(NO_FAILSAFE.format(device=self.device))


def build(device: str, settings: InstrumentFile, place: Place) -> AlicatModbus:
    """The driver of an Alicat device that speaks Modbus."""
    chosen = cast(Settings, settings)
    kind = AlicatModbus if chosen.setpoint is None else AlicatModbusController
    return kind(device, chosen, place)
