"""Writing a recording: into a hidden folder beside it first, read back, and only then given its name."""

from __future__ import annotations

import contextlib
import csv
import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rig.recording.columns import FIGURES, FLAGS
from rig.recording.contents import Channel, Column, Recording, RecordingError, RecordingFile
from rig.recording.files import beside
from rig.recording.folder import RefusedError, parts
from rig.recording.mistakes import shown
from rig.recording.read import TOML, read_recording
from rig.recording.safe_text import harmless
from rig.recording.schema import FORMAT, OF_SPEED

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_SIGN = {0: "", -1: "<", 1: ">"}


class PlaceError(RecordingError):
    """A recording cannot be where it is to be written; the text names that place."""


def write_recording(recording: Recording, folder: Path, beside_it: Mapping[str, str] | None = None) -> None:
    """Write a recording as a recording/1 folder that `read_recording` reads back.

    Figures that a channel lists as defaulted are left out, so that they are read back as defaults. Text of an unknown
    column that a spreadsheet would run as a formula gets an apostrophe in front.

    `recording`: what to write; `folder`, `warnings` and `sha256` of it are not used.
    `beside_it`: further text files of the folder: name and content.
    Raises RecordingError when the folder exists, cannot be made, or what was written would not be read back. Nothing is
    left behind.
    """
    folder = Path(folder)
    if os.path.lexists(folder):
        raise PlaceError(f"{folder}: exists already; nothing is overwritten, give a name that is free")
    try:
        with beside(folder.parent) as hidden:
            whole = hidden / folder.name
            whole.mkdir()
            _write_into(recording, whole)
            for name, text in (beside_it or {}).items():
                with _durable(whole / name) as stream:
                    stream.write(text)
            read_recording(whole)
            whole.rename(folder)
    except RecordingError as error:
        raise RecordingError(str(error).replace(str(whole), str(folder))) from None
    except RefusedError as refusal:
        raise RecordingError(f"{folder}: {refusal}") from None
    except UnicodeError as error:
        what = shown(error.object) if isinstance(error, UnicodeEncodeError) else str(error)
        raise RecordingError(
            f"{folder}: not UTF-8: '{what}'; give the file, the run or the text another name"
        ) from None
    except OSError as error:
        raise PlaceError(f"{folder}: cannot be written ({error.strerror}); check the place and the space") from None


def _write_into(recording: Recording, folder: Path) -> None:
    with _durable(folder / TOML) as stream:
        stream.write(_toml(recording))
    for entry in recording.files:
        path = folder.joinpath(*parts(entry.file))
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            raise RefusedError(f"'{entry.file}' would be written twice; give each file its own name")
        with _durable(path) as stream:
            _write_rows(entry, csv.writer(stream, lineterminator="\n"))


@contextlib.contextmanager
def _durable(path: Path) -> Iterator[Any]:
    """A new text file that is on the disk when it is closed."""
    with path.open("x", encoding="utf-8", newline="") as stream:
        yield stream
        stream.flush()
        os.fsync(stream.fileno())


def _write_rows(entry: RecordingFile, writer: Any) -> None:
    columns: dict[str, Callable[[int], str]] = {}
    for name, column in entry.columns.items():
        columns[name] = _flag_cell(column) if name in FLAGS else _number_cell(column, name)
    if entry.direction is not None:
        columns["direction"] = _text_cell(entry.direction)
    for name, cells in entry.extra.items():
        columns[harmless(name)] = _text_cell(cells)
    for name, length in _lengths(entry).items():
        if length != entry.rows:
            raise RefusedError(f"'{entry.file}', column {name}: {length} values in {entry.rows} rows")
    writer.writerow(columns)
    for row in range(entry.rows):
        writer.writerow([cell(row) for cell in columns.values()])


def _lengths(entry: RecordingFile) -> dict[str, int]:
    lengths = {name: len(column.values) for name, column in entry.columns.items()}
    lengths |= {f"{name} (censor)": len(column.censor) for name, column in entry.columns.items()}
    lengths |= {name: len(cells) for name, cells in entry.extra.items()}
    return lengths | ({} if entry.direction is None else {"direction": len(entry.direction)})


def _number_cell(column: Column, name: str) -> Callable[[int], str]:
    """A reading to its last bit; speed 0 is censored by being 0 and needs no sign."""
    at_rest = (0.0, -1) if name == "speed_rpm" else None

    def cell(row: int) -> str:
        value, censor = float(column.values[row]), int(column.censor[row])
        sign = "" if (value, censor) == at_rest else _SIGN[censor]
        return "" if math.isnan(value) else f"{sign}{value!r}"

    return cell


def _flag_cell(column: Column) -> Callable[[int], str]:
    return lambda row: "" if math.isnan(column.values[row]) else f"{column.values[row]:g}"


def _text_cell(cells: np.ndarray) -> Callable[[int], str]:
    return lambda row: harmless(str(cells[row]))


def _toml(recording: Recording) -> str:
    """recording.toml."""
    tables: list[tuple[str, Mapping[str, Any]]] = [("ambient", vars(recording.ambient))]
    tables += [(f"channels.{_key(name)}", _figures(channel)) for name, channel in recording.channels.items()]
    if recording.added_inertia_kg_m2:
        tables.append(("rig", {"added_inertia_kg_m2": recording.added_inertia_kg_m2}))
    tables += [("supply", vars(recording.supply)), ("origin", recording.origin)]
    head = {"format": FORMAT, "motor": recording.motor}
    text = "".join(f"{key} = {_value(value)}\n" for key, value in head.items())
    for name, table in tables:
        text += _table(f"[{name}]", table)
    for entry in recording.files:
        keys = ("file", "kind", "start_s", "noise_scale", *["added_inertia_kg_m2"] * (entry.added_inertia_kg_m2 > 0.0))
        text += _table("[[files]]", {key: getattr(entry, key) for key in keys})
    return text


def _table(header: str, table: Mapping[str, Any]) -> str:
    stated = [f"{_key(key)} = {_value(value)}\n" for key, value in table.items() if value is not None]
    return f"\n{header}\n{''.join(stated)}" if stated else ""


def _figures(channel: Channel) -> dict[str, float | str | None]:
    stated = [name for name in FIGURES if name not in channel.defaulted]
    told = {name: getattr(channel, name) for name in (*stated, *OF_SPEED, "serial", "calibrated")}
    return told | {"drift_sd": channel.drift_sd or None}


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _value(key)


def _value(value: Any) -> str:
    """A TOML value; tables inline."""
    if isinstance(value, np.generic):
        return _value(value.item())
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise RefusedError(f"{value} cannot be recorded; a figure is finite, or left out")
        return repr(float(value))
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(part)}" for key, part in value.items() if part is not None) + "}"
    raise RefusedError(f"a {type(value).__name__} cannot be recorded; use numbers, text, lists and tables")
