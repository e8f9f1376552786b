"""The control socket of the virtual bench: one JSON object a line, one a line in answer."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from configs import ConfigError
from rig.readings import NS
from rig.virtual.cables.sockets import SocketWire
from rig.virtual.devices.faults import BY_S, read_fault

if TYPE_CHECKING:
    from rig.virtual.serve import VirtualServer

LONGEST_ORDER = 65536
MOST_POINTS = 2000
HIGHEST_BAR = 8.0
CONTROL_ORDERS = ("state", "fault", "clear", "unplug", "plug", "power_cycle", "supply", "log", "quit")


class RequestError(ValueError):
    """A request that makes no sense. The text says what would."""


class Control:
    """Answers requests about the bench, and carries out those to change it."""

    def __init__(self, server: VirtualServer) -> None:
        self.server = server
        self._wire = SocketWire(server.loop, self._receive)
        self._buffers: dict[int, bytes] = {}

    def open(self) -> None:
        """Listen."""
        self._wire.plug()

    def close(self) -> None:
        """Hang up."""
        self._wire.unplug()

    def address(self) -> dict[str, str | int]:
        """Host and port."""
        return self._wire.address()

    def _receive(self, caller: int, data: bytes, _: int) -> None:
        buffer = self._buffers.pop(caller, b"") + data
        while b"\n" in buffer:
            line, buffer = buffer.split(b"\n", 1)
            answer = self._answer(line)
            self._wire.send(caller, json.dumps(answer).encode() + b"\n")
        if buffer and len(buffer) <= LONGEST_ORDER:
            self._buffers[caller] = buffer

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise RequestError("a request is a JSON object")
            return {"ok": True} | self.carry_out(request)
        except (RequestError, ConfigError) as error:
            return {"ok": False, "error": str(error)}
        except ValueError:
            return {"ok": False, "error": "a request is one JSON object on one line"}

    def carry_out(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Do what a request asks, and return what there is to tell.

        Raises RequestError, ConfigError when it cannot be done; nothing is changed then.
        """
        do = request.get("do")
        if do not in CONTROL_ORDERS:
            raise RequestError(f"do: {do!r:.40} is not one of {', '.join(CONTROL_ORDERS)}")
        told: Callable[[Mapping[str, Any]], dict[str, Any] | None] = getattr(self, f"_{do}")
        self.server.world.plant.advance(self.server.clock.now_ns())
        return told(request) or {}

    def _state(self, request: Mapping[str, Any]) -> dict[str, Any]:
        server, plant = self.server, self.server.world.plant
        since_s = _number(request, "since_s", 0.0)
        newest = itertools.islice(reversed(plant.history), MOST_POINTS)
        points = list(itertools.takewhile(lambda point: point[0] >= since_s, newest))[::-1]
        columns = list(zip(*points, strict=True)) or [(), (), (), ()]
        return {
            "time_s": plant.time_ns / NS,
            "rate": server.clock.rate,
            "pressure_bar_abs": plant.pressure_bar,
            "target_bar_abs": plant.target_bar,
            "vented": plant.vented,
            "speed_rpm": plant.speed_rpm,
            "angle_rad": plant.angle_rad,
            "flow_kg_s": plant.flow_kg_s,
            "flow_l_min": plant.volume_flow_l_min(plant.pressure_bar, plant.inlet_k),
            "setpoints": [
                {"time_s": time_s, "real_ns": self._real_ns(time_s), "pressure_bar_abs": bar}
                for time_s, bar in plant.setpoints
                if time_s >= since_s
            ],
            "history": dict(zip(("time_s", "pressure_bar_abs", "speed_rpm", "flow_kg_s"), columns, strict=True))
            | {"real_ns": [self._real_ns(point[0]) for point in points]},
            "lines": {name: bus.wire.plugged for name, bus in server.buses.items()},
            "without_power": [device for bus in server.buses.values() for device in bus.without_power],
            "faults": [fault.model_dump() for fault in server.faults.active],
            "fault_counts": dict(server.faults.counts),
        }

    def _fault(self, request: Mapping[str, Any]) -> None:
        table = {key: value for key, value in request.items() if key != "do"}
        self.server.add_fault(read_fault(table, self.server.place, "fault"))

    def _clear(self, request: Mapping[str, Any]) -> None:
        self.server.faults.clear()

    def _unplug(self, request: Mapping[str, Any]) -> None:
        self.server.buses[_name(request, "line", self.server.buses)].wire.unplug()

    def _plug(self, request: Mapping[str, Any]) -> None:
        self.server.plug(_name(request, "line", self.server.buses))

    def _power_cycle(self, request: Mapping[str, Any]) -> None:
        device = _name(request, "device", self.server.served)
        self.server.power_cycle(device, _number(request, "by_s", BY_S["power_cycle"]))

    def _supply(self, request: Mapping[str, Any]) -> None:
        pressure = _number(request, "pressure_bar_abs", None)
        if not 0.0 <= pressure <= HIGHEST_BAR:
            raise RequestError(f"pressure_bar_abs: {pressure:g} is outside 0..{HIGHEST_BAR:g} bar")
        self.server.world.plant.order(pressure)

    def _log(self, request: Mapping[str, Any]) -> dict[str, Any]:
        wanted = self.server.buses
        if "line" in request:
            name = _name(request, "line", wanted)
            wanted = {name: wanted[name]}
        last = int(_number(request, "last", 1000.0))
        entries = [
            {"line": name, "time_s": time_s, "device": device, "request": data}
            for name, bus in wanted.items()
            for time_s, device, data in itertools.islice(bus.log, max(0, len(bus.log) - last), None)
        ]
        return {"requests": sorted(entries, key=lambda entry: entry["time_s"])}

    def _quit(self, request: Mapping[str, Any]) -> None:
        self.server.loop.after(0.05 * self.server.clock.rate, self.server.loop.stop)

    def _real_ns(self, time_s: float) -> int:
        clock = self.server.clock
        return clock.start_ns + int(time_s * NS / clock.rate)


def _name(request: Mapping[str, Any], key: str, known: Mapping[str, Any]) -> str:
    name = request.get(key)
    if not isinstance(name, str) or name not in known:
        raise RequestError(f"{key}: {name!r:.60} is not one of {', '.join(known)}")
    return name


def _number(request: Mapping[str, Any], key: str, default: float | None) -> float:
    value = request.get(key, default)
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e12:
        raise RequestError(f"{key}: a number is needed, not {value!r:.40}")
    return float(value)
