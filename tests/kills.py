"""Kill -9 at random moments of a sweep on the virtual bench: is the run whole, and is the regulator at zero in time?

`make kills` runs 50; the tests run a few. Each kill is of a real controller process that sweeps a virtual bench of its
own; the bench outlives it, and tells when its regulator was sent to zero.
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
from dataclasses import dataclass
from pathlib import Path

import psutil

from rig.interlock.watchdog import START_S
from rig.replay.replaying import replay
from rig.runlog import read_run, repair, verify
from rig.virtual.launch import ask

ROOT = Path(__file__).resolve().parents[1]
CONTROLLER = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from spinbench.cli import app
app(["sweep", "virtual", "--logs", sys.argv[2], "--minutes-running", "0"])
"""
WATCHDOG_S = 6.0  # one that was only being started has to read its files first
LONGEST_S = 2.0  # real time from the kill to the regulator at zero
MOMENTS_S = (0.0, 10.5)  # after the run's folder is there; a sweep takes some 12 s


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


def kill_once(after_s: float) -> Kill:
    """Start a sweep, kill it, and look at what is left.

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
            [sys.executable, "-c", CONTROLLER, str(ROOT), str(logs)],
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


def main() -> int:
    """Kill as often as asked, tell each, and return the number of faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    draw = random.Random(options.seed)
    faults = 0
    slowest = 0.0
    for i in range(options.kills):
        kill = kill_once(draw.uniform(*MOMENTS_S))
        faults += bool(kill.fault)
        slowest = max(slowest, kill.zero_after_s)
        words = kill.fault or "nothing lost"
        print(
            f"{i + 1}/{options.kills}: after {kill.after_s:.2f} s, {kill.rows_after} rows, at zero after "
            f"{kill.zero_after_s:.2f} s{'' if kill.raised else ' (never raised)'}: {words}",
            flush=True,
        )
    print(f"{options.kills} kills, {faults} faults; slowest to zero {slowest:.2f} s (seed {options.seed})")
    return faults


if __name__ == "__main__":
    sys.exit(min(main(), 1))
