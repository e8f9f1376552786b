"""Where a device sits, out of its table in the bench file; each mistake in it as one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from configs import ConfigError
from rig.lines import Line, Timing
from rig.lines.line import Reply
from rig.lines.modbus import READ_HOLDING, STANDARD, Habits, Request, exchange

if TYPE_CHECKING:
    from rig.bench.bench import Place

FIRST_UNIT, LAST_UNIT = 1, 247  # of an RTU bus; 0 would be everyone's
RTU_BITS = 8  # in a byte; 7 are of Modbus ASCII


@dataclass(frozen=True)
class ModbusUnit:
    """A unit on a Modbus line."""

    unit: int
    framing: str
    habits: Habits = STANDARD

    @property
    def has_numbers(self) -> bool:
        """Whether an answer tells which question it answers."""
        return self.framing == "tcp" and not self.habits.any_number

    def read(
        self, line: Line, first: int, count: int, timing: Timing, function: int = READ_HOLDING
    ) -> tuple[tuple[int, ...], Reply]:
        """Read a block of registers once. `first`, `count`: first register as on the wire, and how many [-]."""
        return exchange(line, self.framing, Request(self.unit, function, first, count), timing, self.habits)

    def write(self, line: Line, first: int, values: tuple[int, ...], function: int, timing: Timing) -> None:
        """Write registers once."""
        exchange(line, self.framing, Request(self.unit, function, first, len(values), values), timing, self.habits)


def modbus_unit(device: str, place: Place) -> ModbusUnit:
    """Unit and framing of a Modbus device.

    Raises ConfigError when the bench file does not say the unit, or the line carries no Modbus.
    """
    if place.line.kind == "keyboard":
        raise ConfigError(f"devices.{device}.line: a Modbus device cannot be on a keyboard; name a serial or tcp line")
    framing = place.line.framing or ("rtu" if place.line.kind == "serial" else "tcp")
    unit = place.table.unit_id
    if unit is None:
        raise ConfigError(f"devices.{device}.unit_id: the key is missing; a Modbus device needs it (1 to 247)")
    if framing == "rtu" and not FIRST_UNIT <= unit <= LAST_UNIT:
        raise ConfigError(f"devices.{device}.unit_id: {unit} is no unit of an RTU bus; it is 1 to 247")
    if place.line.kind == "serial" and framing == "rtu" and place.line.data_bits != RTU_BITS:
        raise ConfigError(f"lines.{place.table.line}.data_bits: Modbus RTU has {RTU_BITS}; set the device to RTU")
    if place.line.echo and framing == "tcp":
        raise ConfigError(f"lines.{place.table.line}.echo: is of a serial bus, and this is Modbus TCP; take it out")
    return ModbusUnit(unit, framing, Habits(place.line.echo, place.line.transaction_numbers == "any"))


def refuse_keyboard(device: str, place: Place) -> None:
    """Refuse a keyboard line for a device that has a cable. Raises ConfigError when the line is a keyboard."""
    if place.line.kind == "keyboard":
        raise ConfigError(f"devices.{device}.line: this instrument has a cable; name a serial or tcp line")
