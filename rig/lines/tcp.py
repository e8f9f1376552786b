"""A TCP socket as a port."""

from __future__ import annotations

import contextlib
import select
import socket

from rig.clock import Clock
from rig.lines.port import LostError
from rig.readings import NS

CONNECT_S = 3.0  # real time: the other end is a machine on the same bench
MOST_UNANSWERED = 3  # questions in a row; then the connection is made anew


class TcpPort:
    """A connection to a device or a gateway.

    One that closes the connection after its first answer is connected to again, as the device that it was, and a
    question that met the closing is sent again, once. From then on each question has a connection of its own. A
    connection that breaks later is lost. One over which nothing comes any more is made anew before the next question:
    a gateway may have forgotten it, and after a pulled cable the system repeats what it has sent ever more rarely.
    """

    def __init__(self, host: str, port: int, clock: Clock) -> None:
        self.host, self.port, self.clock = host, port, clock
        self._socket: socket.socket | None = None
        self._answers = 0  # on this connection
        self._question, self._is_answered = b"", False
        self._closes = False  # after each answer
        self._unanswered = 0  # questions, since bytes came last

    def open(self) -> None:
        """Connect, without Nagle's delay."""
        self.close()
        self._answers = self._unanswered = 0
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
        if (self._closes and self._answers) or self._unanswered >= MOST_UNANSWERED:
            self.open()
        self._question, self._is_answered = data, False
        self._unanswered += 1
        return self._send()

    def _send(self) -> int:
        connection = self._connected()
        time_ns = self.clock.now_ns()
        try:
            connection.sendall(self._question)
        except OSError as error:
            if self._answers == 1:
                return self._send_again()
            raise LostError(f"{self.host}:{self.port}: the connection broke ({error})") from None
        return time_ns

    def _send_again(self) -> int:
        """Over a new connection, the old one being closed after an answer."""
        self._closes = True
        self.open()
        return self._send()

    def read(self, until_ns: int) -> tuple[int, bytes]:
        """Wait for bytes."""
        while True:
            connection = self._connected()
            found = self._received(connection, until_ns)
            if found is not None:
                return found
            self._send_again()

    def _received(self, connection: socket.socket, until_ns: int) -> tuple[int, bytes] | None:
        """What came; None where the device has closed the connection after the answer to an earlier question."""
        wait_s = max(0.0, self.clock.real_s((until_ns - self.clock.now_ns()) / NS))
        try:
            ready, _, _ = select.select([connection], [], [], wait_s)
            if not ready:
                return self.clock.now_ns(), b""
            data = connection.recv(65536)
        except (OSError, ValueError) as error:
            if self._answers == 1 and not self._is_answered:
                return None
            raise LostError(f"{self.host}:{self.port}: the connection broke ({error})") from None
        if not data and self._answers == 1:
            self._closes = True
            return (self.clock.now_ns(), b"") if self._is_answered else None
        if not data:
            hint = (
                ""
                if self._answers
                else " without an answer: it may bear few clients; is another program connected to it?"
            )
            raise LostError(f"{self.host}:{self.port}: the device closed the connection{hint}")
        self._answers += not self._is_answered
        self._is_answered, self._unanswered = True, 0
        return self.clock.now_ns(), data

    def _connected(self) -> socket.socket:
        if self._socket is None:
            raise LostError(f"{self.host}:{self.port} is not connected")
        return self._socket
