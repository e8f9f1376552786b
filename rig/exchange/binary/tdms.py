"""TDMS files of LabVIEW, with npTDMS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rig.exchange.binary.clocks import NS, Channel, Clock, on_one_time_line
from rig.exchange.binary.columns import (
    FEW,
    MAX_BYTES,
    OF_A_RUN,
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

Piece = tuple[int, dict[str, Any]]  # the sample that it begins at, and the properties that hold from there
NO_START = np.datetime64("1904-01-01T00:00:00")  # what LabVIEW writes where no start was set


def read(path: Path, group: str, wanted: Wanted) -> Columns:
    """The channels of a group. Raises RunError where they cannot be read, or stand on two clocks."""
    groups, pieces = _groups(path)
    name = group or (next(iter(groups)) if len(groups) == 1 else "")
    if name not in groups:
        listed = ", ".join(f"'{shown(found)}'" for found in groups) or "none: it is empty"
        hint = f" ({OF_A_RUN})" if any(one.name == "value" for channels in groups.values() for one in channels) else ""
        raise RunError(f"{path}: name the group of channels in [table]: group = one of {listed}{hint}")
    place = f"{path}, group '{shown(name)}'"
    refuse_unknown(place, wanted, [channel.name for channel in groups[name]])
    taken = [channel for channel in groups[name] if not by_name(wanted) or channel.name in wanted]
    return on_one_time_line(
        place, [_channel(channel, groups[name], pieces.get(channel.path, []), place) for channel in taken], wanted
    )


def listed(path: Path) -> list[Listed]:
    """Every channel."""
    return [
        Listed(
            group, channel.name, _unit(channel), len(channel),
            cells_of(np.asarray(channel[:FEW]), f"{path}, '{shown(channel.name)}'"),
            _has_clock(channel),
        )
        for group, channels in _groups(path)[0].items()
        for channel in channels
        if np.asarray(channel[:0]).dtype.kind in "biufMOUS"
    ]  # fmt: skip


def _groups(path: Path) -> tuple[dict[str, list[Any]], dict[str, list[Piece]]]:
    """The channels by group, and the pieces of each by its path."""
    from nptdms import TdmsFile

    with open_plain(path, MAX_BYTES) as stream:
        try:
            pieces = _pieces(stream)
            stream.seek(0)
            file = TdmsFile.read(stream)
            return {found.name: found.channels() for found in file.groups()}, pieces
        except Exception as error:  # whatever a damaged file makes the package stumble over
            raise RunError(f"{path}: not a TDMS file that can be read ({shown(str(error), 100)})") from None


def _pieces(stream: Any) -> dict[str, list[Piece]]:
    """By channel, where its properties are set anew amid its samples, as where a logger was started again.

    The package keeps the last ones alone.
    """
    from nptdms.reader import TdmsReader
    from nptdms.timestamp import TdmsTimestamp

    reader, found, counts = TdmsReader(stream), dict[str, list[Piece]](), Counter[str]()
    keep = reader._update_object_properties

    def see(properties: Mapping[str, Sequence[tuple[str, Any]]] | None) -> None:
        for path, pairs in (properties or {}).items():
            said = {key: value.as_datetime64() if isinstance(value, TdmsTimestamp) else value for key, value in pairs}
            before = found.setdefault(path, [(0, {})])
            begin, known = before[-1]
            if counts[path] > begin and any(known.get(key, value) != value for key, value in said.items()):
                before.append((counts[path], known | said))
            else:
                known.update(said)
        keep(properties)
        counts.update({path: one.num_values - counts[path] for path, one in reader.object_metadata.items()})

    reader._update_object_properties = see
    reader.read_metadata(require_segment_indexes=False)
    return found


def _channel(channel: Any, group: Sequence[Any], pieces: Sequence[Piece], place: str) -> Channel:
    at = f"{place}, '{shown(channel.name)}'"

    def beside(key: str) -> Cells | None:
        found = next((one for one in group if one.name == key and channel.name == "value"), None)
        return None if found is None else cells_of(np.asarray(found[:]), at)

    cells, remark = marked(cells_of(np.asarray(channel[:]), at), beside, at)
    clock = None
    if _has_clock(channel):
        clock, anew = _clock_of_pieces(pieces or [(0, channel.properties)], len(cells), at)
        remark = remark or anew
    _refuse_other_scales(pieces, at)
    return Channel(channel.name, cells, clock, _unit(channel), remark)


def _has_clock(channel: Any) -> bool:
    """Whether a channel is a waveform over time; a spectrum has another unit along its axis."""
    along = str(channel.properties.get("wf_xunit_string", "s")).strip()
    return "wf_increment" in channel.properties and along in ("", "s", "sec", "seconds")


def _unit(channel: Any) -> str:
    return str(channel.properties.get("unit_string", "") or channel.properties.get("NI_UnitDescription", ""))


def _refuse_other_scales(pieces: Sequence[Piece], place: str) -> None:
    """Refuse samples of several scales or units, all of which would be read by the last."""
    scales = [
        {key: value for key, value in known.items() if key.startswith("NI_Scale") or key == "unit_string"}
        for _, known in pieces
    ]
    for (begin, _), scale, before in zip(pieces[1:], scales[1:], scales, strict=False):
        if scale != before:
            raise RunError(f"{place}: its scale or unit is another from sample {begin + 1} on; save the parts apart")


def _clock_of_pieces(pieces: Sequence[Piece], count: int, place: str) -> tuple[Clock, str]:
    """A channel's clock, and what is to be told where it was started anew amid the samples."""
    ends = [*(begin for begin, _ in pieces[1:]), count]
    clocks = [_clock(known, end - begin, place) for (begin, known), end in zip(pieces, ends, strict=True)]
    first, starts = clocks[0], [clock.start_ns for clock in clocks]
    if len({clock.said for clock in clocks}) == 1:
        return _clock(pieces[0][1], count, place), ""
    anew = f"its clock is set anew: {'; '.join(clock.said for clock in clocks[:5])}"
    if None in starts and len(set(starts)) > 1:
        raise RunError(f"{place}: {anew}; one tells no date: save the parts apart")
    times = [clock.time_s + ((clock.start_ns or 0) - (first.start_ns or 0)) / NS for clock in clocks]
    joined = replace(first, time_s=np.concatenate(times))
    spans = np.diff(joined.time_s)
    goes_on = np.allclose(spans, np.median(spans), rtol=0.1, atol=0.0)  # as where each block tells its own start
    return joined, "" if goes_on else f"{place}: {anew}"


def _clock(properties: Mapping[str, Any], count: int, place: str) -> Clock:
    """When a waveform was sampled, by its date, its offset and its period."""
    try:
        offset, increment = float(properties.get("wf_start_offset", 0.0)), float(properties["wf_increment"])
    except (TypeError, ValueError):
        raise RunError(f"{place}: wf_start_offset and wf_increment are not numbers") from None
    start = properties.get("wf_start_time")
    start_ns = None
    if isinstance(start, np.datetime64) and not np.isnat(start) and start != NO_START:
        start_ns = int(start.astype("datetime64[us]").astype(np.int64)) * 1000
    said = f"from {start if start_ns is not None else 'no date'} + {offset:g} s every {increment:g} s"
    return Clock(start_ns, offset + increment * np.arange(count, dtype=np.float64), said)
