"""A Modbus device described by its file alone: registers, types, scales, and at most one register that may be written.

A poll reads the same blocks always: one where the map allows it. Each has its own times. After a question without an
answer the next poll begins with the same block, so an answer that comes late can be old but never another quantity.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from rig.bench.instrument import (
    IdentityError,
    InstrumentError,
    InstrumentFile,
)
from rig.instruments.codecs.blocks import Span, Table, blocks_of
from rig.instruments.codecs.registers import WORD_ORDERS, is_float, number_of
from rig.instruments.codecs.values import Value, joined
from rig.instruments.placing import modbus_unit
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, repeated, timing_of
from rig.instruments.register_numbers import REGISTERS, Check, RegisterChannel, Setpoint
from rig.instruments.setting import set_and_read_back
from rig.lines import BadReplyError, Line, NoReplyError
from rig.lines.line import Reply
from rig.lines.modbus import (
    MOST_REGISTERS,
    READ_HOLDING,
    READ_INPUT,
    WRITE_MANY,
    WRITE_ONE,
    RefusedError,
    registers_of,
)
from rig.readings import NS, Quality

if TYPE_CHECKING:
    from rig.bench.bench import Place


MOST_LATE = 3.0  # times `slowest_reply_s`: so late an answer may come against what the file says
HOLE_CODES = (2, 3, 4)  # exceptions with which devices refuse registers that they do not have
FUNCTIONS = {"holding": READ_HOLDING, "input": READ_INPUT}

Image = Mapping[tuple[Table, int], int]  # registers by table and address


class Settings(PolledFile):
    """The keys of a generic Modbus device."""

    registers: Table = "holding"  # function 3 or 4
    most_registers: Annotated[int, pydantic.Field(ge=1, le=MOST_REGISTERS)] = MOST_REGISTERS
    largest_gap: Annotated[int, pydantic.Field(ge=0, le=MOST_REGISTERS)] | None = None  # see `blocks_of`
    channels: Annotated[dict[ChannelName, RegisterChannel], pydantic.Field(min_length=1, max_length=32)]
    expect: list[Check] = pydantic.Field(default_factory=list)  # checked in every poll
    identity: Check | None = None  # checked when the device is identified
    setpoint: Setpoint | None = None

    @pydantic.model_validator(mode="after")
    def registers_make_sense(self) -> Settings:
        """Refuse a file whose registers a device cannot have."""
        spans = {name: self.span(channel) for name, channel in self.channels.items()}
        longest = max(spans, key=lambda name: spans[name].count)
        if spans[longest].count > self.most_registers:
            raise ValueError(
                f"channels.{longest} has {spans[longest].count} registers, and most_registers allows "
                f"{self.most_registers} in a question: a number is read in one"
            )
        if max(span.end for span in spans.values()) > REGISTERS:
            raise ValueError(f"a channel reaches beyond register {REGISTERS - 1}")
        return self

    def span(self, of: RegisterChannel | Check) -> Span:
        """The registers of a channel or a check."""
        width = of.width if isinstance(of, RegisterChannel) else 1
        return Span(of.registers or self.registers, of.address, width)

    def blocks(self) -> tuple[Span, ...]:
        """What a poll reads, each block with one question."""
        return blocks_of(self.spans(), self.largest_gap, self.most_registers)

    def spans(self) -> list[Span]:
        """The registers that it names."""
        wanted: Iterable[RegisterChannel | Check] = [*self.channels.values(), *self.expect]
        return [self.span(of) for of in wanted]


def image_of(blocks: Mapping[Span, Sequence[int]]) -> dict[tuple[Table, int], int]:
    """The registers of blocks that were read."""
    return {
        (block.table, address): word
        for block, words in blocks.items()
        for address, word in enumerate(words, block.first)
    }


def decode(settings: Settings, image: Image) -> dict[str, Value]:
    """The values of the channels whose registers were read, limits not yet looked at."""
    wrong = [
        f"register {check.address} holds {held}, not {_either(check.values)}: {check.meaning}"
        for check in settings.expect
        if (held := _words(settings.span(check), image)[0]) not in check.values
    ]
    if wrong:
        return dict.fromkeys(settings.channels, Value(None, Quality.EXCEPTION, detail="; ".join(wrong)))
    spans = {name: settings.span(channel) for name, channel in settings.channels.items()}
    return {
        name: _value(settings.channels[name], _words(span, image))
        for name, span in spans.items()
        if (span.table, span.first) in image
    }


def _words(span: Span, image: Image) -> tuple[int, ...]:
    return tuple(image[span.table, address] for address in range(span.first, span.end))


def _value(channel: RegisterChannel, words: Sequence[int]) -> Value:
    number = channel.number(words)
    raw = repr(number)
    invalid, over, under = channel.states
    if number in invalid:
        return Value(None, Quality.EXCEPTION, raw, f"the device reports a fault: {raw}")
    rising = 1.0 if channel.scale > 0.0 else -1.0
    if number in over:
        return Value(rising * math.inf, raw=raw, detail=f"{raw} stands for over-range")
    if number in under:
        return Value(-rising * math.inf, raw=raw, detail=f"{raw} stands for under-range")
    return Value(channel.scale * number + channel.offset, raw=raw)


@dataclass(frozen=True)
class InAllOrders:
    """What a channel of several registers reads in each order of its bytes. `values`: by the order's name, ABCD."""

    channel: str
    registers: Span
    chosen: str
    values: dict[str, float]


class ModbusDevice(Polled):
    """A generic Modbus device that is only read."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings = settings
        self.blocks = settings.blocks()
        spans = {name: settings.span(channel) for name, channel in settings.channels.items()}
        self._block_of = {
            name: next(i for i, block in enumerate(self.blocks) if block.holds(span)) for name, span in spans.items()
        }
        self._unit = modbus_unit(device, place)
        self._next = 0  # the block that is asked for first: that of a question without an answer
        self._late_ns: dict[tuple[Table, int], int] = {}  # until when an answer of so many registers may be late

    def ask(self, line: Line) -> Answer:
        """Read each block once; a block that is refused costs its own channels."""
        read, refused = self._read(line)
        checks = map(self.settings.span, self.settings.expect)
        needed = {i for check in checks for i, block in enumerate(self.blocks) if block.holds(check)}
        if not read or needed & refused.keys():
            raise next(iter(refused.values()))
        found = decode(self.settings, self._image(read))
        replies = {name: read[i][1] for name, i in self._block_of.items() if i in read}
        for name, i in self._block_of.items():
            value = found[name] if i in read else Value(None, Quality.EXCEPTION, detail=str(refused[i]))
            found[name] = self._of_block(i, value, replies[name].request_ns if i in read else 0)
        return Answer(
            found,
            b"".join(registers_of(read[i][0]) for i in sorted(read)),
            min(reply.request_ns for reply in replies.values()),
            max(reply.reply_ns for reply in replies.values()),
            times={name: (reply.request_ns, reply.reply_ns) for name, reply in replies.items()},
        )

    def identify(self, line: Line) -> str:
        """Check the identity register, where the file names one, and that every block can be read."""
        read, refused = repeated(lambda: self._read(line), 1)
        if refused:
            raise self._of_a_hole(*next(iter(refused.items())))
        found = decode(self.settings, self._image(read))
        faults = "; ".join(sorted({value.detail for value in found.values() if value.quality is Quality.EXCEPTION}))
        who = f"{self.settings.title} at unit {self._unit.unit}"
        check = self.settings.identity
        if check is None:
            return joined(f"{who} ({self._what_reads()}; it does not tell who it is)", faults)
        timing, place = timing_of(self.settings, line), self.settings.span(check)
        words, _ = repeated(lambda: self._unit.read(line, place.first, 1, timing, FUNCTIONS[place.table]), 1)
        if words[0] not in check.values:
            raise IdentityError(
                f"{self.device}: register {check.address} of unit {self._unit.unit} holds {words[0]}, not "
                f"{_either(check.values)} ({check.meaning}): this is not a {self.settings.title}"
            )
        blocks = f"; {self._what_reads()}" if len(self.blocks) > 1 else ""
        return joined(f"{who} ({check.meaning}: {words[0]}{blocks})", faults)

    def _of_a_hole(self, i: int, refused: RefusedError) -> RefusedError:
        """Why a block was refused; where it has registers that the file does not name, it may be for one of these."""
        block = self.blocks[i]
        used = {at for span in self.settings.spans() if block.holds(span) for at in range(span.first, span.end)}
        if refused.code not in HOLE_CODES or len(used) == block.count:
            return refused
        hint = f"{block} has registers that the file does not name: if the device has none there, write largest_gap = 0"
        return RefusedError(f"{refused}; {hint} in the instrument file", refused.code)

    def in_all_orders(self, line: Line) -> InAllOrders | None:
        """Read anew, and show a channel of several registers in every order; None where there is none.

        The first whose orders differ. Raises LineError when nobody answers.
        """
        read, _ = repeated(lambda: self._read(line), 1)
        image = self._image(read)
        shown = [
            _in_all_orders(name, channel, self.settings.span(channel), image)
            for name, channel in self.settings.channels.items()
            if channel.width > 1 and self._block_of[name] in read
        ]
        return next((found for found in shown if len(set(found.values.values())) > 1), shown[0] if shown else None)

    def _read(self, line: Line) -> tuple[dict[int, tuple[tuple[int, ...], Reply]], dict[int, RefusedError]]:
        """Ask for each block: the registers and times of those that were answered, and why the others were refused."""
        timing = timing_of(self.settings, line)
        read, refused = {}, {}
        count = len(self.blocks)
        for i in [(self._next + step) % count for step in range(count)]:
            block, self._next = self.blocks[i], i
            try:
                read[i] = self._unit.read(line, block.first, block.count, timing, FUNCTIONS[block.table])
            except RefusedError as error:
                refused[i] = error
            except (NoReplyError, BadReplyError):
                self._late_ns[block.table, block.count] = line.heard_ns + int(MOST_LATE * timing.slowest_reply_s * NS)
                raise
        self._next = 0
        return read, refused

    def _image(self, read: Mapping[int, tuple[tuple[int, ...], Reply]]) -> Image:
        return image_of({self.blocks[i]: words for i, (words, _) in read.items()})

    def _of_block(self, i: int, value: Value, request_ns: int) -> Value:
        """A value with the block it came in, where there are several: its time is that of this block.

        Not verified while it could be another's: an answer to another block of the same length may still be late.
        """
        if len(self.blocks) == 1:
            return value
        detail, block = f"block {i + 1} of {len(self.blocks)}", self.blocks[i]
        alike = sum((other.table, other.count) == (block.table, block.count) for other in self.blocks)
        is_late = request_ns < self._late_ns.get((block.table, block.count), 0)
        if alike > 1 and is_late and not self._unit.has_numbers and value.quality is Quality.OK:
            value = dataclasses.replace(value, quality=Quality.UNVERIFIED)
            detail += "; a late answer of a block as long may pass for it"
        return dataclasses.replace(value, detail=joined(value.detail, detail))

    def _what_reads(self) -> str:
        if len(self.blocks) == 1:
            return "its block reads"
        return f"its {len(self.blocks)} blocks read: {', '.join(map(str, self.blocks))}"


def _in_all_orders(name: str, channel: RegisterChannel, span: Span, image: Image) -> InAllOrders:
    words = _words(span, image)
    values = {
        order: channel.scale * number_of(words, channel.type, *how) + channel.offset
        for order, how in WORD_ORDERS.items()
    }
    chosen = next(order for order, how in WORD_ORDERS.items() if how == (channel.word_order, channel.byte_order))
    return InAllOrders(name, span, chosen, values)


class ModbusRegulator(ModbusDevice):
    """A generic Modbus device with a set-point register. `settings`: its file, with a ``[setpoint]``."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings, place)
        self.setpoint = cast(Setpoint, settings.setpoint)
        self.unit, self.lowest, self.highest = self.setpoint.unit, self.setpoint.lowest, self.setpoint.highest

    def write(self, line: Line, value: float) -> float:
        """Order a set-point and return what the device reads back."""
        timing, table = timing_of(self.settings, line), self.setpoint

        def order() -> None:
            function = WRITE_MANY if table.many or table.width > 1 else WRITE_ONE
            self._unit.write(line, table.address, table.words(value), function, timing)

        def read_back() -> float:
            words, _ = self._unit.read(line, table.address, table.width, timing)
            return table.scale * table.number(words) + table.offset

        try:
            return set_and_read_back(self, value, order, read_back, self._tolerance(value))
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
        if is_float(self.setpoint.type):
            return 1e-6 * max(abs(self.highest), abs(self.lowest), abs(value))
        return 0.5001 * abs(self.setpoint.scale)


def build(device: str, settings: InstrumentFile, place: Place) -> ModbusDevice:
    """The driver of a generic Modbus device, with a set-point if its file has one."""
    chosen = cast(Settings, settings)
    return ModbusDevice(device, chosen, place) if chosen.setpoint is None else ModbusRegulator(device, chosen, place)


def _either(values: Sequence[int]) -> str:
    return " or ".join(str(value) for value in values)
