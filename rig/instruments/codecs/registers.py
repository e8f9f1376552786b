"""Registers to numbers and back: the codec under every Modbus family."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Literal

Kind = Literal["u16", "i16", "u32", "i32", "f32", "u64", "i64", "f64"]
Order = Literal["big", "little"]

_FORMATS = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f", "u64": ">Q", "i64": ">q", "f64": ">d"}
# What manuals call the orders of a number's bytes: the order of its words, and of the bytes within a word.
WORD_ORDERS: dict[str, tuple[Order, Order]] = {
    "ABCD": ("big", "big"),
    "CDAB": ("little", "big"),
    "BADC": ("big", "little"),
    "DCBA": ("little", "little"),
}


def width_of(kind: Kind) -> int:
    """How many registers a number takes [-]."""
    return struct.calcsize(_FORMATS[kind]) // 2


def is_float(kind: Kind) -> bool:
    """Whether a kind has fractions."""
    return kind.startswith("f")


def number_of(words: Sequence[int], kind: Kind, order: Order = "big", byte_order: Order = "big") -> int | float:
    """The number in one, two or four registers, as it came: before scale and offset.

    `order`: ``big``: the high word first, of all the number's words.
    `byte_order`: ``big``: the high byte first within a register, as the standard has it.
    NaN and infinities included.
    """
    packed = struct.pack(f">{len(words)}H", *_arranged(words, order, byte_order))
    return struct.unpack(_FORMATS[kind], packed)[0]


def words_of(number: float, kind: Kind, order: Order = "big", byte_order: Order = "big") -> tuple[int, ...]:
    """A number as registers; whole kinds are rounded. Each is 0-65535. Raises ValueError when it does not fit."""
    try:
        packed = struct.pack(_FORMATS[kind], number if is_float(kind) else round(number))
    except (struct.error, OverflowError, ValueError):
        raise ValueError(f"{number:g} does not fit a register of type {kind}") from None
    return _arranged(struct.unpack(f">{len(packed) // 2}H", packed), order, byte_order)


def _arranged(words: Sequence[int], order: Order, byte_order: Order) -> tuple[int, ...]:
    """Words in another order; the same again brings them back."""
    swapped = words if byte_order == "big" else [(word & 0xFF) << 8 | word >> 8 for word in words]
    return tuple(swapped if order == "big" else reversed(swapped))
