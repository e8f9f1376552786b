"""A counter on USB that sends the time of every edge of a toothed wheel: our own device, see docs/instruments.md.

Normally a poll gives one reading, the mean speed over the whole teeth since the poll before. In a capture every edge
gives its own: the mean speed since the edge before, and the shaft's angle. Spans are measured by the device's clock;
where they lie on the bench's is told by the frame that came with the least delay of late.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from rig.bench.instrument import ChannelFile, IdentityError, InstrumentFile, Positive
from rig.instruments.codecs.edge_frames import Counting, DeviceClock, Mark, cut
from rig.instruments.codecs.values import Times, Value, bounded, failures, joined, reading_of
from rig.instruments.placing import refuse_keyboard
from rig.instruments.polling import FAILING_POLLS, repeated, timing_of
from rig.lines import BadReplyError, Line, LineError, NoReplyError
from rig.readings import NS, Quality, Reading

if TYPE_CHECKING:
    from rig.bench.bench import Place

START_ORDER, STOP_ORDER, WHO = b"S\n", b"X\n", b"I\n"
IDENTITY = re.compile(rb"EDGE1 ([\w.-]{1,32}) ([\w.-]{1,32}) teeth=(\d{1,4}) tick_ns=(\d{1,7})\n")
SPEED, ANGLE = "speed_rpm", "angle_rad"
FEWEST_READS = 3  # before a poll gives up on a counter that sends and does not count
MOST_IDENTITY_BYTES = 4096  # frames may still come before it
MOST_GAP_S = 1.0  # between two frames: heartbeats come twenty times as often
MOST_BARREN = 200  # bytes without a frame: the baud rate is wrong, or another device sends
FULL_READ = 2048  # a read of so many bytes may have left more behind


class Settings(InstrumentFile):
    """The keys of an edge counter."""

    teeth: Annotated[int, pydantic.Field(ge=1, le=9999)]  # edges in a turn, as the wheel has them
    standstill_s: Positive = 0.5  # no edge for so long: the shaft stands
    silence_s: Positive = 0.2  # neither edge nor heartbeat for so long: the device is gone
    channels: dict[str, ChannelFile]

    @pydantic.model_validator(mode="after")
    def known_channels(self) -> Settings:
        """Refuse channels that the counter does not have."""
        if SPEED not in self.channels or not set(self.channels) <= {SPEED, ANGLE}:
            raise ValueError(f"channels: an edge counter has {SPEED}, and {ANGLE} for captures")
        return self


class EdgeCounter:
    """An edge counter on a line of its own. `serial_number`: of the bench file; empty when any will do."""

    def __init__(self, device: str, settings: Settings, serial_number: str = "") -> None:
        self.device = device
        self.channels = settings.channels
        self.settings = settings
        self._serial_number = serial_number
        self._tick_ns = 1000
        self._failed = 0
        self._capture_offset_ns: int | None = None  # of a capture: its times are the device's, shifted once
        self._from: Mark | None = None  # the last edge before what is not yet in a reading
        self._reset()

    @property
    def failing(self) -> bool:
        """Whether the last polls all failed."""
        return self._failed >= FAILING_POLLS

    def open(self, line: Line) -> None:
        """Forget what was known."""
        self._failed = 0
        self._reset()

    def identify(self, line: Line) -> str:
        """Stop the device, ask who it is, and start it."""
        line.tell(STOP_ORDER)
        line.drop()
        reply = repeated(lambda: line.ask(WHO, _identity_end, timing_of(self.settings, line)), 1)
        match = cast("re.Match[bytes]", IDENTITY.search(reply.data))  # the reply ends with it
        serial, firmware = match[1].decode("ascii", "replace"), match[2].decode("ascii", "replace")
        teeth, tick_ns = int(match[3]), int(match[4])
        if teeth != self.settings.teeth or tick_ns == 0:
            raise IdentityError(
                f"{self.device}: the counter is set to {teeth} teeth and ticks of {tick_ns} ns, its file says "
                f"{self.settings.teeth} teeth; set one right"
            )
        if self._serial_number and serial != self._serial_number:
            raise IdentityError(
                f"{self.device}: number '{serial}' answers, the bench file says '{self._serial_number}'"
            )
        self._tick_ns = tick_ns
        self._reset()
        self._started = True
        line.tell(START_ORDER)
        return f"edge counter {serial}, firmware {firmware}, {teeth} teeth, ticks of {tick_ns} ns"

    def poll(self, line: Line) -> list[Reading]:
        """The mean speed over the whole teeth since the poll before."""
        self._capture_offset_ns = None
        seen: list[Mark] = []
        arrivals: list[int] = []
        longest_ns = (self.settings.standstill_s + self.settings.silence_s) * NS
        try:
            while True:
                seen += self._marks(line)
                reading = self._mean_speed(seen)
                if reading is not None:
                    self._failed = 0
                    return [reading]
                arrivals.append(self._arrival_ns)
                if len(arrivals) > FEWEST_READS and arrivals[-1] - arrivals[0] > longest_ns:
                    raise BadReplyError(f"line {line.name}: frames come, but the counter's clock stands", Quality.STALE)
        except (NoReplyError, BadReplyError) as error:
            return self._failure(line, error)

    def poll_edges(self, line: Line) -> list[Reading]:
        """Speed and angle at each edge that came since the poll before; no reading when there was none."""
        try:
            marks = self._marks(line)
        except (NoReplyError, BadReplyError) as error:
            return self._failure(line, error)
        self._failed = 0
        if marks and self._capture_offset_ns is None:
            self._capture_offset_ns = self._clock.offset_ns
        readings = []
        for mark in marks:
            if mark.is_edge:
                readings += self._edge(mark)
            elif mark.fault:
                self._from = None
                readings.append(self._broken(mark))
        if not readings and self._stands(marks[-1] if marks else None):
            readings.append(self._standing(marks[-1]))
        return readings

    def _reset(self) -> None:
        self._rest = b""
        self._started = False
        self._counting = Counting(int(MOST_GAP_S * NS / self._tick_ns))
        self._clock = DeviceClock()
        self._from = None
        self._quiet_since: int | None = None  # ticks of the last edge, or of the first frame
        self._arrival_ns = 0
        self._last_ns: int | None = None  # time of the newest reading
        self._capture_offset_ns = None
        self._barren = 0  # bytes since the last frame

    def _marks(self, line: Line) -> list[Mark]:
        """What came since the last call, as marks; waits for the first bytes only."""
        if not self._started:  # switched on after we were, or its power came back
            self._reset()
            line.tell(START_ORDER)
            self._started = True
        arrival_ns, data = line.listen(self.settings.silence_s)
        if not data:
            self._started = False
            raise NoReplyError(f"line {line.name}: neither edge nor heartbeat for {self.settings.silence_s:g} s")
        self._rest += data
        while len(data) >= FULL_READ:
            arrival_ns, data = line.listen(0.0)
            self._rest += data
        frames, self._rest, skipped = cut(self._rest)
        self._barren = 0 if frames else self._barren + skipped
        if self._barren > MOST_BARREN:
            self._barren = 0
            raise BadReplyError(f"line {line.name}: bytes come, and no frame of an edge counter among them")
        marks = [mark for frame in frames if (mark := self._counting.take(frame)) is not None]
        if any(mark.restarted for mark in marks):
            self._clock = DeviceClock()
            self._capture_offset_ns = self._last_ns = None
        if marks:
            self._clock.saw(arrival_ns, marks[-1].ticks * self._tick_ns)
        self._arrival_ns = arrival_ns
        return marks

    def _mean_speed(self, seen: list[Mark]) -> Reading | None:
        """One reading of all marks of a poll; None while there is not enough for one."""
        broken = next((mark for mark in reversed(seen) if mark.fault), None)
        if broken is not None:
            edges = [mark for mark in seen[seen.index(broken) :] if mark.is_edge]
            self._from = edges[-1] if edges else None
            self._quiet_since = seen[-1].ticks
            return self._broken(broken)
        edges = [mark for mark in seen if mark.is_edge]
        start = self._from or (edges[0] if edges else None)
        if start is not None and edges and edges[-1].edges > start.edges:
            self._from = edges[-1]
            self._quiet_since = edges[-1].ticks
            return self._speed(start, edges[-1], f"{edges[-1].edges - start.edges} edges")
        if edges:
            self._quiet_since = edges[-1].ticks
        if seen and self._stands(seen[-1]):
            return self._standing(seen[-1])
        return None

    def _edge(self, mark: Mark) -> list[Reading]:
        """The readings of one edge in a capture."""
        start, self._from = self._from, mark
        self._quiet_since = mark.ticks
        readings = []
        if mark.fault:
            readings.append(self._broken(mark))
        elif start is not None and mark.ticks > start.ticks:
            readings.append(self._speed(start, mark, "1 edge"))
        if ANGLE in self.channels:
            angle = Value(2.0 * math.pi * mark.edges / self.settings.teeth, raw=f"edge {mark.edges}")
            quality = Quality.OK if not mark.fault else _quality(mark)
            detail = joined("index tooth" if mark.index else "", mark.fault)
            readings.append(self._reading(ANGLE, Value(angle.value, quality, angle.raw, detail), mark))
        return readings

    def _speed(self, start: Mark, end: Mark, raw: str) -> Reading:
        span_s = (end.ticks - start.ticks) * self._tick_ns / NS
        turns = (end.edges - start.edges) / self.settings.teeth
        value = Value(
            60.0 * turns / span_s if span_s > 0.0 else math.inf, raw=f"{raw} in {end.ticks - start.ticks} ticks"
        )
        return self._reading(SPEED, bounded(value, self.channels[SPEED]), end)

    def _stands(self, mark: Mark | None) -> bool:
        if mark is None:
            return False
        if self._quiet_since is None:
            self._quiet_since = mark.ticks
        return (mark.ticks - self._quiet_since) * self._tick_ns >= self.settings.standstill_s * NS

    def _standing(self, mark: Mark) -> Reading:
        """Zero, and what it means: slower than a tooth in the time that was waited. The chain of edges ends here."""
        self._from = None
        detail = f"no edge for {self.settings.standstill_s:g} s"
        return self._reading(SPEED, Value(0.0, Quality.OK, "0 edges", detail, -1), mark)

    def _broken(self, mark: Mark) -> Reading:
        return self._reading(SPEED, Value(None, _quality(mark), detail=mark.fault), mark)

    def _reading(self, name: str, value: Value, mark: Mark) -> Reading:
        offset_ns = self._clock.offset_ns if self._capture_offset_ns is None else self._capture_offset_ns
        time_ns = mark.ticks * self._tick_ns + offset_ns
        if self._last_ns is not None:
            time_ns = max(self._last_ns, time_ns)  # never backwards when a quicker frame moves the offset
        self._last_ns = time_ns
        return reading_of(
            self.device, name, self.channels[name], value, Times(time_ns, self._arrival_ns, self._arrival_ns)
        )

    def _failure(self, line: Line, error: LineError) -> list[Reading]:
        self._failed += 1
        self._from = None
        times = Times(line.heard_ns, line.heard_ns, line.heard_ns)
        return failures(self.device, {SPEED: self.channels[SPEED]}, error, times)


def _quality(mark: Mark) -> Quality:
    return Quality.EXCEPTION if mark.lost_by_device else Quality.CRC


def _identity_end(buffer: bytes) -> int | None:
    match = IDENTITY.search(buffer)
    if match is None and len(buffer) > MOST_IDENTITY_BYTES:
        raise BadReplyError(f"{len(buffer)} bytes without the identity of an edge counter")
    return None if match is None else match.end()


def build(device: str, settings: InstrumentFile, place: Place) -> EdgeCounter:
    """The driver of an edge counter."""
    refuse_keyboard(device, place)
    return EdgeCounter(device, cast(Settings, settings), place.table.serial_number)
