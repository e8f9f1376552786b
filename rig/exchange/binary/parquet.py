"""Parquet files, with pyarrow: tables of columns, and the samples of a run as its export writes them.

Those have a row a reading. Each channel, `device.channel`, has its own clock there, as in the other formats.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rig.exchange.binary.clocks import Channel, Clock, on_one_time_line
from rig.exchange.binary.columns import (
    FEW,
    MAX_BYTES,
    MAX_ROWS,
    WAVEFORM_TIME,
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

SAMPLES = ("device", "channel", "value", "unit", "quality", "censored", "time_ns")  # of the export of a run
NS = 1e9
_UNIT_KEYS = (b"unit", b"units", b"Unit", b"Units")


def read(path: Path, group: str, wanted: Wanted) -> Columns:
    """The columns that are taken. Raises RunError where one is not there, there twice, or neither numbers nor text."""
    with open_plain(path, MAX_BYTES) as stream:
        file = _opened(stream, path)
        if _is_run(file):
            channels = _channels(file, path)
            refuse_unknown(str(path), wanted, [one.name for one in channels])
            taken = [one for one in channels if not by_name(wanted) or one.name in wanted]
            return on_one_time_line(str(path), taken or channels, wanted)
        if WAVEFORM_TIME in wanted:
            raise RunError(f"{path}: its columns have no clock of their own; take one of them as time_s")
        names = file.schema_arrow.names
        refuse_unknown(str(path), wanted, names)
        places = range(1, len(names) + 1)
        asked = {names[key - 1] if isinstance(key, int) else key for key in wanted if key in names or key in places}
        if by_name(wanted):
            names = [name for name in dict.fromkeys(names) if name in asked] or names
        blank: Cells = [""] * file.metadata.num_rows  # for what is not taken, and may be no column
        taken = [_column(file, path, name) if name in asked else Channel(name, blank) for name in names]
        return on_one_time_line(str(path), taken, wanted)


def listed(path: Path) -> list[Listed]:
    """Every column of numbers or text; of a run every channel."""
    with open_plain(path, MAX_BYTES) as stream:
        file = _opened(stream, path)
        if _is_run(file):
            found = _channels(file, path)
        else:
            found = [one for name in file.schema_arrow.names if (one := _listed(file, path, name)) is not None]
        return [Listed("", one.name, one.unit, len(one.cells), one.cells[:FEW], one.clock is not None) for one in found]


def _listed(file: Any, path: Path, name: str) -> Channel | None:
    try:
        return _column(file, path, name)
    except RunError:  # it is no column
        return None


def _opened(stream: Any, path: Path) -> Any:
    import pyarrow.parquet as pq

    file = pq.ParquetFile(stream)
    if file.metadata.num_rows > MAX_ROWS:
        raise RunError(f"{path}: {file.metadata.num_rows} rows; at most {MAX_ROWS} are read")
    return file


def _is_nested(file: Any, name: str) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_nested(file.schema_arrow.field(name).type))


def _column(file: Any, path: Path, name: str) -> Channel:
    at = f"{path}, '{shown(name)}'"
    if file.schema_arrow.names.count(name) > 1:
        raise RunError(f"{at}: several columns have this name; give them names of their own")
    if _is_nested(file, name):
        raise RunError(f"{at}: it holds lists or records, neither numbers nor text")
    metadata = file.schema_arrow.field(name).metadata or {}
    unit = next((metadata[key].decode("utf-8", "replace") for key in _UNIT_KEYS if key in metadata), "")
    column = file.read(columns=[name], use_threads=False).column(0)
    return Channel(name, _cells(column, at), unit=unit)


def _cells(column: Any, place: str) -> Cells:
    """A column's cells: what is null is NaN among numbers, and empty among words."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if pa.types.is_boolean(kind) or pa.types.is_decimal(kind):
        column = column.cast(pa.float64())
    if pa.types.is_null(column.type):
        return [float("nan")] * len(column)
    if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
        return cells_of(np.asarray(column.to_numpy(), dtype=np.float64), place)
    if pa.types.is_temporal(kind) and not pa.types.is_duration(kind):
        return [_time(cell) for cell in _in_microseconds(column).to_pylist()]
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return [cell or "" for cell in column.to_pylist()]
    raise RunError(f"{place}: holds {kind}, neither numbers nor text")


def _in_microseconds(column: Any) -> Any:
    import pyarrow as pa

    if pa.types.is_timestamp(column.type):
        return column.cast(pa.timestamp("us", column.type.tz), safe=False)
    return column.cast(pa.time64("us"), safe=False) if pa.types.is_time(column.type) else column


def _time(cell: Any) -> str:
    return "" if cell is None else cell.isoformat()


def _is_run(file: Any) -> bool:
    metadata = file.schema_arrow.metadata or {}
    return b"start.json" in metadata and set(SAMPLES) <= set(file.schema_arrow.names)


def _channels(file: Any, path: Path) -> list[Channel]:
    """The channels of a run, in the order in which they were first read."""
    table = file.read(columns=list(SAMPLES), use_threads=False).to_pandas()
    found = []
    for (device, channel), rows in table.groupby(["device", "channel"], sort=False, observed=True):
        name = f"{device}.{channel}"
        at, units = f"{path}, '{shown(name)}'", [str(unit) for unit in rows["unit"].unique() if unit]
        if len(units) > 1:
            raise RunError(f"{at}: it has several units: {', '.join(map(shown, units))}")
        times = rows["time_ns"].to_numpy(dtype=np.float64) / NS
        said = f"{times.size} samples from {times[0]:g} s"
        beside = {key: cells_of(rows[key].to_numpy(), at) for key in ("quality", "censored")}
        cells, remark = marked(cells_of(rows["value"].to_numpy(dtype=np.float64), at), beside.get, at)
        found.append(Channel(name, cells, Clock(0, times, said), "".join(units), remark))
    return found
