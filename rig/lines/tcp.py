"""A TCP socket as a port."""

from __future__ import annotations

import contextlib
import select
import socket

from rig.clock import Clock
from rig.lines.port import LostError
from rig.readings import NS

CONNECT_S = 3.0  # real time: the other end is a machine on the same bench


class TcpPort:
    """A connection to a device or a gateway."""

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        self.host, self.port, self.clock = host, port, clock
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect, without Nagle's delay."""
        self.close()
        try:
            self._socket = socket.create_connection((self.host, self.port), timeout=CONNECT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except (OSError, UnicodeError) as error:  # UnicodeError: a name that no host can have
            raise LostError(
                f"{self.host}:{self.port} does not take a connection ({error}): is the device on, its address right, "
                "and no other program connected to it?"
            ) from None

    def close(self) -> None:
        """Disconnect."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None

    def write(self, data: bytes) -> int:
        """Send all bytes."""
        connection = self._connected()
        time_ns = self.clock.now_ns()
        try:
            connection.sendall(data)
        except OSError as error:
            raise LostError(f"{self.host}:{self.port}: the connection broke ({error})") from None
        return time_ns

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """Wait for bytes."""
        connection = self._connected()
        wait_s = max(0.0, self.clock.real_s((until_ns - self.clock.now_ns()) / NS))
        try:
            ready, _, _ = select.select([connection], [], [], wait_s)
            if not ready:
                return self.clock.now_ns(), b""
            data = connection.recv(65536)
        except (OSError, ValueError) as error:
            raise LostError(f"{self.host}:{self.port}: the connection broke ({error})") from None
        if not data:
            raise LostError(f"{self.host}:{self.port}: the device closed the connection")
        return self.clock.now_ns(), data

    def _connected(self) -> socket.socket:
        if self._socket is None:
            raise LostError(f"{self.host}:{self.port} is not connected")
        return self._socket
