"""Every fault of the virtual bench's menu on every kind of line: how many wrong values does the rig take for good?

`make faults` runs the whole table; the tests run a few cells. The device tells a speed that is the time: it rises by
10 rpm each second of the bench's clock, which the campaign shares. So each reading is compared with what the device
could have said between the question and its answer, to 2 ms.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import tempfile
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from rig.acquisition.opening import line_of
from rig.acquisition.worker import Worker
from rig.bench.bench import Bench, bench_of
from rig.readings import NS, Exchange, Reading
from rig.recording.files import write_file
from rig.virtual.devices.faults import FAULT_KINDS, MODBUS, NUMBERS, ONCE
from rig.virtual.launch import port_for
from rig.virtual.plant.truth import LineTruth
from tests.virtual_benches import FLOW, ROLES, Served, serving

FIRST_RPM, RISE_RPM_S = 1000.0, 10.0
NEAR_S = 0.002  # the resolution, 1 ms, and the rounding
FRAME_S = 0.1  # how old a frame may be that nothing asked for: it tells a mean, and has to cross the wire
AGREE_RPM = 2.0  # of two polls, where there is no checksum: of the Monarch and Lutron files
TIMEOUT_S, SLOWEST_S = 0.1, 0.25
SPANS_S = {"late": 0.15, "very_late": 0.3, "split": 0.01, "unplug": 0.5, "power_cycle": 0.5, "frozen": 0.5}
EVERY_S = 2.0  # of what lasts: a cable out, no power, a frozen value
PERIOD_S = 0.005  # less than an answer takes: question follows answer at once
CHANCE = 0.2  # of everything else, for each reply
PATIENCE_S = 3600.0
ESCAPES = {  # of a damaged answer, by the checksum alone
    "rtu": "CRC-16: none of one bit, 2^-16 of any damage",
    "text": "no checksum",
    "frames": "no checksum",
    "tcp": "no checksum in Modbus TCP",
}

HEAD = 'format = "instrument/1"\ntitle = "ramp"\nsource = "test"\ntrust = "simulated"\nstale_s = 0.2\n'
CHANNEL = '[channels.speed_rpm]\nunit = "rpm"\nlowest = 0.0\nhighest = 99999.0\nresolution = 0.01\n'
REGISTERS = f'{HEAD}family = "modbus"\n{CHANNEL}address = 6\ntype = "u32"\nscale = 0.01\ninvalid = [4294967295]\n'
TEXT = HEAD + CHANNEL.join(
    [
        'family = "ascii"\nquery = "@D3\\r"\npattern = \'\\s?(?P<speed_rpm>[+-]?\\d{1,7}(\\.\\d{0,4})?|----)\\s?\'\n',
        f'agree_within = {AGREE_RPM}\ninvalid = ["----"]\n',
    ]
)
FRAMES = f'{HEAD}family = "lutron"\nupdate_s = 0.03\n{CHANNEL}display = "1"\nagree_within = {AGREE_RPM}\n'
SERIAL, TCP = 'kind = "serial"\nport = "virtual"\nbaud = 19200', 'kind = "tcp"\nhost = "virtual"'
LINES = {"rtu": (REGISTERS, SERIAL), "text": (TEXT, SERIAL), "frames": (FRAMES, SERIAL), "tcp": (REGISTERS, TCP)}
BENCH = f"""
format = "bench/1"
title = "faults"
{ROLES.format(pressure="flowmeter.pressure_bar_gauge")}[lines.wire]
timeout_s = {{timeout_s}}
slowest_reply_s = {{slowest_s}}
{{line}}
[devices.tach]
instrument = "ramp"
line = "wire"
{{unit}}
[virtual]
"""


@dataclass(frozen=True)
class Cell:
    """What one fault did on one kind of line.

    `faults`: how often it happened; `ok`, `unverified`, `gaps`: readings of that quality, and without a value.
    `wrong_ok`, `wrong_unverified`: values among them that the device cannot have meant.
    `far_ok`, `worst_ok_rpm`: of the wrong ones taken as ok, those off by more than two polls may differ, and the worst.
    `longest_s`: the longest time without a usable reading [s].
    """

    line: str
    kind: str
    polls: int
    seed: int
    faults: int
    ok: int
    unverified: int
    gaps: int
    wrong_ok: int
    far_ok: int
    worst_ok_rpm: float
    wrong_unverified: int
    longest_s: float


class Ramp:
    """What stands in the place of line and motor: a shaft whose speed tells the time."""

    ambient_bar = target_bar = pressure_bar = line_bar = 1.0
    room_k = inlet_k = 293.15
    flow_kg_s, vented = 0.0, False

    def __init__(self, _: Bench) -> None:
        self.time_ns, self.line = 0, LineTruth()
        self.listeners, self.setpoints, self.history = [], deque(), deque()

    @property
    def speed_rpm(self) -> float:
        """Of the time."""
        return FIRST_RPM + RISE_RPM_S * self.time_ns / NS

    @property
    def angle_rad(self) -> float:
        """The speed's integral."""
        time_s = self.time_ns / NS
        return (FIRST_RPM + RISE_RPM_S * time_s / 2.0) * time_s * 3.141592653589793 / 30.0

    def volume_flow_l_min(self, *_: float) -> float:
        """None."""
        return 0.0

    def advance(self, to_ns: int) -> None:
        """Carry on to a time."""
        self.time_ns = max(self.time_ns, to_ns)


def off_rpm(reading: Reading, line: str) -> float:
    """How far a value lies from all that the device could have said between question and answer; 0 when true [rpm]."""
    said_s = (reading.value - FIRST_RPM) / RISE_RPM_S
    since_s = reading.request_ns / NS - (FRAME_S if line == "frames" else 0.0)
    off_s = max(since_s - said_s, said_s - reading.reply_ns / NS, 0.0)
    return off_s * RISE_RPM_S if off_s > NEAR_S else 0.0


def cells() -> list[tuple[str, str]]:
    """Line and fault of every cell; each line also without any fault, and with answers later than the slowest."""
    kinds = ["none", *FAULT_KINDS, "very_late"]
    not_on = {"rtu": {*NUMBERS}, "tcp": set(), "text": {*MODBUS, *NUMBERS}, "frames": {*MODBUS, *NUMBERS, "echo"}}
    return [(line, kind) for line in LINES for kind in kinds if kind not in not_on[line]]


def measure(line: str, kind: str, polls: int, seed: int, slow: float = 1.0) -> Cell:
    """Poll through the real driver and the real worker while one fault is in force.

    `slow`: factor on the line's patience and on how late answers are, for a machine that is busy [-].
    """
    bench = _bench(line, slow)
    found: list[Exchange] = []
    draw = zlib.crc32(f"{line} {kind} {seed}".encode())
    with tempfile.TemporaryDirectory(prefix="faults-") as folder, serving(bench, Path(folder), 1.0, draw, Ramp) as bus:
        wire = bench.file.lines["wire"]
        to_device = line_of("wire", wire, port_for(bus.ports, "wire", wire, bus.clock), bus.clock)
        drivers = {"tach": (bench.build("tach"), PERIOD_S)}
        worker = Worker(to_device, drivers, found.append, lambda *_, **__: None, bus.clock)
        worker.connect()
        found.clear()
        lasting = kind in ONCE or kind == "frozen"
        if not lasting and kind != "none":
            late = {"by_s": SPANS_S[kind] * (1.0 if kind == "split" else slow)} if kind in SPANS_S else {}
            bus.ask(do="fault", kind=kind.removeprefix("very_"), line="wire", chance=CHANCE, **late)
        worker.start()
        try:
            laid = _wait(bus, kind if lasting else "", lambda: sum(is_poll(ex) for ex in list(found)) >= polls)
        finally:
            worker.stop()
        if worker.failure:
            raise worker.failure
        counts = bus.ask(do="state")["fault_counts"]
    readings = [reading for exchange in found if is_poll(exchange) for reading in exchange.readings]
    return judged(readings, line, kind, seed, laid if lasting else sum(counts.values()))


def _bench(line: str, slow: float) -> Bench:
    instrument, table = LINES[line]
    unit = "unit_id = 1" if line in ("rtu", "tcp") else ""
    text = BENCH.format(line=table, unit=unit, timeout_s=TIMEOUT_S * slow, slowest_s=SLOWEST_S * slow)
    files = {"bench.toml": text, "instruments/ramp.toml": instrument, "instruments/flow.toml": FLOW}
    return bench_of("faults", {name: source.encode() for name, source in files.items()}, "faults.toml")


def is_poll(exchange: Exchange) -> bool:
    """Whether an exchange is no opening."""
    return exchange.action == "poll"


def _wait(bus: Served, kind: str, is_over: Callable[[], bool]) -> int:
    """Until enough is measured; a fault that lasts is laid again and again. Returns how often."""
    where = {"device": "tach"} if kind == "power_cycle" else {"line": "wire"}
    laid, give_up = 0, time.monotonic() + PATIENCE_S
    next_s = bus.clock.now_ns() / NS + EVERY_S / 4.0  # some polls are good before the first
    while not is_over():
        if time.monotonic() > give_up:
            raise TimeoutError("not over within an hour")
        now_s = bus.clock.now_ns() / NS
        if kind and now_s >= next_s:
            bus.ask(do="fault", kind=kind, **where, **_span(kind, now_s, SPANS_S[kind]))
            laid, next_s = laid + 1, now_s + EVERY_S
        time.sleep(0.02)
    return laid


def _span(kind: str, now_s: float, span_s: float) -> dict[str, float]:
    return {"from_s": now_s, "to_s": now_s + span_s} if kind == "frozen" else {"by_s": span_s}


def judged(readings: list[Reading], line: str, kind: str, seed: int, faults: int) -> Cell:
    """The counts of a cell's readings."""
    usable = [reading for reading in readings if reading.usable]
    off_ok = [off_rpm(reading, line) for reading in usable if reading.good]
    off_other = [off_rpm(reading, line) for reading in usable if not reading.good]
    times_ns = [reading.reply_ns for reading in usable]
    return Cell(
        line,
        kind,
        polls=len(readings),
        seed=seed,
        faults=faults,
        ok=len(off_ok),
        unverified=len(off_other),
        gaps=len(readings) - len(usable),
        wrong_ok=sum(off > 0.0 for off in off_ok),
        far_ok=sum(off > AGREE_RPM for off in off_ok),
        worst_ok_rpm=round(max(off_ok, default=0.0), 2),
        wrong_unverified=sum(off > 0.0 for off in off_other),
        longest_s=round(max((b - a for a, b in itertools.pairwise(times_ns)), default=0) / NS, 2),
    )


def kept(folder: Path, line: str, kind: str, polls: int, seed: int) -> Cell:
    """A cell of the table: measured, or read where it was measured before."""
    path = folder / f"{line}_{kind}_{polls}_{seed}.json"
    if path.exists():
        return Cell(**json.loads(path.read_text(encoding="utf-8")))
    cell = measure(line, kind, polls, seed)
    write_file(path, json.dumps(asdict(cell), indent=1).encode())
    return cell


def table(found: Iterable[Cell]) -> str:
    """The table, as the page has it."""
    heads = ["line", "fault", "polls", "faults", "ok", "**wrong as ok**", f"off by > {AGREE_RPM:g} rpm", "worst, rpm"]
    heads += ["unverified", "wrong among these", "gaps", "longest without, s"]
    rows = [heads, ["---"] * len(heads)]
    for c in found:
        kind = f"`{c.kind}`" + (f" ({ESCAPES[c.line]})" if c.kind == "corrupt" else "")
        rows.append([c.line, kind, c.polls, c.faults, c.ok, c.wrong_ok, c.far_ok, c.worst_ok_rpm])
        rows[-1] += [c.unverified, c.wrong_unverified, c.gaps, c.longest_s]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows) + "\n"


def main() -> int:
    """Measure every cell that is not there yet, and print and keep the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--polls", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=4, help="cells at a time; they mostly wait")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(options.jobs) as pool:
        jobs = [pool.submit(kept, options.out, *cell, options.polls, options.seed) for cell in cells()]
        told = table(job.result() for job in jobs)
    write_file(options.out / "table.md", told.encode())
    print(told)
    return 0


if __name__ == "__main__":
    sys.exit(main())
