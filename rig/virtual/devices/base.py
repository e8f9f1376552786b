"""What a simulated instrument is, and how one is made for each device of a bench.

A family is the module of that name in this folder, with `serve(device, settings, place, world)`: nothing else has
to know of a new one. Frames are written here from the makers' documents, not with the rig's own codecs.
"""

from __future__ import annotations

import importlib
import importlib.util
from dataclasses import dataclass
from typing import Any, Protocol

from configs import ConfigError
from rig.bench.bench import Bench, Place
from rig.bench.instrument import ChannelFile
from rig.virtual.devices.faults import Faults
from rig.virtual.devices.sensors import Sensor, truth_of
from rig.virtual.plant.truth import Turning


@dataclass(frozen=True)
class World:
    """What every simulated instrument shares: line and motor, faults, the source of chance, and the clock's rate."""

    plant: Turning
    faults: Faults
    seed: int
    rate: float = 1.0

    def sensor(self, device: str, channel: str, figures: ChannelFile, update_s: float = 0.0) -> Sensor:
        """A channel with errors of its own. `update_s`: how often it has a new value [s]."""
        truth = truth_of(self.plant, channel, figures.reference)
        return Sensor(device, channel, figures, truth, self.faults, self.seed, update_s)


class Served(Protocol):
    """A simulated instrument. Line and motor have been carried on to the time of every call.

    `speaks`: ``modbus``, ``text`` (lines, each with an answer or none), or ``stream`` (unasked; hears lines).
    """

    device: str
    speaks: str

    def restart(self, time_ns: int) -> None:
        """Power comes back: everything as from the factory. `time_ns`: time of the bench [ns]."""

    def tick(self, time_ns: int) -> None:
        """Time has passed; watchdogs look at it. `time_ns`: time of the bench [ns]."""


class TextServed(Served, Protocol):
    """An instrument that is asked in lines of text."""

    terminator: bytes

    def answer(self, line: bytes, time_ns: int) -> bytes | None:
        """The whole answer, or None: not its address, or nothing to say. `time_ns`: time of the bench [ns]."""


def serve_bench(bench: Bench, world: World, devices: list[str]) -> dict[str, Any]:
    """The simulated instruments of a bench.

    By name. Raises ConfigError: all devices that cannot be simulated, a line each.
    """
    served, mistakes = {}, []
    for device in devices:
        settings, table = bench.instruments[device], bench.file.devices[device]
        name = f"{__package__}.{settings.family}"
        if importlib.util.find_spec(name) is None:
            mistakes.append(f"devices.{device}: the virtual bench has no instrument of the family '{settings.family}'")
            continue
        try:
            place = Place(table, bench.file.lines[table.line])
            served[device] = importlib.import_module(name).serve(device, settings, place, world)
        except ValueError as error:
            mistakes.append(f"devices.{device}: {error}")
    if mistakes:
        raise ConfigError("\n".join(mistakes))
    return served
