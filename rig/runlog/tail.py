"""A run followed while it is written, or played again: what is new since the last look, in bounded memory."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.acquisition.derived import CHANNEL as DERIVED_CHANNEL
from rig.acquisition.derived import DEVICE as DERIVED_DEVICE
from rig.readings import NS, USABLE, Reading
from rig.recording.columns import ROLES
from rig.runlog import plateaus
from rig.runlog.folder import END, EVENTS, PLATEAUS, SAMPLES, is_locked
from rig.runlog.lines import whole_lines
from rig.runlog.plateaus import PlateauRow
from rig.runlog.reader import event_of, read_end, read_start, state_of
from rig.runlog.samples import columns_of, reading_of
from rig.runlog.schema import CAPTURE, COURSE, EXPECTED, ZERO, EndRecord, EventLine

FINEST_S = 0.05
BINS = 800  # kept of each scale
SCALES = 20  # the coarsest spans 240 days

Bin = tuple[float, float, float]  # when it begins [s], lowest, highest


class Bins:
    """Bins of one channel. Times may only grow; what comes late is counted to the bin that is open."""

    def __init__(self) -> None:
        self._closed: list[deque[Bin]] = [deque(maxlen=BINS) for _ in range(SCALES)]
        self._open: list[Bin | None] = [None] * SCALES
        self.first_s: float | None = None

    def add(self, time_s: float, value: float) -> None:
        """Take a reading."""
        if self.first_s is None:
            self.first_s = time_s
        self._merge(0, (time_s, value, value))

    def _merge(self, scale: int, new: Bin) -> None:
        width = FINEST_S * 2.0**scale
        start = new[0] // width * width
        held = self._open[scale]
        if held is None or start > held[0]:
            if held is not None:
                self._closed[scale].append(held)
                if scale + 1 < SCALES:
                    self._merge(scale + 1, held)
            self._open[scale] = (start, new[1], new[2])
        else:
            self._open[scale] = (held[0], min(held[1], new[1]), max(held[2], new[2]))

    def last(self, from_s: float, until_s: float, most: int = BINS) -> list[Bin]:
        """The bins from a time to another, no more than `most`, on the finest scale that does."""
        span = max(until_s - from_s, FINEST_S)
        scale = next((k for k in range(SCALES - 1) if FINEST_S * 2.0**k * (most - 1) >= span), SCALES - 1)
        bins = [*self._closed[scale]]
        for k in range(scale, -1, -1):  # what is not in a closed bin of this scale yet
            part = self._open[k]
            if part is not None:
                bins.append(part)
        return [one for one in bins if from_s - FINEST_S * 2.0**scale < one[0] <= until_s]


BLOCK_BYTES = 1 << 18
KEPT_EVENTS = 400
MOST_PLATEAUS = 2000
CHECK, CHECK_FAILED, STATE, SET_POINT = "model check", "model check failed", "state", "set-point"
LATEST = (CHECK, CHECK_FAILED, STATE, SET_POINT, COURSE, EXPECTED, ZERO, CAPTURE)  # of each kind the last is kept
ALARMS = ("warning", "level refused", "set-point not taken", "capture failed", CHECK_FAILED, "line lost")


@dataclass(frozen=True)
class Shown:
    """The newest reading of a role, usable or not."""

    role: str
    channel: str
    value: float | None
    unit: str
    quality: str
    time_s: float
    censored: int = 0

    @property
    def usable(self) -> bool:
        """Whether there is a value without a fault."""
        return self.value is not None and self.quality in USABLE


class _Lines:
    """The whole lines that a growing file has more than those that were taken, with their numbers."""

    def __init__(self, path: Path) -> None:
        self.path, self._number, self._end = path, 0, 0
        self._next = (0, 0)

    def block(self) -> list[tuple[int, bytes]]:
        """Some more, a quarter of a megabyte at most or one line; empty where there are none."""
        found, end = [], self._end
        for number, line in whole_lines(self.path, self._number, end):
            found.append((number, line))
            end += len(line) + 1
            self._next = number, end
            if end - self._end >= BLOCK_BYTES:
                break
        return found

    def taken(self) -> None:
        """Go on behind the last block: a block that is refused is refused at every look."""
        self._number, self._end = self._next


class Tail:
    """One run as far as it was followed: newest readings, binned series, plateaus, and the last events.

    Raises RunError when the folder holds no run.

    `now_s`: the latest time that was seen [s].
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.start = read_start(folder)
        self.end: EndRecord | None = None
        self.state = ""
        self.now_s, self.samples, self.last_event = 0.0, 0, 0
        self.newest: dict[str, Shown] = {}
        self.bins = {role: Bins() for role in ROLES}
        self.events: deque[EventLine] = deque(maxlen=KEPT_EVENTS)
        self.alarms: deque[EventLine] = deque(maxlen=KEPT_EVENTS)
        self.latest: dict[str, EventLine] = {}
        self.plateaus: list[PlateauRow] = []
        channels = {role: self.start.roles.get(role) for role in ROLES}
        self._roles = {channel: role for role, channel in channels.items() if channel}
        if channels["flow"]:
            if not str(channels["flow"]).endswith(f".{DERIVED_CHANNEL}"):  # standard litres are not the inlet's
                del self._roles[str(channels["flow"])]
            self._roles[f"{DERIVED_DEVICE}.{DERIVED_CHANNEL}"] = "flow"
        self._row_lines, self._event_lines = _Lines(folder / SAMPLES), _Lines(folder / EVENTS)
        self._rows: deque[Reading] = deque()
        self._new_events: deque[EventLine] = deque()
        self._exchange = 1
        self._plateau_bytes = -1
        self._plateau_rows: list[PlateauRow] = []

    def advance(self, until_s: float | None = None, blocks: int = 40) -> bool:
        """Take in what is new; whether there may be more at once.

        `until_s`: later rows are left for later, as a replay wants it [s]; everything where it is None.
        `blocks`: at most so many of a quarter of a megabyte [-].
        """
        locked, ended = is_locked(self.folder), (self.folder / END).exists()
        more = False
        for _ in range(blocks):
            more = self._samples(until_s)
            if not more:
                break
        while self._events(until_s):
            pass
        self._plateaus(until_s)
        if more or (until_s is not None and (self._waiting_rows() or self._waiting_events())):
            self.state = state_of(None, True)
            return more
        if ended and self.end is None:
            self.end = read_end(self.folder)
        self.state = state_of(self.end, locked)
        return False

    def _samples(self, until_s: float | None) -> bool:
        """A block of rows; whether a block was there and all of it was due."""
        waiting = self._waiting_rows()
        if not waiting:
            return False
        while waiting:
            if until_s is not None and waiting[0].time_ns / NS > until_s:
                return False
            self._sample(waiting.popleft())
        return True

    def _waiting_rows(self) -> deque[Reading]:
        """Rows not taken yet; some more are read where there are none."""
        if not self._rows and (lines := self._row_lines.block()):
            columns = columns_of(lines, self._row_lines.path, self._exchange)
            count = len(columns["n"])
            self._rows.extend([reading_of(columns, row) for row in range(count)])
            self._exchange = int(columns["exchange"][-1]) if count else 1
            self._row_lines.taken()
        return self._rows

    def _sample(self, reading: Reading) -> None:
        self.samples += 1
        time_s = reading.time_ns / NS
        self.now_s = max(self.now_s, time_s)
        channel = f"{reading.device}.{reading.channel}"
        role = self._roles.get(channel)
        if role is None:
            return
        quality = reading.quality.value
        self.newest[role] = Shown(role, channel, reading.value, reading.unit, quality, time_s, reading.censored)
        if reading.value is not None and quality in USABLE:
            self.bins[role].add(time_s, reading.value)

    def _events(self, until_s: float | None) -> bool:
        """A block of events; whether there may be more."""
        waiting = self._waiting_events()
        if not waiting:
            return False
        while waiting:
            if until_s is not None and waiting[0].time_s > until_s:
                return False
            self._event(waiting.popleft())
        return True

    def _waiting_events(self) -> deque[EventLine]:
        """Events not taken yet; some more are read where there are none."""
        if not self._new_events and (lines := self._event_lines.block()):
            self._new_events.extend([event_of(data, number, self._event_lines.path) for number, data in lines])
            self._event_lines.taken()
        return self._new_events

    def _event(self, event: EventLine) -> None:
        self.now_s, self.last_event = max(self.now_s, event.time_s), event.n
        if event.event in LATEST:
            self.latest[event.event] = event
        if event.event in ALARMS:
            self.alarms.append(event)
        if event.event != SET_POINT:  # a ramp has five a second
            self.events.append(event)

    def _plateaus(self, until_s: float | None) -> None:
        path = self.folder / PLATEAUS
        size = path.stat().st_size if path.exists() else 0
        if size != self._plateau_bytes:
            self._plateau_bytes, self._plateau_rows = size, plateaus.read(path)[-MOST_PLATEAUS:]
        taken = [row for row in self._plateau_rows if until_s is None or row.end_s <= until_s]
        self.plateaus = plateaus.in_use(taken)

    def details(self, kind: str) -> dict[str, Any]:
        """What the newest event of a kind says beyond its time; nothing before the first."""
        event = self.latest.get(kind)
        return {} if event is None else event.details
