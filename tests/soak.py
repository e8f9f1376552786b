"""Every kind of line at its full rate, at once, for as long as asked: `make soak`.

The virtual bench has a process of its own; its devices tell the time, so that a wrong value shows (`tests.faults`).
Lines, workers, recorder and run log are those of a sweep. First pymodbus' client polls the same registers, alone.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from rig.acquisition.channels import Channels
from rig.acquisition.opening import line_of
from rig.acquisition.recorder import Recorder
from rig.acquisition.worker import Worker
from rig.bench.bench import Bench, bench_of
from rig.clock import Clock
from rig.readings import NS, Exchange
from rig.recording.files import write_file
from rig.runlog import RunWriter, read_run, verify
from rig.virtual.launch import port_for
from tests.conformance.clients import Place, Pymodbus
from tests.faults import BENCH, LINES, Ramp, is_poll, off_rpm
from tests.synthetic_runs import start_of
from tests.virtual_benches import FLOW, serving

SHORTEST_S = 1e-6  # between two polls: as fast as the line bears
BARE_S = 10.0
STARTS_S = 3.0  # until a process polls
UNASKED = "frames"  # they have no time: where the machine halts, they are older than they seem
KEPT = 200_000  # intervals of a line, of which the spread is told


@dataclass
class Seen:
    """What a line gave. `intervals_s`: between answers, the latest [s]."""

    polls: int = 0
    usable: int = 0
    wrong: int = 0
    last_ns: int = 0
    intervals_s: list[float] = field(default_factory=list)


def soak_bench() -> Bench:
    """A bench with a line of each kind, and a device on each that tells the time."""
    head, _, _ = BENCH.partition("[lines.wire]")
    text, files = head.replace("tach.speed_rpm", "rtu.speed_rpm"), {"instruments/flow.toml": FLOW}
    for name, (instrument, table) in LINES.items():
        unit = "unit_id = 1\n" if name in ("rtu", "tcp") else ""
        text += f'[lines.{name}]\ntimeout_s = 1.0\nslowest_reply_s = 2.0\n{table}\n[devices.{name}]\nline = "{name}"\n'
        text += f'instrument = "{name}"\n{unit}'
        files[f"instruments/{name}.toml"] = instrument
    files["bench.toml"] = text + "[virtual]\n"
    return bench_of("soak", {name: source.encode() for name, source in files.items()}, "soak.toml")


def _serve(folder: str, ready, end) -> None:
    with serving(soak_bench(), Path(folder), 1.0, 1, Ramp) as served:
        ready.send(served.ports)
        end.wait()


def bare(ports: dict, seconds: float, names: Sequence[str] = ("rtu", "tcp")) -> dict[str, float]:
    """What pymodbus' client reads of the same registers, one line after the other [1/s]."""
    found = {}
    for name in names:
        at = ports["lines"][name]
        client = Pymodbus(Place(at["port"]) if name == "rtu" else Place(tcp_port=at["tcp_port"]))
        start_s, polls = time.monotonic(), 0
        while time.monotonic() < start_s + seconds:
            client.read(1, "holding", 6, 2)
            polls += 1
        found[name] = polls / (time.monotonic() - start_s)
        client.close()
    return found


def crowded(ports: dict, seconds: float, folder: Path) -> float:
    """What pymodbus' client reads on TCP in a process of its own while ours poll the other lines [1/s].

    One thread serves all of the virtual bench's lines: how much they cost a line is no matter of who polls it.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        found = pool.submit(bare, ports, seconds, ("tcp",))
        soak(ports, seconds + STARTS_S, folder, [name for name in LINES if name != "tcp"])
        return found.result()["tcp"]


def soak(
    ports: dict, seconds: float, folder: Path, names: Sequence[str] = tuple(LINES)
) -> tuple[dict[str, Seen], list[int], Path]:
    """Poll lines at once; what each gave, this process's memory each second [bytes], and the run."""
    bench, clock = soak_bench(), Clock(ports["rate"], ports["clock_start_ns"])
    seen: dict[str, Seen] = defaultdict(Seen)
    writer = RunWriter.create(folder, start_of("zero"))
    recorder = Recorder(writer, _Counting(seen), Channels())
    recorder.start()
    workers = []
    for name in names:
        table = bench.file.lines[name]
        line = line_of(name, table, port_for(ports, name, table, clock), clock)
        workers.append(Worker(line, {name: (bench.build(name), SHORTEST_S)}, recorder.put, recorder.note, clock))
        workers[-1].connect()
    for worker in workers:
        worker.start()
    memory, until_s = [], time.monotonic() + seconds
    while time.monotonic() < until_s:
        time.sleep(1.0)
        memory.append(psutil.Process().memory_info().rss)
    for worker in workers:
        worker.stop()
    recorder.finish()
    writer.end("finished")
    failures = [worker.failure for worker in workers if worker.failure]
    if failures:
        raise failures[0]
    return seen, memory, writer.folder


class _Counting:
    """A stage that counts what passes, and changes nothing."""

    def __init__(self, seen: dict[str, Seen]) -> None:
        self._seen = seen

    def __call__(self, exchange: Exchange) -> Exchange:
        for reading in exchange.readings if is_poll(exchange) else ():
            of = self._seen[reading.device]
            of.polls += 1
            of.usable += reading.usable
            of.wrong += reading.good and off_rpm(reading, reading.device) > 0.0
            if of.last_ns and len(of.intervals_s) < KEPT:
                of.intervals_s.append((reading.reply_ns - of.last_ns) / NS)
            of.last_ns = reading.reply_ns
        return exchange

    def hear(self, event: str, details: object) -> None:
        """Nothing."""


def told(seen: dict[str, Seen], rates: dict[str, float], seconds: float) -> str:
    """The table."""
    heads = ["line", "polls", "polls/s", "pymodbus alone, polls/s", "wrong as ok", "without a value"]
    rows = [[*heads, "between answers, ms: median, 99 %, longest"]]
    rows.append(["---"] * len(rows[0]))
    for name, of in seen.items():
        span = np.quantile(of.intervals_s or [np.nan], [0.5, 0.99, 1.0]) * 1e3
        peer = f"{rates[name]:.0f}" if name in rates else ""
        spread = ", ".join(f"{value:.3g}" for value in span)
        rows.append([name, of.polls, f"{of.polls / seconds:.0f}", peer, of.wrong, of.polls - of.usable, spread])
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows) + "\n"


def files_told(run: Path) -> str:
    """Sizes of the run's files, and what a row takes."""
    sizes = {path.name: path.stat().st_size for path in sorted(run.iterdir()) if path.suffix in (".csv", ".jsonl")}
    read = read_run(run)
    rows = Counter({"samples.csv": len(read.samples), "wire.jsonl": read.exchange_count})
    each = []
    for name, size in sizes.items():
        each.append(f"{name} {size / 1e6:.1f} MB" + (f", {size / rows[name]:.0f} bytes a row" if rows[name] else ""))
    return "; ".join(each) + f"; {'verified' if not verify(run) else 'NOT verified'}"


def main() -> int:
    """Soak, and print and keep what came of it; 1 where a wrong answer was taken for good."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--minutes", type=float, default=30.0)
    options = parser.parse_args()
    seconds = 60.0 * options.minutes
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    end = context.Event()
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        bench = context.Process(target=_serve, args=(folder, theirs, end), daemon=True)
        bench.start()
        if not ours.poll(120.0):
            raise TimeoutError("the virtual bench did not start within two minutes")
        ports = ours.recv()
        peer_s = min(BARE_S, seconds / 4.0)
        rates = bare(ports, peer_s)
        beside = crowded(ports, peer_s, Path(folder) / "others")
        seen, memory, run = soak(ports, seconds, Path(folder) / "logs")
        end.set()
        bench.join(30.0)
        third = [f"{memory[i] / 1e6:.0f}" for i in (0, len(memory) // 3, 2 * len(memory) // 3, -1)]
        text = told(seen, rates, seconds)
        text += f"\npymodbus on TCP, while ours poll the other lines: {beside:.0f} polls/s.\n"
        text += (
            f"\n{options.minutes:g} minutes. Memory after 1 s, a third, two thirds, at the end: {', '.join(third)} MB."
        )
        text += f"\nFiles: {files_told(run)}.\n"
    write_file(options.out / "soak.md", text.encode())
    print(text)
    return min(sum(of.wrong for name, of in seen.items() if name != UNASKED), 1)


if __name__ == "__main__":
    sys.exit(main())
