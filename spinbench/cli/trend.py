"""`trend`: the history of motors, with an alarm where something changed."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from spinbench import readings
from spinbench.cli.errors import CHANGED, UNUSABLE_INPUT
from spinbench.cli.options import SchedulerOption, SeedOption, WorkersOption
from spinbench.cli.progress import bars
from spinbench.cli.show import remark
from spinbench.extras import need


def trend(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Folders of runs or recordings, or single ones.")
    ],
    out: Annotated[
        Path,
        typer.Option("-o", "--out", metavar="DIR", help="Folder for page and table; started again, it goes on."),
    ],
    seed: SeedOption = 1,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Show f_overall and each effect along the dates, motor by motor; exit code 6 where one changed."""
    from calibration import fleet
    from calibration.report.comparison import history
    from calibration.report.comparison import trend as trends
    from rig.recording.files import write_files

    need("pyarrow")
    if scheduler is not None:
        need("distributed")
    found = fleet.recordings_in(folders, readings.is_recording)
    swept = [one for one in found if readings.is_swept(one)]
    if len(swept) < len(found):
        remark(f"passed over: {len(found) - len(swept)} runs that are no sweeps")
    with bars() as begin:
        processes = workers or os.cpu_count() or 1
        rows = fleet.diagnose_all(swept, readings.read, seed, out, processes, scheduler, begin("diagnoses"))
    said = fleet.write_trend(out, rows)
    read = {row["recording"]: readings.read(Path(row["recording"]), quiet=True) for row in rows if not row["error"]}
    write_files(out, history.report(rows, read))
    for words in said:
        print(words)
    remark(*(f"{row['recording']}: {row['error']}" for row in rows if row["error"]))
    alarms = trends.alarms(trends.trends(rows))
    for words in alarms:
        print(f"ALARM: {words}", file=sys.stderr)
    remark(f"the page is {out / 'report.html'}")
    if alarms:
        raise typer.Exit(CHANGED)
    if not said:
        remark("no two recordings of one motor can be compared")
        raise typer.Exit(UNUSABLE_INPUT)
