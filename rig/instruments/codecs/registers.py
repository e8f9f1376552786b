"""Registers to numbers and back: the codec under every Modbus family."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Literal

Kind = Literal["u16", "i16", "u32", "i32", "f32"]
WordOrder = Literal["big", "little"]

_FORMATS = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f"}


def width_of(kind: Kind) -> int:
    """How many registers a number takes [-]."""
    return struct.calcsize(_FORMATS[kind]) // 2


def number_of(words: Sequence[int], kind: Kind, order: WordOrder = "big") -> int | float:
    """The number in one or two registers, as it came: before scale and offset.

    `order`: ``big``: the high word first. Within a register the high byte is always first.
    NaN and infinities included.
    """
    ordered = words if order == "big" else list(reversed(words))
    return struct.unpack(_FORMATS[kind], struct.pack(f">{len(ordered)}H", *ordered))[0]


def words_of(number: float, kind: Kind, order: WordOrder = "big") -> tuple[int, ...]:
    """A number as registers; whole kinds are rounded. Each is 0-65535. Raises ValueError when it does not fit."""
    try:
        packed = struct.pack(_FORMATS[kind], number if kind == "f32" else round(number))
    except (struct.error, OverflowError, ValueError):
        raise ValueError(f"{number:g} does not fit a register of type {kind}") from None
    words = struct.unpack(f">{len(packed) // 2}H", packed)
    return words if order == "big" else tuple(reversed(words))
