"""The acquisition of a bench: a worker a line, one recorder, and the view that the sweep and the interlocks have."""

from __future__ import annotations

import concurrent.futures
from collections.abc import Callable
from typing import Any

from rig.acquisition.actions import WRITE
from rig.acquisition.channels import Channels, Window
from rig.acquisition.opening import line_of, port_of
from rig.acquisition.recorder import Recorder, Sink
from rig.acquisition.stage import Stage
from rig.acquisition.worker import Worker
from rig.bench.bench import Bench, LineTable
from rig.clock import Clock
from rig.lines import LineError, NoReplyError, Port
from rig.readings import NS, Exchange, Reading
from rig.recording.columns import ROLES


class Acquisition:
    """Reads a bench into a run log.

    `ports`: from a line's name, its table and the clock to its port; the ports that the bench file names when left out.
    `ambient_bar`, `ambient_c`: the room's pressure [bar] and temperature [degree Celsius] in this run; the bench file's
        when left out.
    """

    def __init__(
        self,
        bench: Bench,
        clock: Clock,
        ports: Callable[[str, LineTable, Clock], Port] = port_of,
        simulated: bool = False,
        ambient_bar: float | None = None,
        ambient_c: float | None = None,
    ) -> None:
        self.bench, self.clock = bench, clock
        self.channels = Channels()
        self.recorder = Recorder(None, Stage(bench, simulated, ambient_bar, ambient_c), self.channels)
        self.workers: dict[str, Worker] = {}
        for name, table in bench.file.lines.items():
            drivers = {
                device: (bench.build(device), None if table.kind == "keyboard" else of_device.period_s)
                for device, of_device in bench.file.devices.items()
                if of_device.line == name
            }
            if drivers:
                line = line_of(name, table, ports(name, table, clock), clock)
                self.workers[name] = Worker(line, drivers, self.recorder.put, self.recorder.note, clock)
        self._line_of = {device: table.line for device, table in bench.file.devices.items()}
        self._names = {role: self._role_name(role) for role in ROLES}

    def connect(self) -> None:
        """Open every line and identify every device. What crosses the wires is kept for the log.

        Raises LineError when a port does not open or a device does not answer: all of them, a line each; IdentityError
        when another device answers than the bench file says.
        """
        with concurrent.futures.ThreadPoolExecutor(max(1, len(self.workers))) as pool:
            connecting = {name: pool.submit(worker.connect) for name, worker in self.workers.items()}
        faults = [fault for future in connecting.values() if (fault := future.exception()) is not None]
        if not faults:
            return
        for worker in self.workers.values():
            worker.stop()
        if len(faults) == 1:
            raise faults[0]
        raise LineError("\n".join(str(fault) for fault in faults))

    def begin(self, sink: Sink) -> None:
        """Begin to write into the run log, what `connect` exchanged first, and to poll."""
        self.recorder.sink = sink
        self.recorder.start()
        for worker in self.workers.values():
            worker.start()

    def stop(self) -> None:
        """Stop polling, close the lines, and write everything that was read.

        Raises RecorderError when the log could not be written.
        """
        for worker in self.workers.values():
            worker.stop()
        self.recorder.finish()

    def command(
        self,
        device: str,
        action: str,
        argument: float | None = None,
        wait_s: float = 5.0,
        take_back: bool = True,
    ) -> Exchange:
        """Have a device do something, and wait until it is done.

        `argument`: set-point of a write, in the actuator's unit [own unit].
        `wait_s`: longest wait, in real time [s].
        `take_back`: whether what was not begun by then is not done any more.
        Returns what crossed the wire. Raises LineError, IdentityError, InstrumentError when it was not done.
        """
        if action != WRITE:  # the regulator is sent to zero also when nothing can be logged any more
            self.check()
        done = self.workers[self._line_of[device]].command(device, action, argument)
        try:
            return done.result(wait_s)
        except concurrent.futures.TimeoutError:
            if take_back:
                done.cancel()
            raise NoReplyError(f"{device}: '{action}' was not done within {wait_s:g} s; its line is busy") from None

    def hurry(self, device: str) -> None:
        """Poll a device as fast as its line bears, until `relax`; commands and other devices go first."""
        self.workers[self._line_of[device]].hurry(device, self.bench.instruments[device].update_s)

    def relax(self, device: str) -> None:
        """Poll a device at its own period again."""
        self.workers[self._line_of[device]].relax(device)

    def event(self, kind: str, time_ns: int | None = None, **details: Any) -> None:
        """Write an event into the log, in its place among the readings.

        `time_ns`: when, on the bench's clock [ns]; now when left out.
        """
        self.recorder.note(kind, self.clock.now_ns() if time_ns is None else time_ns, **details)

    def window(self, channel: str, span_s: float) -> Window:
        """The usable readings of a channel over the latest span of time."""
        self.check()
        return self.channels.window(self._name(channel), self.clock.now_ns() - int(span_s * NS))

    def between(self, channel: str, start_ns: int, end_ns: int) -> Window:
        """The usable readings of a channel between two times."""
        return self.channels.window(self._name(channel), start_ns, end_ns)

    def last(self, channel: str) -> Reading | None:
        """The newest reading of a channel, failed or not; None before the first."""
        self.check()
        return self.channels.last(self._name(channel))

    def since(self, channel: str, after_ns: int) -> list[Reading]:
        """The readings of a channel, failed or not, whose replies came after a time [ns], oldest first."""
        self.check()
        return self.channels.since(self._name(channel), after_ns)

    def statistics(self) -> dict[str, Any]:
        """Rates, jitter, latency and failures of every device, and how full the queue was."""
        devices: dict[str, Any] = {}
        for worker in self.workers.values():
            devices |= worker.statistics()
        return {
            "devices": devices,
            "queue_high_water": self.recorder.high_water,
            "queue_full": self.recorder.waits,
            "exchanges": self.recorder.written,
        }

    def identities(self) -> dict[str, str]:
        """Who answered as each device, with the firmware where it was told."""
        return {name: device.identity for worker in self.workers.values() for name, device in worker.devices.items()}

    def check(self) -> None:
        """Raise what ended a thread of the acquisition, if one has ended."""
        self.recorder.check()
        for worker in self.workers.values():
            if worker.failure is not None:
                raise worker.failure

    def _role_name(self, role: str) -> str | None:
        from rig.acquisition.derived import CHANNEL, DEVICE

        if role == "flow" and self.recorder.stage.inlet_flow.reference is not None:
            return f"{DEVICE}.{CHANNEL}"
        return getattr(self.bench.file.roles, role)

    def _name(self, channel: str) -> str:
        return self._names.get(channel) or channel
