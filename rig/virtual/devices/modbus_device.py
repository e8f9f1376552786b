"""A Modbus device: registers that are worked out when asked for, and the answers to each function."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from rig.virtual.devices import frames
from rig.virtual.devices.base import Served
from rig.virtual.devices.sensors import Sensor

MOST_REGISTERS = 125
# type of a value, as instrument files name it: how struct packs it, and the integers' limits
PACKED = {
    "u16": ("H", 0, 0xFFFF),
    "i16": ("h", -0x8000, 0x7FFF),
    "u32": ("I", 0, 0xFFFF_FFFF),
    "i32": ("i", -0x8000_0000, 0x7FFF_FFFF),
    "f32": ("f", 0, 0),
    "u64": ("Q", 0, 0xFFFF_FFFF_FFFF_FFFF),
    "i64": ("q", -0x8000_0000_0000_0000, 0x7FFF_FFFF_FFFF_FFFF),
    "f64": ("d", 0, 0),
}


class Refusal(Exception):  # noqa: N818 - it is an answer, not an error
    """The device answers with an exception."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


def width_of(kind: str) -> int:
    """How many registers a number takes [-]."""
    return struct.calcsize(PACKED[kind][0]) // 2


def words_of(value: float, kind: str, low_word_first: bool = False, low_byte_first: bool = False) -> list[int]:
    """A number as registers.

    `value`: the number; cut off at an integer's limits, and not a number is all ones in an integer [-].
    `low_word_first`, `low_byte_first`: order of the words, and of the bytes within each.
    Each is 0-65535.
    """
    code, lowest, highest = PACKED[kind]
    if code in "fd":
        packed = struct.pack(">" + code, value)
    elif math.isnan(value):
        packed = b"\xff" * struct.calcsize(code)
    else:
        packed = struct.pack(">" + code, min(highest, max(lowest, round(value))))
    high = int(low_byte_first)
    words = [packed[i + high] << 8 | packed[i + 1 - high] for i in range(0, len(packed), 2)]
    return words[::-1] if low_word_first else words


def value_of(words: list[int], kind: str, low_word_first: bool = False, low_byte_first: bool = False) -> float:
    """Registers as a number."""
    ordered = words[::-1] if low_word_first else words
    pairs = [bytes([word >> 8, word & 0xFF]) for word in ordered]
    packed = b"".join(pair[::-1] if low_byte_first else pair for pair in pairs)
    return float(struct.unpack(">" + PACKED[kind][0], packed)[0])


@dataclass(frozen=True)
class Field:
    """Registers that belong together.

    `words`: time [ns] to the registers; called once a request, so that the words of one value belong together.
    """

    address: int
    size: int
    words: Callable[[int], list[int]]


def constant(address: int, *words: int) -> Field:
    """Registers that never change."""
    return Field(address, len(words), lambda _: list(words))


def measured(address: int, sensor: Sensor, kind: str) -> Field:
    """A measured value, the channel's own number."""
    return Field(address, width_of(kind), lambda time_ns: words_of(sensor.read(time_ns), kind))


class ModbusDevice(Served):
    """Answers reads of its fields, and takes writes where there is a place for them.

    `tables`: function code of a read to what it finds; a coil is a field of size 1.
    """

    speaks = "modbus"
    most_registers = MOST_REGISTERS  # in one question

    def __init__(self, device: str, unit: int, tables: dict[int, list[Field]]) -> None:
        self.device, self.unit, self.tables = device, unit, tables
        self.last_heard_ns = 0

    def restart(self, time_ns: int) -> None:
        """Power comes back."""
        self.last_heard_ns = time_ns
        self.switch_off()

    def write(self, address: int, values: list[int], time_ns: int) -> None:
        """Take a write; a device with registers to write says which.

        Raises Refusal when there is no such register, or the value is not one for it.
        """
        raise Refusal(frames.ILLEGAL_ADDRESS)

    def answer(self, body: bytes, time_ns: int) -> bytes:
        """Function code and data of the answer."""
        self.tick(time_ns)
        self.last_heard_ns = time_ns
        try:
            return self._answer(body, time_ns)
        except Refusal as refusal:
            return bytes([body[0] | 0x80, refusal.code])

    def _answer(self, body: bytes, time_ns: int) -> bytes:
        function = body[0]
        if function in self.tables and len(body) == 5:
            address, count = struct.unpack(">HH", body[1:])
            bits = function in (frames.READ_COILS, frames.READ_INPUTS)
            if not 1 <= count <= (2000 if bits else self.most_registers):
                raise Refusal(frames.ILLEGAL_VALUE)
            words = self._read(self.tables[function], address, count, time_ns)
            data = _bits(words) if bits else struct.pack(f">{count}H", *words)
            return bytes([function, len(data)]) + data
        if function == frames.WRITE_ONE and len(body) == 5:
            address, value = struct.unpack(">HH", body[1:])
            self.write(address, [value], time_ns)
            return body
        if function == frames.WRITE_MANY and len(body) >= 6:
            address, count, size = struct.unpack(">HHB", body[1:6])
            if size != 2 * count or len(body) != 6 + size:
                raise Refusal(frames.ILLEGAL_VALUE)
            self.write(address, list(struct.unpack(f">{count}H", body[6:])), time_ns)
            return body[:5]
        raise Refusal(frames.ILLEGAL_FUNCTION)

    def _read(self, fields: list[Field], address: int, count: int, time_ns: int) -> list[int]:
        found: dict[int, int] = {}
        for field in fields:
            if field.address < address + count and address < field.address + field.size:
                found.update(enumerate(field.words(time_ns), field.address))
        try:
            return [found[place] for place in range(address, address + count)]
        except KeyError:
            raise Refusal(frames.ILLEGAL_ADDRESS) from None


def _bits(words: list[int]) -> bytes:
    packed = bytearray((len(words) + 7) // 8)
    for place, word in enumerate(words):
        packed[place // 8] |= (word & 1) << place % 8
    return bytes(packed)
