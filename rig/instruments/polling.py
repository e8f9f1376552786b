"""What every polled driver does alike: asks, asks once more, judges what came, and makes readings of it.

A driver says how one poll is asked and decoded (`Polled.ask`). The rest is here: one repetition after a timeout or a
damaged reply, limits of the scale, two polls that agree where nothing on the wire is checked, a block that never
changes, and a failure as a reading without a value.
"""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, TypeVar

import pydantic

from rig.bench.instrument import ChannelFile, InstrumentFile, NotNegative, Positive
from rig.instruments.codecs.values import Times, Value, bounded, failures, joined, reading_of
from rig.lines import Line, LineError, LostError, Timing
from rig.readings import NS, Quality, Reading

FAILING_POLLS = 3  # so many failed polls in a row, and the device is asked rarely

ChannelName = Annotated[str, pydantic.StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,39}$")]
Found = TypeVar("Found")


class UncheckedChannel(ChannelFile):
    """A channel of an instrument without a checksum: two polls in a row that agree make a reading ok."""

    agree_within: NotNegative | None = None  # in the channel's unit; the resolution, or 0, when left out


class PolledFile(InstrumentFile):
    """Keys that every polled family has."""

    retries: Annotated[int, pydantic.Field(ge=0, le=3)] = 1
    stale_s: Positive | None = None  # a block without any change for longer is stale; never, when left out


@dataclass(frozen=True, slots=True)
class Answer:
    """One successful poll.

    `block`: what tells a repeated value from a new one: all that the device said about its channels.
    `time_ns`: when the quantities were sampled [ns]; between question and answer when left out.
    `times`: of a device that is read in several questions: when a channel's own was asked and answered [ns].
    """

    found: Mapping[str, Value]
    block: bytes
    request_ns: int
    reply_ns: int
    time_ns: int | None = None
    times: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def times_of(self, channel: str, retries: int) -> Times:
        """The times of a channel's reading."""
        request_ns, reply_ns = self.times.get(channel, (self.request_ns, self.reply_ns))
        time_ns = (request_ns + reply_ns) // 2 if self.time_ns is None else self.time_ns
        return Times(time_ns, request_ns, reply_ns, retries)


@dataclass
class _Memory:
    """What a driver remembers between polls, all of it from the wire."""

    failed: int = 0
    last: dict[str, float] = field(default_factory=dict)  # of the poll before, for agreement
    block: bytes | None = None
    block_since_ns: int = 0


class Polled(abc.ABC):
    """An instrument that is asked, or listened to, once a poll."""

    checked = True  # whether a checksum protects what is on the wire

    def __init__(self, device: str, channels: Mapping[str, ChannelFile], settings: PolledFile) -> None:
        self.device = device
        self.channels: dict[str, ChannelFile] = dict(channels)
        self._file = settings
        self._memory = _Memory()

    @property
    def failing(self) -> bool:
        """Whether the last polls all failed."""
        return self._memory.failed >= FAILING_POLLS

    def open(self, line: Line) -> None:
        """Forget what was known."""
        self._memory = _Memory()
        line.drop()

    @abc.abstractmethod
    def ask(self, line: Line) -> Answer:
        """Ask once and decode; raises `LineError` on a timeout, damage or refusal."""

    def poll(self, line: Line) -> list[Reading]:
        """Read every channel once."""
        asked = 0

        def ask() -> Answer:
            nonlocal asked
            asked += 1
            return self.ask(line)

        try:
            answer = repeated(ask, 0 if self.failing else self._file.retries)
        except LostError:
            raise
        except LineError as error:
            self._memory.failed += 1
            self._memory.last.clear()
            times = Times(line.heard_ns, line.asked_ns, line.heard_ns, asked - 1)
            return failures(self.device, self.channels, error, times)
        self._memory.failed = 0
        return self._readings(answer, asked - 1)

    def _readings(self, answer: Answer, retries: int) -> list[Reading]:
        found = {name: bounded(answer.found[name], channel) for name, channel in self.channels.items()}
        if not self.checked:
            found = {name: self._confirmed(name, value) for name, value in found.items()}
            self._memory.last = {name: value.value for name, value in found.items() if value.value is not None}
        found = self._aged(found, answer)
        return [
            reading_of(self.device, name, self.channels[name], value, answer.times_of(name, retries))
            for name, value in found.items()
        ]

    def _confirmed(self, name: str, value: Value) -> Value:
        """Unverified, unless the poll before gave the same."""
        if value.value is None or value.quality is not Quality.OK:
            return value
        last = self._memory.last.get(name)
        if last is not None and abs(value.value - last) <= agreement(self.channels[name]):
            return value
        return dataclasses.replace(value, quality=Quality.UNVERIFIED)

    def _aged(self, found: dict[str, Value], answer: Answer) -> dict[str, Value]:
        """Stale, when the whole block has been the same for longer than the file allows."""
        if answer.block != self._memory.block:
            self._memory.block, self._memory.block_since_ns = answer.block, answer.reply_ns
            return found
        age_s = (answer.reply_ns - self._memory.block_since_ns) / NS
        if self._file.stale_s is None or age_s <= self._file.stale_s:
            return found
        detail = f"the device has repeated itself for {age_s:.1f} s"
        return {
            name: dataclasses.replace(value, value=None, quality=Quality.STALE, detail=joined(detail, value.detail))
            if value.quality in (Quality.OK, Quality.UNVERIFIED)
            else value
            for name, value in found.items()
        }


def repeated(ask: Callable[[], Found], retries: int) -> Found:
    """Ask, and ask again after a timeout or a damaged reply; a refusal is an answer and is not repeated.

    A late answer costs no repetition, once: the device is there, and at the next question the line is in step again.
    Raises LineError: the last failure.
    """
    may_be_late = retries > 0
    while True:
        try:
            return ask()
        except LineError as error:
            if isinstance(error, LostError) or error.quality is Quality.EXCEPTION:
                raise
            if may_be_late and error.quality is Quality.STALE:
                may_be_late = False
            elif retries > 0:
                retries -= 1
            else:
                raise


def agreement(channel: ChannelFile) -> float:
    """How far two polls may differ and still agree [own unit]."""
    chosen = getattr(channel, "agree_within", None)
    within = channel.resolution if chosen is None else chosen
    return within * (1.0 + 1e-9) if within else 0.0


def timing_of(settings: InstrumentFile, line: Line) -> Timing:
    """The line's times, with those of the device's file in their place."""
    timeout_s = settings.timeout_s or line.timing.timeout_s
    slowest_s = settings.slowest_reply_s or line.timing.slowest_reply_s
    return dataclasses.replace(line.timing, timeout_s=timeout_s, slowest_reply_s=max(timeout_s, slowest_s))
