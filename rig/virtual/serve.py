"""The virtual bench put together: lines, instruments, the motor behind them, and the faults of the bench file."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

from configs import ConfigError
from configs.units import BAR, ZERO_C
from model.motor import Motor, read_motor
from rig.acquisition.opening import timing_of
from rig.bench.bench import Bench, BenchFile, LineTable
from rig.clock import Clock
from rig.readings import NS
from rig.recording.files import write_file
from rig.virtual.cables.bus import Bus
from rig.virtual.cables.loop import Loop
from rig.virtual.cables.sockets import SocketWire
from rig.virtual.cables.terminals import PtyWire
from rig.virtual.control import Control
from rig.virtual.devices.base import World, serve_bench
from rig.virtual.devices.faults import ONCE, Fault, Faults, Place, read_fault
from rig.virtual.devices.sensors import generator
from rig.virtual.launch import PORTS
from rig.virtual.plant.plant import Plant
from rig.virtual.plant.truth import Turning, read_truth

TICK_S = 0.004  # of the wall
OWNER_LOOK_S = 0.5
LINGER_S = 10.0  # of the wall: long enough for a watchdog to send the regulator to zero

PlantOf = Callable[[Bench], Turning]


def virtual_lines(file: BenchFile) -> dict[str, LineTable]:
    """The lines that the virtual bench serves: their port or host is ``virtual``."""
    return {name: line for name, line in file.lines.items() if "virtual" in (line.port, line.host)}


class VirtualServer:
    """A bench being served; everything happens in the thread that calls `run`.

    `rate`: seconds of the bench in one of the wall [-]; the file's when left out.
    `seed`: of everything that is left to chance [-]; the file's when left out.
    `plant_of`: makes line and motor of the bench file; the project's own model when left out.
    `seal`: asked for the SHA-256 of what the bench conceals; empty where it conceals nothing.
    """

    def __init__(
        self,
        bench: Bench,
        folder: Path,
        rate: float | None = None,
        seed: int | None = None,
        plant_of: PlantOf | None = None,
        seal: Callable[[], str] = str,
    ) -> None:
        virtual = bench.file.virtual
        if virtual is None:
            raise ConfigError(f"{bench.name}: the bench file has no [virtual] table, so there is nothing to simulate")
        self.bench, self.folder, self.seal = bench, folder, seal
        self.seed = virtual.seed if seed is None else seed
        lines = virtual_lines(bench.file)
        devices_of = {
            name: [device for device, table in bench.file.devices.items() if table.line == name] for name in lines
        }
        plant = (plant_of or _plant)(bench)
        place = Place(devices_of, frozenset())
        self.faults = Faults(generator(self.seed, "faults"), place)
        self.clock = Clock(virtual.rate if rate is None else rate)
        self.world = World(plant, self.faults, self.seed, self.clock.rate)
        self.served = serve_bench(bench, self.world, [device for found in devices_of.values() for device in found])
        speaking = frozenset(name for name, device in self.served.items() if device.speaks == "modbus")
        self.faults.place = self.place = Place(devices_of, speaking)
        first = [
            read_fault(table, self.place, f"{bench.name}: [[virtual.faults]] entry {n}")
            for n, table in enumerate(virtual.faults, start=1)
        ]
        self.loop = Loop(self.clock)
        self.buses = {name: self._bus(name, line) for name, line in lines.items()}
        self.control = Control(self)
        for fault in first:
            self.add_fault(fault)

    def _bus(self, name: str, line: LineTable) -> Bus:
        devices = [self.served[device] for device in self.place.devices_of[name]]
        framing = line.framing or ("rtu" if line.kind == "serial" else "tcp")
        bus = Bus(name, framing, devices, self.loop, self.world, generator(self.seed, "line", name))
        if line.kind == "serial":
            link = self.folder / f"{name}.tty"
            bus.wire = PtyWire(self.loop, link, timing_of(line).byte_s, line.baud, bus.receive)
        else:
            bus.wire = SocketWire(self.loop, bus.receive)
        return bus

    def add_fault(self, fault: Fault) -> None:
        """Lay a fault, or let it happen at its time."""
        if fault.kind not in ONCE:
            self.faults.add(fault)
            return
        when_ns = max(self.clock.now_ns(), int(fault.from_s * NS))
        if fault.kind == "unplug":
            wire = self.buses[fault.line].wire
            self.loop.at(when_ns, wire.unplug)
            self.loop.at(when_ns + int(fault.span_s * NS), lambda: self.plug(fault.line))
        else:
            self.loop.at(when_ns, lambda: self.power_cycle(fault.device, fault.span_s))

    def plug(self, line: str) -> None:
        """Put a line's cable in."""
        wire = self.buses[line].wire
        if not wire.plugged:
            wire.plug()

    def power_cycle(self, device: str, span_s: float) -> None:
        """Take a device's power for some time. `span_s`: how long [s]."""
        bus = next(bus for name, bus in self.buses.items() if device in self.place.devices_of[name])
        self.world.plant.advance(self.clock.now_ns())
        self.served[device].switch_off()
        bus.switch_off(device, self.clock.now_ns() + int(span_s * NS))

    def run(
        self, owner: int | None = None, linger_s: float = LINGER_S, ready: Callable[[], None] = lambda: None
    ) -> None:
        """Serve until the loop is told to stop.

        `linger_s`: how long after that process this one ends, on the wall's clock [s].
        """
        try:
            for bus in self.buses.values():
                bus.wire.plug()
            self.control.open()
            self.loop.every(TICK_S, self._tick)
            if owner is not None:
                self.loop.every(OWNER_LOOK_S, _OwnerWatch(owner, linger_s, self.loop))
            write_file(self.folder / PORTS, json.dumps(self.ports()).encode())
            ready()
            self.loop.run()
        finally:
            for bus in self.buses.values():
                bus.wire.unplug()
            self.control.close()
            (self.folder / PORTS).unlink(missing_ok=True)

    def ports(self) -> dict[str, Any]:
        """What ports.json holds."""
        return {
            "pid": os.getpid(),
            "rate": self.clock.rate,
            "clock_start_ns": self.clock.start_ns,
            "lines": {name: bus.wire.address() for name, bus in self.buses.items()},
            "control": self.control.address(),
        } | ({"seal": seal} if (seal := self.seal()) else {})

    def _tick(self) -> None:
        now_ns = self.clock.now_ns()
        self.world.plant.advance(now_ns)
        for bus in self.buses.values():
            bus.tick(now_ns)


class _OwnerWatch:
    """Stops the loop some time after a process is gone."""

    def __init__(self, owner: int, linger_s: float, loop: Loop) -> None:
        self.owner, self.left_s, self.loop = owner, linger_s, loop

    def __call__(self) -> None:
        if _lives(self.owner):
            return
        self.left_s -= OWNER_LOOK_S
        if self.left_s <= 0.0:
            self.loop.stop()


def _lives(process: int) -> bool:
    """Whether a process runs; one that is killed and not yet waited for does not."""
    with contextlib.suppress(OSError, IndexError):
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
        return state not in "ZX"
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def motor_in_room(bench: Bench) -> Motor:
    """The motor's file, in the room of the bench file."""
    ambient = bench.file.ambient
    room: dict[str, float] = {}
    if ambient.pressure_bar_abs is not None:
        room["ambient_pressure"] = ambient.pressure_bar_abs * BAR
    if ambient.temperature_c is not None:
        room["ambient_temperature"] = room["inlet_temperature"] = ambient.temperature_c + ZERO_C
    if ambient.relative_humidity is not None:
        room["relative_humidity"] = ambient.relative_humidity
    return read_motor(bench.motor).with_values(room)


def _plant(bench: Bench) -> Plant:
    """Line and motor as they really are: the motor's file, in the bench's room, with the truth of the bench file."""
    truth = bench.file.virtual.truth if bench.file.virtual else {}
    rotor, line = read_truth(motor_in_room(bench), truth, bench.name)
    motor = rotor.with_flywheel(bench.file.added_inertia_kg_m2)
    trial = Plant(motor, line)  # compiles the model before the clock starts
    trial.order(2.0)
    trial.advance(NS // 10)
    return Plant(motor, line)


def serve(
    bench: Bench,
    folder: Path,
    rate: float | None = None,
    owner: int | None = None,
    seed: int | None = None,
    linger_s: float = LINGER_S,
    plant_of: PlantOf | None = None,
    ready: Callable[[], None] = lambda: None,
    seal: Callable[[], str] = str,
) -> None:
    """Serve a bench until told to stop.

    `rate`: seconds of the bench in one of the wall [-].
    `linger_s`: how long after the owner this process ends, on the wall's clock [s].
    `plant_of`: makes line and motor of the bench file; the project's own model when left out.
    `seal`: asked for the SHA-256 of what the bench conceals; empty where it conceals nothing.
    """
    folder.mkdir(parents=True, exist_ok=True)
    server = VirtualServer(bench, folder.resolve(), rate, seed, plant_of, seal)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: server.loop.stop())
    server.run(owner, linger_s, ready)
