"""Serial lines of the virtual bench: pseudo-terminals, paced to a baud rate."""

from __future__ import annotations

import contextlib
import fcntl
import os
import struct
import termios
import tty
from collections.abc import Callable
from pathlib import Path

from rig.readings import NS
from rig.virtual.cables.loop import Loop
from rig.virtual.cables.wires import READ_BYTES, Receive

AT_ONCE_S = 0.002  # of the wall: bytes whose times are nearer than this are written together
UNREAD_BYTES = 3000  # a terminal holds 4096 bytes that nobody has read
MOST_BACKLOG = 65536


class PtyWire:
    """A serial line: a pseudo-terminal behind a symbolic link that stays when the cable is pulled and put back.

    `byte_s`: time of one byte on the wire, on the bench's clock [s]; 0 when not paced.
    `baud`: the devices'; a caller who sets another one reads and writes garbage, unless the line is not paced [1/s].
    """

    def __init__(self, loop: Loop, link: Path, byte_s: float, baud: int, receive: Receive) -> None:
        self.loop, self.link, self.receive = loop, link, receive
        self._speed: int | None = getattr(termios, f"B{baud}", None) if byte_s > 0.0 else None
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
        if self._speed is not None:
            settings = termios.tcgetattr(self._slave)
            settings[4] = settings[5] = self._speed
            termios.tcsetattr(self._slave, termios.TCSANOW, settings)
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
        """Send byte after byte at the line's pace. `from_ns`: when to begin; now, when that is past [ns]."""
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

    def _heard(self, data: bytes) -> bytes:
        """What the other end makes of bytes: a terminal carries them at any speed, a real line does not."""
        if self._speed is None or termios.tcgetattr(self._slave)[4] == self._speed:
            return data
        return bytes(byte * 29 + 0x5B & 0xFF for byte in data)

    def _delivery(self, data: bytes) -> Callable[[], None]:
        pulled = self._pulled
        return lambda: self._deliver(data, pulled)

    def _deliver(self, data: bytes, pulled: int) -> None:
        if pulled == self._pulled:
            self._backlog += self._heard(data)
            self.flush()
            if self._byte_ns > 0.0:  # a line without memory: what nobody reads is lost; a USB device keeps it
                self._backlog.clear()

    def _read(self) -> None:
        try:
            data = self._heard(os.read(self._master, READ_BYTES))
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
