"""The cables of the virtual bench: pseudo-terminals and loopback sockets, paced, and pulled out and put back."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import struct
import termios
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from rig.readings import NS
from rig.virtual.loop import Loop

HOST = "127.0.0.1"
AT_ONCE_S = 0.002  # of the wall: bytes whose times are nearer than this are written together
UNREAD_BYTES = 3000  # a terminal holds 4096 bytes that nobody has read
MOST_BACKLOG = 65536
MOST_CALLERS = 8
MOST_SEND_S = 1.0  # of the wall: a caller that does not read for so long is cut off
READ_BYTES = 4096

# Called with who sent (0 on a serial line), what, and when the last byte has crossed the wire [ns]: now, or so soon
# that waiting for it would only cost time.
Receive = Callable[[int, bytes, int], None]


class Wire(Protocol):
    """A cable: what the bus sends goes to one caller, what callers send goes to the bus."""

    plugged: bool

    def plug(self) -> None:
        """Put the cable in."""

    def unplug(self) -> None:
        """Pull the cable; what is on its way is lost."""

    def send(self, caller: int, data: bytes, from_ns: int = 0) -> bool:
        """Send, and return whether there was room.

        Parameters
        ----------
        caller : int
            Who gets it [-].
        data : bytes
            What to send.
        from_ns : int
            When to begin; now, when that is past [ns].
        """

    def forget_backlog(self) -> None:
        """Throw away what nobody has read yet."""

    def address(self) -> dict[str, str | int]:
        """How a caller reaches the wire."""


class PtyWire:
    """A serial line: a pseudo-terminal behind a symbolic link that stays when the cable is pulled and put back.

    Parameters
    ----------
    loop : Loop
        Whose thread does the work.
    link : Path
        The symbolic link.
    byte_s : float
        Time of one byte on the wire, on the bench's clock [s]; 0 when not paced.
    receive : callable
        Gets what comes.
    """

    def __init__(self, loop: Loop, link: Path, byte_s: float, receive: Receive) -> None:
        self.loop, self.link, self.receive = loop, link, receive
        self.plugged = False
        self.path = ""
        self._byte_ns = byte_s * NS
        self._master = self._slave = -1
        self._in_free_ns = self._out_free_ns = 0.0
        self._backlog = bytearray()
        self._pulled = 0  # how often: what was on its way then does not arrive

    def plug(self) -> None:
        """Put the cable in: a new pseudo-terminal under the old name."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)  # kept open: without it reading fails between two callers
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._in_free_ns = self._out_free_ns = 0.0
        beside = self.link.with_name(f".{self.link.name}.new")
        beside.unlink(missing_ok=True)
        beside.symlink_to(self.path)
        beside.replace(self.link)
        self.loop.watch(self._master, self._read)
        self.plugged = True

    def unplug(self) -> None:
        """Pull the cable: the caller's terminal hangs up, and the name is gone."""
        if not self.plugged:
            return
        self.plugged = False
        self._pulled += 1
        self._backlog.clear()
        self.loop.forget(self._master)
        self.link.unlink(missing_ok=True)
        os.close(self._slave)
        os.close(self._master)

    def send(self, caller: int, data: bytes, from_ns: int = 0) -> bool:
        """Send byte after byte at the line's pace.

        Parameters
        ----------
        caller : int
            Always 0 [-].
        data : bytes
            What to send.
        from_ns : int
            When to begin; now, when that is past [ns].
        """
        if not self.plugged or len(self._backlog) + len(data) > MOST_BACKLOG:
            return False
        now_ns = self.loop.clock.now_ns()
        if self._byte_ns == 0.0:
            if from_ns <= now_ns:
                self._deliver(data, self._pulled)
            else:
                self.loop.at(from_ns, self._delivery(data))
            return True
        start_ns = max(float(now_ns), float(from_ns), self._out_free_ns)
        self._out_free_ns = start_ns + len(data) * self._byte_ns
        group = max(1, int(AT_ONCE_S * self.loop.clock.rate * NS / self._byte_ns))
        for first in range(0, len(data), group):
            part = data[first : first + group]
            self.loop.at(int(start_ns + (first + len(part)) * self._byte_ns), self._delivery(part))
        return True

    def forget_backlog(self) -> None:
        """Throw away what nobody has read yet."""
        self._backlog.clear()

    def address(self) -> dict[str, str | int]:
        """The symbolic link, and the terminal it points to at present."""
        return {"port": str(self.link), "terminal": self.path}

    def flush(self) -> None:
        """Write what waits, as far as the reader has made room."""
        if not self._backlog or not self.plugged:
            return
        unread = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, b"\0\0\0\0"))[0]
        room = max(0, UNREAD_BYTES - unread)
        with contextlib.suppress(BlockingIOError):
            written = os.write(self._master, bytes(self._backlog[:room])) if room else 0
            del self._backlog[:written]

    def _delivery(self, data: bytes) -> Callable[[], None]:
        pulled = self._pulled
        return lambda: self._deliver(data, pulled)

    def _deliver(self, data: bytes, pulled: int) -> None:
        if pulled == self._pulled:
            self._backlog += data
            self.flush()
            if self._byte_ns > 0.0:  # a line without memory: what nobody reads is lost; a USB device keeps it
                self._backlog.clear()

    def _read(self) -> None:
        try:
            data = os.read(self._master, READ_BYTES)
        except OSError:
            return
        now_ns = float(self.loop.clock.now_ns())
        self._in_free_ns = max(now_ns, self._in_free_ns) + len(data) * self._byte_ns
        pulled, whole_ns = self._pulled, int(self._in_free_ns)

        def arrive() -> None:
            if pulled == self._pulled:
                self.receive(0, data, whole_ns)

        if whole_ns - now_ns < AT_ONCE_S * self.loop.clock.rate * NS:
            arrive()
        else:
            self.loop.at(whole_ns, arrive)


class SocketWire:
    """A network cable: a loopback socket on a port of the system's choice, kept when the cable is put back.

    Parameters
    ----------
    loop : Loop
        Whose thread does the work.
    receive : callable
        Gets what comes.
    """

    def __init__(self, loop: Loop, receive: Receive) -> None:
        self.loop, self.receive = loop, receive
        self.plugged = False
        self.port = 0
        self._listener: socket.socket | None = None
        self._callers: dict[int, socket.socket] = {}
        self._next = 1

    def plug(self) -> None:
        """Put the cable in: listen."""
        self._listener = socket.create_server((HOST, self.port), backlog=MOST_CALLERS)
        self._listener.setblocking(False)
        self.port = self._listener.getsockname()[1]
        self.loop.watch(self._listener, self._accept)
        self.plugged = True

    def unplug(self) -> None:
        """Pull the cable: every connection ends, and none is taken."""
        if self._listener is None:
            return
        self.plugged = False
        self.loop.forget(self._listener)
        self._listener.close()
        self._listener = None
        for caller in list(self._callers):
            self._hang_up(caller)

    def send(self, caller: int, data: bytes, from_ns: int = 0) -> bool:
        """Send in one piece.

        Parameters
        ----------
        caller : int
            Number of the connection; 0 for all [-].
        data : bytes
            What to send.
        from_ns : int
            When; now, when that is past [ns].
        """
        if from_ns > self.loop.clock.now_ns():
            self.loop.at(from_ns, lambda: self._send(caller, data))
            return True
        return self._send(caller, data)

    def _send(self, caller: int, data: bytes) -> bool:
        if caller == 0:
            sent = [self._send(known, data) for known in list(self._callers)]
            return all(sent)
        connection = self._callers.get(caller)
        if connection is None:
            return False
        try:
            connection.settimeout(MOST_SEND_S)
            connection.sendall(data)
            connection.setblocking(False)
        except OSError:
            self._hang_up(caller)
            return False
        return True

    def forget_backlog(self) -> None:
        """Nothing waits here."""

    def address(self) -> dict[str, str | int]:
        """Host and port."""
        return {"host": HOST, "tcp_port": self.port}

    def flush(self) -> None:
        """Nothing waits here."""

    def _accept(self) -> None:
        if self._listener is None:
            return
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        if len(self._callers) >= MOST_CALLERS:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        caller = self._next
        self._next += 1
        self._callers[caller] = connection
        self.loop.watch(connection, lambda: self._read(caller))

    def _read(self, caller: int) -> None:
        connection = self._callers.get(caller)
        if connection is None:
            return
        try:
            data = connection.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self.receive(caller, data, self.loop.clock.now_ns())
        else:
            self._hang_up(caller)

    def _hang_up(self, caller: int) -> None:
        connection = self._callers.pop(caller, None)
        if connection is not None:
            self.loop.forget(connection)
            connection.close()
