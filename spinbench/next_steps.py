"""What can be done next, given what lies in the logs folder: for whoever types `spinbench` alone."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calibration.diagnosis.result import Diagnosis
    from rig.runlog import StartRecord

Step = tuple[str, str]  # what for, and the command


def next_steps(logs: Path) -> tuple[str, list[Step]]:
    """What there is, in a sentence, and what can be done next, the likeliest first."""
    from rig.runlog.listing import find_run
    from rig.runlog.reader import BEING_WRITTEN, KILLED, read_end, read_start, state_of

    watch = ("watch the bench in a browser", "spinbench console virtual")
    try:
        newest = find_run("last", logs)
        start, end = read_start(newest), read_end(newest)
    except ValueError as error:
        there = "There are no runs here yet." if _is_empty(logs) else f"The newest run cannot be read: {error}"
        return there, [
            ("try a bench that is not there", "spinbench sweep virtual --minutes-running 0"),
            watch,
            ("examine your own bench's file and cables", "spinbench doctor lab"),
            ("fit the sweep that comes with the program", "spinbench fit published_sweep -o out/fit"),
        ]
    from rig.runlog.folder import is_locked

    state = state_of(end, end is None and is_locked(newest))
    said = f"The newest run is {newest.name}: {state}."
    show = ("read what happened in it", "spinbench runs show last")
    if state == BEING_WRITTEN:
        return said, [watch, show]
    if state == KILLED:
        return said, [("seal it", "spinbench runs repair last"), show]
    return said, [*after(newest, start, state, "last"), watch]


def after(folder: Path, start: StartRecord, state: str, run: str) -> list[Step]:
    """What can be done with a run that has ended, the likeliest first; `run`: as a command names it."""
    from rig.runlog.folder import WIRE

    show = ("read what happened in it", f"spinbench runs show {shlex.quote(run)}")
    if state != "finished":
        words = ["spinbench", "sweep", bench_named(start), "--continue", run if run == "last" else folder.name]
        again = ("take the levels that are left", shlex.join([*words, *(kept_in(folder) if run != "last" else [])]))
        return [show, *([again] if start.kind == "sweep" else [])]
    run = shlex.quote(run)
    parents = " --with-parents" if start.goes_on_from else ""
    asked = [
        ("ask whether the model explains it", f"spinbench diagnose {run}{parents} -o out/diagnosis"),
        ("find f_overall and how sure it is", f"spinbench fit {run}{parents} -o out/fit"),
    ]
    is_alone = start.kind in ("coast-down", "spin-up", "zero", "plateaus") and not parents
    replay = ("see that its bytes give the same readings", f"spinbench replay {run}")
    return [*([] if is_alone else asked), *([replay] if (folder / WIRE).is_file() else []), show]


def bench_named(start: StartRecord, *typed: str) -> str:
    """The bench of a run, as a command names it; BENCH where the file that it was made with is not found.

    `typed`: how else it may be named, the best first.
    """
    from rig.bench.bench import BENCH_SOURCE, bench_path
    from rig.runlog.folder import sha256_of

    kept = start.sources.get(BENCH_SOURCE)
    for word in filter(None, (*typed, start.bench)):
        path = bench_path(Path(word))
        if kept is not None and path.is_file() and sha256_of(path) == kept.sha256:
            return word
    return "BENCH"


def bench_of(folder: Path) -> tuple[str, str]:
    """How commands name the bench that a recording is of, and the run as an option; BENCH where it is not known."""
    from rig.runlog.folder import START
    from rig.runlog.reader import read_start

    start = read_start(folder) if (folder / START).is_file() else None
    if start is None or start.imported or start.kind == "import":
        return "BENCH", ""
    return shlex.quote(bench_named(start)), shlex.join(["--after", folder.resolve().name, *kept_in(folder)])


def tests_of_bench(diagnosis: Diagnosis, bench: str, after: str) -> Diagnosis:
    """A diagnosis whose tests are commands of the bench and the run that it is of, as `bench_of` tells them."""
    tests = [
        replace(one, capture=one.capture and replace(one.capture, bench=bench, after=after))
        for one in diagnosis.next_tests
    ]
    return replace(diagnosis, next_tests=tests)


def kept_in(run: Path) -> list[str]:
    """The option that says in which folder a run lies; nothing where it is the usual one."""
    from spinbench.cli.options import LOGS

    folder, here = run.resolve().parent, Path.cwd()
    if folder == LOGS.resolve():
        return []
    return ["--logs", str(folder.relative_to(here) if folder.is_relative_to(here) else folder)]


def show_command(run: Path) -> str:
    """The command that shows a run; a name may begin like an option."""
    last = ["--"] * run.name.startswith("-") + [run.name]
    return shlex.join(["spinbench", "runs", "show", *kept_in(run), *last])


def _is_empty(logs: Path) -> bool:
    from rig.runlog.listing import list_runs

    return not list_runs(logs)


def shown(logs: Path) -> str:
    """The same as lines for the terminal."""
    said, steps = next_steps(logs)
    width = max(len(command) for _, command in steps)
    lines = [f"  {command:<{width}}   {what}" for what, command in steps]
    return "\n".join([said, "What can be done next:", *lines, "All commands: spinbench --help"])
