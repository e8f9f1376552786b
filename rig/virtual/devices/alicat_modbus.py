"""Alicat over Modbus, after the manual: status 1201, pressure 1203, temperature 1205, volume flow 1207, mass flow 1209
as floats with the high word first, set-point 1010. The manual counts from 1.
"""

from __future__ import annotations

from typing import Any

from rig.bench.bench import Place
from rig.virtual.devices import frames
from rig.virtual.devices.alicat import AlicatPart, status_of
from rig.virtual.devices.base import World
from rig.virtual.devices.modbus_device import Field, ModbusDevice, Refusal, value_of, words_of

STATUS, SETPOINT = 1201, 1010
FLOATS = {"pressure": 1203, "temperature": 1205, "flow_l_": 1207, "flow_sl": 1209}  # by the channel's beginning


def serve(device: str, settings: Any, place: Place, world: World) -> AlicatModbus:
    """A device with the channels of its file."""
    return AlicatModbus(device, settings, place.table.unit_id or 0, world)


class AlicatModbus(ModbusDevice):
    """The block of status and floats, and the set-point."""

    def __init__(self, device: str, settings: Any, unit: int, world: World) -> None:
        self.part = AlicatPart(device, settings, world)
        self.less = 1 if settings.numbering == "from 1" else 0
        fields = [
            Field(STATUS - self.less, 10, self._block),
            Field(SETPOINT - self.less, 2, lambda _: words_of(self.part.setpoint, "f32")),
        ]
        super().__init__(device, unit, {frames.READ_HOLDING: fields})

    def switch_off(self) -> None:
        """Without power the valve is closed."""
        self.part.switch_off()

    def write(self, address: int, values: list[int], time_ns: int) -> None:
        """Take a set-point."""
        if address != SETPOINT - self.less or len(values) != 2:
            raise Refusal(frames.ILLEGAL_ADDRESS)
        if not self.part.order(value_of(values, "f32")):
            raise Refusal(frames.ILLEGAL_VALUE)

    def _block(self, time_ns: int) -> list[int]:
        numbers, flags = self.part.read(time_ns)
        block = words_of(status_of(flags), "u32") + [0] * 8
        for name, number in numbers.items():
            place = next(address for start, address in FLOATS.items() if name.startswith(start)) - STATUS
            block[place : place + 2] = words_of(number, "f32")
        return block
