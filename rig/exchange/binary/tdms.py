"""TDMS files of LabVIEW, with npTDMS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.exchange.binary.clocks import Channel, Clock, on_one_time_line
from rig.exchange.binary.columns import FEW, MAX_BYTES, Cells, Columns, Listed, Wanted, by_name, cells_of
from rig.exchange.binary.marks import marked
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError, open_plain


def read(path: Path, group: str, wanted: Wanted) -> Columns:
    """The channels of a group. Raises RunError where they cannot be read, or stand on two clocks."""
    groups = _groups(path)
    name = group or (next(iter(groups)) if len(groups) == 1 else "")
    if name not in groups:
        listed = ", ".join(f"'{shown(found)}'" for found in groups)
        raise RunError(f"{path}: name the group of channels in [table]: group = one of {listed or 'none: it is empty'}")
    place = f"{path}, group '{shown(name)}'"
    taken = [channel for channel in groups[name] if not by_name(wanted) or channel.name in wanted]
    return on_one_time_line(place, [_channel(channel, groups[name], place) for channel in taken], wanted)


def listed(path: Path) -> list[Listed]:
    """Every channel."""
    return [
        Listed(
            group, channel.name, str(channel.properties.get("unit_string", "")), len(channel),
            cells_of(np.asarray(channel[:FEW]), f"{path}, '{shown(channel.name)}'"),
            "wf_increment" in channel.properties,
        )
        for group, channels in _groups(path).items()
        for channel in channels
    ]  # fmt: skip


def _groups(path: Path) -> dict[str, list[Any]]:
    from nptdms import TdmsFile

    with open_plain(path, MAX_BYTES) as stream:
        try:
            file = TdmsFile.read(stream)
            return {found.name: found.channels() for found in file.groups()}
        except Exception as error:  # whatever a damaged file makes the package stumble over
            raise RunError(f"{path}: not a TDMS file that can be read ({shown(str(error), 100)})") from None


def _channel(channel: Any, group: Sequence[Any], place: str) -> Channel:
    at = f"{place}, '{shown(channel.name)}'"

    def beside(key: str) -> Cells | None:
        found = next((one for one in group if one.name == key and channel.name == "value"), None)
        return None if found is None else cells_of(np.asarray(found[:]), at)

    cells, remark = marked(cells_of(np.asarray(channel[:]), at), beside, at)
    has_clock = "wf_increment" in channel.properties
    clock = _clock(channel.properties, len(cells), at) if has_clock else None
    return Channel(channel.name, cells, clock, str(channel.properties.get("unit_string", "")), remark)


def _clock(properties: Mapping[str, Any], count: int, place: str) -> Clock:
    """When a waveform was sampled, by its date, its offset and its period."""
    try:
        offset, increment = float(properties.get("wf_start_offset", 0.0)), float(properties["wf_increment"])
    except (TypeError, ValueError):
        raise RunError(f"{place}: wf_start_offset and wf_increment are not numbers") from None
    start = properties.get("wf_start_time")
    start_ns = None
    if isinstance(start, np.datetime64) and not np.isnat(start):
        start_ns = int(start.astype("datetime64[us]").astype(np.int64)) * 1000
    said = f"from {start if start_ns is not None else 'no date'} + {offset:g} s every {increment:g} s"
    return Clock(start_ns, offset + increment * np.arange(count, dtype=np.float64), said)
