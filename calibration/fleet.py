"""Many recordings at once: a fleet of motors, a year of runs. One table comes out, whatever one recording does.

How a folder is read is given from outside, for a run's folder is read by the rig.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import configs
from calibration.data.dates import as_text, date_of
from calibration.data.joined import as_given
from calibration.data.together import motor_of
from calibration.work import many_table
from calibration.work.many import Item, Tell, run_many
from calibration.work.sources import imported_sha256
from rig.recording.files import write_files

if TYPE_CHECKING:
    from calibration.fit.fit import Fit
    from calibration.fit.sampling import Settings
    from calibration.fit.whole import WholeFit
    from rig.recording import Recording

Read = Callable[[Path], "Recording"]
CSV, PARQUET, RESULTS = "table.csv", "table.parquet", "results"
DIAGNOSES, FITS = "diagnoses", "fits"  # folders of results, one recording's in each


def diagnose_all(
    folders: Sequence[Path], read: Read, seed: int, out: Path, workers: int, scheduler: str | None, tell: Tell
) -> list[dict[str, Any]]:
    """Diagnose recordings, and write one table.

    `read`: reads one; a function of a module.
    `out`: gets ``table.csv``, ``table.parquet`` and a result a recording. What is there is not done again, unless the
        recording, the seed or the code is another.
    `scheduler`: a Dask scheduler instead, whose workers see the folders under the same paths.
    Returns the table's rows.
    """
    items = [item_of(folder, {"seed": seed}, read) for folder in folders]
    task = functools.partial(_diagnose_one, read)
    done = run_many(task, items, out / RESULTS / DIAGNOSES, workers, scheduler, tell)
    rows = [many_table.diagnosis_row(result) for result in done]
    return _write(out, rows, many_table.DIAGNOSIS_COLUMNS, folders)


def fit_all(
    folders: Sequence[Path],
    read: Read,
    settings: Settings,
    steady_only: bool,
    out: Path,
    workers: int,
    scheduler: str | None,
    tell: Tell,
) -> list[dict[str, Any]]:
    """Fit recordings as `spinbench fit` does, and write one table.

    `read`: reads one; a function of a module.
    Returns the table's rows.
    """
    options = {"settings": asdict(settings), "steady_only": steady_only}
    items = [item_of(folder, options, read) for folder in folders]
    task = functools.partial(_fit_one, read)
    done = run_many(task, items, out / RESULTS / FITS, workers, scheduler, tell)
    rows = [many_table.fit_row(result) for result in done]
    return _write(out, rows, many_table.fit_columns(rows), folders)


def write_trend(out: Path, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Write f_overall and the effects that are named along the dates, as ``trend.csv`` and ``trend.png``.

    Returns each trend in a sentence; none where fewer than two recordings tell of anything.
    """
    from calibration.report.comparison import trend

    found = trend.trends(rows)
    contents = {trend.CSV: trend.table(rows)}
    if found:
        contents[trend.PNG] = trend.picture(found)
    write_files(out, contents)
    return [trend.sentence(one) for one in found]


def recordings_in(folders: Sequence[Path], is_recording: Callable[[Path], bool]) -> list[Path]:
    """The recordings that folders are, or hold one level down; each once, in the order given.

    Raises FileNotFoundError when a folder neither is a recording nor holds one.
    """
    found: dict[Path, Path] = {}
    for folder in folders:
        inside = sorted(p for p in folder.iterdir() if p.is_dir() and is_recording(p)) if folder.is_dir() else []
        mine = [folder] if is_recording(folder) else inside
        if not mine:
            raise FileNotFoundError(f"{folder}: neither a recording nor a folder of recordings")
        found |= {one.resolve(): one for one in mine if one.resolve() not in found}
    return list(found.values())


def item_of(folder: Path, options: dict[str, Any], read: Read) -> Item:
    """A recording as an item: a file name of its own, and a mark that changes with its contents and the code.

    `read`: what reads it.
    """
    place = str(folder.resolve())
    slug = re.sub(r"[^A-Za-z0-9._-]", "_", folder.resolve().name)[:60]
    contents = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        contents.update(f"{path.relative_to(folder)} {_sha256(path)}\n".encode(errors="surrogateescape"))
    for motors in configs.places("motors", folder)[1:]:  # a motor that the recording may name
        contents.update(b"".join(path.read_bytes() for path in sorted(motors.glob("*.toml"))))
    code = imported_sha256(__name__, read.__module__)
    mark = f"{contents.hexdigest()}/{json.dumps(options, sort_keys=True)}/{code}"
    name = f"{slug}-{hashlib.sha256(os.fsencode(place)).hexdigest()[:8]}"
    return Item(name, {"folder": place, **options}, mark)


def _sha256(path: Path) -> str:
    """A file's hash; what cannot be read is told by who reads the recording."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        return f"unreadable: {error.strerror}"


def _write(
    out: Path, rows: list[dict[str, Any]], columns: dict[str, str], folders: Sequence[Path]
) -> list[dict[str, Any]]:
    named = [row | {"recording": str(folder)} for row, folder in zip(rows, folders, strict=True)]
    first = {"recording": many_table.TEXT} | columns
    contents = {CSV: many_table.as_csv(named, first), PARQUET: many_table.as_parquet(named, first)}
    write_files(out, contents)
    return named


def _diagnose_one(read: Read, argument: dict[str, Any]) -> dict[str, Any]:
    from calibration.diagnosis import as_json, diagnose

    recording, seed = read(Path(argument["folder"])), argument["seed"]
    return _origin(recording) | {"diagnosis": as_json(diagnose(recording, seed=seed))}


def _fit_one(read: Read, argument: dict[str, Any]) -> dict[str, Any]:
    from calibration import fit_quality
    from calibration.fit import fit, whole
    from calibration.fit.document import as_json
    from calibration.fit.sampling import STEADY, WHOLE, Settings

    recording, settings = read(Path(argument["folder"])), Settings(**argument["settings"])
    found: Fit | WholeFit
    parts = as_given([recording])
    if argument["steady_only"] or (len(parts) == 1 and all(file.kind != "transient" for file in recording.files)):
        quality = fit_quality.judge(recording, settings.seed)
        found = fit.fit(recording, settings.within(STEADY))
    else:
        used, start, quality = fit_quality.judge_whole(parts, settings.seed)
        found = whole.fit(used, start.comparison, start.base, settings.within(WHOLE))
    return _origin(recording) | {"posterior": as_json(replace(found, quality=quality))}


def _origin(recording: Recording) -> dict[str, Any]:
    motor, sha256 = motor_of(recording)
    serial = recording.origin.get("motor_serial")
    return {"date": as_text(date_of(recording)), "motor_serial": serial, "motor": motor, "motor_sha256": sha256}
