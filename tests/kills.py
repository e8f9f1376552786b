"""Kill -9 at random moments of a sweep or a capture of the virtual bench: is the run whole, the regulator soon at zero?

`make kills` runs 200 kills with those of `kills_of_commands`; the tests run a few. Each kill is of a real controller
process on a virtual bench of its own; the bench outlives it, and tells when its regulator was sent to zero.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil

from rig.interlock.watchdog import START_S
from rig.recording.files import write_file
from rig.replay.replaying import replay
from rig.runlog import read_run, repair, verify
from rig.virtual.launch import ask
from tests.kills_of_commands import hidden_in, of_a_command

ROOT = Path(__file__).resolve().parents[1]
CONTROLLER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from spinbench.cli import app
app([*sys.argv[3:], "--logs", sys.argv[2], "--minutes-running", "0"])
"""
SWEEP, CAPTURE = "sweep virtual", "capture virtual --kind coast-down"
WATCHDOG_S = 6.0  # one that was only being started has to read its files first
LONGEST_S = 2.0  # real time from the kill to the regulator at zero
LONG_S = {SWEEP: 10.5, CAPTURE: 5.0}  # kills come within so long after the run's folder is there: it takes longer
COUNTS = {SWEEP: 50, CAPTURE: 25, "replay": 20, "repair": 25, "export": 15, "export_samples": 10, "import": 15}
COUNTS |= {"import_recording": 10, "fit": 10, "diagnose": 15, "challenge": 5}


@dataclass(frozen=True)
class Kill:
    """One kill.

    Attributes
    ----------
    after_s : float
        From the start of the run to the kill [s].
    rows_before, rows_after : int
        Rows of samples.csv just before the kill, and in the end [-].
    kept : bool
        Whether what was there before still stands, byte for byte.
    raised : bool
        Whether the regulator had been raised.
    zero_after_s : float
        From the kill to the last set-point above zero being gone [s]; 0 when there was none.
    readable, replayed, repaired : bool
        Whether the run can be read, replays bit for bit, and verifies after its repair.
    finished : bool
        Whether the sweep had ended by itself before the kill.
    temporary, left : int
        Hidden temporary folders and files after the kill, and after the repair [-].
    """

    after_s: float
    rows_before: int
    rows_after: int
    kept: bool
    raised: bool
    zero_after_s: float
    readable: bool
    replayed: bool
    repaired: bool
    finished: bool
    temporary: int
    left: int

    @property
    def fault(self) -> str:
        """What went wrong; empty when nothing did."""
        checks = {
            "rows were lost": self.kept and self.rows_after >= self.rows_before,
            "not readable": self.readable,
            "does not replay": self.replayed,
            "does not verify after its repair": self.repaired,
            f"regulator not at zero within {LONGEST_S:g} s": self.zero_after_s <= LONGEST_S,
        }
        return "; ".join(words for words, good in checks.items() if not good)


def kill_once(after_s: float, command: str = SWEEP) -> Kill:
    """Start a sweep, or another command that drives the bench, kill it, and look at what is left.

    Parameters
    ----------
    after_s : float
        From the start of the run to the kill [s].
    """
    with tempfile.TemporaryDirectory(prefix="kills-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        logs, temporary = folder / "logs", folder / "tmp"
        logs.mkdir()
        temporary.mkdir()
        controller = subprocess.Popen(
            [sys.executable, "-c", CONTROLLER, str(ROOT), str(logs), *command.split()],
            env=os.environ | {"TMPDIR": str(temporary)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            run = _wait_for(lambda: next(iter(path.parent for path in logs.glob("*/start.json")), None))
            time.sleep(after_s)
            finished = controller.poll() is not None or (run / "end.json").exists()
            before = (run / "samples.csv").read_bytes()
            killed_ns = time.monotonic_ns()
        finally:
            controller.kill()
            controller.wait()
        acknowledged = before[: before.rfind(b"\n") + 1]
        raised, zero_after_s = (False, 0.0) if finished else _zero_after(temporary, killed_ns)
        after = (run / "samples.csv").read_bytes()
        read = read_run(run)
        replayed = replay(read)
        temporary = hidden_in(logs)
        if not finished:
            _wait_for_the_watchdog(run)  # it writes its last line into the run after the regulator is at zero
            repair(run)
        return Kill(
            after_s,
            acknowledged.count(b"\n") - 1,
            after.count(b"\n") - 1,
            after.startswith(acknowledged),
            raised,
            zero_after_s,
            read.state == ("finished" if finished else "killed"),
            replayed.same,
            not told(verify(run)),
            finished,
            temporary,
            hidden_in(logs),
        )


def told(problems):
    """The same problems, said, for whoever looks why a kill was not survived."""
    print(*problems, sep="\n")
    return problems


def _zero_after(temporary: Path, killed_ns: int) -> tuple[bool, float]:
    """Whether the regulator had been raised, and how long after the kill it was sent to zero."""
    path = next(temporary.glob("virtual-bench-*/ports.json"))
    ports = json.loads(path.read_text(encoding="utf-8"))
    give_up = time.monotonic() + 8.0
    while True:
        setpoints = ask(ports, {"do": "state"})["setpoints"]
        last = setpoints[-1] if setpoints else None
        at_zero = last is None or last["pressure_bar_abs"] < 1.05
        if at_zero or time.monotonic() > give_up:
            break
        time.sleep(0.05)
    os.kill(ports["pid"], signal.SIGTERM)
    raised = any(one["pressure_bar_abs"] >= 1.05 for one in setpoints)
    if not at_zero:
        return raised, float("inf")
    return raised, max(0.0, (last["real_ns"] - killed_ns) / 1e9) if last is not None else 0.0


def _wait_for_the_watchdog(run: Path) -> None:
    """Until the watchdog that the run names has ended; for one that is not named yet, as long as any may take."""
    text = (run / "events.jsonl").read_text(encoding="utf-8") if (run / "events.jsonl").exists() else ""
    events = [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
    pid = next((event["pid"] for event in events if event["event"] == "watchdog"), None)
    give_up = time.monotonic() + (WATCHDOG_S if pid is None else START_S)
    while time.monotonic() < give_up and (pid is None or psutil.pid_exists(pid)):
        time.sleep(0.05)


def _wait_for(look):
    give_up = time.monotonic() + 60.0
    while time.monotonic() < give_up:
        found = look()
        if found is not None:
            return found
        time.sleep(0.02)
    raise TimeoutError("the sweep did not start within a minute")


def of_the_bench(out: Path, command: str, kills: int, seed: int) -> tuple[int, int, int, int]:
    """Kill what drives the bench so often; the numbers that `of_a_command` gives."""
    counted = faults = hidden = left = 0
    draw = random.Random(f"{command} {seed}")
    for i in range(kills):
        after_s = draw.uniform(0.0, LONG_S[command])
        path = out / f"{command.split()[0]}_{seed}_{i}.json"
        if not path.exists():
            write_file(path, json.dumps(asdict(kill_once(after_s, command))).encode())
        kill = Kill(**json.loads(path.read_text(encoding="utf-8")))
        counted += not kill.finished
        faults += bool(kill.fault)
        hidden += bool(kill.temporary)
        left += bool(kill.left)
        print(
            f"{command} {i + 1}/{kills}: after {kill.after_s:.2f} s, {kill.rows_after} rows, at zero after "
            f"{kill.zero_after_s:.2f} s{'' if kill.raised else ' (never raised)'}: {kill.fault or 'nothing lost'}",
            flush=True,
        )
    return counted, faults, hidden, left


def main() -> int:
    """Kill as often as asked, going on where it was interrupted; print the counts; 1 where there was a fault."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--share", type=float, default=1.0, help="of the 200 kills")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=[name.split()[0] for name in COUNTS])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, count in COUNTS.items():
        if options.only in (None, name.split()[0]):
            of = of_the_bench if name in LONG_S else of_a_command
            rows.append((name.split()[0], *of(options.out, name, round(count * options.share), options.seed)))
    rows.append(("together", *(sum(row[i] for row in rows) for i in range(1, 5))))
    for name, kills, faults, hidden, left in rows:
        print(f"{name}: {kills} kills, {faults} faults; {hidden} left temporary files, {left} for good")
    return min(rows[-1][2], 1)


if __name__ == "__main__":
    sys.exit(main())
