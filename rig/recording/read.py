"""Reading a recording: recording.toml first, then every file, all mistakes in one error."""

from __future__ import annotations

import codecs
import contextlib
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from configs import ConfigError, read_toml, validate
from rig.recording.columns import MEASURED, NAMES, PRESSURE, siblings
from rig.recording.contents import Ambient, Channel, Recording, RecordingError, RecordingFile, SupplyFigures
from rig.recording.folder import RefusedError, check_plain, inside, open_plain
from rig.recording.header import needed_columns, unknown_warning
from rig.recording.mistakes import Mistakes, shown
from rig.recording.origin import NOT_ISO, mistake_in
from rig.recording.schema import (
    FileTable,
    RecordingTable,
    channel_of,
    check_channels,
    check_motor,
    default_warnings,
    motor_of,
)
from rig.recording.table import EXTRA_BYTES, Plan, Table, read_table

TOML = "recording.toml"
OWN_ZERO_S = 1.0  # a file without start_s that begins no later may count from a zero of its own
_OF_A_PLATEAU = (*PRESSURE, "flow_l_min", "speed_rpm")
PROGRESS_BYTES = 20_000_000  # below it, reading ends before a bar would be seen


def read_recording(path: Path) -> Recording:
    """Read a recording/1 folder. Nothing is guessed and nothing on disk is changed.

    An instrument's figure that is left out takes the default listed in `rig.recording.columns`, and a warning says so.
    Columns come in the units of their names. Raises RecordingError, a line a mistake (20 at most, then a count): file,
    row, column, what was expected, what to do.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    toml = folder / TOML
    if path.name != TOML and path != folder:
        raise RecordingError(f"{path}: a recording is a folder with {TOML}; give the folder, or that file")
    table, data = _read_toml(toml)
    mistakes = Mistakes()
    check_motor(table.motor, folder, str(toml), mistakes)
    check_channels(table.channels, str(toml), mistakes)
    places = _places(folder, table.files, str(toml), mistakes)
    channels = {name: channel_of(name, figures) for name, figures in table.channels.items() if name in MEASURED}
    digest = hashlib.sha256(hashlib.sha256(data).digest())
    tables: list[Table | None] = []
    with _progress(list(places.values())) as advance:
        for index, entry in enumerate(table.files):
            if index in places:
                plan = _plan(entry, table, channels, places[index])
                tables.append(_read_file(places[index], plan, mistakes, digest, advance))
            else:
                tables.append(None)
    _check_used(table, tables, str(toml), mistakes)
    _check_clock(table, tables, str(toml), mistakes)
    mistakes.raise_any()
    motor = motor_of(table.motor, folder)
    if motor != table.motor:  # what is found is another where the project's motor is
        digest.update(json.dumps(motor, sort_keys=True, default=str).encode())
    return _assembled(folder, table, motor, [found for found in tables if found is not None], digest.hexdigest())


def _read_toml(toml: Path) -> tuple[RecordingTable, bytes]:
    """recording.toml, checked, and its bytes."""
    mistakes = Mistakes()
    try:
        check_plain(toml, str(toml))
        data = toml.read_bytes()
        if data.startswith(codecs.BOM_UTF8):
            raise RecordingError(f"{toml}: begins with a byte order mark; save it as UTF-8 without one")
        return validate(RecordingTable, read_toml(toml), str(toml)), data
    except RefusedError as refusal:
        raise RecordingError(f"{refusal}; a recording is a folder with {TOML}") from None
    except OSError as error:
        raise RecordingError(f"{toml}: cannot be read ({error.strerror}); check its permissions") from None
    except ConfigError as error:
        for line in str(error).splitlines():
            mistakes.add(str(toml), shown(line.removeprefix(f"{toml}: "), 400))
    mistakes.raise_any()
    raise AssertionError("a ConfigError without text")


def _places(folder: Path, files: list[FileTable], toml: str, mistakes: Mistakes) -> dict[int, Path]:
    """Where each file stands, by its place in the list; those that may not be opened are noted and left out."""
    places: dict[int, Path] = {}
    seen: dict[tuple[int, int], int] = {}
    for index, entry in enumerate(files):
        where = f"{toml}, [[files]] entry {index + 1}"
        try:
            path = inside(folder, entry.file)
            identity = (path.stat().st_dev, path.stat().st_ino)
        except (RefusedError, OSError) as refusal:
            mistakes.add(where, str(refusal))
            continue
        if identity in seen:
            mistakes.add(where, f"'{shown(entry.file)}' is the file of entry {seen[identity] + 1}; name each file once")
            continue
        seen[identity] = index
        places[index] = path
    return places


def _plan(entry: FileTable, table: RecordingTable, channels: dict[str, Channel], place: Path) -> Plan:
    """What a file is read as."""
    flow = channels.get("flow_l_min") or channel_of("flow_l_min", None)
    lowest = -(6.0 * flow.noise_sd * entry.noise_scale + 3.0 * flow.bias_sd + flow.resolution)
    keep_extra = place.stat().st_size <= EXTRA_BYTES
    return Plan(entry.kind, needed_columns(entry.kind, table.motor), lowest, keep_extra)


def _read_file(
    place: Path, plan: Plan, mistakes: Mistakes, digest: Any, advance: Callable[[int], None]
) -> Table | None:
    content = hashlib.sha256()

    def seen(data: bytes) -> None:
        content.update(data)
        advance(len(data))

    try:
        with open_plain(place) as stream:
            found = read_table(stream, plan, str(place), mistakes, seen)
    except (RefusedError, OSError) as refusal:
        mistakes.add(str(place), str(refusal))
        return None
    digest.update(content.digest())
    return found


def _check_used(table: RecordingTable, tables: list[Table | None], toml: str, mistakes: Mistakes) -> None:
    """What only all the files together show: instruments without a column, transients without an inertia."""
    columns = {name for found in tables if found for name in found.names}
    misnamed = {name for column in columns if mistakes.count and column not in NAMES for name in siblings(column)}
    complete = all(found is not None for found in tables)
    for name in table.channels:
        if name in MEASURED and name not in columns | misnamed and complete:
            other = set(PRESSURE) & columns if name in PRESSURE else set()
            there = f"the files have {', '.join(sorted(other))}" if other else "no file has this column"
            mistakes.add(f"{toml}, [channels.{name}]", f"{there}; name the table as the CSV names the column")
    motor = table.motor
    if isinstance(motor, dict) and "mass_kg" in motor:
        places = {"[rig]": table.rig} | {f"[[files]] '{shown(entry.file)}'": entry for entry in table.files}
        for place, of in places.items():
            if of.added_inertia_kg_m2:
                what = "added_inertia_kg_m2 beside mass_kg: a slide has no shaft; add it to mass_kg"
                mistakes.add(f"{toml}, {place}", what)
    if isinstance(motor, dict) and motor.get("kind") == "displacement_machine" and "inertia_kg_m2" not in motor:
        for entry in table.files:
            if entry.kind == "transient":
                what = f"inertia_kg_m2 is missing, which the transient '{shown(entry.file)}' needs"
                mistakes.add(f"{toml}, [motor]", what)


def _check_clock(table: RecordingTable, tables: list[Table | None], toml: str, mistakes: Mistakes) -> None:
    """No instrument reads two runs in time at once, nor a plateau within a run; zero rows may be anywhere."""
    timed = [
        (entry, when, {name for name in MEASURED if name in found.columns})
        for entry, found in zip(table.files, tables, strict=True)
        if found is not None and entry.kind != "zero" and (when := _when(entry, found)).size
    ]
    for (one, when, mine), (other, then, theirs) in itertools.combinations(timed, 2):
        both = [name for name in MEASURED if name in mine & theirs]
        if not both or one.kind == other.kind == "steady":
            continue
        if not one.start_s and not other.start_s and min(when[0], then[0]) <= OWN_ZERO_S:
            continue
        if one.kind != other.kind:  # a plateau is a point in time
            run, rows = (when, then) if one.kind == "transient" else (then, when)
            shared = rows[(rows > run[0]) & (rows < run[-1])]
        else:
            shared = np.array([max(when[0], then[0]), min(when[-1], then[-1])])
            shared = shared[: 2 * (shared[1] > shared[0])]
        if shared.size:
            mistakes.add(
                toml,
                f"'{shown(one.file)}' and '{shown(other.file)}' overlap by {shared[-1] - shared[0]:.6g} s, from "
                f"{shared[0]:.10g} to {shared[-1]:.10g} s on the recording's clock, and one instrument ({both[0]}) "
                "cannot have read both; put right start_s or time_s",
            )


def _when(entry: FileTable, found: Table) -> np.ndarray:
    """When the rows of a file were read, in order, on the recording's clock [s]; of a run its first and last."""
    if "time_s" not in found.columns:
        return np.empty(0)
    time = found.columns["time_s"].values
    time = time[[0, -1]] if entry.kind == "transient" else time
    return entry.start_s + np.sort(time[np.isfinite(time)])


def _assembled(
    folder: Path, table: RecordingTable, motor: str | dict[str, Any], tables: list[Table], sha256: str
) -> Recording:
    """The recording out of its parts, with the warnings."""
    columns = {name for found in tables for name in found.columns}
    channels = {name: channel_of(name, table.channels.get(name)) for name in MEASURED if name in columns}
    ambient = Ambient(**table.ambient.model_dump())
    warnings = []
    if table.origin.date and (wrong := mistake_in(table.origin.date)):
        counts = "; it counts as not stated" if wrong == NOT_ISO else "; correct it, or results stand in a wrong order"
        warnings.append(f"[origin] date '{shown(table.origin.date)}' {wrong}{counts}")
    files = []
    for entry, found in zip(table.files, tables, strict=True):
        warnings += unknown_warning(found.names, entry.file, kept=bool(found.extra))
        files.append(
            RecordingFile(
                file=entry.file,
                kind=entry.kind,
                start_s=entry.start_s,
                noise_scale=entry.noise_scale,
                rows=found.rows,
                columns=found.columns,
                direction=found.direction,
                extra=found.extra,
                added_inertia_kg_m2=entry.added_inertia_kg_m2,
            )
        )
    return Recording(
        folder=folder,
        motor=motor,
        ambient=ambient,
        channels=channels,
        files=tuple(files),
        added_inertia_kg_m2=table.rig.added_inertia_kg_m2,
        warnings=(*what_lacks(channels, ambient, files), *warnings),
        sha256=sha256,
        supply=SupplyFigures(**table.supply.model_dump()),
        origin=table.origin.model_dump(exclude_none=True),
    )


def what_lacks(channels: dict[str, Channel], ambient: Ambient, files: Sequence[RecordingFile]) -> list[str]:
    """What a recording leaves out, in words: figures and a room that are taken by default, readings of plateaus."""
    told = default_warnings(channels)
    if ambient.pressure_bar_abs is None and set(PRESSURE) & channels.keys():
        told.append("[ambient] leaves out pressure_bar_abs (taken: the motor's default and its prior)")
    return told + [words for file in files for words in _not_read(file)]


def _not_read(found: RecordingFile) -> list[str]:
    """Plateaus that an instrument of the file has no reading of, in words; those with the rotor locked are none."""
    if found.kind != "steady":
        return []
    locked = found.columns.get("rotor_locked")
    turning = np.ones(found.rows, dtype=bool) if locked is None else locked.values != 1.0
    told = []
    for name in _OF_A_PLATEAU:
        empty = np.flatnonzero(np.isnan(found.columns[name].values) & turning) if name in found.columns else np.empty(0)
        if 0 < empty.size < turning.sum():
            rows = f"{', '.join(str(int(row) + 1) for row in empty[:5])}{', ...' * (empty.size > 5)}"
            told.append(f"{found.file}: {name} has no reading in {empty.size} of {found.rows} rows ({rows})")
    return told


@contextlib.contextmanager
def _progress(places: list[Path]) -> Iterator[Callable[[int], None]]:
    """A bar on the error stream for large files (a line where no terminal shows it); nothing for small ones."""
    total = sum(place.stat().st_size for place in places)
    if total <= PROGRESS_BYTES:
        yield lambda count: None
        return
    from rig.progress import bar_of

    progress = bar_of(passing=True)
    if not progress.console.is_terminal:
        progress.console.print(f"reading the recording, {total / 1e6:.0f} MB")
        yield lambda count: None
        return
    with progress:
        task = progress.add_task("reading the recording", total=total)
        yield lambda count: progress.advance(task, count)
