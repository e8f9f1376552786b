"""What a simulated instrument is, and how one is made for each device of a bench.

A family is the module of that name in this folder, with `serve(device, settings, place, world)`: nothing else has
to know of a new one. Frames are written here from the makers' documents, not with the rig's own codecs.
"""

from __future__ import annotations

import abc
import importlib
import importlib.util
from dataclasses import dataclass
from typing import Any

from configs import ConfigError
from rig.bench.bench import Bench, Place
from rig.bench.instrument import ChannelFile
from rig.readings import NS
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


class Served:
    """A simulated instrument. Line and motor have been carried on to the time of every call, the bench's [ns].

    `speaks`: ``modbus``, ``text`` (lines, each with an answer or none), or ``stream`` (unasked; hears lines).
    """

    device: str
    speaks: str

    def switch_off(self) -> None:
        """Power is gone."""

    def restart(self, time_ns: int) -> None:
        """Power comes back: everything as from the factory."""
        self.switch_off()

    def tick(self, time_ns: int) -> None:
        """Time has passed; watchdogs look at it."""

    def overrun(self) -> None:
        """What was sent unasked found no room, and is lost."""


class Sender(Served, abc.ABC):
    """One that answers a question in text, or sends now and then where its file has none."""

    def __init__(self, device: str, settings: Any, apart_s: float) -> None:
        self.device, self.settings = device, settings
        self.query = settings.query.encode("ascii")
        self.speaks = "text" if self.query else "stream"
        self.period_ns = int((settings.update_s or apart_s) * NS)
        self._next_ns = 0

    def restart(self, time_ns: int) -> None:
        """Power comes back: the first value takes a while."""
        self._next_ns = time_ns + self.period_ns

    def stream(self, time_ns: int) -> list[bytes]:
        """What is sent, when it is time for it."""
        if time_ns < self._next_ns:
            return []
        self._next_ns = time_ns + self.period_ns
        return self._sent(time_ns)

    @abc.abstractmethod
    def _sent(self, time_ns: int) -> list[bytes]: ...


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
