"""MDF files (.mf4, .mdf, .dat) of ASAM, with asammdf."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rig.exchange.binary.clocks import Channel, Clock, on_one_time_line
from rig.exchange.binary.columns import (
    FEW,
    MAX_BYTES,
    MAX_ROWS,
    Cells,
    Columns,
    Listed,
    Wanted,
    by_name,
    cells_of,
    refuse_unknown,
)
from rig.exchange.binary.marks import marked
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain

TIME = 1  # sync type of a master channel


def read(path: Path, group: str, wanted: Wanted) -> Columns:
    """The channels that are taken, of all groups or of one. Raises RunError where one is not there, or there twice."""
    with _opened(path) as file:
        taken = [one for one in _channels(file, path) if group in ("", one[0])]
        if not taken:
            names = dict.fromkeys(name for name, *_ in _channels(file, path))
            there = ", ".join(f"'{shown(name)}'" for name in names)
            raise RunError(f"{path}: name the group of channels in [table]: group = one of {there or 'none: no data'}")
        place = f"{path}, group '{shown(group)}'" if group else str(path)
        refuse_unknown(place, wanted, list(dict.fromkeys(one[1] for one in taken)))
        taken = [one for one in taken if not by_name(wanted) or one[1] in wanted]
        for name in dict.fromkeys(name for _, name, *_ in taken):
            groups = [one[0] for one in taken if one[1] == name]
            if len(groups) > 1 and by_name(wanted):
                there = ", ".join(f"'{shown(found)}'" for found in groups)
                raise RunError(f"{place}: '{shown(name)}' stands in several groups: {there}; name one in [table]")
        return on_one_time_line(place, [_channel(file, path, *one) for one in taken], wanted)


def listed(path: Path) -> list[Listed]:
    """Every channel."""
    with _opened(path) as file:
        found = []
        for group, name, at, index in _channels(file, path):
            try:
                signal, cells = _signal(file, path, name, at, index, FEW)
            except RunError:  # it is no column
                continue
            count = int(file.groups[at].channel_group.cycles_nr)
            found.append(Listed(group, name, str(signal.unit), count, cells, _has_clock(file, at)))
        return found


def _opened(path: Path) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF
    with open_plain(path, MAX_BYTES) as stream:
        if stream.read(3) not in (b"MDF", b"UnF"):  # the package would unpack an archive too
            raise RunError(f"{path}: not an MDF file")
    return MDF(str(path))


def _channels(file: Any, path: Path) -> Iterator[tuple[str, str, int, int]]:
    """Group, name, number of the group and of the channel; of those that hold samples."""
    seen: set[str] = set()
    for at, group in enumerate(file.groups):
        name = str(getattr(group.channel_group, "acq_name", "") or at)
        name = f"{name} {at}" if name in seen else name
        seen.add(name)
        if group.channel_group.cycles_nr > MAX_ROWS:
            raise RunError(f"{path}, group '{shown(name)}': more than {MAX_ROWS} rows")
        for index, channel in enumerate(group.channels):
            if group.channel_group.cycles_nr and index != file.masters_db.get(at):
                yield name, str(channel.name), at, index


def _has_clock(file: Any, at: int) -> bool:
    """Whether the group's master channel is time; a file of version 3 has no other."""
    master = file.masters_db.get(at)
    return master is not None and getattr(file.groups[at].channels[master], "sync_type", TIME) == TIME


def _signal(file: Any, path: Path, name: str, at: int, index: int, count: int | None) -> tuple[Any, list[Any]]:
    """A channel with its cells; a sample that the file marks as invalid is missing."""
    signal = file.get(group=at, index=index, record_count=count, ignore_invalidation_bits=True)
    samples = np.asarray(signal.samples)
    if samples.ndim != 1 or samples.dtype.names:
        raise RunError(f"{path}, '{shown(name)}': its samples are no single values")
    cells: list[Any] = list(cells_of(samples, f"{path}, '{shown(name)}'"))
    if signal.invalidation_bits is not None:
        bad = np.asarray(signal.invalidation_bits, dtype=bool)
        empty = "" if cells and isinstance(cells[0], str) else float("nan")
        cells = [empty if is_bad else cell for cell, is_bad in zip(cells, bad, strict=True)]
    return signal, cells


def _channel(file: Any, path: Path, group: str, name: str, at: int, index: int) -> Channel:
    signal, cells = _signal(file, path, name, at, index, None)
    channels = file.groups[at].channels

    def beside(key: str) -> Cells | None:
        found = next((other for other, one in enumerate(channels) if str(one.name) == f"{name}.{key}"), None)
        return None if found is None else _signal(file, path, f"{name}.{key}", at, found, None)[1]

    cells, remark = marked(cells, beside, f"{path}, '{shown(name)}'")
    if not _has_clock(file, at):
        return Channel(name, cells, None, str(signal.unit), remark)
    times = np.asarray(signal.timestamps, dtype=np.float64)
    spans = np.diff(times)
    said = f"in group '{shown(group)}', {times.size} samples from {times[0]:g} s" if times.size else "without samples"
    clock = Clock(0, times, said + (f" every {spans.mean():.6g} s" if spans.size else ""))
    return Channel(name, cells, clock, str(signal.unit), remark)
