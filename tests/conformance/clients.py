"""Other people's Modbus clients behind one face: RTU on a serial port, or TCP.

A client is made for a `Place`, and has `read(unit, table, address, count)` and `write(unit, address, values, many)`.
It raises `Refused` for a Modbus exception, `Silent` where nobody answered, and `Missing` when it is not on the machine
or not made for the line.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import socket
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import serial

TIMEOUT_S = 2.0  # of a machine that is busy
GO = Path(__file__).parent / "go"


class Refused(Exception):  # noqa: N818
    """The device answered with an exception."""

    def __init__(self, code):
        super().__init__(f"exception {code}")
        self.code = code


class Silent(Exception):  # noqa: N818
    """Nobody answered."""


class Missing(Exception):  # noqa: N818
    """The client is not on this machine, or does not speak over this line."""


@dataclass(frozen=True)
class Place:
    """Where the devices are: a serial port at 19200 baud without parity, or a TCP port of this machine."""

    port: str = ""
    tcp_port: int = 0

    @property
    def is_rtu(self):
        return bool(self.port)

    def serial(self):
        return serial.Serial(self.port, 19200, timeout=TIMEOUT_S)


class Pymodbus:
    def __init__(self, place):
        from pymodbus.client import ModbusSerialClient, ModbusTcpClient

        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
        if place.is_rtu:
            self.client = ModbusSerialClient(place.port, baudrate=19200, timeout=TIMEOUT_S, retries=0)
        else:
            self.client = ModbusTcpClient("127.0.0.1", port=place.tcp_port, timeout=TIMEOUT_S, retries=0)
        self.client.connect()

    def read(self, unit, table, address, count):
        ask = {"holding": "read_holding_registers", "input": "read_input_registers", "coils": "read_coils"}
        ask["discrete"] = "read_discrete_inputs"
        found = self._said(lambda: getattr(self.client, ask[table])(address, count=count, device_id=unit))
        return [int(bit) for bit in found.bits[:count]] if table in ("coils", "discrete") else found.registers

    def write(self, unit, address, values, many):
        if many:
            self._said(lambda: self.client.write_registers(address, values, device_id=unit))
        else:
            self._said(lambda: self.client.write_register(address, values[0], device_id=unit))

    def close(self):
        self.client.close()

    def _said(self, ask):
        from pymodbus.exceptions import ConnectionException, ModbusIOException

        try:
            if not self.client.connected:
                self.client.connect()
            found = ask()
        except (ModbusIOException, ConnectionException):
            raise Silent from None
        if found.isError():
            raise Refused(found.exception_code)
        return found


class ModbusTk:
    def __init__(self, place):
        try:
            from modbus_tk import modbus_rtu, modbus_tcp
        except ImportError:
            raise Missing from None
        if place.is_rtu:
            self.client = modbus_rtu.RtuMaster(place.serial())
        else:
            self.client = modbus_tcp.TcpMaster("127.0.0.1", place.tcp_port)
        self.client.set_timeout(TIMEOUT_S)

    def read(self, unit, table, address, count):
        return list(self._said(unit, {"coils": 1, "discrete": 2, "holding": 3, "input": 4}[table], address, count))

    def write(self, unit, address, values, many):
        self._said(unit, 16 if many else 6, address, output_value=values if many else values[0])

    def close(self):
        self.client.close()

    def _said(self, *question, **more):
        from modbus_tk.exceptions import ModbusInvalidResponseError
        from modbus_tk.modbus import ModbusError

        try:
            return self.client.execute(*question, **more)
        except ModbusError as error:
            raise Refused(error.get_exception_code()) from None
        except (TimeoutError, ModbusInvalidResponseError):  # over RTU: too few bytes, none
            self.client.close()
            raise Silent from None


class MinimalModbus:
    """RTU alone."""

    def __init__(self, place):
        try:
            import minimalmodbus
        except ImportError:
            raise Missing from None
        if not place.is_rtu:
            raise Missing
        self.module, self.serial = minimalmodbus, place.serial()

    def read(self, unit, table, address, count):
        with self._said(unit) as device:
            if table in ("coils", "discrete"):
                return device.read_bits(address, count, functioncode=1 if table == "coils" else 2)
            return device.read_registers(address, count, functioncode=3 if table == "holding" else 4)

    def write(self, unit, address, values, many):
        with self._said(unit) as device:
            if many:
                device.write_registers(address, values)
            else:
                device.write_register(address, values[0], functioncode=6)

    def close(self):
        self.serial.close()

    def _said(self, unit):
        return _Minimal(self.module, self.module.Instrument(self.serial, unit))


class _Minimal:
    def __init__(self, module, device):
        self.module, self.device = module, device

    def __enter__(self):
        return self.device

    def __exit__(self, kind, error, _):
        if isinstance(error, self.module.NoResponseError):
            raise Silent from None
        if isinstance(error, self.module.SlaveReportedException):
            words = {"function": 1, "data address": 2, "data value": 3}
            code = next((code for word, code in words.items() if f"illegal {word}" in str(error)), 0)
            raise Refused(code or int(re.search(r"\d+", str(error))[0])) from None


class UModbus:
    def __init__(self, place):
        try:
            if place.is_rtu:
                from umodbus.client.serial import rtu as way
            else:
                from umodbus.client import tcp as way
        except ImportError:
            raise Missing from None
        self.way = way
        self.to = place.serial() if place.is_rtu else socket.create_connection(("127.0.0.1", place.tcp_port))
        if not place.is_rtu:
            self.to.settimeout(TIMEOUT_S)

    def read(self, unit, table, address, count):
        ask = {"holding": "read_holding_registers", "input": "read_input_registers", "coils": "read_coils"}
        ask["discrete"] = "read_discrete_inputs"
        return self._said(getattr(self.way, ask[table])(unit, address, count))

    def write(self, unit, address, values, many):
        ask = self.way.write_multiple_registers if many else self.way.write_single_register
        self._said(ask(unit, address, values if many else values[0]))

    def close(self):
        self.to.close()

    def _said(self, question):
        from umodbus.exceptions import ModbusError

        try:
            return self.way.send_message(question, self.to)
        except ModbusError as error:
            raise Refused(error.error_code) from None
        except (TimeoutError, ValueError):  # over RTU: no bytes are too few
            raise Silent from None


class Program:
    """A program that is started for each question: its words are read."""

    def __init__(self, place):
        self.place = place

    def run(self, *command):
        done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
        return done.stdout + done.stderr

    def close(self):
        """Nothing stays open."""


class Mbpoll(Program):
    REFUSALS = ("Illegal function", "Illegal data address", "Illegal data value")

    def __init__(self, place):
        super().__init__(place)
        if shutil.which("mbpoll") is None:
            raise Missing
        line = ["-m", "rtu", "-b", "19200", "-P", "none"] if place.is_rtu else ["-m", "tcp", "-p", str(place.tcp_port)]
        self.line, self.where = line, place.port or "127.0.0.1"

    def read(self, unit, table, address, count):
        kind = {"coils": "0", "discrete": "1", "input": "3", "holding": "4"}[table]
        text = self._said(unit, kind, address, ["-c", str(count), "-1"], [])
        found = re.findall(r"^\[(\d+)\]:\s+(\d+)", text, re.MULTILINE)
        assert [int(at) for at, _ in found] == list(range(address, address + count)), text
        return [int(value) for _, value in found]

    def write(self, unit, address, values, many):
        assert many == (len(values) > 1)  # it chooses the function by the number
        assert "Written" in self._said(unit, "4", address, [], [str(value) for value in values])

    def _said(self, unit, kind, address, more, values):
        command = ["mbpoll", *self.line, "-0", "-a", str(unit), "-t", kind, "-r", str(address), "-o", str(TIMEOUT_S)]
        text = self.run(*command, *more, self.where, *values)
        for code, words in enumerate(self.REFUSALS, 1):
            if words in text:
                raise Refused(code)
        if "timed out" in text:
            raise Silent
        return text


class GoModbus(Program):
    """simonvetter/modbus, by a small program that is built where Go is there."""

    def __init__(self, place):
        super().__init__(place)
        if shutil.which("go") is None:
            raise Missing
        self.folder = tempfile.TemporaryDirectory(prefix="conformance-")
        self.program = Path(self.folder.name) / "client"
        plain = os.environ | {"CGO_ENABLED": "0"}  # it needs no C compiler
        done = subprocess.run(
            ["go", "build", "-o", self.program, "."], cwd=GO, env=plain, capture_output=True, check=False
        )
        if done.returncode:
            raise Missing
        self.url = f"rtu://{place.port}" if place.is_rtu else f"tcp://127.0.0.1:{place.tcp_port}"

    def read(self, unit, table, address, count):
        return [int(word) for word in self._said(unit, table, address, count).split()]

    def write(self, unit, address, values, many):
        self._said(unit, "many" if many else "one", address, *values)

    def _said(self, unit, *question):
        text = self.run(self.program, self.url, str(unit), *map(str, question))
        for code, words in enumerate(("illegal function", "illegal data address", "illegal data value"), 1):
            if words in text:
                raise Refused(code)
        if "timed out" in text:
            raise Silent
        assert text.startswith("ok"), text
        return text.removeprefix("ok")
