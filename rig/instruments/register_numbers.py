"""Numbers in Modbus registers, as the file of a generic device names them: channels, checks, a set-point."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Annotated

import pydantic

from configs import Strict
from rig.bench.instrument import ChannelFile, Positive, Scale, refuse_doubles
from rig.instruments.codecs.blocks import Table
from rig.instruments.codecs.registers import Kind, Order, is_float, number_of, width_of, words_of


def _on_the_wire(address: object) -> object:
    """Refuse a manual's number of six digits with what it is on the wire."""
    first = next(
        (first for first in (300_001, 400_001) if isinstance(address, int) and 0 <= address - first < 65536), 0
    )
    if first and isinstance(address, int):
        raise ValueError(f"is as on the wire, from 0, where a manual's {address} is {address - first}")
    return address


# Address as on the wire, from 0: "40001" is 0.
Register = Annotated[int, pydantic.Field(ge=0, le=65535), pydantic.BeforeValidator(_on_the_wire)]
Factor = Annotated[float, pydantic.Field(ge=-1e12, le=1e12)]
REGISTERS = 65536  # of a table


class RegisterNumber(Strict):
    """A number in registers: value = scale * number + offset."""

    address: Register
    type: Kind
    word_order: Order = "big"
    byte_order: Order = "big"  # within a register
    scale: Scale = 1.0
    offset: Factor = 0.0

    @property
    def width(self) -> int:
        """How many registers [-]."""
        return width_of(self.type)

    def number(self, words: Sequence[int]) -> int | float:
        """The number as it came, before scale and offset."""
        return number_of(words, self.type, self.word_order, self.byte_order)

    def words(self, value: float) -> tuple[int, ...]:
        """A value as registers. Raises ValueError when it does not fit."""
        return words_of((value - self.offset) / self.scale, self.type, self.word_order, self.byte_order)


class RegisterChannel(ChannelFile, RegisterNumber):
    """A quantity in registers."""

    registers: Table | None = None  # the file's when left out
    over_range: list[int | float] = pydantic.Field(default_factory=list)  # raw numbers that stand for a state
    under_range: list[int | float] = pydantic.Field(default_factory=list)
    invalid: list[int | float] = pydantic.Field(default_factory=list)

    @pydantic.model_validator(mode="after")
    def states_can_come(self) -> RegisterChannel:
        """Refuse a number for a state that the type cannot hold: it would never come, and what comes would pass."""
        for number in (*self.over_range, *self.under_range, *self.invalid):
            bits = 16 * self.width
            signed = f"; as {self.type} it is {int(number) - (1 << bits)}" if 0 < number < 1 << bits else ""
            try:
                comes: float | None = self._comes(number)
            except ValueError:
                comes = None
            if comes is None or (not is_float(self.type) and comes != number):
                raise ValueError(f"over_range, under_range, invalid: {number} never comes as {self.type}{signed}")
        refuse_doubles(self.over_range, self.under_range, self.invalid)
        return self

    @functools.cached_property
    def states(self) -> tuple[frozenset[float], frozenset[float], frozenset[float]]:
        """Invalid, over and under range: the numbers as they come. -999.9 is another one as f32."""
        given = (self.invalid, self.over_range, self.under_range)
        invalid, over, under = (frozenset(map(self._comes, numbers)) for numbers in given)
        return invalid, over, under

    def _comes(self, number: float) -> float:
        return number_of(words_of(number, self.type), self.type)


class Check(Strict):
    """A register that must hold one of some values: a model number, a unit, a count of decimals."""

    address: Register
    registers: Table | None = None  # the file's when left out
    values: Annotated[list[Register], pydantic.Field(min_length=1, max_length=32)]
    meaning: str


class Setpoint(RegisterNumber):
    """The one number that may be written, in holding registers."""

    unit: str
    lowest: float
    highest: float
    tolerance: Positive | None = None  # of the read-back; the register's resolution when left out
    many: bool = False  # write with function 16 even where one register is meant

    @pydantic.model_validator(mode="after")
    def has_room(self) -> Setpoint:
        """Refuse a set-point that no register has, or that has no room."""
        if self.lowest >= self.highest:
            raise ValueError("lowest lies below highest")
        if self.address + self.width > REGISTERS:
            raise ValueError(f"it reaches beyond register {REGISTERS - 1}")
        return self
