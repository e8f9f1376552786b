"""`compare`: what changed between two recordings of one motor."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from spinbench import readings
from spinbench.cli.errors import kept_when_interrupted
from spinbench.cli.options import LOGS, JsonOption, LogsOption, SeedOption, WithoutOption
from spinbench.cli.progress import diagnosing
from spinbench.cli.show import check_places, deliver, refuse_twice, remark


def _kept(out: Path | None) -> str:
    return "nothing is kept of an unfinished comparison; the same command begins again"


@kept_when_interrupted(_kept)
def compare(
    before: Annotated[Path, typer.Argument(metavar="A", help="A recording/1 folder, or a run: the earlier one.")],
    after: Annotated[Path, typer.Argument(metavar="B", help="The later one, of the same motor.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Write report.html, .png and comparison.json there."),
    ] = None,
    json_file: JsonOption = None,
    seed: SeedOption = 1,
    left_out: WithoutOption = None,
    logs: LogsOption = LOGS,
) -> None:
    """Say what changed from one recording of a motor to another, or that nothing did; 0 whatever the answer."""
    from calibration.data.dates import date_of
    from calibration.data.left_out import without
    from calibration.data.runs_in_time import few_used
    from calibration.diagnosis import changes
    from calibration.diagnosis.changes_document import as_json
    from calibration.report.comparison import page, words
    from calibration.report.diagnosis.words import steps_in_words
    from rig.recording import files

    check_places(out, json_file)
    parts = [readings.read(readings.folder_named(named, logs)) for named in (before, after)]
    refuse_twice(parts)
    parts = without(parts, left_out or [])
    remark(*(warning for part in parts for warning in part.warnings))
    dates = [date_of(part) for part in parts]
    if dates[0] and dates[1] and dates[0] > dates[1]:
        remark(f"{parts[1].folder} is the earlier one by its date; before and after are told in the order given")
    with diagnosing("comparison") as tell:
        found = changes.compare(parts[0], parts[1], seed, tell, min(2, os.cpu_count() or 1))
        document = as_json(found)
        data = files.json_bytes(document)
        if out is not None:
            tell("report")
            files.write_files(out, {page.JSON: data} | page.report(found, document))
    deliver(data, [words.table(document)], json_file)
    print(words.sentence(document), file=sys.stderr)
    remark(*few_used(document["files"]), steps_in_words(found.seconds))
    if out is not None:
        remark(f"the report is {out / 'report.html'}")
