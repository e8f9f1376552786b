"""libmodbus by its public interface: a client, and a device that misbehaves at some registers."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import pty
import select
import socket
import threading
import time
import tty

from tests.conformance.clients import TIMEOUT_S, Missing, Refused, Silent
from tests.modbus_peer import crc

ETIMEDOUT, ENOBASE = 110, 112345678  # of errno, and of MODBUS_ENOBASE in modbus.h
MOST_BYTES = 260
BUSY = 6
REGISTERS = 200
# what the device does when it is asked for a register: everywhere else it answers as it should
BUSY_AT, OTHER_AT, SLOW_AT, BYTES_AT, LONGER_AT, SHORTER_AT, MISSING_AT = 100, 101, 102, 103, 104, 105, 300
SLOW_S, BYTE_S = 0.5, 0.005
WIRE_S = 20 * 10 / 19200  # of a question and its answer, which a pty does not take


class Mapping(ctypes.Structure):
    """modbus_mapping_t."""

    _fields_ = (
        *((name, ctypes.c_int) for name in ("nb_bits", "start_bits", "nb_input_bits", "start_input_bits")),
        *((name, ctypes.c_int) for name in ("nb_inputs", "start_inputs", "nb_registers", "start_registers")),
        ("bits", ctypes.POINTER(ctypes.c_uint8)),
        ("input_bits", ctypes.POINTER(ctypes.c_uint8)),
        ("inputs", ctypes.POINTER(ctypes.c_uint16)),
        ("registers", ctypes.POINTER(ctypes.c_uint16)),
    )


def library():
    """The library; raises `Missing`."""
    name = ctypes.util.find_library("modbus")
    if name is None:
        raise Missing
    found = ctypes.CDLL(name, use_errno=True)
    found.modbus_new_rtu.restype = found.modbus_new_tcp.restype = ctypes.c_void_p
    found.modbus_new_rtu.argtypes = [ctypes.c_char_p, ctypes.c_int, ctypes.c_char, ctypes.c_int, ctypes.c_int]
    found.modbus_new_tcp.argtypes = [ctypes.c_char_p, ctypes.c_int]
    found.modbus_mapping_new.restype = ctypes.POINTER(Mapping)
    return found


class Libmodbus:
    """Its client."""

    def __init__(self, place):
        self.library = library()
        if place.is_rtu:
            made = self.library.modbus_new_rtu(place.port.encode(), 19200, b"N", 8, 1)
        else:
            made = self.library.modbus_new_tcp(b"127.0.0.1", place.tcp_port)
        self.context = ctypes.c_void_p(made)
        self.library.modbus_set_response_timeout(self.context, int(TIMEOUT_S), 0)
        self._said("modbus_connect")

    def read(self, unit, table, address, count):
        name = {"holding": "registers", "input": "input_registers", "coils": "bits", "discrete": "input_bits"}[table]
        found = ((ctypes.c_uint8 if "bits" in name else ctypes.c_uint16) * count)()
        self.library.modbus_set_slave(self.context, unit)
        self._said(f"modbus_read_{name}", address, count, found)
        return list(found)

    def write(self, unit, address, values, many):
        self.library.modbus_set_slave(self.context, unit)
        if many:
            self._said("modbus_write_registers", address, len(values), (ctypes.c_uint16 * len(values))(*values))
        else:
            self._said("modbus_write_register", address, values[0])

    def close(self):
        self.library.modbus_close(self.context)
        self.library.modbus_free(self.context)

    def _said(self, name, *arguments):
        if getattr(self.library, name)(self.context, *arguments) >= 0:
            return
        error = ctypes.get_errno()
        self.library.modbus_flush(self.context)
        if error == ETIMEDOUT:
            raise Silent
        if error > ENOBASE:
            raise Refused(error - ENOBASE)
        raise OSError(error, name)


def held(address):
    """What a register of the device holds: each another number."""
    return 7 * address + 1


class Device(threading.Thread):
    """A device of libmodbus, unit 3, on a pty (`path`) or at a port (`tcp_port`), until `end`."""

    unit = 3

    def __init__(self, framing):
        super().__init__(daemon=True)
        self.library, self.framing = library(), framing
        self.path, self.tcp_port, self.ends, self.ending = "", 0, [], threading.Event()
        self.mapping = self.library.modbus_mapping_new(0, 0, REGISTERS, REGISTERS)
        for address in range(REGISTERS):
            self.mapping.contents.registers[address] = self.mapping.contents.inputs[address] = held(address)
        if framing == "rtu":
            self.context = ctypes.c_void_p(self.library.modbus_new_rtu(b"/dev/null", 19200, b"N", 8, 1))
            self.ends = list(pty.openpty())
            tty.setraw(self.ends[1])
            self.path = os.ttyname(self.ends[1])
        else:
            self.context = ctypes.c_void_p(self.library.modbus_new_tcp(b"127.0.0.1", 0))
            self.listener = socket.create_server(("127.0.0.1", 0))
            self.tcp_port = self.listener.getsockname()[1]
        self.library.modbus_set_slave(self.context, self.unit)
        self.start()

    def end(self):
        self.ending.set()
        self.join()
        for end in self.ends:
            os.close(end)

    def run(self):
        file = self.ends[0] if self.ends else self._taken()
        if file is None:
            return
        self.library.modbus_set_socket(self.context, file)
        question = (ctypes.c_uint8 * MOST_BYTES)()
        while not self.ending.is_set():
            if not select.select([file], [], [], 0.02)[0]:
                continue
            length = self.library.modbus_receive(self.context, question)
            if length < 0 and self.framing == "tcp":
                return
            if length > 0:
                self._answer(file, question, length)

    def _taken(self):
        self.listener.settimeout(0.05)
        while not self.ending.is_set():
            try:
                self.connection = self.listener.accept()[0]
            except TimeoutError:
                continue
            self.connection.setblocking(True)
            return self.connection.fileno()
        return None

    def _answer(self, file, question, length):
        data = bytes(question[:length])
        body = data[7:] if self.framing == "tcp" else data[1:-2]
        address = int.from_bytes(body[1:3], "big")
        time.sleep(WIRE_S if self.framing == "rtu" else 0.0)
        if address == BUSY_AT:
            self.library.modbus_reply_exception(self.context, question, BUSY)
        elif address == OTHER_AT:
            self._tell(file, data[1] ^ 0xFF, self.unit + (self.framing == "rtu"), self._values(body), data[0])
        elif address == BYTES_AT:
            self._tell(file, data[1], self.unit, self._values(body), data[0], BYTE_S)
        elif address in (LONGER_AT, SHORTER_AT):
            more = 1 if address == LONGER_AT else -1
            self._tell(file, data[1], self.unit, self._values(body, more), data[0])
        else:
            time.sleep(SLOW_S if address == SLOW_AT else 0.0)
            self.library.modbus_reply(self.context, question, length, self.mapping)

    @staticmethod
    def _values(body, more=0):
        first, count = int.from_bytes(body[1:3], "big"), int.from_bytes(body[3:5], "big") + more
        return bytes([body[0], 2 * count]) + b"".join(held(first + i).to_bytes(2, "big") for i in range(count))

    def _tell(self, file, low, unit, body, high, byte_s=0.0):
        """A frame that libmodbus would not make, byte by byte where a byte takes time."""
        whole = bytes([unit]) + body
        number = bytes([high, low]) + b"\0\0" + len(whole).to_bytes(2, "big")
        frame = number + whole if self.framing == "tcp" else whole + crc(whole)
        if not byte_s:
            os.write(file, frame)
            return
        for byte in frame:
            os.write(file, bytes([byte]))
            time.sleep(byte_s)
