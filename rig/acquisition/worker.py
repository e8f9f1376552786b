"""The thread of a line: polls each device at its own period, carries out commands, and mends the line when it is lost.

Everything on a line happens in this thread, one thing after the other, so two questions never cross on a bus. A device
that has failed several times is asked rarely where others wait, so that its timeouts do not eat their time.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rig.acquisition import actions
from rig.bench.instrument import IdentityError, Instrument
from rig.clock import Clock
from rig.lines import Line, LineError, LostError
from rig.lines.modbus import RefusedError
from rig.readings import NS, Exchange

FIRST_BACK_OFF_S = 0.1
LONGEST_BACK_OFF_S = 2.0
PROBE_S = 2.0  # where others wait on the line, a failing device is asked no more often than this,
PROBE_SHARE = 0.2  # and takes no more than this share of the line's time
ALONE_S = 0.5  # where none does: it is asked again after this
IDLE_S = 0.5
BUSY_TRIES, BUSY_S = 4, 0.5  # of a device that says at the start that it is busy, and how long it is left alone
CAPTURE_PAUSE_S = 0.2  # of real time after a capture, in which the device is not polled
FASTEST_REAL_S = 0.005  # of the wall, between two hurried polls: a fast virtual bench has a motor to compute too
KEPT_TIMES = 20_000


@dataclass
class Device:
    """A device on a line, and how its polling goes.

    `period_ns`: between polls [ns]; None for a device that is only asked on command.
    `due_ns`, `last_cost_ns`, `polls`, `failures`, `skipped`: when it is next polled and what its last poll took [ns];
        polls made, polls that gave no usable reading, and slots of the schedule that passed without a poll [-].
    `identified`: whether it answered as itself since the line was last opened.
    `hurried_ns`: while it is polled as fast as its line bears: the least between two polls [ns].
    `hurry_since_ns`, `hurry_total_ns`: when that began, and how long it has lasted before [ns]: its own period is
        judged without that time.
    `starts`, `latenesses`, `latencies`: of the latest polls: start, start after the schedule, and request to reply
        [ns].
    """

    driver: Instrument
    period_ns: int | None
    due_ns: int = 0
    last_cost_ns: int = 0
    polls: int = 0
    failures: int = 0
    skipped: int = 0
    identified: bool = False
    identity: str = ""
    hurried_ns: int | None = None
    hurry_since_ns: int = 0
    hurry_total_ns: int = 0
    starts: list[int] = field(default_factory=list)
    latenesses: list[int] = field(default_factory=list)
    latencies: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class _Command:
    device: str
    action: str
    argument: float | None
    done: Future[Exchange]


class Worker(threading.Thread):
    """The thread of one line.

    `line`: the line; nobody else uses it.
    `drivers`: device to its driver and its period [s].
    `note`: takes events: kind, time [ns] and details.
    """

    def __init__(
        self,
        line: Line,
        drivers: dict[str, tuple[Instrument, float | None]],
        put: Callable[[Exchange], None],
        note: Callable[..., None],
        clock: Clock,
    ) -> None:
        super().__init__(name=f"line {line.name}", daemon=True)
        self.line, self.clock = line, clock
        self.devices = {
            name: Device(driver, None if period_s is None else int(period_s * NS))
            for name, (driver, period_s) in drivers.items()
        }
        self.failure: Exception | None = None
        self.lost_since_ns: int | None = None
        self._put, self._note = put, note
        self._commands: queue.Queue[_Command] = queue.Queue()
        self._stopping = threading.Event()
        self._wake = threading.Event()

    def connect(self) -> None:
        """Open the line and identify its devices, in the caller's thread, before the own thread starts.

        Raises LostError, LineError, IdentityError when the port does not open, a device does not answer, or another one
        does.
        """
        exchange, lost = actions.open_line(self.line)
        self._put(exchange)
        if lost:
            raise lost
        faults: list[Exception] = []
        for name in self.devices:
            try:
                self._introduce_patiently(name)
            except LostError:
                raise
            except actions.FAULTS as error:
                faults.append(error if isinstance(error, IdentityError) else LineError(self._silent(name, error)))
        if len(faults) == 1:
            raise faults[0]
        if faults:
            raise LineError("\n".join(str(fault) for fault in faults))

    def _silent(self, name: str, error: Exception) -> str:
        if isinstance(error, RefusedError) and error.is_busy:
            return f"{name} (line {self.line.name}) is busy, {BUSY_TRIES + 1} times: {error}; {error.while_busy}"
        ask = "is it on, and are its address and the baud rate right? spinbench doctor tells more"
        if self.clock.rate > 1.0:
            ask = f"does the machine keep up with a virtual bench at {self.clock.rate:g} times real time? Lower --rate"
        return f"{name} (line {self.line.name}) does not answer as it should: {error}; {ask}"

    def command(self, device: str, action: str, argument: float | None = None) -> Future[Exchange]:
        """Have something done on the line, before the next poll. The future is of the exchange, or of the fault."""
        done: Future[Exchange] = Future()
        if not self.is_alive():
            done.set_exception(LostError(f"line {self.line.name}: nothing runs on it any more"))
            return done
        self._commands.put(_Command(device, action, argument, done))
        self._wake.set()
        return done

    def hurry(self, device: str, update_s: float = 0.0) -> None:
        """Poll a device as fast as the line bears, until `relax`. Commands, and the other devices' polls, go first.

        `device`: on this line; one that is only asked on command stays so.
        `update_s`: how often it makes a new value [s]: it is not asked more often.
        """
        chosen = self.devices[device]
        if chosen.period_ns is None or chosen.hurried_ns is not None:
            return
        chosen.hurry_since_ns = self.clock.now_ns()
        least_ns = int(max(FASTEST_REAL_S * self.clock.rate, update_s) * NS)
        chosen.hurried_ns = min(least_ns, chosen.period_ns)
        if not chosen.driver.failing:
            chosen.due_ns = min(chosen.due_ns, chosen.hurry_since_ns)
        self._wake.set()

    def relax(self, device: str) -> None:
        """Poll a device at its own period again."""
        chosen = self.devices[device]
        if chosen.hurried_ns is None:
            return
        chosen.hurried_ns = None
        chosen.hurry_total_ns += self.clock.now_ns() - chosen.hurry_since_ns

    def stop(self) -> None:
        """End the thread after what it is doing, and close the line."""
        self._stopping.set()
        self._wake.set()
        if self.is_alive():
            self.join()
        self.line.close()
        self._refuse_commands(LostError(f"line {self.line.name} is closed"))

    def run(self) -> None:
        """Work until `stop`. A fault that is not the line's is kept in ``failure``; then nothing is polled any more,
        but commands are still carried out: the regulator may be on this line.
        """
        now_ns = self.clock.now_ns()
        for device in self.devices.values():
            device.due_ns = now_ns
        while not self._stopping.is_set():
            try:
                self._turn()
            except Exception as error:
                self.failure = self.failure or error

    def statistics(self) -> dict[str, dict[str, Any]]:
        """How the polling of each device goes: rates asked and achieved [1/s], jitter and latency [ms], counts [-]."""
        return {name: _statistics(device) for name, device in self.devices.items() if device.period_ns is not None}

    def _turn(self) -> None:
        try:
            self._work()
        except LostError as error:
            self._mend(error)
        except actions.FAULTS:
            pass  # of a command, whose caller has been told

    def _work(self) -> None:
        """One command, one poll, or a wait for either."""
        self._wake.clear()
        try:
            command = self._commands.get_nowait()
        except queue.Empty:
            command = None
        if command is not None:
            self._carry_out(command)
            return
        waiting = [(device.due_ns, name) for name, device in self.devices.items() if device.period_ns is not None]
        if self.failure is not None:
            waiting = []
        due_ns, name = min(waiting) if waiting else (self.clock.now_ns() + int(IDLE_S * self.clock.rate * NS), "")
        wait_s = self.clock.real_s((due_ns - self.clock.now_ns()) / NS)
        if wait_s > 0.0:
            self._wake.wait(min(wait_s, IDLE_S))
        elif name:
            self._poll(name)

    def _carry_out(self, command: _Command) -> None:
        if not command.done.set_running_or_notify_cancel():  # taken back: its caller waits no longer
            return
        device = self.devices[command.device]
        try:
            if not device.identified:  # after a reopening another device may be there: nothing is ordered of it
                self._introduce(command.device)
            exchange, fault = actions.perform(
                self.line, command.device, device.driver, command.action, command.argument
            )
        except Exception as error:
            command.done.set_exception(error)
            raise
        self._put(exchange)
        if command.action == actions.CAPTURE and device.period_ns is not None:
            # a poll between two captures would take edges into a mean
            pause_ns = max(device.period_ns, int(CAPTURE_PAUSE_S * self.clock.rate * NS))
            device.due_ns = self.clock.now_ns() + pause_ns
        if fault is None:
            command.done.set_result(exchange)
            return
        command.done.set_exception(fault)
        if isinstance(fault, LostError):
            raise fault

    def _poll(self, name: str) -> None:
        device = self.devices[name]
        start_ns = self.clock.now_ns()
        if not device.identified:
            self._try_introduction(name)
            return
        exchange, fault = actions.perform(self.line, name, device.driver, actions.POLL)
        end_ns = self.clock.now_ns()
        self._put(exchange)
        hurried_ns = device.hurried_ns
        if hurried_ns is None:
            self._count(device, exchange, start_ns, end_ns)
        else:
            self._count_hurried(device, exchange, start_ns, end_ns, hurried_ns)
        if isinstance(fault, LostError):
            raise fault

    def _count(self, device: Device, exchange: Exchange, start_ns: int, end_ns: int) -> None:
        period_ns = device.period_ns or 0
        self._count_poll(device, exchange, start_ns, end_ns)
        device.starts.append(start_ns - device.hurry_total_ns)
        device.latenesses.append(start_ns - device.due_ns)
        device.latencies += [reading.reply_ns - reading.request_ns for reading in exchange.readings[:1]]
        if len(device.starts) > KEPT_TIMES:
            for kept in (device.starts, device.latenesses, device.latencies):
                del kept[: len(kept) // 2]
        if self._put_off(device, end_ns):
            return
        device.due_ns += period_ns
        late = (end_ns - device.due_ns) // period_ns + 1 if end_ns > device.due_ns else 0
        if late > 1:  # one late poll is made at once; older slots are gone
            device.skipped += late - 1
            device.due_ns += (late - 1) * period_ns

    def _count_hurried(self, device: Device, exchange: Exchange, start_ns: int, end_ns: int, hurried_ns: int) -> None:
        """The next poll comes after those that fell due during this one; after a failure at the own period."""
        usable = self._count_poll(device, exchange, start_ns, end_ns)
        if not self._put_off(device, end_ns):
            device.due_ns = max(end_ns, start_ns + (hurried_ns if usable else device.period_ns or 0))

    def _count_poll(self, device: Device, exchange: Exchange, start_ns: int, end_ns: int) -> bool:
        usable = any(reading.usable for reading in exchange.readings)
        device.polls += 1
        device.failures += not usable
        device.last_cost_ns = end_ns - start_ns
        return usable

    def _put_off(self, device: Device, end_ns: int) -> bool:
        """Whether a device fails, and is asked rarely."""
        if device.driver.failing:
            device.due_ns = end_ns + self._pause_ns(device.last_cost_ns)
        return device.driver.failing

    def _pause_ns(self, cost_ns: int) -> int:
        """How long a device that fails is left alone, so that its timeouts do not eat the others' time."""
        if len(self.devices) == 1:
            return int(ALONE_S * NS)
        return int(max(PROBE_S * NS, cost_ns * (1.0 / PROBE_SHARE - 1.0)))

    def _introduce_patiently(self, name: str) -> None:
        """Identify a device that may have just been switched on."""
        for _ in range(BUSY_TRIES):
            try:
                self._introduce(name)
                return
            except RefusedError as error:
                if not error.is_busy:
                    raise
            self._stopping.wait(BUSY_S)
        self._introduce(name)

    def _introduce(self, name: str) -> None:
        """Open and identify a device; its fault is raised."""
        device = self.devices[name]
        for action in (actions.OPEN, actions.IDENTIFY):
            exchange, fault = actions.perform(self.line, name, device.driver, action)
            self._put(exchange)
            for text in self.line.take_remarks():
                self._note("warning", self.clock.now_ns(), line=self.line.name, text=text)
            if fault:
                raise fault
            device.identity = exchange.outcome
        device.identified = True

    def _try_introduction(self, name: str) -> None:
        """After a reopening: a device that does not answer, or is another one, is not read, but asked again."""
        device = self.devices[name]
        start_ns = self.clock.now_ns()
        try:
            self._introduce(name)
        except LostError:
            raise
        except actions.FAULTS as error:
            self._note("device not identified", self.clock.now_ns(), device=name, error=str(error))
            now_ns = self.clock.now_ns()
            device.due_ns = now_ns + self._pause_ns(now_ns - start_ns)
        else:
            device.due_ns = self.clock.now_ns()

    def _mend(self, error: LostError) -> None:
        """Close, back off, reopen, and leave the identification to the next turn of each device."""
        self.lost_since_ns = self.clock.now_ns()
        self._note("line lost", self.lost_since_ns, line=self.line.name, error=str(error))
        back_off_s = FIRST_BACK_OFF_S
        while not self._stopping.is_set():
            self.line.close()
            self._refuse_commands(error)
            self._stopping.wait(back_off_s)
            back_off_s = min(2.0 * back_off_s, LONGEST_BACK_OFF_S)
            exchange, lost = actions.open_line(self.line)
            if lost is None:
                self._put(exchange)
                break
        else:
            return
        now_ns = self.clock.now_ns()
        gap_s = (now_ns - self.lost_since_ns) / NS
        self._note("line back", now_ns, line=self.line.name, gap_s=round(gap_s, 6))
        self.lost_since_ns = None
        for device in self.devices.values():
            device.identified = False
            device.due_ns = now_ns

    def _refuse_commands(self, error: Exception) -> None:
        while True:
            try:
                done = self._commands.get_nowait().done
            except queue.Empty:
                return
            if done.set_running_or_notify_cancel():
                done.set_exception(error)


def _statistics(device: Device) -> dict[str, Any]:
    period_ns = device.period_ns or 1
    found: dict[str, Any] = {"asked_hz": NS / period_ns, "polls": device.polls, "failures": device.failures}
    found["skipped"] = device.skipped
    if len(device.starts) > 1:
        found["achieved_hz"] = (len(device.starts) - 1) * NS / (device.starts[-1] - device.starts[0])
        found["jitter_ms"] = float(np.std(device.latenesses)) / 1e6
    if device.latencies:
        found["latency_p50_ms"], found["latency_p99_ms"] = (
            float(q) / 1e6 for q in np.quantile(device.latencies, [0.5, 0.99])
        )
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in found.items()}
