"""A Modbus RTU device on a pseudo-terminal, written without the rig's code: the other end of the cable in tests."""

from __future__ import annotations

import os
import pty
import select
import termios
import threading
import time
import tty

SPEEDS = {getattr(termios, f"B{baud}"): baud for baud in (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)}
ADAM = {0: 0, 1: 0, 2: 0, 3: 0, 200: 0x31, 201: 0x31, 202: 0x31, 203: 0x31}  # 4-20 mA
ADAM |= {210: 0x4024, 211: 0, 212: 0x0100, 213: 0, 214: 1, 215: 0}


def crc(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return value.to_bytes(2, "little")


def rtu(body: bytes) -> bytes:
    """A frame with its checksum."""
    return body + crc(body)


class ModbusPeer:
    """Registers of some units behind a pty.

    `baud`: answers only where the port is set to it; elsewhere `garbage`, if any. `byte_s`: pace of the wire.
    `delay_s`: before each answer.
    `read_only`: registers that refuse a write. `writes`: (monotonic seconds, unit, register, value).
    """

    def __init__(self, units, baud=None, garbage=b"", byte_s=10 / 19200, delay_s=0.0, read_only=()):
        self.units, self.baud, self.garbage = units, baud, garbage
        self.byte_s, self.delay_s, self.read_only = byte_s, delay_s, set(read_only)
        self.writes: list[tuple[float, int, int, int]] = []
        self.answers = 0
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self):
        self._ending.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def wait_for_write(self, register, value, wait_s):
        """The monotonic time at which a register was written to a value; None when it was not in time."""
        until_s = time.monotonic() + wait_s
        while time.monotonic() < until_s:
            for at_s, _, where, what in list(self.writes):
                if (where, what) == (register, value):
                    return at_s
            time.sleep(0.01)
        return None

    def _serve(self):
        buffer = b""
        while not self._ending.is_set():
            if not select.select([self._master], [], [], 0.05)[0]:
                buffer = b""  # silence ends a frame
                continue
            buffer += os.read(self._master, 1024)
            length = 9 + buffer[6] if len(buffer) > 6 and buffer[1] == 16 else 8
            if len(buffer) < length:
                continue
            frame, buffer = buffer[:length], b""
            answer = self._answer(frame)
            time.sleep(self.delay_s + (len(frame) + len(answer)) * self.byte_s)
            if answer:
                self.answers += 1
                os.write(self._master, answer)

    def _answer(self, frame):
        if self.baud is not None and SPEEDS.get(termios.tcgetattr(self._slave)[5]) != self.baud:
            return self.garbage
        if crc(frame[:-2]) != frame[-2:] or frame[0] not in self.units:
            return b""
        unit, function = frame[0], frame[1]
        registers = self.units[unit]
        first, count = int.from_bytes(frame[2:4], "big"), int.from_bytes(frame[4:6], "big")
        if function == 6:
            if first not in registers or first in self.read_only:
                return self._framed(bytes([unit, 0x86, 2]))
            registers[first] = count
            self.writes.append((time.monotonic(), unit, first, count))
            return frame
        if function not in (3, 4) or any(first + i not in registers for i in range(count)):
            return self._framed(bytes([unit, function | 0x80, 2]))
        data = b"".join(registers[first + i].to_bytes(2, "big") for i in range(count))
        return self._framed(bytes([unit, function, len(data)]) + data)

    @staticmethod
    def _framed(body):
        return body + crc(body)
