"""Edge counter: the time of every tooth of a wheel on the shaft, by the counter's own clock, as docs/instruments.md
describes its frames.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np

from rig.bench.bench import Place
from rig.readings import NS
from rig.virtual.devices.base import Served, World
from rig.virtual.devices.sensors import generator

TURN = 2.0 * math.pi
START_BYTE, EDGE, HEARTBEAT = 0xA5, 0x45, 0x48
LOST, INDEX, LEVEL = 1, 2, 4  # flags
HEARTBEAT_NS = 50_000_000  # without an edge
CLOCK_PPM = 20.0  # error of the counter's clock, 1 sigma
FIRMWARE = "1.2"
MOST_WAITING = 20_000
MOST_STEPS, LEAST_STEP = 40, 1e-9  # to a crossing, in parts of a sample


def serve(device: str, settings: Any, place: Place, world: World) -> EdgeCounter:
    """A counter on a wheel with the teeth of its file."""
    serial = place.table.serial_number or f"V{world.seed:05d}"
    return EdgeCounter(device, settings, serial, world)


def crc8(data: bytes) -> int:
    """Checksum: polynomial 0x07, started with 0 [-]."""
    register = 0
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register << 1 ^ 0x07) & 0xFF if register & 0x80 else register << 1
    return register


class EdgeCounter(Served):
    """Sends a frame for each edge once it is started, and a heartbeat where there is none."""

    speaks = "stream"
    terminator = b"\n"

    def __init__(self, device: str, settings: Any, serial: str, world: World) -> None:
        self.device, self.serial, self.faults = device, serial, world.faults
        self.teeth = int(settings.teeth)
        self.tick_ns = int(getattr(settings, "tick_ns", None) or 100)
        chance = generator(world.seed, device)
        self.pace = 1.0 + CLOCK_PPM * 1e-6 * chance.standard_normal()
        self.plant = world.plant
        self._first_ticks = int(chance.integers(2**32))
        self._pattern = wheel(self.teeth, self.plant.line.pitch_error_sd, world.seed, device)
        self._tooth = int(self._teeth_passed(np.array([self.plant.angle_rad]))[0])
        self._started_ns = 0
        self._running = False
        self._edges: list[tuple[float, bool]] = []  # time [ns], index tooth
        self._count = self._sequence = 0
        self._last_sent_ns = 0.0
        self._lost = False
        self.plant.listeners.append(self._watch)

    def restart(self, time_ns: int) -> None:
        """Power comes back: stopped, with a clock that starts again."""
        self._started_ns, self._first_ticks = time_ns, 0
        self._count = self._sequence = 0
        self.switch_off()

    def switch_off(self) -> None:
        """Without power nothing is counted."""
        self._running = False
        self._edges.clear()

    def answer(self, line: bytes, time_ns: int) -> bytes | None:
        """Start, stop, or tell who this is; empty where there is nothing to say."""
        order = line.strip()
        if order == b"S":
            if not self._running:
                self._running = True
                self._edges.clear()
                self._sequence = 0
                self._lost = False
                self._last_sent_ns = time_ns
            return b""
        if order == b"X":
            self._running = False
            self._edges.clear()
            return b""
        if order == b"I":
            who = f"EDGE1 {re.sub(r'[^!-~]', '_', self.serial)} {FIRMWARE}"
            return f"{who} teeth={self.teeth} tick_ns={self.tick_ns}\n".encode("ascii")
        return None

    def stream(self, time_ns: int) -> list[bytes]:
        """Frames of the edges since the last call, and of the heartbeats between them."""
        if not self._running:
            return []
        edges, self._edges = self._edges, []
        if self.faults.happens("frozen", self.device, time_ns):
            edges = []  # a counter that hangs still sends its heartbeat
        sent = []
        for edge_ns, index in edges:
            sent += self._heartbeats(edge_ns)
            self._count += 1
            flags = (LOST if self._lost else 0) | (INDEX if index else 0) | LEVEL
            self._lost = False
            sent.append(self._frame(EDGE, flags, edge_ns))
        return sent + self._heartbeats(time_ns)

    def overrun(self) -> None:
        """A frame found no room: the next edge says so."""
        self._lost = True

    def _heartbeats(self, until_ns: float) -> list[bytes]:
        sent = []
        while until_ns - self._last_sent_ns > HEARTBEAT_NS:
            sent.append(self._frame(HEARTBEAT, 0, self._last_sent_ns + HEARTBEAT_NS))
        return sent

    def _frame(self, kind: int, flags: int, time_ns: float) -> bytes:
        self._last_sent_ns = time_ns
        ticks = (self._first_ticks + int((time_ns - self._started_ns) * self.pace / self.tick_ns)) & 0xFFFF_FFFF
        head = bytes([START_BYTE, kind, self._sequence, flags]) + ticks.to_bytes(4, "little")
        head += bytes([self._count & 0xFF])
        self._sequence = (self._sequence + 1) & 0xFF
        return head + bytes([crc8(head)])

    def _teeth_passed(self, angles: np.ndarray) -> np.ndarray:
        """Number of the last edge at or before each angle."""
        turns = np.floor(angles / TURN)
        return (turns * self.teeth + np.searchsorted(self._pattern, angles - turns * TURN, "right") - 1).astype(
            np.int64
        )

    def _watch(self, times_ns: np.ndarray, angles: np.ndarray, speeds: np.ndarray) -> None:
        """Find the teeth that have passed between samples of the shaft."""
        tooth = self._teeth_passed(angles)
        tooth[0] = self._tooth  # where the last call ended: rounding must not lose an edge, nor count it twice
        self._tooth = int(tooth[-1])
        if not self._running:
            return
        for i in np.flatnonzero(np.diff(tooth)):
            step = 1 if tooth[i + 1] > tooth[i] else -1
            for number in range(int(tooth[i]), int(tooth[i + 1]), step):
                edge = number + 1 if step > 0 else number  # the line between two teeth that is crossed
                turns, place = divmod(edge, self.teeth)
                angle = turns * TURN + float(self._pattern[place])
                time_ns = crossing_ns(times_ns[i : i + 2], angles[i : i + 2], speeds[i : i + 2], angle)
                self._edges.append((time_ns, place == 0))
        if len(self._edges) > MOST_WAITING:
            self._edges.clear()
            self._lost = True


def wheel(teeth: int, pitch_error_sd: float, seed: int, device: str) -> np.ndarray:
    """Where the edges of a wheel are within a turn [rad], shape (teeth,); the first at 0, and they stay in order.

    `pitch_error_sd`: error of each edge's place as a share of the pitch, 1 sigma [-].
    """
    errors = np.clip(pitch_error_sd * generator(seed, device, "pitch").standard_normal(teeth), -0.45, 0.45)
    errors[0] = 0.0  # the turn counts from it
    return (np.arange(teeth) + errors) * (TURN / teeth)


def crossing_ns(times_ns: np.ndarray, angles: np.ndarray, speeds: np.ndarray, angle: float) -> float:
    """When the shaft passes an angle between two samples [ns], on the cubic through both with their speeds.

    `times_ns`, `angles`, `speeds`, shape (2,): the samples [ns], [rad], [rad/s].
    """
    span_s = float(times_ns[1] - times_ns[0]) / NS
    turned = float(angles[1] - angles[0])
    if span_s <= 0.0 or turned == 0.0:
        return float(times_ns[1])
    before, after, wanted = float(speeds[0]) * span_s, float(speeds[1]) * span_s, angle - float(angles[0])
    square, cube = 3.0 * turned - 2.0 * before - after, before + after - 2.0 * turned
    low, high, s = 0.0, 1.0, min(1.0, max(0.0, wanted / turned))
    for _ in range(MOST_STEPS):
        over = s * (before + s * (square + s * cube)) - wanted
        low, high = (low, s) if over * turned > 0.0 else (s, high)
        slope = before + s * (2.0 * square + 3.0 * s * cube)
        step = over / slope if slope * turned > 0.0 else math.inf  # it turns back between the samples
        last, s = s, s - step if low <= s - step <= high else 0.5 * (low + high)
        if abs(s - last) < LEAST_STEP:
            break
    return float(times_ns[0]) + s * span_s * NS
