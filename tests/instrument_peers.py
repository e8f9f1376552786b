"""What tests of the instruments need of the other end: a peer, their files by name, frames as devices write them."""

import os
import pty
import select
import struct
import threading
import time
import tty

from configs import read_source
from rig.bench.instrument import FOLDER, instrument_of
from rig.instruments import lutron
from rig.instruments.codecs import edge_frames


class Peer(threading.Thread):
    """The far end of a pty, at `path`.

    `reply`: what it sends for a request: bytes, nothing, or pairs of a delay [s] and bytes.
    `size`: bytes of each request, where a busy machine may hand over two at once; 0 where one is taken as it comes.
    """

    def __init__(self, reply, size=0):
        super().__init__(daemon=True)
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        self.reply, self.size, self.ended = reply, size, threading.Event()
        self.requests = []
        self.start()

    def send(self, data):
        os.write(self.master, data)

    def run(self):
        pending = []  # (when, bytes)
        while not self.ended.is_set():
            now = time.monotonic()
            for item in [item for item in pending if item[0] <= now]:
                pending.remove(item)
                self.send(item[1])
            if select.select([self.master], [], [], 0.001)[0]:
                for request in self._apart(os.read(self.master, 512)):
                    self.requests.append(request)
                    answer = self.reply(request) or []
                    pairs = [(0.0, answer)] if isinstance(answer, bytes) else answer
                    pending += [(time.monotonic() + delay, data) for delay, data in pairs]
                pending.sort(key=lambda item: item[0])

    def _apart(self, came):
        whole = self.size and len(came) % self.size == 0
        return [came[i : i + self.size] for i in range(0, len(came), self.size)] if whole else [came]

    def end(self):
        self.ended.set()
        self.join()
        os.close(self.master)
        os.close(self.slave)


def read_instrument(name):
    """The settings in a shipped instrument file."""
    path = FOLDER / f"{name}.toml"
    return instrument_of(read_source(path), str(path))


def lutron_bytes(frame, decimals):
    """A frame of a Lutron meter."""
    digits = round(abs(frame.value) * 10**decimals)
    text = f"4{frame.display}{frame.unit_code}{int(frame.value < 0.0)}{decimals}{digits:08d}"
    return bytes([lutron.FIRST_BYTE]) + text.encode("ascii") + bytes([lutron.LAST_BYTE])


def edge_bytes(frame):
    """A frame of the edge counter."""
    head = (edge_frames.SYNC, frame.kind, frame.sequence, frame.flags, frame.ticks, frame.edges)
    body = struct.pack("<BBBBIB", *head)
    return body + bytes([edge_frames.crc8(body)])
