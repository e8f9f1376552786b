"""A serial port, through pyserial: the only module that knows it."""

from __future__ import annotations

import contextlib
import errno
import select
import sys

import serial

try:
    from termios import error as TermiosError  # noqa: N812  pyserial lets it through; it is no OSError
except ImportError:  # Windows

    class TermiosError(Exception):  # type: ignore[no-redef]
        """There is no terminal to fail."""


from rig.clock import Clock
from rig.lines.port import LostError
from rig.readings import NS

WRITE_S = 5.0  # real time after which a device that takes nothing counts as lost
PORT_ERRORS = (serial.SerialException, OSError, TermiosError)


class SerialPort:
    """A serial port that no other program may open meanwhile.

    `exclusive`: whether no other program may have it; the watchdog of a controller that hangs goes without.
    """

    def __init__(
        self, path: str, clock: Clock, baud: int = 9600, parity: str = "N", stop_bits: int = 1, data_bits: int = 8
    ) -> None:
        self.path, self.clock = path, clock
        self.exclusive = sys.platform != "win32"
        self.baud, self.parity, self.stop_bits, self.data_bits = baud, parity, stop_bits, data_bits
        self._serial: serial.Serial | None = None

    def open(self) -> None:
        """Open the port for this program alone, with the driver's shortest latency where it has one."""
        self.close()
        try:
            self._serial = serial.Serial(
                self.path,
                baudrate=self.baud,
                bytesize=self.data_bits,
                parity=self.parity,
                stopbits=self.stop_bits,
                timeout=0,
                write_timeout=WRITE_S,
                exclusive=self.exclusive or None,
            )
        except (*PORT_ERRORS, ValueError) as error:
            raise LostError(f"{self.path} cannot be opened: {_why(error)}") from None
        with contextlib.suppress(Exception):  # a pty or a port without the setting
            self._serial.set_low_latency_mode(True)
        with contextlib.suppress(*PORT_ERRORS):
            self._serial.reset_input_buffer()

    def close(self) -> None:
        """Close the port."""
        if self._serial is not None:
            with contextlib.suppress(*PORT_ERRORS):
                self._serial.close()
            self._serial = None

    def write(self, data: bytes) -> int:
        """Send all bytes."""
        port = self._opened()
        time_ns = self.clock.now_ns()
        try:
            port.write(data)
        except PORT_ERRORS as error:
            raise LostError(f"{self.path}: writing failed: {_why(error)}") from None
        return time_ns

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """Wait for bytes."""
        port = self._opened()
        wait_s = max(0.0, self.clock.real_s((until_ns - self.clock.now_ns()) / NS))
        try:
            data = _read_posix(port, wait_s) if sys.platform != "win32" else _read_windows(port, wait_s)
        except (*PORT_ERRORS, TypeError) as error:  # TypeError: closed while reading
            raise LostError(f"{self.path}: reading failed: {_why(error)}") from None
        return self.clock.now_ns(), data

    def _opened(self) -> serial.Serial:
        if self._serial is None:
            raise LostError(f"{self.path} is not open")
        return self._serial


def _read_posix(port: serial.Serial, wait_s: float) -> bytes:
    """Wait outside pyserial: setting its timeout configures the whole port anew, each time."""
    if not select.select([port.fileno()], [], [], wait_s)[0]:
        return b""
    return port.read(max(1, port.in_waiting))


def _read_windows(port: serial.Serial, wait_s: float) -> bytes:
    port.timeout = wait_s
    data = port.read(1)
    return data + port.read(port.in_waiting) if data else data


def _why(error: Exception) -> str:
    """What the system's words mean at a bench, and what to do."""
    code = getattr(error, "errno", None)
    text = str(error)
    if code == errno.ENOENT or "No such file" in text:
        return "there is no such port; is the cable plugged in? (spinbench doctor lists the ports that are there)"
    if code == errno.EACCES or "Permission denied" in text:
        return "no permission; add yourself to the group that owns it (often dialout) and log in again"
    if code in (errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY) or "exclusively lock" in text:
        return "another program has it open; close that program"
    if code in (errno.EIO, errno.ENXIO, errno.ENODEV):
        return f"the device was unplugged, or its adapter has failed ({text})"
    if "returned no data" in text:
        return "the device was unplugged, or a second program reads the same port"
    return text
