"""Kill -9 at random moments of what reads and writes files: replay, repair, export, import, fit, diagnose, challenge.

`make kills` runs it after the sweeps. Each kill is of a real command on copies of its own. Half of the kills come at a
random time of the command's usual length, half just after something new stood in the folder of results.
"""

from __future__ import annotations

import atexit
import csv
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from rig.recording.files import write_file
from rig.runlog import read_run, verify
from tests.declared import figures
from tests.synthetic_runs import write_sweep

ROOT = Path(__file__).resolve().parents[1]
OLD = b"old\n"  # what stood in the place of a result before
SAID = "said"
LONGEST_S = 600.0
JUST_AFTER_S = 0.03
FOLDER = ("out/recording.toml", "out/notes.txt")
ENDS = {".html": b"</html>", ".png": b"IEND\xaeB`\x82", ".csv": b"\n", ".jsonl": b"\n", ".txt": b"\n", ".md": b"\n"}
LOGGER = "t,P,n\n" + "".join(f"{0.1 * i:.1f},{2.0 - 0.01 * i:.3f},{400.0 - 3.0 * i:.1f}\n" for i in range(100))
MAPPING = f"""
format = "import/1"
title = "a logger"
source = "made up"
licence = "none"
motor = "ptm3600"
[ambient]
pressure_bar_abs = 1.01325
temperature_c = 20.0
[table]
reader = "csv"
delimiter = ","
decimal = "."
[columns.time_s]
column = "t"
unit = "s"
[columns.pressure_bar_abs]
column = "P"
unit = "bar abs"
{figures("pressure_bar_abs")}[columns.speed_rpm]
column = "n"
unit = "rpm"
{figures("speed_rpm")}[[files]]
file = "log.csv"
kind = "transient"
"""


def _a_run(folder: Path) -> Path:
    """A finished run in `folder`/logs."""
    return write_sweep(folder / "logs")


def _a_run_of_bytes(folder: Path) -> None:
    """A finished run of a virtual bench, which is swept once."""
    kept = Path(tempfile.gettempdir()) / f"kills-sweep-{os.getpid()}"
    if not kept.exists():
        line = f"sweep virtual --rate 10 --logs {kept} --minutes-running 0"
        if _run(line, folder).wait(LONGEST_S):
            raise RuntimeError(f"no sweep: {_said(folder)}")
        atexit.register(shutil.rmtree, kept)
    shutil.copytree(kept, folder / "logs", dirs_exist_ok=True)


def _a_killed_run(folder: Path) -> None:
    """The same without its end, and with a torn last line."""
    run = _a_run(folder)
    (run / "end.json").unlink()
    with (run / "samples.csv").open("ab") as samples:
        samples.write(b"12345,gau")


def _a_logger_file(folder: Path) -> None:
    (folder / "log.csv").write_text(LOGGER, encoding="utf-8")
    (folder / "map.toml").write_text(MAPPING, encoding="utf-8")


@dataclass(frozen=True)
class Command:
    """What is killed. `inputs`: what it reads, made in a folder; `lines`: commands of that folder, one after the other.

    `results`: files that it makes, where another result stood before. `changes`: whether it writes into a run itself.
    `together`: files that are all there or none. `mark`: a folder in which something new means that it writes.
    """

    name: str
    inputs: Callable[[Path], object]
    lines: tuple[str, ...]
    results: tuple[str, ...] = ()
    changes: bool = False
    together: tuple[str, ...] = ()
    mark: str = "out"


COMMANDS = {
    one.name: one
    for one in (
        Command(
            "replay",
            _a_run_of_bytes,
            ("replay last --logs logs --save --with-model -o out",),
            ("out/replay.csv", "out/replay.png"),
            mark="logs",
        ),
        Command("repair", _a_killed_run, ("runs repair last --logs logs",), changes=True, mark="logs"),
        Command("export", _a_run, ("runs export last --logs logs -o out",), together=FOLDER, mark="."),
        Command("export_samples", _a_run, ("runs export last --logs logs -o out/s.parquet",)),
        Command("import", _a_logger_file, ("runs import log.csv --mapping map.toml --logs logs",), mark="logs"),
        Command(
            "import_recording",
            _a_logger_file,
            ("runs import log.csv --mapping map.toml -o out",),
            together=FOLDER,
            mark=".",
        ),
        Command(
            "fit",
            lambda _: None,
            ("fit published_sweep -o out --json fit.json --effective-samples 400",),
            ("out/posterior.json", "out/report.html", "out/report.png", "fit.json"),
        ),
        Command(
            "diagnose",
            lambda _: None,
            ("diagnose published_sweep -o out --json diagnosis.json",),
            ("out/diagnosis.json", "out/report.html", "out/report.png", "diagnosis.json"),
        ),
        Command(
            "challenge",
            lambda _: None,
            ("challenge make out --cases 1 --only none --seed 7 --family development", "challenge run out"),
        ),
    )
}  # fmt: skip


@dataclass(frozen=True)
class Kill:
    """One kill.

    `finished`: whether the command had ended by itself.
    `temporary`, `left`: hidden temporary folders and files after the kill, and after the command was run again.
    """

    command: str
    moment: str
    finished: bool
    temporary: int
    left: int
    faults: list[str]


def kill_once(command: Command, usual_s: float, draw: random.Random) -> Kill:
    """Kill a command once, look at what is left, and run it again to its end. `usual_s`: how long it takes [s]."""
    with tempfile.TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        _prepare(command, folder)
        before = _files(folder)
        at_writing = draw.random() < 0.5
        after_s = draw.uniform(0.0, JUST_AFTER_S) if at_writing else draw.uniform(0.0, 0.9 * usual_s)
        finished = _start_and_kill(command, folder, after_s, at_writing)
        faults = _faults(command, folder, before)
        temporary = hidden_in(folder)
        faults += _again(command, folder, before)
        left = hidden_in(folder)
        moment = f"{'from the first writing' if at_writing else 'from the start'} {after_s:.3f} s"
        return Kill(command.name, moment, finished, temporary, left, faults)


def usual(command: Command) -> float:
    """How long a command takes that nobody kills [s]; it must succeed."""
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        folder = Path(name)
        _prepare(command, folder)
        start_s = time.monotonic()
        faults = _again(command, folder, _files(folder))
        if faults:
            raise RuntimeError(f"{command.name}, not killed: {'; '.join(faults)}")
        return time.monotonic() - start_s


def _prepare(command: Command, folder: Path) -> None:
    (folder / "logs").mkdir()
    command.inputs(folder)
    for result in command.results:
        (folder / result).parent.mkdir(exist_ok=True)
        (folder / result).write_bytes(OLD)


def _files(folder: Path) -> dict[str, bytes]:
    """What is there, without locks and temporary files."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != SAID and not _is_hidden(path, folder)
    }


def _is_hidden(path: Path, folder: Path) -> bool:
    """Locks, and what is written beside its place."""
    return any(part.startswith(".") for part in path.relative_to(folder).parts)


def hidden_in(folder: Path) -> int:
    """How many temporary folders and files there are."""
    return sum(path.name.startswith(".") and path.name != ".lock" for path in folder.rglob("*"))


def _run(line: str, folder: Path) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-m", "spinbench", *line.split()]
    search = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    said = (folder / SAID).open("wb")
    return subprocess.Popen(words, cwd=folder, env=os.environ | {"PYTHONPATH": search}, stdout=said, stderr=said)


def _paths(folder: Path) -> set[Path]:
    """What is there while a command writes: `walk` passes over a folder that is gone before it can be looked into."""
    inside = ((Path(top), [*folders, *files]) for top, folders, files in os.walk(folder))
    return {top / name for top, names in inside for name in names if name != SAID}


def _said(folder: Path) -> str:
    """The end of what the last command said."""
    return (folder / SAID).read_text(encoding="utf-8", errors="replace")[-300:]


def _start_and_kill(command: Command, folder: Path, after_s: float, at_writing: bool) -> bool:
    """Run the lines until the moment has come, and kill what runs then. Whether all had ended before."""
    start_s, moment_s = time.monotonic(), None if at_writing else time.monotonic() + after_s
    there = _paths(folder / command.mark)
    for line in command.lines:
        process = _run(line, folder)
        while process.poll() is None and time.monotonic() < start_s + LONGEST_S:
            if moment_s is None and _paths(folder / command.mark) != there:
                moment_s = time.monotonic() + after_s
            if moment_s is not None and time.monotonic() >= moment_s:
                children = psutil.Process(process.pid).children(recursive=True)
                process.kill()
                process.wait()
                psutil.wait_procs(children, timeout=60.0)
                return False
            time.sleep(0.001)
        process.wait()
    return True


def _faults(command: Command, folder: Path, before: dict[str, bytes]) -> list[str]:
    """What is neither as it was nor whole."""
    found = _files(folder)
    faults = [f"{name} is gone" for name in before if name not in found]
    there = [name for name in command.together if name in found]
    faults += [] if len(there) in (0, len(command.together)) else [f"{', '.join(there)} alone"]
    for name, content in found.items():
        if name.startswith("logs/"):
            continue
        if content != before.get(name) and (problem := half_written(Path(name), content)):
            faults.append(f"{name}: {problem}")
    for run in sorted((folder / "logs").iterdir()):
        faults += _run_faults(run, before, command.changes)
    return faults


def _run_faults(run: Path, before: dict[str, bytes], changes: bool) -> list[str]:
    """A run that was there is as it was; one that is written has whole rows, and can be read as soon as it is begun."""
    if not (run / "start.json").exists():
        headed = (
            path.read_bytes().partition(b"\n")[2] for path in run.glob("*.csv")
        )  # the start comes after the header
        return [f"{run.name}: rows without a start"] if any(headed) else []
    samples = before.get(f"logs/{run.name}/samples.csv", b"")
    acknowledged = samples[: samples.rfind(b"\n") + 1]
    try:
        read = read_run(run)
    except Exception as error:
        return [f"{run.name} cannot be read: {error}"]
    faults = [] if (run / "samples.csv").read_bytes().startswith(acknowledged) else [f"{run.name}: rows were lost"]
    if samples and not changes:
        names = [name for name in before if name.startswith(f"logs/{run.name}/")]
        same = all((run.parent.parent / name).read_bytes() == before[name] for name in names)
        faults += [] if same else [f"{run.name} was changed"]
    if read.state == "finished" and (problems := verify(run)):
        faults.append(f"{run.name} says finished, and does not verify: {problems[0]}")
    return faults


def half_written(name: Path, content: bytes) -> str:
    """Why a result is not whole; empty when it is."""
    try:
        if name.suffix == ".json":
            json.loads(content)
        elif name.suffix == ".toml":
            tomllib.loads(content.decode())
        elif name.suffix == ".parquet":
            return "" if content[:4] == content[-4:] == b"PAR1" else "not whole"
        if name.suffix in (".csv", ".jsonl"):
            lines = content.decode().splitlines()
            rows = list(csv.reader(lines)) if name.suffix == ".csv" else [json.loads(line) for line in lines]
            if name.suffix == ".csv" and len({len(row) for row in rows}) > 1:
                return "rows of different lengths"
    except ValueError as error:
        return f"not whole: {error}"
    end = ENDS.get(name.suffix, b"")
    return "" if content.rstrip().endswith(end.rstrip()) and content else "ends too soon"


def _again(command: Command, folder: Path, before: dict[str, bytes]) -> list[str]:
    """Run the lines to their end on what is there, and look at the results."""
    place = command.lines[0].partition(" -o ")[2]
    if place and not command.results:  # nothing is overwritten
        shutil.rmtree(folder / place, ignore_errors=True)
        (folder / place).unlink(missing_ok=True)
    for line in command.lines:
        process = _run(line, folder)
        code = process.wait(LONGEST_S)
        if code:
            return [f"again: exit code {code}: {_said(folder)}"]
    found = _files(folder)
    faults = [f"again: {result} is still old" for result in command.results if found.get(result) in (OLD, None)]
    return faults + [f"again: {fault}" for fault in _faults(command, folder, before)]


def of_a_command(out: Path, name: str, kills: int, seed: int) -> tuple[int, int, int, int]:
    """Kill a command so often.

    Returns the numbers of kills, without those that came when it had ended, of faults, of kills that left something
    hidden, and of those where it was still there after the command was run again.
    """
    counted = faults = hidden = left = 0
    usual_s = None
    for i in range(kills):
        path = out / f"{name}_{seed}_{i}.json"
        if not path.exists():
            usual_s = usual(COMMANDS[name]) if usual_s is None else usual_s
            kill = kill_once(COMMANDS[name], usual_s, random.Random(f"{name} {seed} {i}"))
            write_file(path, json.dumps(asdict(kill), indent=1).encode())
        kill = Kill(**json.loads(path.read_text(encoding="utf-8")))
        counted += not kill.finished
        faults += bool(kill.faults)
        hidden += bool(kill.temporary)
        left += bool(kill.left)
        told = "; ".join(kill.faults) or ("had ended" if kill.finished else "nothing half-written")
        temporary = f"{kill.temporary} temporary, {kill.left} in the end"
        print(f"{name} {i + 1}/{kills}: {kill.moment}, {temporary}: {told}", flush=True)
    return counted, faults, hidden, left
