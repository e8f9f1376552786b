"""A Modbus device described by its file alone: registers, types, scales, and at most one register that may be written.

Every poll reads one and the same block, so an answer that comes late can be old but never another quantity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, cast

import pydantic

from configs import Strict
from rig.bench.instrument import ChannelFile, IdentityError, InstrumentError, InstrumentFile, Positive
from rig.instruments.codecs.registers import Kind, WordOrder, number_of, width_of, words_of
from rig.instruments.codecs.values import Value, joined
from rig.instruments.placing import modbus_unit
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, repeated, timing_of
from rig.instruments.setting import set_and_read_back
from rig.lines import Line
from rig.lines.modbus import MOST_REGISTERS, READ_HOLDING, READ_INPUT, WRITE_MANY, WRITE_ONE, registers_of
from rig.readings import Quality

if TYPE_CHECKING:
    from rig.bench.bench import Place

Register = Annotated[int, pydantic.Field(ge=0, le=65535)]  # address as on the wire, from 0: "40001" is 0
Factor = Annotated[float, pydantic.Field(ge=-1e12, le=1e12)]


class RegisterChannel(ChannelFile):
    """A quantity in registers: value = scale * number + offset."""

    address: Register
    type: Kind
    word_order: WordOrder = "big"
    scale: Factor = 1.0
    offset: Factor = 0.0
    over_range: list[int] = pydantic.Field(default_factory=list)  # raw numbers that stand for a state, not for a value
    under_range: list[int] = pydantic.Field(default_factory=list)
    invalid: list[int] = pydantic.Field(default_factory=list)


class Check(Strict):
    """A register that must hold one of some values: a model number, a unit, a count of decimals."""

    address: Register
    values: Annotated[list[Register], pydantic.Field(min_length=1, max_length=32)]
    meaning: str


class Setpoint(Strict):
    """The one register, or pair, that may be written."""

    address: Register
    type: Kind
    word_order: WordOrder = "big"
    scale: Factor = 1.0
    offset: Factor = 0.0
    unit: str
    lowest: float
    highest: float
    tolerance: Positive | None = None  # of the read-back; the register's resolution when left out
    many: bool = False  # write with function 16 even where one register is meant


class Settings(PolledFile):
    """The keys of a generic Modbus device."""

    registers: Literal["holding", "input"] = "holding"  # function 3 or 4; one kind, as a poll is one question
    most_registers: Annotated[int, pydantic.Field(ge=1, le=MOST_REGISTERS)] = MOST_REGISTERS
    channels: Annotated[dict[ChannelName, RegisterChannel], pydantic.Field(min_length=1, max_length=32)]
    expect: list[Check] = pydantic.Field(default_factory=list)  # checked in every poll, within the block
    identity: Check | None = None  # checked when the device is identified
    setpoint: Setpoint | None = None

    @pydantic.model_validator(mode="after")
    def block_fits(self) -> Settings:
        """Refuse a file whose channels do not fit one question."""
        first, count = block_of(self)
        if count > self.most_registers:
            raise ValueError(
                f"the channels span registers {first} to {first + count - 1}, {count} in all; a poll reads one block "
                f"of at most {self.most_registers}: split the device into two instrument files"
            )
        if first + count > 65536:
            raise ValueError("a channel reaches beyond register 65535")
        if any(channel.scale == 0.0 for channel in self.channels.values()):
            raise ValueError("a channel's scale is 0; it would read the same always")
        if self.setpoint is not None and (self.setpoint.scale == 0.0 or self.setpoint.lowest >= self.setpoint.highest):
            raise ValueError("setpoint: scale is not 0, and lowest lies below highest")
        return self


def block_of(settings: Settings) -> tuple[int, int]:
    """First register and number of registers of the one block that a poll reads [-]."""
    spans = [(channel.address, width_of(channel.type)) for channel in settings.channels.values()]
    spans += [(check.address, 1) for check in settings.expect]
    first = min(start for start, _ in spans)
    return first, max(start + width for start, width in spans) - first


def decode(settings: Settings, words: Sequence[int]) -> dict[str, Value]:
    """The values of a block. By channel, limits not yet looked at."""
    first, _ = block_of(settings)
    wrong = [
        f"register {check.address} holds {words[check.address - first]}, not {_either(check.values)}: {check.meaning}"
        for check in settings.expect
        if words[check.address - first] not in check.values
    ]
    if wrong:
        return dict.fromkeys(settings.channels, Value(None, Quality.EXCEPTION, detail="; ".join(wrong)))
    return {
        name: _value(channel, words[channel.address - first :][: width_of(channel.type)])
        for name, channel in settings.channels.items()
    }


def _value(channel: RegisterChannel, words: Sequence[int]) -> Value:
    number = number_of(words, channel.type, channel.word_order)
    raw = repr(number)
    if number in channel.invalid:
        return Value(None, Quality.EXCEPTION, raw, f"the device reports a fault: {raw}")
    rising = 1.0 if channel.scale > 0.0 else -1.0
    if number in channel.over_range:
        return Value(rising * math.inf, raw=raw, detail=f"{raw} stands for over-range")
    if number in channel.under_range:
        return Value(-rising * math.inf, raw=raw, detail=f"{raw} stands for under-range")
    return Value(channel.scale * number + channel.offset, raw=raw)


class ModbusDevice(Polled):
    """A generic Modbus device that is only read."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings = settings
        self._unit = modbus_unit(device, place)
        self._function = READ_HOLDING if settings.registers == "holding" else READ_INPUT

    def ask(self, line: Line) -> Answer:
        """Read the block once."""
        words, reply = self._unit.read(line, *block_of(self.settings), timing_of(self.settings, line), self._function)
        return Answer(decode(self.settings, words), registers_of(words), reply.request_ns, reply.reply_ns)

    def identify(self, line: Line) -> str:
        """Check the identity register, where the file names one, and that the block can be read."""
        answer = repeated(lambda: self.ask(line), 1)
        faults = {value.detail for value in answer.found.values() if value.quality is Quality.EXCEPTION}
        who = f"{self.settings.title} at unit {self._unit.unit}"
        check = self.settings.identity
        if check is None:
            return joined(f"{who} (its block reads; it does not tell who it is)", "; ".join(sorted(faults)))
        timing = timing_of(self.settings, line)
        words, _ = repeated(lambda: self._unit.read(line, check.address, 1, timing, self._function), 1)
        if words[0] not in check.values:
            raise IdentityError(
                f"{self.device}: register {check.address} of unit {self._unit.unit} holds {words[0]}, not "
                f"{_either(check.values)} ({check.meaning}): this is not a {self.settings.title}"
            )
        return joined(f"{who} ({check.meaning}: {words[0]})", "; ".join(sorted(faults)))


class ModbusRegulator(ModbusDevice):
    """A generic Modbus device with a set-point register. `settings`: its file, with a ``[setpoint]``."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings, place)
        self.setpoint = cast(Setpoint, settings.setpoint)
        self.unit, self.lowest, self.highest = self.setpoint.unit, self.setpoint.lowest, self.setpoint.highest

    def write(self, line: Line, value: float) -> float:
        """Order a set-point and return what the device reads back."""
        timing, table = timing_of(self.settings, line), self.setpoint
        width = width_of(table.type)

        def order() -> None:
            words = words_of((value - table.offset) / table.scale, table.type, table.word_order)
            function = WRITE_MANY if table.many or width > 1 else WRITE_ONE
            self._unit.write(line, table.address, words, function, timing)

        def read_back() -> float:
            words, _ = self._unit.read(line, table.address, width, timing)
            return table.scale * number_of(words, table.type, table.word_order) + table.offset

        try:
            limits = (self.lowest, self.highest)
            return set_and_read_back(value, self.unit, limits, order, read_back, self._tolerance(value), self.device)
        except ValueError as error:
            raise InstrumentError(f"{self.device}: {error}") from None

    def set_failsafe(self, line: Line) -> str:
        """A generic device has none that its file could describe."""
        raise InstrumentError(
            f"{self.device}: no communications failsafe is described for {self.settings.title}; set one in the device "
            "by its maker's means and waive it by name in the bench file ([safety] waive_failsafe)"
        )

    def _tolerance(self, value: float) -> float:
        if self.setpoint.tolerance is not None:
            return self.setpoint.tolerance
        if self.setpoint.type == "f32":
            return 1e-6 * max(abs(self.highest), abs(self.lowest), abs(value))
        return 0.5001 * abs(self.setpoint.scale)


def build(device: str, settings: InstrumentFile, place: Place) -> ModbusDevice:
    """The driver of a generic Modbus device, with a set-point if its file has one."""
    chosen = cast(Settings, settings)
    return ModbusDevice(device, chosen, place) if chosen.setpoint is None else ModbusRegulator(device, chosen, place)


def _either(values: Sequence[int]) -> str:
    return " or ".join(str(value) for value in values)
