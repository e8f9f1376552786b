"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from spinbench.api.fitting import LEAST_EFFECTIVE

LOGS = Path("logs")  # of the folder that the program is started in: runs are data, not part of the program


def out_folder(what: str) -> Any:
    """The option that names a folder to write into. `what`: its help."""
    return typer.Option("-o", "--out", metavar="DIR", help=what)


def ids_in(given: list[str] | None) -> list[str]:
    """Ids that stand one by one, or several with commas between them; an empty one of a text that has none."""
    return [name for text in given or [] for name in ([one.strip() for one in text.split(",") if one.strip()] or [""])]


def _once(assignments: list[str] | None) -> list[str] | None:
    """What is set, each parameter once."""
    from spinbench.api.simulating import set_once

    return set_once(assignments or [])


RecordingsArgument = Annotated[
    list[Path],
    typer.Argument(metavar="RECORDING", help="Folders of recordings, or names of runs; several must be of one motor."),
]
MotorOption = Annotated[
    str, typer.Option("--motor", metavar="NAME|FILE", help="A motor of the project or in configs/motors, or a file.")
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        callback=_once,
        help="Change a parameter or a reading; may be given several times, each name once.",
    ),
]
JsonOption = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - for standard output.")
]
WithoutOption = Annotated[
    list[str] | None,
    typer.Option(
        "--without",
        metavar="FILE[:ROWS]",
        help="Leave out a file, or rows (sweep.csv:3,7-9) or levels (sweep.csv:2.0bar) of it. Of several as NAME/FILE.",
    ),
]
WithParentsOption = Annotated[
    bool,
    typer.Option(
        "--with-parents",
        help="Take in the runs before, too: the sweep that a run continues, or that a capture was taken after.",
    ),
]
PerRecordingOption = Annotated[
    list[str] | None,
    typer.Option(
        "--per-recording",
        metavar="ID,ID",
        help="Effects whose sizes are each recording's own, and not shared; may be given several times.",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed; the same seed gives the same result to the bit.")]
EffectiveSamplesOption = Annotated[
    int | None,
    typer.Option(
        min=LEAST_EFFECTIVE,
        max=1_000_000,
        help="Least effective sample size of every unknown: 10 000, with runs in time 2000.",
    ),
]
MaxStepsOption = Annotated[
    int | None,
    typer.Option(min=50, max=1_000_000, help="Budget of each ensemble: 12 000 steps, with runs in time 400."),
]
SteadyOnlyOption = Annotated[
    bool, typer.Option("--steady-only", help="Leave runs in time out: plateaus and zero readings alone.")
]

# A bench, and the room that it stands in.
BenchArgument = Annotated[
    Path, typer.Argument(metavar="BENCH", help="A bench file, or the name of one in the project or in configs/benches.")
]
RateOption = Annotated[
    float | None,
    typer.Option(
        min=0.1,
        max=50.0,
        help="Virtual bench: how many of its seconds pass in a real one; the bench file's if left out.",
    ),
]
OperatorOption = Annotated[str, typer.Option(help="Who runs the bench.")]
MotorSerialOption = Annotated[str | None, typer.Option(help="The motor's serial number; the bench file's if left out.")]
AfterOption = Annotated[
    str | None,
    typer.Option(metavar="RUN", help="The run that it belongs to, such as its sweep; 'last' is the newest."),
]
NoteOption = Annotated[str, typer.Option(help="What whoever reads the run should know; goes along with its export.")]
RoomPressureOption = Annotated[float | None, typer.Option(help="Pressure of the room, in bar.")]
RoomTemperatureOption = Annotated[float | None, typer.Option(help="Temperature of the room, in degC.")]
HumidityOption = Annotated[float | None, typer.Option(help="Relative humidity of the room, 0 to 1.")]
LubricationOption = Annotated[str | None, typer.Option(help="Oil, and when it was last given.")]
MinutesRunningOption = Annotated[float | None, typer.Option(help="How long the motor has run today, in minutes.")]

# A bench that conceals something.
SealOption = Annotated[
    Path | None,
    typer.Option(
        "--conceal",
        metavar="SEAL",
        help="Virtual bench: draw something to conceal, and seal what it is in this folder.",
    ),
]
ConcealSeedOption = Annotated[
    int | None, typer.Option("--conceal-seed", min=0, help="Seed of what is concealed; drawn if left out.")
]
OnlyOption = Annotated[
    str, typer.Option("--only", metavar="ID", help="Conceal this effect, or something of this category, such as none.")
]
SealKeyOption = Annotated[
    Path | None, typer.Option("--key", metavar="FILE", help="The seal's key; in your state folder if left out.")
]

# Runs.
RunArgument = Annotated[
    str, typer.Argument(metavar="RUN", help="A run: its folder, its name or how that begins, or 'last'.")
]
LogsOption = Annotated[Path, typer.Option("--logs", metavar="DIR", help="Where runs are kept.")]

# Many recordings.
WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, help="Processes of this machine; as many as it has cores if left out.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="tcp://HOST:PORT", help="A Dask scheduler, whose workers are used instead."),
]
