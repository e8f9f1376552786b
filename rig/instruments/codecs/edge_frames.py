"""The frames of the edge counter, ten bytes an edge or a heartbeat, and its clock.

``A5``, kind (``E`` edge, ``H`` heartbeat), sequence, flags, ticks (four bytes, lowest first), edge counter, CRC-8. What
wraps (sequence, ticks, edge counter) is carried on here. docs/instruments.md describes the device.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import dataclass

SYNC, EDGE, HEARTBEAT = 0xA5, 0x45, 0x48
FRAME_BYTES = 10
EDGES_LOST, INDEX = 1, 2  # flags
CRC_POLYNOMIAL = 0x07
CRYSTALS_PART = 100e-6  # by which two crystals part at most [s/s]


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame's content; the names are those of the module's text."""

    kind: int
    sequence: int
    flags: int
    ticks: int
    edges: int


@dataclass(frozen=True, slots=True)
class Mark:
    """A frame's place on the device's own clock and count, both carried on over their wraps.

    `fault`: why what lies between the mark before and this one cannot be trusted; empty when it can.
    """

    is_edge: bool
    ticks: int
    edges: int
    index: bool = False
    fault: str = ""
    lost_by_device: bool = False
    restarted: bool = False


def crc8(data: bytes) -> int:
    """CRC-8, polynomial 0x07, starting at 0."""
    crc = 0
    for byte in data:
        crc = _CRC[crc ^ byte]
    return crc


def _crc_of_byte(byte: int) -> int:
    for _ in range(8):
        byte = (byte << 1) ^ CRC_POLYNOMIAL if byte & 0x80 else byte << 1
    return byte & 0xFF


_CRC = bytes(_crc_of_byte(byte & 0xFF) for byte in range(256))


def cut(buffer: bytes) -> tuple[list[Frame], bytes, int]:
    """The whole frames of a buffer.

    Returns `frames`: oldest first; `rest`: what may become a frame; `skipped`: bytes that belong to no frame [-].
    """
    frames, place, skipped = [], 0, 0
    while len(buffer) - place >= FRAME_BYTES:
        frame = buffer[place : place + FRAME_BYTES]
        if frame[0] == SYNC and frame[1] in (EDGE, HEARTBEAT) and crc8(frame[:-1]) == frame[-1]:
            _, kind, sequence, flags, ticks, edges, _ = struct.unpack("<BBBBIBB", frame)
            frames.append(Frame(kind, sequence, flags, ticks, edges))
            place += FRAME_BYTES
        else:
            place, skipped = place + 1, skipped + 1
    return frames, buffer[place:], skipped


class Counting:
    """Carries ticks and edges on over their wraps, and notices what is missing.

    `most_ticks`: between two frames when none is missing [-]; heartbeats see to it. More is a clock that began anew.
    """

    def __init__(self, most_ticks: int = 1 << 31) -> None:
        self._most_ticks = most_ticks
        self._last: Frame | None = None
        self._ticks = self._edges = 0

    def take(self, frame: Frame) -> Mark | None:
        """The mark of the next frame; None when it is the frame before once more."""
        last, self._last = self._last, frame
        is_edge, index = frame.kind == EDGE, bool(frame.flags & INDEX)
        if last is None:
            return Mark(is_edge, 0, 0, index)
        if frame == last:
            return None
        missing = (frame.sequence - last.sequence - 1) & 0xFF
        ticks = (frame.ticks - last.ticks) & 0xFFFFFFFF
        edges = (frame.edges - last.edges) & 0xFF
        lost = bool(frame.flags & EDGES_LOST)
        restarted = ticks >= 1 << 31 or (ticks > self._most_ticks and not missing)
        if restarted:
            fault, ticks, edges = "the device's clock jumped: it was started anew", 0, int(is_edge)
        elif missing:
            fault = f"{missing} frames are missing"
        elif lost:
            fault = "the device has lost edges"
        elif edges != int(is_edge):
            fault = f"the device counted {edges} edges where it sent {int(is_edge)}"
        else:
            fault = ""
        self._ticks += ticks
        self._edges += edges
        return Mark(is_edge, self._ticks, self._edges, index, fault, lost, restarted)


class DeviceClock:
    """Lays the device's clock on the bench's: arrival less latency, by the frame that was quickest.

    An older frame counts for less: since it came the clocks may have parted by `CRYSTALS_PART`.
    """

    def __init__(self) -> None:
        self._seen = (0, sys.maxsize)  # arrival and offset of the quickest [ns]: any frame is quicker than none
        self._now_ns = 0

    def saw(self, arrival_ns: int, device_ns: int) -> None:
        """Note a frame.

        `arrival_ns`: when it came, on the bench's clock [ns].
        `device_ns`: when it was made, on the device's [ns].
        """
        self._now_ns = arrival_ns
        if arrival_ns - device_ns <= self.offset_ns:
            self._seen = (arrival_ns, arrival_ns - device_ns)

    @property
    def offset_ns(self) -> int:
        """The bench's time less the device's: no more than this, and close to it when the quickest frame came [ns].

        Of a clock that has seen a frame.
        """
        arrival_ns, offset_ns = self._seen
        return offset_ns + int(CRYSTALS_PART * (self._now_ns - arrival_ns))
