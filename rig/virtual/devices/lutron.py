"""Lutron-family meter: frames of 16 characters, sent unasked whenever the display changes, without a checksum.

``02 '4' display unit unit sign decimals eight-digits 0D``, as the makers' manuals print it.
"""

from __future__ import annotations

import math
from typing import Any

from rig.bench.bench import Place
from rig.readings import NS
from rig.virtual.devices.base import Sender, World
from rig.virtual.devices.sensors import Sensor

DISPLAY_S = 1.0  # between two values, when the file does not say
OVERFLOW = 99_999_999


def serve(device: str, settings: Any, place: Place, world: World) -> Lutron:
    """A meter with the displays of its file."""
    return Lutron(device, settings, world)


class Lutron(Sender):
    """Shows, and sends, the mean over the time since the display changed last; speed by the turns of the shaft."""

    def __init__(self, device: str, settings: Any, world: World) -> None:
        super().__init__(device, settings, DISPLAY_S)
        self.plant = world.plant
        self.terminator = self.query[-1:] or b"\r"
        self._last_ns = 0
        self._angle = 0.0
        self._mean_rpm = 0.0
        self._sensors = {}
        for name, channel in settings.channels.items():
            truth = (lambda: self._mean_rpm) if name == "speed_rpm" else world.sensor(device, name, channel).truth
            self._sensors[name] = Sensor(device, name, channel, truth, world.faults, world.seed)

    def answer(self, line: bytes, time_ns: int) -> bytes | None:
        """The frames, for a meter that is asked."""
        if not self.query or line + self.terminator != self.query:
            return None
        return b"".join(self._sent(time_ns))

    def _sent(self, time_ns: int) -> list[bytes]:
        if time_ns > self._last_ns:
            turned = abs(self.plant.angle_rad - self._angle)
            self._mean_rpm = turned / (2.0 * math.pi) / (time_ns - self._last_ns) * NS * 60.0
            self._angle, self._last_ns = self.plant.angle_rad, time_ns
        return [_frame(channel, self._sensors[name].read(time_ns)) for name, channel in self.settings.channels.items()]


def _frame(channel: Any, value: float) -> bytes:
    code = (channel.unit_codes or ["00"])[0]
    resolution = channel.resolution or 1.0
    decimals = min(3, max(0, math.ceil(-math.log10(resolution / abs(channel.scale)) - 1e-9)))
    shown = value / channel.scale
    digits = OVERFLOW if math.isnan(shown) else min(OVERFLOW, round(abs(shown) * 10**decimals))
    sign = "1" if shown < 0.0 and digits else "0"
    return b"\x02" + f"4{channel.display}{code}{sign}{decimals}{digits:08d}".encode("ascii") + b"\x0d"
