"""`many`: many recordings at once, as one table; `trend`: the history of motors, with an alarm where one changed."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from spinbench import readings
from spinbench.cli import options
from spinbench.cli.errors import CHANGED, UNUSABLE_INPUT, kept_when_interrupted, without_class
from spinbench.cli.show import check_places, on_terminal, read_if_there, recordings_in, remark, tell_replaced
from spinbench.extras import need
from spinbench.progress import bars

ManyArgument = Annotated[
    list[Path], typer.Argument(metavar="DIR", help="Recordings or runs, or folders that hold them.")
]
TableOption = Annotated[Path, options.out_folder("Folder for the table; started again, it goes on.")]
SHOWN = 5  # names of folders that are passed over


_going_on = kept_when_interrupted(lambda out: f"what was done is kept in {out}; the same command goes on from there")


@_going_on
def diagnose(
    recordings: ManyArgument,
    out: TableOption,
    seed: options.SeedOption = 1,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
) -> None:
    """Diagnose many recordings into one table; exit code 2 when some could not be."""
    _need_packages(scheduler)
    check_places(out, None)
    found = _recordings_in(recordings)
    _refuse_other_than_iso(found)
    rows = _diagnosed(found, seed, out, workers, scheduler)
    shown = [(str(row["recording"]), row["verdict"], " + ".join(row["effects"] or [])) for row in rows]
    _tell(("recording", "verdict", "effects"), shown, rows, out)


@_going_on
def fit(
    recordings: ManyArgument,
    out: TableOption,
    seed: options.SeedOption = 1,
    effective_samples: options.EffectiveSamplesOption = None,
    max_steps: options.MaxStepsOption = None,
    steady_only: options.SteadyOnlyOption = False,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
) -> None:
    """Fit many recordings into one table, which says where the model does not fit; exit code 2 when some failed."""
    from calibration import fleet
    from calibration.fit.sampling import Settings

    _need_packages(scheduler)
    check_places(out, None)
    found = _recordings_in(recordings)
    _refuse_other_than_iso(found)
    settings = Settings(seed=seed, effective_samples=effective_samples or 0, most_steps=max_steps or 0)
    processes = workers or os.cpu_count() or 1
    before = read_if_there(out / fleet.CSV)
    with bars() as begin:
        rows = fleet.fit_all(
            found, readings.read_of_many, settings, steady_only, out, processes, scheduler, begin("fits")
        )
    _tell_replaced(out, before, rows)
    figures = [(row.get("f_overall_mean"), row.get("f_overall_sd")) for row in rows]
    fits_well = {True: "yes", False: "no: do not rely on it", None: ""}
    shown = [
        (str(row["recording"]), "failed" if mean is None else f"{mean:.4f} +- {sd:.4f}", fits_well[row["model_fits"]])
        for row, (mean, sd) in zip(rows, figures, strict=True)
    ]
    _tell(("recording", "f_overall, N m s", "the model fits"), shown, rows, out)


@_going_on
def trend(
    recordings: ManyArgument,
    out: Annotated[Path, options.out_folder("Folder for page and table; started again, it goes on.")],
    seed: options.SeedOption = 1,
    workers: options.WorkersOption = None,
    scheduler: options.SchedulerOption = None,
) -> None:
    """Show f_overall and each effect along the dates, motor by motor; exit code 6 where one changed."""
    from calibration import fleet
    from calibration.report.comparison import history
    from calibration.report.comparison import trend as trends
    from rig.recording.files import write_files

    _need_packages(scheduler)
    check_places(out, None)
    found = _recordings_in(recordings)
    swept = [one for one in found if readings.is_swept(one)]
    if len(swept) < len(found):
        remark(f"passed over: {len(found) - len(swept)} runs that are no sweeps")
    _refuse_other_than_iso(swept)
    swept, twice = readings.each_once(swept)
    remark(*twice)
    rows = _diagnosed(swept, seed, out, workers, scheduler)
    said = fleet.write_trend(out, rows)
    read = {row["recording"]: readings.read(Path(row["recording"]), quiet=True) for row in rows if not row["error"]}
    write_files(out, history.report(rows, read))
    for words in said:
        print(words)
    remark(*_failed(rows))
    alarms = trends.alarms(trends.trends(rows))
    for words in alarms:
        print(f"ALARM: {words}", file=sys.stderr)
    remark(f"the page is {out / 'report.html'}")
    if alarms:
        raise typer.Exit(CHANGED)
    if not said:
        remark("no two recordings of one motor can be compared")
        raise typer.Exit(UNUSABLE_INPUT)


def _recordings_in(folders: Sequence[Path]) -> list[Path]:
    """The recordings that folders are or hold; the other folders beside them are told."""
    from calibration import fleet

    found = fleet.recordings_in(folders, readings.is_recording)
    for folder in folders:
        if readings.is_recording(folder):
            continue
        inside = sorted(one.name for one in folder.iterdir() if one.is_dir() and not readings.is_recording(one))
        over = [name for name in inside if not name.startswith(".")]
        if over:
            more = f" and {len(over) - SHOWN} more" * (len(over) > SHOWN)
            names = ", ".join(over[:SHOWN])
            remark(f"passed over in {folder}: {names}{more}: no recordings or runs; name folders below them")
    return found


def _refuse_other_than_iso(found: Sequence[Path]) -> None:
    """Refuse dates that no history can be ordered by, before the work."""
    from calibration.data.dates import refuse_other_than_iso

    refuse_other_than_iso({one: readings.date_stated(one) for one in found})


def _diagnosed(
    found: Sequence[Path], seed: int, out: Path, workers: int | None, scheduler: str | None
) -> list[dict[str, Any]]:
    """Diagnoses side by side, with a bar; a row each."""
    from calibration import fleet

    before = read_if_there(out / fleet.CSV)
    with bars() as begin:
        processes = workers or os.cpu_count() or 1
        rows = fleet.diagnose_all(found, readings.read_of_many, seed, out, processes, scheduler, begin("diagnoses"))
    _tell_replaced(out, before, rows)
    return rows


def _tell_replaced(out: Path, before: bytes, rows: Sequence[dict[str, Any]]) -> None:
    """Say that the table in a folder was of other recordings, or of fits where there are diagnoses now.

    `before`: the table as it was; `rows`: those of the one that is there now.
    """
    tell_replaced(out, recordings_in(before), [str(row["recording"]) for row in rows])
    kinds = {True: "diagnoses", False: "fits"}
    was, is_now = b"verdict" in before.partition(b"\n")[0].split(b","), any("verdict" in row for row in rows)
    if before and was != is_now:
        remark(f"replaced: the table in {out}, which was of {kinds[was]} and is of {kinds[is_now]} now")


def _failed(rows: Sequence[dict[str, Any]]) -> list[str]:
    """What failed, a line each, which names the recording once."""
    told = [(row["recording"], without_class(row["error"])) for row in rows if row["error"]]
    return [f"{one}: {error.replace(f'{Path(one).resolve()}: ', '', 1)}" for one, error in told]


def _need_packages(scheduler: str | None) -> None:
    """Refuse at once what would fail when the table is written, or when the scheduler is asked."""
    need("pyarrow")
    if scheduler is not None:
        need("distributed")


def _tell(header: tuple[str, ...], shown: Sequence[tuple[str, ...]], rows: list[dict[str, Any]], out: Path) -> None:
    """The table on the terminal, the trends and what failed on standard error."""
    from rich.markup import escape
    from rich.table import Table

    from calibration import fleet

    table = Table(*header)
    for cells in shown:
        table.add_row(*(escape(cell) for cell in cells))
    on_terminal(table)
    print(out / fleet.CSV)
    failed = _failed(rows)
    remark(*failed)
    once, twice = readings.each_once([Path(row["recording"]) for row in rows])
    remark(*(f"in the trend, {words}" for words in twice))
    for words in fleet.write_trend(out, [row for row in rows if Path(row["recording"]) in once]):
        print(words, file=sys.stderr)
    if failed:
        raise typer.Exit(UNUSABLE_INPUT)
