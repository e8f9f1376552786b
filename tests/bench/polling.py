"""Polling of the same two registers: our lines, and the whole acquisition with its run log, against bare pymodbus."""

from __future__ import annotations

import asyncio
import functools
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient, ModbusSerialClient, ModbusTcpClient
from results import Row

from rig.acquisition.channels import Channels
from rig.acquisition.recorder import Recorder
from rig.acquisition.worker import Worker
from rig.clock import Clock
from rig.lines import Line, Port, Timing, modbus
from rig.lines.serial import SerialPort
from rig.lines.tcp import TcpPort
from rig.readings import Exchange, Quality, Reading
from rig.runlog import RunWriter, StartRecord
from rig.runlog.rows import utc_text
from rig.runlog.schema import ClockRecord

TOPIC = "Polling two registers, against bare pymodbus"
BAUDS = (19_200, 115_200)
REQUEST = modbus.Request(1, modbus.READ_HOLDING, 0, 2)
BITS_A_BYTE = 10
PATIENCE_S = 2.0


@contextmanager
def server() -> Iterator[dict[str, Any]]:
    """pymodbus' server in a process of its own; its addresses."""
    command = [sys.executable, str(Path(__file__).with_name("modbus_server.py")), *map(str, BAUDS)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdin is not None
        yield json.loads(process.stdout.readline())
        process.stdin.close()


def counted(read: Callable[[], object], seconds: float) -> float:
    """Calls a second of a function [1/s].

    Parameters
    ----------
    read : callable
        Reads once.
    seconds : float
        How long [s].
    """
    read()
    calls, start = 0, time.perf_counter()
    while (passed := time.perf_counter() - start) < seconds:
        read()
        calls += 1
    return calls / passed


def bare_sync(client: ModbusSerialClient | ModbusTcpClient, seconds: float) -> float:
    """Rate of pymodbus' synchronous client [1/s].

    Parameters
    ----------
    client : client of pymodbus
        Not connected yet.
    seconds : float
        How long [s].
    """
    client.connect()
    try:
        return counted(lambda: client.read_holding_registers(0, count=2, device_id=1), seconds)
    finally:
        client.close()


async def bare_async(make: Callable[[], AsyncModbusSerialClient | AsyncModbusTcpClient], seconds: float) -> float:
    """Rate of pymodbus' asynchronous client, one question after the other [1/s].

    Parameters
    ----------
    make : callable
        Gives the client; called inside the loop.
    seconds : float
        How long [s].
    """
    client = make()
    await client.connect()
    try:
        await client.read_holding_registers(0, count=2, device_id=1)
        calls, start = 0, time.perf_counter()
        while (passed := time.perf_counter() - start) < seconds:
            await client.read_holding_registers(0, count=2, device_id=1)
            calls += 1
        return calls / passed
    finally:
        client.close()


class Gauge:
    """The least driver there can be, so that the acquisition is measured and not an instrument."""

    failing = False

    def __init__(self, framing: str) -> None:
        self.framing = framing

    def open(self, line: Line) -> None:
        """Nothing to forget."""

    def identify(self, line: Line) -> str:
        """Any device will do."""
        return "peer"

    def poll(self, line: Line) -> list[Reading]:
        """Two registers, one reading."""
        registers, reply = modbus.exchange(line, self.framing, REQUEST)
        times = (reply.reply_ns, reply.request_ns, reply.reply_ns)
        return [Reading("gauge", "pressure_bar_abs", float(registers[0]), "bar", Quality.OK, *times)]


class AsItIs:
    """A stage that adds nothing."""

    def __call__(self, exchange: Exchange) -> Exchange:
        return exchange

    def hear(self, event: str, details: object) -> None:
        """Nothing."""


def whole(port: Port, framing: str, timing: Timing, clock: Clock, seconds: float, folder: Path) -> float:
    """Rate of a worker that polls as fast as it can, every exchange and reading written to a run's files [1/s].

    Parameters
    ----------
    port : Port
        Not opened yet.
    framing : str
        ``rtu`` or ``tcp``.
    timing : Timing
        Of the line.
    clock : Clock
        Of the port.
    seconds : float
        How long [s].
    folder : Path
        Where the run goes.
    """
    start = StartRecord(
        kind="zero",
        bench="benchmark",
        utc_start=utc_text(clock.utc_start_ns),
        clock=ClockRecord(rate=1.0, utc_start_ns=clock.utc_start_ns),
    )
    writer = RunWriter.create(folder, start)
    recorder = Recorder(writer, AsItIs(), Channels())
    recorder.start()
    worker = Worker(
        Line("bus", port, clock, timing), {"gauge": (Gauge(framing), 1e-6)}, recorder.put, recorder.note, clock
    )
    worker.connect()
    written, start = recorder.written, time.perf_counter()
    worker.start()
    time.sleep(seconds)
    rate = (recorder.written - written) / (time.perf_counter() - start)
    worker.stop()
    recorder.finish()
    writer.end("finished", "benchmark")
    if worker.failure:
        raise worker.failure
    return rate


@dataclass(frozen=True)
class Link:
    """A way to the server: our port, pymodbus' clients, and the line's times."""

    name: str
    framing: str
    port: Callable[[Clock], Port]
    sync: Callable[[], ModbusSerialClient | ModbusTcpClient]
    asynchronous: Callable[[], AsyncModbusSerialClient | AsyncModbusTcpClient]
    byte_s: float


def links(at: dict[str, Any]) -> Iterator[Link]:
    """The links of a server.

    Parameters
    ----------
    at : dict
        Its addresses.
    """
    for baud in BAUDS:
        path, options = at["serial"][str(baud)], {"baudrate": baud, "timeout": PATIENCE_S, "retries": 0}
        yield Link(
            f"RTU at {baud} baud",
            "rtu",
            functools.partial(SerialPort, path, baud=baud),
            functools.partial(ModbusSerialClient, path, **options),
            functools.partial(AsyncModbusSerialClient, path, **options),
            BITS_A_BYTE / baud,
        )
    options = {"port": at["tcp_port"], "timeout": PATIENCE_S, "retries": 0}
    yield Link(
        "TCP on this machine",
        "tcp",
        functools.partial(TcpPort, "127.0.0.1", at["tcp_port"]),
        functools.partial(ModbusTcpClient, "127.0.0.1", **options),
        functools.partial(AsyncModbusTcpClient, "127.0.0.1", **options),
        0.0,
    )


def rows(seconds: float, tell: Callable[[str], None]) -> list[Row]:
    """Polling on two baud rates and on TCP.

    Parameters
    ----------
    seconds : float
        Of each measurement [s].
    tell : callable
        Told what comes next.
    """
    found = []
    with server() as at, tempfile.TemporaryDirectory() as folder:
        for link in links(at):
            tell(f"polling: {link.name}")
            timing, clock = Timing(PATIENCE_S, PATIENCE_S, byte_s=link.byte_s), Clock()
            line = Line("bus", link.port(clock), clock, timing)
            line.open()
            ours = counted(functools.partial(read_and_forget, line, link.framing), seconds)
            line.close()
            peer = asyncio.run(bare_async(link.asynchronous, seconds))
            sync = bare_sync(link.sync(), seconds)
            logged = whole(link.port(clock), link.framing, timing, clock, seconds, Path(folder))
            note = f"pymodbus' asynchronous client, one question after the other; its synchronous one {sync:.0f}/s"
            found.append(Row(TOPIC, f"{link.name}, the line alone", ours, peer, "1/s", True, note=note))
            words = "a worker that polls as fast as it can, every byte and reading written to a run"
            found.append(Row(TOPIC, f"{link.name}, run log and all", logged, peer, "1/s", True, note=words))
    return found


def read_and_forget(line: Line, framing: str) -> None:
    """One question on our line; what the log would keep is dropped.

    Parameters
    ----------
    line : Line
        Open.
    framing : str
        ``rtu`` or ``tcp``.
    """
    modbus.exchange(line, framing, REQUEST)
    line.take_events()
