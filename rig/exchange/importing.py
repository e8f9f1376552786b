"""Data taken elsewhere, as a run of this tool or, of another rig, as a recording; the mapping's motor decides."""

from __future__ import annotations

import itertools
import math
import re
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rig.exchange.converted import Converted, convert
from rig.exchange.doubts import numbers_for_headings, other_times, other_units
from rig.exchange.export import NOTES
from rig.exchange.mapping import FileTable, Mapping
from rig.exchange.placing import capture_of, starts_by_dates, times_on_one_clock
from rig.exchange.tables import Table, read_table
from rig.readings import NS, Exchange, Quality, Reading
from rig.recording import Ambient, Channel, Recording, RecordingError, RecordingFile, write_recording
from rig.recording.columns import FIGURES, MEASURED, NUMERIC, OF_CHANNEL, PRESSURE, ROLES
from rig.recording.files import beside, sync_folder
from rig.recording.mistakes import shown
from rig.recording.schema import ChannelTable, channel_of, motor_of
from rig.recording.write import PlaceError
from rig.runlog.folder import A_FILE, RunError, make_folder, sha256_of
from rig.runlog.plateaus import QUANTITIES
from rig.runlog.rows import utc_text
from rig.runlog.schema import CAPTURE, ZERO, AmbientRecord, ChannelRecord, ClockRecord, DeviceRecord, StartRecord
from rig.runlog.start import source, versions
from rig.runlog.writer import RunWriter

DEVICE = "import"
MOST_NAME = 255
SAMPLED = (*QUANTITIES, "supply_open")
COLUMN_OF = {role: OF_CHANNEL[role].column for role in ROLES if role != "pressure"}


Tell = Callable[[str], None]


def import_files(
    files: Sequence[Path],
    mapping: Mapping,
    target: Path,
    as_recording: bool = False,
    tell: Tell = lambda words: None,
) -> Path:
    """Import files: as a run in the folder of runs or, when the mapping holds another rig's motor, as a recording.

    `target`: where runs are kept, or the recording's folder to make.
    `as_recording`: whether data of a motor by name become a recording too.
    `tell`: of each thing that was left out, in words.
    Returns the run's folder, or the recording's.
    """
    is_run = isinstance(mapping.file.motor, str) and not as_recording
    return (import_table if is_run else import_recording)(files, mapping, target, tell)


def import_table(files: Sequence[Path], mapping: Mapping, root: Path, tell: Tell = lambda words: None) -> Path:
    """Write tables as a run of kind ``import``; its readings count as unverified, for nothing here checked them.

    Returns the run's folder. No run is made and RunError is raised when a file cannot be read as the mapping says, or
    RecordingError when what it gives would be no recording.
    """
    parts = _converted(files, mapping, tell)
    columns = {name for part in parts for name in part.columns}
    foreign = sorted(columns - {"time_s", *SAMPLED})
    if foreign:
        raise RunError(
            f"{mapping.path}: {', '.join(foreign)}: not in a run of this motor; make a recording of it with -o, or, "
            "of another rig, give it as a table [motor]"
        )
    with tempfile.TemporaryDirectory() as place:
        _write(parts, mapping, Path(place) / "recording")
    times = times_on_one_clock(mapping.path, parts)
    for part, times_ns in zip(parts, times, strict=True):
        capture_of(part, times_ns)  # which may refuse it
        if part.entry.noise_scale != 1.0:
            tell(f"{part.entry.file}: a run has no noise_scale; make a recording with -o, or it counts as 1")
    paths = sorted({path for path, _ in _entries(files, mapping)})
    return _write_run(_start(mapping, columns), paths, list(zip(parts, times, strict=True)), Path(root))


def _write_run(
    start: StartRecord, paths: Sequence[Path], parts: Sequence[tuple[Converted, list[int]]], root: Path
) -> Path:
    """Write the parts, with their times [ns], as a run, hidden until it is whole: half of one would be a killed run."""
    try:
        root.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise RunError(f"{root}: {A_FILE}") from None
    with beside(root) as hidden:
        try:
            with RunWriter.create(hidden, start, wire=False) as writer:
                for path in paths:
                    writer.event("import", 0, file=path.name, sha256=sha256_of(path))
                plateaus = 0
                for part, times_ns in parts:
                    plateaus = _write_part(writer, part, times_ns, plateaus)
                sealed = writer.end("finished")
            if sealed.outcome != "finished":  # the disk does not keep it
                raise RunError(sealed.reason)
        except RunError as error:
            raise RunError(f"{str(error).replace(str(hidden), str(root))}; no run was made") from None
        folder = make_folder(root, writer.name)
        writer.folder.rename(folder)
    sync_folder(root)
    return folder


def import_recording(files: Sequence[Path], mapping: Mapping, folder: Path, tell: Tell = lambda words: None) -> Path:
    """Write tables as a recording/1 folder.

    `mapping`: from `read_mapping`; its motor may be a table of another rig.
    Returns the folder. Raises RunError when a file cannot be read as the mapping says; RecordingError when what it
    gives is no recording.
    """
    parts = _converted(files, mapping, tell)
    paths = sorted({path for path, _ in _entries(files, mapping)})
    lines = [mapping.file.title, f"source: {mapping.file.source}", f"licence: {mapping.file.licence}"]
    named = [(shown(mapping.path.name, MOST_NAME), shown(path.name, MOST_NAME), sha256_of(path)) for path in paths]
    lines += [f"imported with {by} from {name}, SHA-256 {sha256}" for by, name, sha256 in named]
    lines += [words for part in parts for words in part.notes]
    Path(folder).parent.mkdir(parents=True, exist_ok=True)
    _write(parts, mapping, Path(folder), "\n".join(lines) + "\n")
    return Path(folder)


def _write(parts: Sequence[Converted], mapping: Mapping, folder: Path, notes: str = "") -> None:
    """Write the parts as a recording, with notes. Raises RecordingError with the places of the sources."""
    columns = {name for part in parts for name in part.columns}
    ambient = Ambient(**mapping.file.ambient.model_dump())
    channels = {name: _channel(mapping, name) for name in MEASURED if name in columns}
    named = _names(parts)
    recorded = tuple(
        RecordingFile(
            name, part.entry.kind, part.entry.start_s, part.entry.noise_scale, part.rows, part.columns, part.direction
        )
        for name, part in zip(named, parts, strict=True)
    )
    origin = mapping.file.origin.model_dump(exclude_none=True)
    recording = Recording(folder, mapping.file.motor, ambient, channels, recorded, origin=origin)
    try:
        write_recording(recording, folder, {NOTES: notes})
    except PlaceError:
        raise
    except RecordingError as error:
        raise RecordingError(_of_sources(str(error), folder, named, parts, mapping)) from None


def _entries(files: Sequence[Path], mapping: Mapping) -> list[tuple[Path, FileTable]]:
    """What is made of which file. Every file is used, and every entry has one."""
    paths = [Path(file) for file in files]
    if not mapping.file.files:
        kind = mapping.file.kind or "steady"
        return [(path, FileTable(file=path.name, kind=kind)) for path in paths]
    known = {path.name: path for path in paths}
    missing = sorted({entry.file for entry in mapping.file.files} - set(known))
    unused = sorted(set(known) - {entry.file for entry in mapping.file.files})
    if missing or unused or len(known) < len(paths):
        words = [f"'{shown(name)}' is named in [[files]] and was not given" for name in missing]
        words += [f"'{shown(name)}' was given and is not named in [[files]]" for name in unused]
        words += ["two files have one name"] * (len(known) < len(paths))
        raise RunError("\n".join(f"{mapping.path}: {word}" for word in words))
    return [(known[entry.file], entry) for entry in mapping.file.files]


def _converted(files: Sequence[Path], mapping: Mapping, tell: Tell) -> list[Converted]:
    if not files:
        raise RunError(f"{mapping.path}: no file was given to import")
    parts = []
    columns = [source.column for source in mapping.file.columns.values()]
    wanted = [key for one in columns if one is not None for key in (one if isinstance(one, list) else [one])]
    for path, entry in _entries(files, mapping):
        only = [entry.only.column] if entry.only else []
        table = read_table(path, mapping.file.table, entry.sheet, entry.group, [*wanted, *only], entry.rows)
        _refuse_gaps(mapping, entry, table)
        part = convert(mapping.file, entry, table)
        part.notes += [
            *other_units(mapping.file, table),
            *other_times(mapping.file, table),
            *numbers_for_headings(mapping.file, table),
            *table.remarks,
        ]
        part.notes += [f"{table.place}: {table.clocks}; on one time line, with empty cells between"] * bool(
            table.clocks
        )
        part.notes = [shown(words, len(words)) for words in part.notes]  # a file's name may hold anything
        for words in part.notes:
            tell(words)
        if entry.kind == "transient" and "time_s" not in part.columns:
            raise RunError(
                f"{table.place}: a transient needs time_s; where the source has no times, give [columns.time_s] "
                "sample_period_s = .."
            )
        parts.append(part)
    for words in [*_refuse_twice(mapping, parts), *starts_by_dates(mapping.file, parts)]:
        tell(words)
    return parts


def _refuse_twice(mapping: Mapping, parts: Sequence[Converted]) -> list[str]:
    """Refuse readings that are given twice, for they would count twice; and where a few rows are, say so."""
    notes = []
    for one, other in itertools.combinations([part for part in parts if part.entry.kind != "zero"], 2):
        read = [name for name in MEASURED if name in one.columns and name in other.columns]
        values = [b"".join(part.columns[name].values.tobytes() for name in read) for part in (one, other)]
        names = " and ".join(dict.fromkeys(part.entry.file for part in (one, other)))
        if read and one.rows > 1 and values[0] == values[1]:
            raise RunError(f"{mapping.path}: {names}: the same readings twice, which would count twice; give them once")
        same = [getattr(one.entry, key) == getattr(other.entry, key) for key in ("file", "sheet", "group")]
        lines = sorted(set(one.lines) & set(other.lines))
        if all(same) and lines and mapping.file.files:
            notes.append(f"{names}, lines {lines[0]} to {lines[-1]}: two of [[files]] take them, and they count twice")
    return notes


def _refuse_gaps(mapping: Mapping, entry: FileTable, table: Table) -> None:
    """Refuse columns of several clocks where the empty cells between would mean something else than no sample."""
    columns = mapping.file.columns
    held = [name for name in ("supply_open", "rotor_locked", "angle_rad", "direction") if name in columns]
    made = [name for name, source in columns.items() if source.differentiate]
    why = [f"a {entry.kind} file has whole rows"] * (entry.kind != "transient")
    why += ["average_rows takes whole rows"] * (entry.average_rows > 1)
    why += [f"{name} holds between its samples" for name in held] + [f"{name} is made of differences" for name in made]
    why += [f"drop_repeats of {name} needs its own rows" for name, source in columns.items() if source.drop_repeats]
    if table.clocks and why:
        raise RunError(f"{table.place}: {table.clocks}; {why[0]}: save the channels on one clock, or import one")


def _names(parts: Sequence[Converted]) -> list[str]:
    """A CSV name for each part, none twice."""
    names: list[str] = []
    for part in parts:
        stem = part.entry.name or "".join(c if c.isalnum() and c.isascii() else "_" for c in Path(part.entry.file).stem)
        stem = stem.strip("_") or "data"
        number = 1
        while (name := f"{stem}.csv" if number == 1 else f"{stem}_{number}.csv") in names:
            number += 1
        names.append(name)
    return names


def _of_sources(text: str, folder: Path, names: Sequence[str], parts: Sequence[Converted], mapping: Mapping) -> str:
    """What is wrong with a recording that was not written, told of the files that it would be made of."""
    for name, part in zip(names, parts, strict=True):
        there = rf"(?<!\S){re.escape(str(folder / name))}"

        def of_source(found: re.Match[str], part: Converted = part) -> str:
            line = f", line {part.lines[int(found[1]) - 1]}" if found[1] else ""
            return f"{part.entry.file}{line}{f', column {found[2]}' if found[2] else ''}"

        text = re.sub(rf"{there}(?:, row (\d+)(?:, column (\w+))?)?", of_source, text)
    # The folder may be called as anything in the text, such as bar: it is one where a line begins with it.
    there = re.escape(str(folder))
    return re.sub(
        rf"(?<!\S){there}/recording\.toml|^{there}(?=[:,])", lambda _: str(mapping.path), text, flags=re.MULTILINE
    )


def _channel(mapping: Mapping, name: str) -> Channel:
    table = mapping.file.columns[name]
    return channel_of(name, ChannelTable(**{key: getattr(table, key) for key in FIGURES}))


def _start(mapping: Mapping, columns: set[str]) -> StartRecord:
    file = mapping.file
    now_ns = time.time_ns()
    pressure = next((name for name in PRESSURE if name in columns), None)
    roles = {role: f"{DEVICE}.{name}" if name in columns else None for role, name in COLUMN_OF.items()}
    channels = {
        name: ChannelRecord(unit=NUMERIC[name].unit, **{key: getattr(file.columns[name], key) for key in FIGURES})
        for name in SAMPLED
        if name in columns
    }
    return StartRecord(
        kind="import",
        bench=mapping.path.stem,
        title=file.title,
        utc_start=utc_text(now_ns),
        clock=ClockRecord(utc_start_ns=now_ns),
        operator=file.origin.operator or "",
        note=file.origin.note or "",
        parent=file.origin.parent,
        motor=motor_of(file.motor, mapping.path.parent),
        motor_serial=file.origin.motor_serial or "",
        lubrication=file.origin.oil or "",
        ambient=AmbientRecord(**file.ambient.model_dump()),
        roles={"pressure": f"{DEVICE}.{pressure}" if pressure else None, **roles},
        devices={DEVICE: DeviceRecord(instrument=file.title, channels=channels)},
        versions=versions(),
        sources={mapping.path.name: source(mapping.data)},
        imported={"title": file.title, "source": file.source, "licence": file.licence, "date": file.origin.date or ""},
    )


def _write_part(writer: RunWriter, part: Converted, times_ns: list[int], plateaus: int) -> int:
    """The rows of one file; returned is the number of plateaus written so far."""
    for row, time_ns in enumerate(times_ns):
        readings = _readings(part, row, time_ns)
        writer.exchange(Exchange(DEVICE, DEVICE, "import", None, (), readings))
        if part.entry.kind == "steady":
            plateaus += 1
            writer.plateau(_plateau(part, row, plateaus, time_ns, readings))
    first, last = min(times_ns), max(times_ns)
    span = {"start_s": first / NS, "end_s": last / NS}
    if part.entry.kind == "zero":
        writer.event(ZERO, last, which=part.entry.file, vented=True, **span)
    elif part.entry.kind == "transient":
        writer.event(CAPTURE, last, file=part.entry.file, **span, **capture_of(part, times_ns))
    return plateaus


def _readings(part: Converted, row: int, time_ns: int) -> tuple[Reading, ...]:
    readings = []
    for name, column in part.columns.items():
        value, censored = float(column.values[row]), int(column.censor[row])
        if name == "time_s" or math.isnan(value):
            continue
        cells = part.cells.get(name)
        raw, unit = cells[row] if cells else "", NUMERIC[name].unit
        readings.append(
            Reading(DEVICE, name, value, unit, Quality.UNVERIFIED, time_ns, time_ns, time_ns, 0, raw, "", censored)
        )
    return tuple(readings)


def _plateau(part: Converted, row: int, number: int, time_ns: int, readings: tuple[Reading, ...]) -> dict[str, object]:
    sign = {-1: "<", 0: "", 1: ">"}
    cells: dict[str, object] = {"n": number, "start_s": time_ns / NS, "end_s": time_ns / NS, "note": part.entry.file}
    if part.direction is not None:
        cells["direction"] = str(part.direction[row])
    for reading in readings:
        if reading.channel in QUANTITIES and reading.value is not None:
            off = sign[reading.censored]
            cells[reading.channel] = f"{off}{reading.value!r}" if off else reading.value
            cells[f"{reading.channel}_n"] = 1
    return cells
