"""`replay`: a run's bytes through the drivers again, and its pressure through the model."""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench.cli.errors import RUN_FAILED
from spinbench.cli.options import LOGS, LogsOption, RunArgument, out_folder
from spinbench.cli.show import check_places, on_terminal, remark
from spinbench.progress import counting
from spinbench.readings import run_named

if TYPE_CHECKING:
    from rig.bench.bench import Bench
    from rig.replay.replaying import Replayed
    from rig.runlog import Run


def replay(
    run: RunArgument,
    logs: LogsOption = LOGS,
    real_time: Annotated[
        bool, typer.Option("--real-time", help="As slowly as it was measured; otherwise as fast as possible.")
    ] = False,
    mended: Annotated[
        list[str] | None,
        typer.Option(metavar="INSTRUMENT", help="Take today's file of this instrument instead of the run's own."),
    ] = None,
    save: Annotated[bool, typer.Option("--save", help="Keep the new samples as a run that names this one.")] = False,
    with_model: Annotated[
        bool, typer.Option("--with-model", help="Drive the model with the recorded pressure.")
    ] = False,
    out: Annotated[Path | None, out_folder("Where the comparison with the model goes.")] = None,
) -> None:
    """Play a run's bytes back through the drivers; exit code 4 unless every sample comes again, bit for bit."""
    from configs import find
    from rig.replay.replaying import bench_of_run, mended_bench
    from rig.runlog.reader import KILLED

    if out is not None and not with_model:
        raise typer.BadParameter(f"-o {out} is for the comparison with the model; say --with-model too")
    if mended and with_model:
        raise typer.BadParameter(
            "--with-model takes the run's own samples; keep the mended ones by --save, then replay those --with-model"
        )
    check_places(out, None)
    read = run_named(run, logs)
    bench = mended_bench(read, mended, partial(find, "instruments")) if mended else bench_of_run(read)
    found = _played(read, bench, logs if save else None, real_time)
    verdict = "the same, bit for bit" if found.same else f"{found.different} differ"
    print(f"{read.name}: {found.exchanges} exchanges, {found.samples} samples of {found.logged}: {verdict}")
    remark(*found.asked, *found.differences)
    if found.tail and read.state == KILLED:
        remark(f"{found.tail} more rows than the log: it was killed between its files")
    if with_model:
        _against_model(read, out)
    if not found.same and not mended:
        raise typer.Exit(RUN_FAILED)


def _played(run: Run, bench: Bench, logs: Path | None, real_time: bool) -> Replayed:
    """The run played back; with a folder of runs its new samples are kept there."""
    from rig.replay.replaying import replay as play
    from rig.replay.saving import retake_plateaus, writer_for

    with contextlib.ExitStack() as kept:
        writer = kept.enter_context(writer_for(run, bench, logs)) if logs is not None else None
        try:
            with counting(f"replay of {run.name}", run.exchange_count) as tell:
                found = play(run, bench, writer, real_time, lambda done, exchange: tell(done))
        except Exception as error:
            if writer is not None:
                writer.end("failed", f"replay of {run.name}: {error}")
            raise
        if writer is not None:
            retake_plateaus(run, writer)
            writer.end("finished", f"replay of {run.name}")
            print(f"{writer.folder}: the new samples")
    return found


def _against_model(run: Run, out: Path | None) -> None:
    """Measured against simulated speed and flow in time.

    Raises RunError where the model cannot be driven with the run's pressure, or nothing was read beside it.
    """
    from calibration.report import replay_comparison
    from model.motor import read_motor
    from model.operation.performance import OperatingPointError
    from model.operation.replayed import drive, in_room
    from rig.recording import files
    from rig.replay.channels import STEP_S, channels_of
    from rig.runlog import RunError
    from rig.runlog.phases import room_said

    measured = channels_of(run)
    room = room_said(run)
    motor = in_room(read_motor(run.start.motor), room.pressure_bar_abs, room.temperature_c, room.relative_humidity)
    motor = motor.with_flywheel(run.start.added_inertia_kg_m2)
    with counting("model", 1) as tell:
        try:
            simulated = drive(motor, measured.pressure_time_s, measured.pressure_pa, STEP_S)
        except OperatingPointError as error:
            raise RunError(f"{run.folder}: {error}") from None
        tell(1)
    compared = replay_comparison.compare(measured, simulated)
    if not compared:
        raise RunError(f"{run.folder}: no speed or flow was read while the pressure was; there is nothing to compare")
    if out is not None:
        files.write_files(out, replay_comparison.report(run.name, simulated, compared))
        remark(f"the comparison is {out / 'replay.png'}, its figures replay.csv")
    on_terminal(replay_comparison.table(compared))
