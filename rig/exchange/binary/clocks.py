"""Channels that were sampled on clocks of their own, on one time line.

Channels of one clock are the columns of one table. Those of several have a row for each moment at which any of them was
sampled, and empty cells between: no value is moved or made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rig.exchange.binary.columns import WAVEFORM_TIME, Cells, Columns, Wanted, by_name, of_one_length
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError

NS = 1e9
MOST_S = 5e9  # whose nanoseconds an integer holds


@dataclass(frozen=True, eq=False)
class Clock:
    """When a channel was sampled.

    `start_ns`: the moment that the times are counted from [ns]; None where the file does not tell it.
    `said`: the clock in words, for an error.
    """

    start_ns: int | None
    time_s: NDArray[np.float64]
    said: str

    def same_as(self, other: Clock) -> bool:
        """Whether the samples were taken at the same moments."""
        same = self.start_ns == other.start_ns and np.array_equal(self.time_s, other.time_s)
        return self is other or same


@dataclass(frozen=True)
class Channel:
    """A channel's cells, its clock where it has one, its unit as the file states it, and what is to be told of it."""

    name: str
    cells: Cells
    clock: Clock | None = None
    unit: str = ""
    remark: str = ""


def on_one_time_line(place: str, channels: Sequence[Channel], wanted: Wanted) -> Columns:
    """Channels as columns, with their units, and with `WAVEFORM_TIME` behind them where they have clocks.

    Raises RunError when their clocks differ, and their times are not taken, or a channel cannot be placed on the time
    line: one that has no clock neither.
    """
    units = {channel.name: channel.unit for channel in channels}
    found = _placed(place, channels, wanted)
    remarks = [channel.remark for channel in channels if channel.remark]
    remarks += [words for channel in channels if found.clocks and (words := _empty(place, channel))]
    return replace(found, units=units, remarks=remarks)


def _empty(place: str, channel: Channel) -> str:
    """How many samples of a channel have no value, which nobody sees among the empty cells between the clocks."""
    count = sum(cell != cell or cell == "" for cell in channel.cells)
    return f"{place}, '{shown(channel.name)}': {count} of {len(channel.cells)} samples have no value" if count else ""


def _placed(place: str, channels: Sequence[Channel], wanted: Wanted) -> Columns:
    headings, columns = [channel.name for channel in channels], [channel.cells for channel in channels]
    clocked = [(channel.name, channel.clock) for channel in channels if channel.clock is not None]
    if not clocked:
        return of_one_length(place, headings, columns)
    without = next((channel.name for channel in channels if channel.clock is None), None)
    if without is not None and WAVEFORM_TIME in wanted:
        raise RunError(
            f"{place}, '{shown(without)}': it has no clock, as '{shown(clocked[0][0])}' has; take as time_s a column "
            "that belongs to it, or do not take it (columns by their headings)"
        )
    first = clocked[0][1]
    others = [name for name, clock in clocked if not clock.same_as(first)]
    if not others:
        return of_one_length(place, [*headings, WAVEFORM_TIME], [*columns, first.time_s.tolist()])
    said = _both(channels, clocked[0][0], others[0])
    if not (by_name(wanted) and WAVEFORM_TIME in wanted):
        raise RunError(
            f"{place}: {said}; take the columns by their headings and as time_s column = '{WAVEFORM_TIME}', which "
            "places each on its own time, or import one"
        )
    return _merged(place, channels, said)


def _both(channels: Sequence[Channel], *names: str) -> str:
    clocks = {channel.name: channel.clock for channel in channels}
    said = (f"'{shown(name)}' {clock.said}" for name in names if (clock := clocks[name]) is not None)
    return f"two clocks: {' and '.join(said)}"


def _merged(place: str, channels: Sequence[Channel], said: str) -> Columns:
    times = [_moments(place, channel, said) for channel in channels]
    if len({start is None for start, _ in times}) > 1:
        raise RunError(f"{place}: {said}; one tells no date, so that they cannot be placed; import one")
    origin = min(start or 0 for start, _ in times)
    moments = [(start or 0) - origin + ns for start, ns in times]
    line = np.unique(np.concatenate(moments))
    columns: list[Cells] = []
    for channel, ns in zip(channels, moments, strict=True):
        values = np.full(line.size, "" if isinstance(next(iter(channel.cells), None), str) else np.nan, dtype=object)
        values[np.searchsorted(line, ns)] = channel.cells
        columns.append(values.tolist())
    headings = [*(channel.name for channel in channels), WAVEFORM_TIME]
    return of_one_length(place, headings, [*columns, (line / NS).tolist()], said)


def _moments(place: str, channel: Channel, said: str) -> tuple[int | None, NDArray[np.int64]]:
    """A channel's start, and its times from there [ns]."""
    at, clock = f"{place}, '{shown(channel.name)}'", channel.clock
    assert clock is not None  # noqa: S101 - the caller has seen to it
    if len(channel.cells) != clock.time_s.size:
        raise RunError(f"{at}: {len(channel.cells)} values and {clock.time_s.size} times")
    if not (np.abs(clock.time_s) <= MOST_S).all():
        raise RunError(f"{at}: a time is no number, or beyond 160 years; is its unit right?")
    ns = np.round(clock.time_s * NS).astype(np.int64)
    if not (np.diff(ns) > 0).all():
        raise RunError(f"{at}: its times do not increase, so that it cannot be placed beside others: {said}")
    return clock.start_ns, ns
