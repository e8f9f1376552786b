"""Tables with units: pandas DataFrames whose column names carry the unit, and whose ``attrs["units"]`` say it again."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

if TYPE_CHECKING:
    from rig.recording import RecordingFile
    from rig.runlog import PlateauRow, Run

UNITS = "units"
# How a column's name ends, and the unit; an ending that is part of another comes behind it.
ENDINGS = {
    "_bar_abs": "bar",
    "_bar_gauge": "bar",
    "_l_min": "L/min",
    "_rpm": "rpm",
    "_kg_s": "kg/s",
    "_m_s": "m/s",
    "_rad": "rad",
    "_nm": "N m",
    "_kg": "kg",
    "_n": "N",
    "_w": "W",
    "_c": "degC",
    "_s": "s",
}


def unit_of(column: str) -> str:
    """The unit that a column's name ends in; empty where it has none."""
    return next((unit for ending, unit in ENDINGS.items() if column.endswith(ending)), "")


def with_units(frame: pd.DataFrame, units: Mapping[str, str] | None = None, **attrs: Any) -> pd.DataFrame:
    """A table whose ``attrs`` say the unit of each column that has one, and what else is given.

    `units`: of the columns; by their names if left out.
    """
    found = units if units is not None else {str(name): unit_of(str(name)) for name in frame.columns}
    frame.attrs |= {UNITS: {name: unit for name, unit in found.items() if unit}} | attrs
    return frame


def of_file(file: RecordingFile) -> pd.DataFrame:
    """A recording's file. Where a column has values off the instrument's scale, ``NAME_censored`` tells which.

    It is -1 where the true value is below the one shown, 1 where it is above, 0 elsewhere.
    """
    columns: dict[str, Any] = {}
    for name, column in file.columns.items():
        columns[name] = column.values
        if column.censor.any():
            columns[f"{name}_censored"] = column.censor
    if file.direction is not None:
        columns["direction"] = file.direction.astype(object)
    columns |= {name: values for name, values in file.extra.items() if name not in columns}
    index = pd.RangeIndex(1, file.rows + 1, name="row")
    units = {name: unit_of(name) for name in file.columns}
    return with_units(pd.DataFrame(columns, index=index), units, kind=file.kind, start_s=file.start_s)


def of_channels(run: Run) -> dict[str, pd.DataFrame]:
    """The readings of a run, a table for each ``device.channel``; failed readings are there, without a value."""
    found = {}
    for (device, channel), rows in run.samples.groupby(["device", "channel"], sort=False):
        name = str(channel)
        kept = {"time_s": rows["time_s"], name: rows["value"], "quality": rows["quality"], "detail": rows["detail"]}
        frame = pd.DataFrame(kept).reset_index(drop=True)
        frame[f"{name}_censored"] = rows["censored"].to_numpy(dtype=np.int8)
        found[f"{device}.{name}"] = with_units(frame, {"time_s": "s", name: str(rows["unit"].iloc[-1])})
    return found


def of_plateaus(plateaus: Sequence[PlateauRow]) -> pd.DataFrame:
    """The plateaus of a run that count: means, with their standard errors (``_se``), and readings (``_n``)."""
    from rig.runlog.plateaus import QUANTITIES, Mean

    names = [name for name in QUANTITIES if any(name in one.means for one in plateaus)]
    own = ("n", "level_bar_abs", "direction", "repeat", "start_s", "end_s", "settled", "note")
    columns: dict[str, Any] = {name: [getattr(one, name) for one in plateaus] for name in own}
    for name in names:
        means = [one.means.get(name, Mean(np.nan, n=0)) for one in plateaus]
        columns[name] = [mean.mean for mean in means]
        columns[f"{name}_se"] = np.array([mean.se for mean in means], dtype=float)
        columns[f"{name}_n"] = [mean.n for mean in means]
        if any(mean.censored for mean in means):
            columns[f"{name}_censored"] = [mean.censored for mean in means]
    columns["level_bar_abs"] = np.array(columns["level_bar_abs"], dtype=float)
    units = {"level_bar_abs": "bar", "start_s": "s", "end_s": "s"}
    units |= {f"{name}{part}": unit_of(name) for name in names for part in ("", "_se")}
    return with_units(pd.DataFrame(columns), units)


def of_steady(files: Sequence[RecordingFile]) -> pd.DataFrame:
    """The rows of a recording's steady files, with the file and the row that each is."""
    steady = [(file.file, of_file(file)) for file in files if file.kind == "steady"]
    if not steady:
        return with_units(pd.DataFrame({"file": [], "row": []}))
    parts = [frame.reset_index().assign(file=name) for name, frame in steady]
    frame = pd.concat(parts, ignore_index=True)
    frame.attrs = {}
    ahead = ["file", "row"]
    frame = frame[[*ahead, *(name for name in frame.columns if name not in ahead)]]
    return with_units(frame, {name: unit for _, one in steady for name, unit in one.attrs[UNITS].items()})


def of_events(run: Run | None) -> pd.DataFrame:
    """The events of a run; ``details`` is what each says beyond its kind. No rows without a run."""
    events = run.events if run is not None else []
    rows = [(one.time_s, one.utc, one.event, one.details) for one in events]
    return with_units(pd.DataFrame(rows, columns=["time_s", "utc", "event", "details"]))


def of_next_tests(document: Mapping[str, Any]) -> pd.DataFrame:
    """The tests that a diagnosis or a comparison asks for; ``needs`` is an instrument that the bench has not."""
    columns = ["test", "separates", "information_nats", "range_nats", "repeats", "needs", "command"]
    return pd.DataFrame(document["next_tests"], columns=columns)


def as_html(title: str, sentences: Sequence[str], *tables: pd.DataFrame) -> str:
    """A title, sentences and tables for a notebook; all text in them is escaped."""
    parts = [f"<p><strong>{html.escape(title)}</strong></p>"]
    parts += [f"<p>{html.escape(one)}</p>" for one in sentences]
    return "\n".join([*parts, *(table.to_html(border=0, float_format="{:.5g}".format) for table in tables)])
