"""A run played back: each exchange goes through its driver once more, over the bytes that were there then."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rig.acquisition import actions
from rig.acquisition.opening import timing_of
from rig.acquisition.stage import Stage
from rig.bench.bench import Bench
from rig.clock import Clock
from rig.lines import Line
from rig.lines.port import LostError
from rig.readings import Event, Exchange
from rig.runlog import RunError


class ReplayPort:
    """Plays back the events of one exchange after the other.

    A driver that asks what it asked then gets what came then. One that was mended may ask or wait otherwise: what was
    received is given until the next question, and silence after that.
    """

    def __init__(self) -> None:
        self._events: deque[Event] = deque()
        self._last_ns = 0
        self.differences: list[str] = []  # where the bytes asked are not those that were asked

    def load(self, events: tuple[Event, ...]) -> None:
        """Lay in the events of the next exchange; what is left of the last one is dropped."""
        self._events = deque(events)
        if events:
            self._last_ns = events[0].time_ns

    def open(self) -> None:
        """Open; fails as it failed then."""
        self._fail_if_lost()

    def close(self) -> None:
        """Close."""

    def write(self, data: bytes) -> int:
        """Compare with what was sent, and return the time at which it was [ns]."""
        while self._events and self._events[0].kind in ("rx", "silence"):
            self._events.popleft()
        self._fail_if_lost()
        if not self._events:
            self.differences.append(f"sends {data[:32].hex(' ')} where nothing was sent")
            return self._last_ns
        sent = self._events.popleft()
        self._last_ns = sent.time_ns
        if sent.data != data:
            self.differences.append(f"sends {data[:32].hex(' ')} where {sent.data[:32].hex(' ')} was sent")
        return sent.time_ns

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """What came next then. `until_ns`: not used: the wait ended as it ended then [ns]."""
        self._fail_if_lost()
        if not self._events or self._events[0].kind == "tx":
            return max(self._last_ns, until_ns), b""
        event = self._events.popleft()
        self._last_ns = event.time_ns
        return event.time_ns, event.data

    def _fail_if_lost(self) -> None:
        if self._events and self._events[0].kind == "lost":
            raise LostError(self._events.popleft().data.decode(errors="replace"))


class Player:
    """Plays the exchanges of a run through the drivers of its bench.

    `bench`: with the instruments' files: those that the run kept, or mended ones.
    """

    def __init__(self, bench: Bench, simulated: bool, ambient: Mapping[str, Any], rate: float = 1.0) -> None:
        clock = Clock(rate)
        self.ports = {name: ReplayPort() for name in bench.file.lines}
        self.lines = {
            name: Line(name, self.ports[name], clock, timing_of(table)) for name, table in bench.file.lines.items()
        }
        self.drivers = {device: bench.build(device) for device in bench.file.devices}
        self.stage = Stage(bench, simulated, ambient.get("pressure_bar_abs"), ambient.get("temperature_c"))

    def play(self, exchange: Exchange) -> Exchange:
        """What the drivers make of an exchange now.

        `exchange`: as logged; its readings are not used.
        Returns it with the same bytes, and the readings and outcome of today's drivers.
        """
        self._check(exchange)
        line, port = self.lines[exchange.line], self.ports[exchange.line]
        port.load(exchange.events)
        if not exchange.device:
            played, _ = actions.open_line(line)
        else:
            driver = self.drivers[exchange.device]
            played, _ = actions.perform(line, exchange.device, driver, exchange.action, exchange.argument)
        line.take_events()
        return self.stage(replace(exchange, readings=played.readings, outcome=played.outcome))

    def _check(self, exchange: Exchange) -> None:
        """What is no exchange of this bench is refused before a driver sees it."""
        what = f"exchange '{exchange.action}' of '{exchange.device}' on line '{exchange.line}'"
        if exchange.line not in self.lines or (exchange.device and exchange.device not in self.drivers):
            raise RunError(f"{what}: the bench of this run has no such line or device")
        needs = {actions.WRITE: "write", actions.FAILSAFE: "set_failsafe", actions.CAPTURE: "poll_edges"}
        known = (actions.OPEN, actions.IDENTIFY, actions.POLL, *needs)
        driver = self.drivers.get(exchange.device)
        if exchange.action not in known or (not exchange.device and exchange.action != actions.OPEN):
            raise RunError(f"{what}: there is no such action ({', '.join(known)})")
        if exchange.action in needs and not hasattr(driver, needs[exchange.action]):
            raise RunError(f"{what}: this device does nothing of the kind")
        if exchange.action == actions.WRITE and exchange.argument is None:
            raise RunError(f"{what}: without a set-point")

    @property
    def differences(self) -> list[str]:
        """Where today's drivers ask something else than was asked."""
        return [f"line {name}: {text}" for name, port in self.ports.items() for text in port.differences]
