"""`runs`: the runs that were logged."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from spinbench.cli.errors import RUN_FAILED, kept_when_interrupted
from spinbench.cli.options import LOGS, LogsOption, RunArgument
from spinbench.cli.show import check_places, on_terminal, remark
from spinbench.readings import run_named

OUT_HELP = "A folder to make, or a file that ends in .parquet, .h5, .hdf5, .nxs, .tdms or .mf4."
FILES_HELP = "CSV, Excel, TDMS, MATLAB, HDF5, MDF or Parquet files."


def list_all(logs: LogsOption = LOGS) -> None:
    """List the runs."""
    from rich.markup import escape
    from rich.table import Column, Table

    from rig.runlog import RunError
    from rig.runlog.listing import list_runs

    found = list_runs(logs)
    if logs != LOGS and not logs.exists():
        raise RunError(f"{logs}: there is no such folder; name with --logs the one that runs are in")
    if not found:
        print(f"no runs in {logs}{'' if logs.is_dir() else ': there is no such folder'}", file=sys.stderr)
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
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR|FILE", help=OUT_HELP)],
    logs: LogsOption = LOGS,
    unsettled: Annotated[bool, typer.Option("--unsettled", help="Take plateaus that had not settled, too.")] = False,
) -> None:
    """Export a run as a recording/1 folder, or its samples as Parquet, HDF5, TDMS or MDF 4."""
    from rig.exchange.export import export_recording
    from rig.exchange.samples.export import export_samples, is_file_of_samples

    as_samples = is_file_of_samples(out)
    check_places(*((None, out) if as_samples else (out, None)))
    read = run_named(run, logs)
    if as_samples:
        export_samples(read, out)
    else:
        remark(*export_recording(read, out, unsettled).notes)
    print(out)


@kept_when_interrupted(lambda out: "nothing was imported")
def import_data(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help=FILES_HELP)],
    mapping: Annotated[
        Path | None, typer.Option("--mapping", metavar="FILE", help="A mapping: what each column is, and its unit.")
    ] = None,
    guess: Annotated[
        bool, typer.Option("--guess", help="Import nothing: propose a mapping of one file, to be read and confirmed.")
    ] = False,
    logs: LogsOption = LOGS,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="DIR|FILE",
            help="Make a recording there instead of a run; with --guess, the mapping file.",
        ),
    ] = None,
) -> None:
    """Import data taken elsewhere, as a run; of a rig that is not this motor, as a recording."""
    if guess == (mapping is not None) or (guess and len(files) > 1):
        raise typer.BadParameter("give --mapping, or --guess and one file")
    check_places(*((None, out) if guess else (out, None)))
    if mapping is None:
        propose_mapping(files[0], out)
        return
    from rig.exchange.importing import import_files
    from rig.exchange.mapping import read_mapping

    read = read_mapping(mapping)
    if not isinstance(read.file.motor, str) and out is None:
        raise typer.BadParameter(f"{mapping} is of another rig: name the recording to make with -o")
    print(import_files(files, read, logs if out is None else out, as_recording=out is not None, tell=remark))


def propose_mapping(file: Path, out: Path | None) -> None:
    """A mapping proposed for a file, on standard output or as a new file."""
    from rig.exchange.guess.proposal import propose
    from rig.runlog.folder import write_whole

    text = propose(file)
    if out is None:
        print(text, end="")
        return
    write_whole(out, text.encode("utf-8"))
    remark("a proposal: read every line before you import with it")
    print(out)
