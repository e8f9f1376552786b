"""`sheet`: a sheet for a bench that a person reads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench.cli import options
from spinbench.cli.show import check_places

if TYPE_CHECKING:
    from rig.bench.bench import Bench
    from rig.sweep.ambient import Ambient, Given


def sheet(
    bench: options.BenchArgument,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE", help="Print a sheet: .html for paper, .csv to fill in."),
    ] = None,
    entered: Annotated[
        Path | None, typer.Option("--enter", metavar="FILE", help="A filled-in .csv sheet becomes a run.")
    ] = None,
    logs: options.LogsOption = options.LOGS,
    operator: Annotated[str, typer.Option(help="Who read the instruments.")] = "",
    motor_serial: options.MotorSerialOption = None,
    note: options.NoteOption = "",
    date: Annotated[str, typer.Option(help="When they were read, such as 2026-05-28.")] = "",
    ambient_pressure_bar_abs: options.RoomPressureOption = None,
    ambient_temperature_c: options.RoomTemperatureOption = None,
    relative_humidity: options.HumidityOption = None,
    lubrication: options.LubricationOption = None,
    minutes_running: Annotated[
        float | None, typer.Option(help="How long the motor had run that day, in minutes.")
    ] = None,
    as_read: Annotated[
        bool, typer.Option("--as-read", help="Improbable readings of the sheet were read so: enter them, with a note.")
    ] = False,
) -> None:
    """A sheet for a bench that a person reads: to be printed, or entered once it is filled in."""
    from rig.bench.bench import bench_path, read_bench
    from rig.by_hand.sheet_entry import SheetError
    from rig.recording.origin import mistake_in
    from rig.run.running import enter
    from rig.sweep.ambient import Given

    if (out is None) == (entered is None):
        raise typer.BadParameter("give either -o, to print a sheet, or --enter, to enter one")
    if date and (wrong := mistake_in(date)):
        raise typer.BadParameter(f"--date '{date}' {wrong}")
    read = read_bench(bench_path(bench))
    given = Given(ambient_pressure_bar_abs, ambient_temperature_c, relative_humidity, lubrication, minutes_running)
    if out is not None:
        _print(read, out, given)
    if entered is not None:
        text, room = _filled_in(read, entered, given)
        try:
            print(enter(read, text, room, logs, operator, motor_serial, note, date, as_read))
        except SheetError as error:
            raise SheetError("\n".join(f"{entered}: {line}" for line in str(error).splitlines())) from None


def _print(bench: Bench, out: Path, given: Given) -> None:
    from rig.by_hand import sheet as sheets
    from rig.recording import files
    from rig.sweep.ambient import known_of

    if out.suffix not in (".html", ".csv"):
        raise typer.BadParameter(f"{out}: a sheet is .html, to be printed, or .csv, to be filled in")
    if out.exists():
        raise typer.BadParameter(f"{out} exists already, and may be filled in; give a name that is free")
    check_places(None, out)
    room, _ = known_of(bench, given)
    is_table = out.suffix == ".csv"
    text = sheets.print_sheet(bench) if is_table else sheets.print_page(bench, room.get("pressure_bar_abs"))
    files.write_file(out, text.encode())
    print(out)


def _filled_in(bench: Bench, entered: Path, given: Given) -> tuple[str, Ambient]:
    """The sheet's text, and the room that it was filled in in."""
    from rig.by_hand.sheet_entry import SheetError
    from rig.run.terminal import ask, somebody_is_there
    from rig.sweep.ambient import at_start

    room = at_start(bench, given, ask if somebody_is_there() else None)
    try:
        return entered.read_text(encoding="utf-8"), room
    except UnicodeDecodeError:
        raise SheetError(f"{entered}: not UTF-8 text; save it as UTF-8") from None
