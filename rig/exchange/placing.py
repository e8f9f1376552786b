"""Where the files of an import stand on one clock: a run has one, and tells what belongs together by the times."""

from __future__ import annotations

import datetime
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rig.exchange.cells import Cell, date_in
from rig.exchange.converted import Converted
from rig.exchange.mapping import MappingFile
from rig.readings import NS
from rig.recording.units import DATED
from rig.runlog.folder import RunError

APART_NS = NS  # between files without times
SAME_START_S = 1.0


def times_on_one_clock(place: Path, parts: Sequence[Converted]) -> list[list[int]]:
    """The times of each file's rows on a run's clock [ns].

    A file without times stands at its start, or behind all others where something else is there. `place`: the mapping.
    Raises RunError where two files that are not both of plateaus would be at the same time, for a zero or a run in time
    would then hold the readings of the other.
    """
    placed: dict[int, NDArray[np.int64]] = {}
    timed = [at for at, part in enumerate(parts) if "time_s" in part.columns]
    for at in timed:
        placed[at] = np.round((parts[at].columns["time_s"].values + parts[at].entry.start_s) * NS).astype(np.int64)
    for at, part in enumerate(parts):
        if at not in timed:
            times = np.full(part.rows, round(part.entry.start_s * NS), dtype=np.int64)
            if any(_clash(parts, placed | {at: times}, at, other) for other in placed):
                times[:] = max(int(one.max()) for one in placed.values()) + APART_NS
            placed[at] = times
    for one, other in itertools.combinations(range(len(parts)), 2):
        if _clash(parts, placed, one, other):
            spans = (f"{placed[at].min() / NS:g} to {placed[at].max() / NS:g} s" for at in (one, other))
            raise RunError(
                f"{place}: {parts[one].entry.file} and {parts[other].entry.file} are at the same time on the run's "
                f"clock ({' and '.join(spans)}); say in [[files]] start_s = .. when each began, or make a recording "
                "with -o, whose files have their own clocks"
            )
    return [placed[at].tolist() for at in range(len(parts))]


def _clash(parts: Sequence[Converted], placed: dict[int, NDArray[np.int64]], one: int, other: int) -> bool:
    if parts[one].entry.kind == parts[other].entry.kind == "steady":
        return False
    return bool(placed[one].min() <= placed[other].max() and placed[other].min() <= placed[one].max())


def capture_of(part: Converted, times_ns: Sequence[int]) -> dict[str, object]:
    """What a run says of a run in time: a coast-down or a spin-up, and when the supply was shut or opened.

    `supply_open` decides; without it, what ends faster than it began is a spin-up.
    Raises RunError where the supply is switched more than once, which a run cannot tell.
    """
    flags, speed = part.columns.get("supply_open"), part.columns.get("speed_rpm")
    if flags is None or part.entry.kind != "transient":
        read = speed.values[~np.isnan(speed.values)] if speed is not None else np.zeros(0)
        return {"capture": "spin-up" if read.size and read[-1] > read[0] else "coast-down"}
    known = np.flatnonzero(~np.isnan(flags.values))
    is_open = flags.values[known] > 0.5
    switched = np.flatnonzero(np.diff(is_open)) + 1
    if switched.size > 1:
        lines = ", ".join(str(part.lines[known[at]]) for at in switched[:5])
        raise RunError(
            f"{part.entry.file}, line {lines}: supply_open changes more than once, and a run in time has one change: "
            "take each part as one of [[files]], or make a recording with -o"
        )
    at = int(switched[0]) if switched.size else 0
    event_s = times_ns[int(known[at])] / NS if switched.size else min(times_ns) / NS
    return {"capture": "spin-up" if is_open[at] else "coast-down", "event_s": event_s}


def _of_another_day(mapping: MappingFile, part: Converted, cell: str) -> list[str]:
    """In words, where the first time is of another day than [origin] date; a day's difference is one of time zones."""
    day, said = date_in(cell, mapping.columns["time_s"].unit), mapping.origin.date
    if day is None or not said:
        return []
    stated = datetime.date.fromisoformat(said[:10])
    if abs((day - stated).days) <= 1:
        return []
    return [f"{part.entry.file}: its times begin on {day}, and [origin] date says {stated}"]


def starts_by_dates(mapping: MappingFile, parts: Sequence[Converted]) -> list[str]:
    """In words, where the dates of several files tell another distance between them than `start_s` does."""
    source = mapping.columns.get("time_s")
    if source is None or source.unit not in ("ISO", *DATED, "Excel days"):
        return []
    read = Cell(mapping.table).time(source.unit)
    first, notes = None, []
    for part in parts:
        began = read(part.cells["time_s"][0]) if part.cells.get("time_s") else None
        if began is None:
            continue
        notes += _of_another_day(mapping, part, part.cells["time_s"][0])
        first = first or (part, began[0])
        after, said = began[0] - first[1], part.entry.start_s - first[0].entry.start_s
        if abs(after - said) > SAME_START_S:
            notes.append(
                f"{part.entry.file}: by its dates it begins {after:.10g} s after {first[0].entry.file}, by start_s in "
                f"[[files]] {said:.10g} s; times count from each one's first row"
            )
    return notes
