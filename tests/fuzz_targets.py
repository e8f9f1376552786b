"""What is fuzzed: a function a codec or reader, which takes any bytes, and inputs to begin with.

A target returns whether the bytes were taken. It may refuse them in words; anything else that it raises is a fault. So
is a value that the bytes do not say: each target says by other means what they do.
"""

from __future__ import annotations

import contextlib
import math
import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from configs import ConfigError
from rig.bench.bench import bench_of, read_bench
from rig.bench.instrument import instrument_of
from rig.exchange.guess.proposal import propose
from rig.exchange.importing import import_recording
from rig.exchange.mapping import read_mapping
from rig.instruments import alicat, ascii, keller_30x, lutron, manual
from rig.instruments.codecs import edge_frames, registers
from rig.lines.modbus import READ_COILS, READ_HOLDING, WRITE_MANY, WRITE_ONE, Request, decode, encode, length_of
from rig.lines.port import BadReplyError
from rig.recording import RecordingError, read_recording
from rig.runlog import RunError, read_run, verify
from rig.runlog.tail import Tail
from tests.instrument_peers import edge_bytes, lutron_bytes
from tests.kills_of_commands import LOGGER, MAPPING
from tests.modbus_peer import crc
from tests.synthetic_runs import write_sweep

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "configs" / "instruments").glob("*.toml"))
KINDS = ("u16", "i16", "u32", "i32", "f32", "u64", "i64", "f64")
FUNCTIONS = (READ_HOLDING, READ_COILS, WRITE_ONE, WRITE_MANY)
APART = b"\xff\xfe\xff"  # between the files of an input
SHORT = 'format = "recording/1"\nmotor = "ptm3600"\n[ambient]\npressure_bar_abs = 1.0\ntemperature_c = 20.0\n'
SHORT += '[[files]]\nfile = "sweep.csv"\nkind = "steady"\n'
RUN_FILES = ("samples.csv", "events.jsonl", "plateaus.csv", "wire.jsonl", "end.json", "start.json")
REFUSALS = (BadReplyError, ConfigError, RecordingError, RunError, manual.EntryError)


def modbus(data: bytes) -> bool:
    """An answer to a question of the first bytes."""
    if len(data) < 5:
        return False
    framing, function = ("rtu", "tcp")[data[0] & 1], FUNCTIONS[data[0] >> 1 & 3]
    request = Request(data[1] % 248, function, data[2], data[3] % 8 + 1, (data[4],))
    complete = length_of(request, framing, bool(data[0] & 8))
    buffer = data[5:]
    length = complete(buffer)
    if length is None:
        return False
    frame = buffer[:length]
    values = decode(request, framing, 7, frame)
    if framing == "rtu":
        assert frame[0] == request.unit, "another unit's answer"
        assert crc(frame[:-2]) == frame[-2:], "a wrong CRC"
        body = frame[1:-2]
    else:
        assert frame[:4] == b"\0\7\0\0", "another question's answer"
        body = frame[7:]
    assert body[0] == function, "another function's answer"
    if function == READ_HOLDING:
        assert body[1] == 2 * request.count == len(body) - 2, "another length"
        assert values == tuple(body[i] << 8 | body[i + 1] for i in range(2, len(body), 2)), "other values"
    return True


def numbers(data: bytes) -> bool:
    """Registers to a number and back."""
    if len(data) < 10:
        return False
    kind, order = KINDS[data[0] % 8], ("big", "little")[data[1] & 1]
    width, byte_order = registers.width_of(kind), ("big", "little")[data[1] >> 1 & 1]
    words = tuple(data[i] << 8 | data[i + 1] for i in range(2, 2 + 2 * width, 2))
    number = registers.number_of(words, kind, order, byte_order)
    if not math.isnan(number):
        assert registers.words_of(number, kind, order, byte_order) == words, "other registers"
    return True


def edges(data: bytes) -> bool:
    """Frames of the edge counter, cut out in one piece and in two."""
    frames, rest, skipped = edge_frames.cut(data[1:])
    assert len(frames) * edge_frames.FRAME_BYTES + len(rest) + skipped == len(data[1:]), "bytes were lost"
    half = data[0] if data else 0
    first, tail, _ = edge_frames.cut(data[1 : 1 + half])
    assert first + edge_frames.cut(tail + data[1 + half :])[0] == frames, "other frames in two pieces"
    counting = edge_frames.Counting()
    for frame in frames:
        assert edge_bytes(frame) in data, "a frame that was not sent"
        counting.take(frame)
    return bool(frames)


def meter(data: bytes) -> bool:
    """Frames of the Lutron meter."""
    frames, rest = lutron.cut(data)
    assert len(rest) < lutron.FRAME_BYTES, "what waits is no beginning of a frame"
    for frame in frames:
        value = lutron.decode(frame).value
        assert abs(value) == int(frame[7:15]) / 10 ** int(frame[6:7]), "another value"
    return bool(frames)


_MONARCH = instrument_of((ROOT / "configs/instruments/monarch_act3x.toml").read_bytes(), "monarch_act3x")
_ALICAT = instrument_of((ROOT / "configs/instruments/alicat_pc_ascii.toml").read_bytes(), "alicat_pc_ascii")
_PATTERN = re.compile(_MONARCH.pattern)


def text(data: bytes) -> bool:
    """A line of a tachometer that answers in text."""
    with contextlib.suppress(BadReplyError):
        ascii.ends_with(b"\r\n", 64)(data)
    found = ascii.decode(data, _PATTERN, _MONARCH.channels)["speed_rpm"]
    said = data.decode().strip("\r\n\0\x02\x03").strip()
    assert found.value == (float(said) if said.strip("+-.") else None), "another value"
    return True


def controller(data: bytes) -> bool:
    """A line of an Alicat."""
    line = data.decode("ascii", errors="replace")
    fields, flags = alicat.decode(line, "A", _ALICAT.layout)
    names = [name for name in _ALICAT.channels if name in fields]
    judged = alicat.judge({name: alicat._number(fields[name]) for name in names}, fields, flags)
    assert all(value.raw in line.split() for value in judged.values()), "a value that was not sent"
    return True


def transmitter(data: bytes) -> bool:
    """The registers of a Keller transmitter."""
    words = [data[i] << 8 | data[i + 1] for i in range(0, len(data) - 1, 2)]
    return len(words) >= 10 and bool(keller_30x.decode(words, ["pressure_bar_abs", "temperature_c"]))


_COLUMNS = {"speed_rpm": next(iter(_MONARCH.channels.values()))}


def entry(data: bytes) -> bool:
    """What a person types."""
    manual.decode_entry(data.decode("utf-8", errors="replace"), _COLUMNS)
    return True


def instrument(data: bytes) -> bool:
    """An instrument file."""
    instrument_of(data, "instrument.toml")
    return True


_LAB = read_bench(ROOT / "configs/benches/virtual.toml")


def bench(data: bytes) -> bool:
    """A bench file, with the instruments of the virtual one."""
    bench_of("fuzzed", {**_LAB.sources, "bench.toml": data}, "bench.toml")
    return True


@contextlib.contextmanager
def _folder(files: dict[str, bytes]):
    memory = Path("/dev/shm")  # noqa: S108
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=memory if memory.is_dir() else None) as name:
        for file, content in files.items():
            (Path(name) / file).write_bytes(content)
        yield Path(name)


def mapping(data: bytes) -> bool:
    """A mapping file."""
    with _folder({"map.toml": data}) as folder:
        read_mapping(folder / "map.toml")
    return True


def imported(data: bytes) -> bool:
    """A logger's CSV file, by a mapping that is right; nothing is left behind where it is refused."""
    with _folder({"log.csv": data, "map.toml": MAPPING.encode()}) as folder:
        try:
            import_recording([folder / "log.csv"], read_mapping(folder / "map.toml"), folder / "out")
        except REFUSALS:
            assert sorted(path.name for path in folder.iterdir()) == ["log.csv", "map.toml"], "something was left"
            raise
    return True


def guess(data: bytes) -> bool:
    """A table of which the mapping is guessed."""
    with _folder({"log.csv": data}) as folder:
        propose(folder / "log.csv")
    return True


def recording(data: bytes) -> bool:
    """A recording: its table, and its rows."""
    head, _, rows = data.partition(APART)
    with _folder({"recording.toml": head, "sweep.csv": rows}) as folder:
        read_recording(folder)
    return True


_RUN = Path(tempfile.mkdtemp(prefix="fuzz-run-"))


def _run_files() -> dict[str, bytes]:
    """The files of a small run; it is made once."""
    if not any(_RUN.iterdir()):
        written = write_sweep(_RUN / "logs")
        for name in RUN_FILES:
            lines = (written / name).read_bytes().splitlines(keepends=True)
            (_RUN / name).write_bytes(b"".join(lines if name.endswith(".json") else lines[:12]))
        shutil.rmtree(_RUN / "logs")
    return {path.name: path.read_bytes() for path in _RUN.iterdir()}


def run(data: bytes) -> bool:
    """A run of which one file is another."""
    name, content = RUN_FILES[data[0] % len(RUN_FILES)] if data else RUN_FILES[0], data[1:]
    with _folder(_run_files() | {name: content}) as folder:
        with contextlib.suppress(RunError):
            Tail(folder).advance()
        found = read_run(folder)
        rows = content.rpartition(b"\n")[0].count(b"\n") if name == "samples.csv" else len(found.samples)
        assert len(found.samples) == rows, "rows were lost or made"
        list(found.exchanges())
        verify(folder)
    return True


_CODECS = (modbus, numbers, edges, meter, text, controller, transmitter, entry)
_READERS = (instrument, bench, mapping, imported, guess, recording, run)
TARGETS: dict[str, Callable[[bytes], bool]] = {one.__name__: one for one in (*_CODECS, *_READERS)}


def seeds(name: str) -> list[bytes]:
    """Inputs that a target takes."""
    if name == "modbus":
        answer = bytes([3, 3, 4, 0, 1, 255, 2])
        return [b"\0\3\0\1\0" + answer + crc(answer), b"\1\3\0\1\0\0\7\0\0\0\7" + answer] + [
            bytes([how, 3, 9, 0, 5]) + encode(Request(3, function, 9, 1, (5,)), framing, 7)
            for how, function, framing in ((4, WRITE_ONE, "rtu"), (5, WRITE_ONE, "tcp"))
        ]
    frames = [edge_frames.Frame(edge_frames.EDGE, i, 0, 1000 * i, i) for i in range(3)]
    return {
        "numbers": [
            bytes([kind, order]) + b"\x12\x34\x56\x78\x9a\xbc\xde\xf0" for kind in range(8) for order in range(4)
        ],
        "edges": [b"\5" + b"".join(map(edge_bytes, frames))],
        "meter": [lutron_bytes(lutron.Frame("1", "19", 397.5), 1) * 2],
        "text": [b"397.1", b" +12.5"],
        "controller": [("A " + " ".join("+1.00" if e != "gas" else "Air" for e in _ALICAT.layout)).encode()],
        "transmitter": [b"\x40\0\0\0" * 6],
        "entry": [b"397", b">100"],
        "instrument": [path.read_bytes() for path in FILES],
        "bench": [_LAB.sources["bench.toml"]],
        "mapping": [MAPPING.encode(), (ROOT / "configs/imports/emps.toml").read_bytes()],
        "imported": [LOGGER.encode()],
        "guess": [LOGGER.encode(), b"Zeit;Druck [kPa]\n0,1;200\n0,2;199\n"],
        "recording": [SHORT.encode() + APART + (ROOT / "logs/published_sweep/sweep.csv").read_bytes()],
        "run": [bytes([i]) + _run_files()[name] for i, name in enumerate(RUN_FILES)],
    }[name]


def fault_of(name: str, data: bytes) -> str:
    """What a target does that it should not; empty when it takes or refuses the bytes."""
    try:
        TARGETS[name](data)
    except REFUSALS as error:
        return "" if str(error).strip() else "a refusal without words"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""
