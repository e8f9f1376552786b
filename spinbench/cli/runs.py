"""`runs`: the runs that were logged."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from spinbench.cli.errors import RUN_FAILED
from spinbench.cli.options import LOGS, LogsOption, RunArgument
from spinbench.cli.show import on_terminal, remark
from spinbench.readings import run_named


def list_all(logs: LogsOption = LOGS) -> None:
    """List the runs."""
    from rich.markup import escape
    from rich.table import Column, Table

    from rig.runlog.listing import list_runs

    found = list_runs(logs)
    if not found:
        print(f"no runs in {logs}", file=sys.stderr)
        return
    whole = (Column(words, no_wrap=True) for words in ("run", "kind"))  # a name has to be typed
    table = Table(*whole, "bench", "outcome", "rows", "plateaus", box=None, pad_edge=False)
    for row in found:
        bench = f"{row.bench} (virtual)" if row.simulated else row.bench
        cells = (row.name, row.kind, bench, row.outcome, str(row.rows), str(row.plateaus))
        table.add_row(*map(escape, cells))
    on_terminal(table)


def show(run: RunArgument, logs: LogsOption = LOGS) -> None:
    """Show a run: its start, its plateaus, what went wrong, its end."""
    from rig.runlog.listing import summary

    print(summary(run_named(run, logs)))


def verify(run: RunArgument, logs: LogsOption = LOGS) -> None:
    """Compare a run with its hashes and counts; exit code 4 when something was changed."""
    from rig.runlog import verify as check
    from rig.runlog.listing import find_run

    folder = find_run(run, logs)
    findings = check(folder)
    for words in findings or ["verified: unchanged since the run ended"]:
        print(f"{folder}: {words}")
    if findings:
        raise typer.Exit(RUN_FAILED)


def repair(run: RunArgument, logs: LogsOption = LOGS) -> None:
    """Seal a run that was killed; nothing but a torn last line is dropped, and it is said which."""
    from rig.runlog import repair as mend
    from rig.runlog.listing import find_run

    folder = find_run(run, logs)
    for words in mend(folder):
        print(f"{folder}: {words}")


def export(
    run: RunArgument,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR|FILE", help="A folder to make, or a .parquet file.")],
    logs: LogsOption = LOGS,
    unsettled: Annotated[bool, typer.Option("--unsettled", help="Take plateaus that had not settled, too.")] = False,
) -> None:
    """Export a run as a recording/1 folder, or its samples as Parquet."""
    from rig.exchange.export import export_recording
    from rig.exchange.parquet import export_parquet

    read = run_named(run, logs)
    if out.suffix == ".parquet":
        export_parquet(read, out)
    else:
        remark(*export_recording(read, out, unsettled).notes)
    print(out)


def import_data(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="CSV, TDMS, MATLAB or Excel files.")],
    mapping: Annotated[
        Path, typer.Option("--mapping", metavar="FILE", help="A mapping: what each column is, and its unit.")
    ],
    logs: LogsOption = LOGS,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="DIR", help="Make a recording there instead of a run.")
    ] = None,
) -> None:
    """Import data taken elsewhere, as a run; of a rig that is not this motor, as a recording."""
    from rig.exchange.importing import import_files
    from rig.exchange.mapping import read_mapping

    read = read_mapping(mapping)
    if not isinstance(read.file.motor, str) and out is None:
        raise typer.BadParameter(f"{mapping} is of another rig: name the recording to make with -o")
    print(import_files(files, read, logs if out is None else out, as_recording=out is not None, tell=remark))
