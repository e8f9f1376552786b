"""Network cables of the virtual bench: loopback sockets."""

from __future__ import annotations

import socket

from rig.virtual.cables.loop import Loop
from rig.virtual.cables.wires import READ_BYTES, Receive

HOST = "127.0.0.1"
MOST_CALLERS = 8
MOST_SEND_S = 1.0  # of the wall: a caller that does not read for so long is cut off


class SocketWire:
    """A network cable: a loopback socket on a port of the system's choice, kept when the cable is put back."""

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
        """Send in one piece. `caller`: number of the connection; 0 for all [-]."""
        if from_ns > self.loop.clock.now_ns():

            def later() -> None:
                self._send(caller, data)

            self.loop.at(from_ns, later)
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
