"""Keller 30X, after the maker's description of the Modbus floats: P1 at 0x0002, temperature at 0x0006, high word first,
not a number where a channel is faulty or not there.
"""

from __future__ import annotations

import math
from typing import Any

from rig.bench.bench import Place
from rig.virtual.devices import frames
from rig.virtual.devices.base import World
from rig.virtual.devices.modbus_device import Field, ModbusDevice, constant, measured, words_of

CALCULATED, P1, P2, TOB1, TOB2 = 0x0000, 0x0002, 0x0004, 0x0006, 0x0008


def serve(device: str, settings: Any, place: Place, world: World) -> ModbusDevice:
    """A transmitter with one pressure and one temperature."""
    missing = words_of(math.nan, "f32")
    fields: list[Field] = [constant(address, *missing) for address in (CALCULATED, P1, P2, TOB1, TOB2)]
    for name, figures in settings.channels.items():
        address = TOB1 if name.startswith("temperature") else P1
        sensor = world.sensor(device, name, figures, settings.update_s)
        fields = [field for field in fields if field.address != address]
        fields.append(measured(address, sensor, "f32"))
    return ModbusDevice(device, place.table.unit_id or 0, {frames.READ_HOLDING: fields})
