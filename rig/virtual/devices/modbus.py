"""Any Modbus device that its file describes: the register image of the file, filled from the truth."""

from __future__ import annotations

import math
from typing import Any

from rig.bench.bench import Place
from rig.virtual.devices import frames
from rig.virtual.devices.base import World
from rig.virtual.devices.modbus_device import Field, ModbusDevice, Refusal, constant, value_of, width_of, words_of
from rig.virtual.devices.sensors import Sensor

MOST_BETWEEN = 1000
FUNCTIONS = {"holding": frames.READ_HOLDING, "input": frames.READ_INPUT_REGISTERS}


def serve(device: str, settings: Any, place: Place, world: World) -> DescribedDevice:
    """A device after its file."""
    return DescribedDevice(device, settings, place.table.unit_id or 0, world)


class DescribedDevice(ModbusDevice):
    """A device with the registers of its file, and with its set-point where it has one."""

    def __init__(self, device: str, settings: Any, unit: int, world: World) -> None:
        tables: dict[int, list[Field]] = {}

        def put(of: Any, field: Field) -> None:
            table = FUNCTIONS[of.registers or settings.registers]
            tables.setdefault(table, []).append(field)

        for name, channel in settings.channels.items():
            put(channel, self._channel(device, name, settings, world))
        for check in [*settings.expect, *([settings.identity] if settings.identity else [])]:
            put(check, constant(check.address, check.values[0]))
        for table in tables.values():
            table[:0] = _between(table, settings.largest_gap)
        self.setpoint, self.plant = settings.setpoint, world.plant
        self.most_registers = settings.most_registers
        self._ordered: list[int] = []
        if self.setpoint is not None:
            self._ordered = self._words(0.0)
            place = Field(self.setpoint.address, len(self._ordered), lambda _: self._ordered)
            tables.setdefault(frames.READ_HOLDING, []).append(place)
        super().__init__(device, unit, tables)

    def switch_off(self) -> None:
        """Without power a regulator shuts."""
        if self.setpoint is not None:
            self._ordered = self._words(0.0)
            self.plant.order(0.0)

    def write(self, address: int, values: list[int], time_ns: int) -> None:
        """Take a set-point."""
        table = self.setpoint
        if table is None or address != table.address or len(values) != width_of(table.type):
            raise Refusal(frames.ILLEGAL_ADDRESS)
        value = table.scale * value_of(values, table.type, *_order(table)) + table.offset
        if not table.lowest <= value <= table.highest:
            raise Refusal(frames.ILLEGAL_VALUE)
        self._ordered = values
        above = 0.0 if "abs" in table.unit else self.plant.ambient_bar
        self.plant.order(value + above)

    def _words(self, value: float) -> list[int]:
        table = self.setpoint
        return words_of((value - table.offset) / table.scale, table.type, *_order(table))

    @staticmethod
    def _channel(device: str, name: str, settings: Any, world: World) -> Field:
        channel = settings.channels[name]
        sensor = world.sensor(device, name, channel, settings.update_s)

        def words(time_ns: int) -> list[int]:
            """The registers' number of the value, or the one that stands for a state."""
            number = _number(sensor, channel, time_ns)
            return words_of(number, channel.type, *_order(channel))

        return Field(channel.address, width_of(channel.type), words)


def _order(number: Any) -> tuple[bool, bool]:
    return number.word_order == "little", number.byte_order == "little"


def _between(fields: list[Field], largest_gap: int | None) -> list[Field]:
    """Registers between those of the file hold something on a real device too, where the file says they can be read."""
    found = []
    end = min(field.address for field in fields)
    for field in sorted(fields, key=lambda field: field.address):
        gap = field.address - end
        if 0 < gap <= (MOST_BETWEEN if largest_gap is None else largest_gap):
            found.append(constant(end, *[0] * gap))
        end = max(end, field.address + field.size)
    return found


def _number(sensor: Sensor, channel: Any, time_ns: int) -> float:
    value = sensor.read(time_ns)
    if math.isnan(value) and channel.invalid:
        return float(channel.invalid[0])
    if channel.highest is not None and value > channel.highest and channel.over_range:
        return float(channel.over_range[0])
    return float((value - channel.offset) / channel.scale)
