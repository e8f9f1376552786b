"""Advantech ADAM-4024, after the register table of its manual, with an analogue regulator on one output.

Its communications safety, once switched on, sends all outputs to zero when nothing valid is heard for some time. How
its flag goes out is not in the table: here, when an output is written again.
"""

from __future__ import annotations

from typing import Any

from rig.bench.bench import Place
from rig.readings import NS
from rig.virtual.devices import frames
from rig.virtual.devices.base import World
from rig.virtual.devices.modbus_device import Field, ModbusDevice, Refusal, constant

OUTPUTS, TYPES, NAME, SAFETY_ENABLED = 0, 200, 210, 214  # 40001, 40201, 40211, 40215, beside 40216: it has occurred
COUNT = 4
MODEL_AND_VERSION = (0x4024, 0x0000, 0xA200, 0x0000)
# As with every wait on a bench faster than real time: a busy machine is not a silent bus.
LEAST_REAL_SAFETY_S = 5.0


def serve(device: str, settings: Any, place: Place, world: World) -> Adam4024:
    """A module with the regulator on the output that the bench file names."""
    return Adam4024(device, settings, place, world)


class Adam4024(ModbusDevice):
    """Four outputs, the first range of the file set on each."""

    def __init__(self, device: str, settings: Any, place: Place, world: World) -> None:
        self.range = settings.ranges[0]
        self.span = place.table.span or [0.0, 5.0]
        self.driving = place.table.channel or 0
        self.plant = world.plant
        self.offset_bar = 0.0 if "abs" in settings.unit else self.plant.ambient_bar
        self.safety_ns = int(max(self.plant.line.comm_safety_s, LEAST_REAL_SAFETY_S * world.rate) * NS)
        self.outputs = [self.range.low_counts] * COUNT
        self.safety, self.occurred = 0, 0
        table = [
            Field(OUTPUTS, COUNT, lambda _: list(self.outputs)),
            constant(TYPES, *[self.range.code] * COUNT),
            constant(NAME, *MODEL_AND_VERSION),
            Field(SAFETY_ENABLED, 2, lambda _: [self.safety, self.occurred]),
        ]
        coils = [constant(0, 0, 0, 0, 0)]  # emergency inputs
        super().__init__(device, place.table.unit_id or 0, {frames.READ_HOLDING: table, frames.READ_COILS: coils})

    def restart(self, time_ns: int) -> None:
        """Power comes back: outputs at zero, and the safety as it was switched, which the module keeps."""
        self.occurred = 0
        super().restart(time_ns)

    def switch_off(self) -> None:
        """Without power there is no voltage, and the regulator shuts."""
        self.outputs = [self.range.low_counts] * COUNT
        self._drive()

    def tick(self, time_ns: int) -> None:
        """The communications safety looks at the time."""
        if self.safety and not self.occurred and time_ns - self.last_heard_ns > self.safety_ns:
            self.occurred = 1
            self.switch_off()

    def write(self, address: int, values: list[int], time_ns: int) -> None:
        """Take outputs, or switch the communications safety."""
        if address >= OUTPUTS and address + len(values) <= OUTPUTS + COUNT:
            self.outputs[address : address + len(values)] = values
            self.occurred = 0
            self._drive()
        elif address == SAFETY_ENABLED and len(values) == 1:
            if values[0] not in (0, 1):
                raise Refusal(frames.ILLEGAL_VALUE)
            self.safety = values[0]
        else:
            raise Refusal(frames.ILLEGAL_ADDRESS)

    def _drive(self) -> None:
        """The regulator follows its input; at the low end of the span it shuts and opens its dump valve."""
        low, high = self.range.low_counts, self.range.high_counts
        share = min(1.0, (self.outputs[self.driving] - low) / (high - low))
        value = self.span[0] + share * (self.span[1] - self.span[0])
        self.plant.order(value + self.offset_bar if share > 0.0 else 0.0)
