"""Alicat over its text protocol: ``A`` asks unit A for a frame, ``AS1.250`` sets, ``AHC`` holds the valve closed,
``AC`` takes that back; every order is answered with a frame, and what is not understood with ``A ?``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

from rig.bench.bench import Place
from rig.virtual.devices.base import Served, World
from rig.virtual.devices.sensors import Sensor

ORDER = re.compile(r"S *([+-]?[0-9]{1,8}(?:\.[0-9]{0,8})?)")
OVER = {"pressure": "POV", "temperature": "TOV", "flow_sl": "MOV", "flow_l": "VOV"}  # the flag, by what is over-range
GAS = "Air"


def serve(device: str, settings: Any, place: Place, world: World) -> Alicat:
    """A device with the layout of its file."""
    return Alicat(device, settings, place.table.address or "A", world)


class AlicatPart:
    """What the text and the Modbus device have in common: numbers in the device's unit, flags, and the controller."""

    def __init__(self, device: str, settings: Any, world: World) -> None:
        self.settings, self.plant = settings, world.plant
        self.sensors = {
            name: world.sensor(device, name, channel, settings.update_s) for name, channel in settings.channels.items()
        }
        self.setpoint = 0.0
        self.held = False
        if settings.setpoint is not None:
            self.setpoint = -settings.setpoint.offset / settings.setpoint.scale

    def read(self, time_ns: int) -> tuple[dict[str, float], list[str]]:
        """Numbers as the device shows them, by channel, and flags."""
        numbers, flags = {}, ["HLD"] if self.held else []
        for name, sensor in self.sensors.items():
            channel = self.settings.channels[name]
            value = sensor.read(time_ns)
            if math.isnan(value):
                flags.append("ADC")
                value = 0.0
            elif channel.highest is not None and value > channel.highest:
                flags.append(next(flag for start, flag in OVER.items() if name.startswith(start)))
                value = channel.highest
            numbers[name] = (value - channel.offset) / channel.scale
        return numbers, list(dict.fromkeys(flags))

    def order(self, number: float) -> bool:
        """Take a set-point in the device's unit, and return whether it is one. `number`: of the device [own unit]."""
        table = self.settings.setpoint
        if table is None:
            return False
        value = number * table.scale + table.offset
        if not table.lowest - 1e-9 <= value <= table.highest + 1e-9:
            return False
        self.setpoint = number
        self._drive()
        return True

    def hold(self, held: bool) -> None:
        """Hold the valve closed, or take that back."""
        self.held = held
        self._drive()

    def switch_off(self) -> None:
        """Without power the valve is closed, and the set-point is forgotten."""
        if self.settings.setpoint is not None:
            self.held = False
            self.order(-self.settings.setpoint.offset / self.settings.setpoint.scale)

    def _drive(self) -> None:
        table = self.settings.setpoint
        value = self.setpoint * table.scale + table.offset
        above = 0.0 if "abs" in table.unit else self.plant.ambient_bar
        self.plant.order(0.0 if self.held else value + above)


class Alicat(Served):
    """A unit that answers to its letter."""

    speaks = "text"
    terminator = b"\r"

    def __init__(self, device: str, settings: Any, letter: str, world: World) -> None:
        self.device, self.settings, self.letter = device, settings, letter
        self.part = AlicatPart(device, settings, world)

    def switch_off(self) -> None:
        """Without power the valve is closed."""
        self.part.switch_off()

    def answer(self, line: bytes, time_ns: int) -> bytes | None:
        """A frame, or a question mark; None for another unit's letter."""
        text = line.decode("ascii", errors="replace").strip()
        if not text.startswith(self.letter):
            return None
        understood: dict[str, Callable[[], None]] = {
            "": lambda: None,
            "HC": lambda: self.part.hold(True),
            "C": lambda: self.part.hold(False),
        }
        rest = text.removeprefix(self.letter)
        order = ORDER.fullmatch(rest)
        if order is not None and self.part.order(float(order[1])):
            return self._frame(time_ns)
        if rest not in understood or (rest and self.settings.setpoint is None):
            return f"{self.letter} ?\r".encode("ascii")
        understood[rest]()
        return self._frame(time_ns)

    def _frame(self, time_ns: int) -> bytes:
        numbers, flags = self.part.read(time_ns)
        fields = [self._field(entry, numbers) for entry in self.settings.layout]
        return (" ".join([self.letter, *fields, *flags]) + "\r").encode("ascii")

    def _field(self, entry: str, numbers: dict[str, float]) -> str:
        if entry == "gas":
            return GAS
        if entry == "setpoint":
            decimals = self.settings.setpoint.decimals if self.settings.setpoint else 2
            return f"{self.part.setpoint + 0.0:+0{5 + decimals}.{decimals}f}"  # no -0
        if entry not in numbers:
            return "+000.00"
        decimals = decimals_of(self.part.sensors[entry], self.settings.channels[entry].scale)
        return f"{numbers[entry] + 0.0:+0{5 + decimals}.{decimals}f}"


def decimals_of(sensor: Sensor, scale: float) -> int:
    """Decimals that show an instrument's resolution [-]."""
    resolution = (sensor.figures.resolution or 0.01) / abs(scale)
    return min(5, max(0, math.ceil(-math.log10(resolution) - 1e-9)))


def status_of(flags: Sequence[str]) -> int:
    """The bits of the Modbus status that stand for flags [-]."""
    bits = {"TOV": 0, "VOV": 2, "MOV": 4, "POV": 6, "OVR": 7, "HLD": 8, "ADC": 9, "EXH": 10}
    return sum(1 << bits[flag] for flag in flags)
