"""HDF5 files, among them NeXus, netCDF-4 and MATLAB 7.3, with h5py.

A column is a dataset of one dimension, or a field of a compound one. Its clock is what NeXus or netCDF say it is: the
dataset `time` beside the `value` of a log, the axis of a group, or the scale of its dimension. Nothing is read through
a link to another file.
"""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.exchange.binary.clocks import Channel, Clock, on_one_time_line
from rig.exchange.binary.columns import (
    FEW,
    MAX_ROWS,
    MAX_SERIES,
    WAVEFORM_TIME,
    Cells,
    Columns,
    Listed,
    Wanted,
    by_name,
    cells_of,
)
from rig.exchange.binary.marks import marked
from rig.exchange.binary.missing import missing, written
from rig.recording.mistakes import shown
from rig.runlog.folder import RunError

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86_400.0}
_WORDS = {"sec": "s", "second": "s", "seconds": "s", "millisecond": "ms", "milliseconds": "ms", "µs": "us"}
_WORDS |= {"nanoseconds": "ns", "minute": "min", "minutes": "min", "hour": "h", "hours": "h", "day": "d", "days": "d"}
EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
MOST_LINKS = 8
_PACKED = (("scale_factor", 1.0), ("add_offset", 0.0))


def read(path: Path, group: str, wanted: Wanted) -> Columns:
    """The datasets below a group. Raises RunError where they are not there, or stand on two clocks."""
    import h5py

    with h5py.File(path, "r") as file:
        root = _at(file, group or "/", path)
        place = f"{path}, group '{shown(group)}'" if group else str(path)
        if not isinstance(root, h5py.Group):
            raise RunError(f"{place}: not a group")
        if any(isinstance(key, int) for key in wanted):
            raise RunError(f"{place}: the datasets of an HDF5 file have no order; take them by their paths")
        names = [str(key) for key in wanted if key != WAVEFORM_TIME] if by_name(wanted) else _names(root, path)
        channels = [_channel(root, name, path, place, wanted) for name in dict.fromkeys(names)]
        return on_one_time_line(place, channels, wanted)


def listed(path: Path) -> list[Listed]:
    """Every dataset that could be a column, from the root, but for the clocks of others."""
    import h5py

    with h5py.File(path, "r") as file:
        found, clocks = [], set()
        for name in _names(file, path):
            data, field = _dataset(file, name, path, str(path))
            try:
                cells = cells_of(_values(data, field, f"{path}, '{shown(name)}'", FEW), f"{path}, '{shown(name)}'")
            except RunError:  # it is no column
                continue
            clock = _clock_of(data, path)
            clocks |= {clock.name} if clock is not None else set()
            clocked = clock is not None and _unit(clock)[0] is not None
            found.append(Listed("", name, _text(data.attrs.get("units", "")), int(data.size), cells, clocked))
        return [one for one in found if f"/{one.name}" not in clocks]


def _at(root: Any, name: str, path: Path, links: int = 0) -> Any:
    """What stands at a path of the file; None where nothing does. Raises RunError for what lies in another file."""
    import h5py

    here = root.file["/"] if name.startswith("/") else root
    for part in (part for part in name.split("/") if part):
        link = here.get(part, getlink=True) if isinstance(here, h5py.Group) else None
        if link is None:
            return None
        if isinstance(link, h5py.ExternalLink) or links > MOST_LINKS:
            raise RunError(f"{path}: '{shown(name)}' is a link to another file, or in a circle; it is not followed")
        here = _at(here, link.path, path, links + 1) if isinstance(link, h5py.SoftLink) else here.get(part)
    return here


def _names(root: Any, path: Path) -> list[str]:
    """Datasets of one dimension below a group, and fields of compound ones."""
    import h5py

    names: list[str] = []

    def see(name: str, found: Any) -> None:
        if len(names) > MAX_SERIES:
            raise RunError(f"{path}: more than {MAX_SERIES} datasets; name a group in [table], or the columns")
        if isinstance(found, h5py.Dataset) and found.shape and found.size == max(found.shape) and found.size > 1:
            fields = [key for key in found.dtype.names or () if not found.dtype[key].shape]
            names.extend([f"{name}/{field}" for field in fields] or [name] * (found.dtype.kind in "biufOSU"))

    root.visititems(see)
    return names


def _dataset(root: Any, name: str, path: Path, place: str) -> tuple[Any, str]:
    """A dataset and, of a compound one, the field that is meant."""
    import h5py

    field, found = "", _at(root, name, path)
    if found is None and "/" in name:
        whole, _, field = name.rpartition("/")
        found = _at(root, whole, path)
        found = found if isinstance(found, h5py.Dataset) and field in (found.dtype.names or ()) else None
    if not isinstance(found, h5py.Dataset):
        there = ", ".join(f"'{shown(one)}'" for one in _names(root, path)[:40])
        raise RunError(f"{place}: no dataset is called '{shown(name)}'; there are {there or 'none'}")
    return found, field


def _values(data: Any, field: str, place: str, count: int | None = None) -> NDArray[Any]:
    """A dataset's values, those that stand for none as NaN, packed ones unpacked."""
    if data.external or data.is_virtual:
        raise RunError(f"{place}: its values lie in another file, which is not read")
    if not data.shape or data.size != max(data.shape) or data.size > MAX_ROWS:
        raise RunError(f"{place}: its shape is {data.shape}; a column has one dimension, and at most {MAX_ROWS} rows")
    values = np.asarray(data[()] if count is None or data.ndim > 1 else data[:count]).ravel()[:count]
    values = values[field] if field else values
    if values.ndim > 1:
        raise RunError(f"{place}: it holds {values.shape[1:]} numbers a row; a column has one")
    if values.dtype.kind not in "biuf":
        return values
    known = values.astype(np.float64)
    known[missing(data, field, values, place)] = np.nan
    try:
        scale, offset = (float(np.squeeze(data.attrs.get(key, plain))) for key, plain in _PACKED)
    except (TypeError, ValueError):
        raise RunError(f"{place}: scale_factor or add_offset is not a number") from None
    return known if (scale, offset) == (1.0, 0.0) else known * scale + offset


def _channel(root: Any, name: str, path: Path, place: str, wanted: Wanted) -> Channel:
    import h5py

    data, field = _dataset(root, name, path, place)
    at = f"{place}, '{shown(name)}'"
    cells: Cells = cells_of(_values(data, field, at), at)

    def beside(key: str) -> Cells | None:
        other = _at(data.parent, key, path) if data.name.endswith("/value") else None
        found = isinstance(other, h5py.Dataset) and other.shape == data.shape
        return cells_of(_values(other, "", at), at) if found else None

    cells, marks = marked(cells, beside, at)
    gaps = data.size - int(written(data).sum())
    clock = _clock_of(data, path)
    if clock is not None and WAVEFORM_TIME in wanted and _unit(clock)[0] is None:
        raise RunError(f"{at}: its clock '{shown(clock.name)}' says no unit of time; take it as a column")
    remark = f"{at}: {gaps} of {data.size} values were never written" if gaps else marks
    when = _clock(clock, at) if clock is not None else None
    return Channel(name, cells, when, _text(data.attrs.get("units", "")), remark)


def _clock_of(data: Any, path: Path) -> Any:
    """The dataset that tells when another was sampled; None where the file does not say."""
    import h5py

    parent, own = data.parent, data.name.rpartition("/")[2]
    is_log = own == "value" or _text(parent.attrs.get("NX_class", "")) == "NXlog"
    candidates = [_at(parent, "time", path)] if is_log and own != "time" else []
    axes = np.atleast_1d(parent.attrs.get(f"{own}_axes", parent.attrs.get("axes", [])))
    candidates += [_at(parent, _text(axis), path) for axis in axes[:1] if _text(axis) != own]
    if data.ndim and not data.is_scale and len(data.dims[0]):
        candidates.append(data.dims[0][0])
    for found in candidates:
        if isinstance(found, h5py.Dataset) and found != data and found.dtype.kind in "iuf":
            return found
    return None


def _unit(data: Any) -> tuple[float | None, str]:
    """A time's unit [s], None where it is none; and the date that it is counted from."""
    words = _text(data.attrs.get("units", ""))
    unit, _, since = words.partition(" since ")
    unit = _WORDS.get(unit.strip(), unit.strip())
    return SECONDS.get(unit), since.strip() or _text(data.attrs.get("start", ""))


def _clock(data: Any, place: str) -> Clock:
    unit, start = _unit(data)
    times = np.asarray(_values(data, "", f"{place}, its time"), dtype=np.float64) * (unit or 1.0)
    spans = np.diff(times)
    every = f" every {spans.mean():.6g} s" if spans.size else ""
    first = f"{times[0]:g}" if times.size else "no"
    said = f"from {start or 'no date'} + {first} s{every} ('{shown(data.name)}')"
    return Clock(_nanoseconds(start, place), times, said)


def _nanoseconds(start: str, place: str) -> int | None:
    if not start:
        return None
    try:
        date = datetime.datetime.fromisoformat(start.removesuffix(" UTC").strip())
    except ValueError:
        raise RunError(f"{place}: its times count from '{shown(start)}', which is no date (ISO 8601)") from None
    since = date.replace(tzinfo=date.tzinfo or datetime.UTC) - EPOCH
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
