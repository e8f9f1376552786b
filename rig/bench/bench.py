"""The bench file: which lines there are, which instrument is on each, what role each channel plays, and the sweep.

    format = "bench/1"
    title = "the paper's bench"
    motor = "ptm3600"
    [ambient] [supply] [lines.NAME] [devices.NAME] [roles] [safety] [sweep] [virtual]

docs/bench.md explains each key.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

import configs
from configs import ConfigError, Strict
from rig.bench import checks
from rig.bench.instrument import FOLDER as INSTRUMENTS
from rig.bench.instrument import ChannelFile, Instrument, InstrumentFile, Regulator, Wait, instrument_of
from rig.recording.schema import SupplyTable

BENCH_SOURCE = "bench.toml"
FOLDER = configs.FOLDER / "benches"

Positive = Annotated[float, pydantic.Field(gt=0.0)]
Span = Annotated[float, pydantic.Field(gt=0.0, le=86_400.0)]  # of time [s]: a day at most


class AmbientTable(Strict):
    """The room; what is left out is asked for at the start of a run."""

    pressure_bar_abs: Annotated[float, pydantic.Field(ge=0.5, le=1.2)] | None = None
    pressure_sd_bar: Positive = 0.0015
    temperature_c: Annotated[float, pydantic.Field(ge=-20.0, le=60.0)] | None = None
    relative_humidity: Annotated[float, pydantic.Field(ge=0.0, le=1.0)] | None = None


class LineTable(Strict):
    """One cable."""

    kind: Literal["serial", "tcp", "keyboard"]
    port: str = ""  # of a serial line: its path, by-id where there is one; "virtual" on a virtual bench
    baud: Annotated[int, pydantic.Field(ge=300, le=4_000_000)] = 9600
    parity: Literal["N", "E", "O"] = "N"
    stop_bits: Literal[1, 2] = 1
    data_bits: Literal[7, 8] = 8
    paced: bool = True  # false for USB devices, whose baud rate means nothing
    host: str = ""
    tcp_port: Annotated[int, pydantic.Field(ge=1, le=65535)] = 502
    framing: Literal["rtu", "tcp"] | None = None  # of Modbus; rtu on serial lines and tcp on sockets when left out
    transaction_numbers: Literal["checked", "any"] = "checked"  # of Modbus TCP; any: the device does not repeat them
    echo: bool = False  # each question comes back before its answer: an RS-485 adapter that hears itself, a terminal
    timeout_s: Wait = 0.3
    slowest_reply_s: Wait = 1.0


class DeviceTable(Strict):
    """One instrument on a line."""

    instrument: str  # a file beside the bench file, in the project or in configs/instruments, without its ending
    line: str
    unit_id: Annotated[int, pydantic.Field(ge=0, le=255)] | None = None  # Modbus
    address: str = ""  # other protocols, such as Alicat's letter
    same_device_as: str = ""  # another entry, at the same address: two instrument files tell of one device
    period_s: Annotated[float, pydantic.Field(ge=1e-3, le=3600.0)] = 0.2
    serial_number: str = ""  # as on its plate; another one that answers is refused
    calibration: str = ""  # certificate, for the record
    channel: Annotated[int, pydantic.Field(ge=0, le=15)] | None = None  # output of a many-channel device
    span: Annotated[list[float], pydantic.Field(min_length=2, max_length=2)] | None = (
        None  # of an analogue regulator: set-point at the output's low and high end
    )


class RolesTable(Strict):
    """Which channel is which: ``device.channel``; ``regulator`` is a device."""

    pressure: str
    speed: str
    flow: str | None = None  # left out: the bench has no flow meter
    temperature: str | None = None
    regulator: str | None = None  # left out: a person sets the pressure


class SafetyTable(Strict):
    """Limits, and what is done without."""

    highest_speed_rpm: Positive = 600.0
    highest_pressure_bar_abs: Positive = 4.0
    speed_stale_s: Wait = 1.0
    # Regulators that may run without a communications failsafe of their own.
    waive_failsafe: list[str] = pydantic.Field(default_factory=list)


class SweepTable(Strict):
    """The no-load sweep."""

    levels_bar_abs: Annotated[list[Positive], pydantic.Field(min_length=1, max_length=200)]
    order: Literal["up", "down", "up-down", "down-up", "random"] = "up-down"
    repeats: Annotated[int, pydantic.Field(ge=1, le=100)] = 1
    seed: int = 1  # of the random order
    ramp_bar_s: Annotated[float, pydantic.Field(ge=1e-4, le=1e3)] = 0.5
    window_s: Span = 3.0  # settled is judged over this
    speed_slope_rpm_s: Positive = 2.0  # settled: the slope over the window is below this, or not to be told from 0
    pressure_slope_bar_s: Positive = 0.005
    speed_scatter_rpm: Positive = 10.0
    settle_timeout_s: Span = 60.0
    dwell_s: Span = 5.0
    zero_s: Span = 3.0
    captures: list[Literal["coast-down", "spin-up"]] = pydantic.Field(default_factory=list)
    capture_level_bar_abs: Positive | None = None  # the highest level when left out
    agreeing_readings: Annotated[int, pydantic.Field(ge=2, le=10)] | None = None  # manual bench: instead of the clock


class VirtualTable(Strict):
    """A bench that is not there: see rig/virtual."""

    rate: Annotated[float, pydantic.Field(ge=0.1, le=50.0)] = 1.0  # seconds of the bench in one of the wall
    seed: Annotated[int, pydantic.Field(ge=0)] = 1
    truth: dict[str, float] = pydantic.Field(default_factory=dict)  # parameters of the motor off their defaults
    faults: list[dict[str, str | int | float]] = pydantic.Field(default_factory=list)  # docs/virtual-bench.md


class BenchFile(Strict):
    """A bench file, key by key."""

    format: Literal["bench/1"]
    title: str
    motor: str = "ptm3600"
    motor_serial: str = ""
    lubrication: str = ""
    added_inertia_kg_m2: Annotated[float, pydantic.Field(ge=0.0, le=100.0)] = 0.0  # a flywheel on the shaft
    ambient: AmbientTable = AmbientTable()
    supply: SupplyTable = SupplyTable()
    lines: dict[str, LineTable]
    devices: dict[str, DeviceTable]
    roles: RolesTable
    safety: SafetyTable = SafetyTable()
    sweep: SweepTable
    virtual: VirtualTable | None = None


@dataclass(frozen=True)
class Place:
    """Where a family's `build` puts a device: its table in the bench file, and its line's."""

    table: DeviceTable
    line: LineTable


@dataclass(frozen=True)
class Bench:
    """A bench file with its instruments' files.

    `sources`: the text of each file, for the run's record: a run is replayed with what it was made with.
    """

    name: str
    file: BenchFile
    instruments: dict[str, InstrumentFile]
    sources: dict[str, bytes]

    @property
    def motor(self) -> str | dict[str, Any]:
        """The motor by its shipped name; in full where its file stands beside the bench's, or in the project."""
        source = self.sources.get(motor_source(self.file.motor))
        return self.file.motor if source is None else configs.parse_toml(source, motor_source(self.file.motor))

    def build(self, device: str, place: Place | None = None) -> Instrument:
        """The driver of a device. `place`: where it is looked for; where the bench file has it when left out."""
        settings = self.instruments[device]
        table = self.file.devices[device]
        module = importlib.import_module(f"rig.instruments.{settings.family}")
        return module.build(device, settings, place or Place(table, self.file.lines[table.line]))

    def regulator(self, device: str) -> Regulator:
        """The driver of a device that takes a set-point. Raises ConfigError for one that takes none."""
        driver = self.build(device)
        if not isinstance(driver, Regulator):
            raise ConfigError(f"{self.name}: '{device}' takes no set-point")
        return driver

    def with_flywheel(self, added_inertia_kg_m2: float | None) -> Bench:
        """The bench with another flywheel on the shaft; with that of its file where None is given."""
        if added_inertia_kg_m2 is None:
            return self
        table = self.file.model_dump() | {"added_inertia_kg_m2": added_inertia_kg_m2}
        return replace(self, file=configs.validate(BenchFile, table, f"{self.name} with another flywheel"))

    def channel(self, role: str) -> tuple[str, ChannelFile]:
        """The full name and the figures of the channel that plays a role."""
        name: str = getattr(self.file.roles, role)
        device, _, channel = name.partition(".")
        return name, self.build(device).channels[channel]


def read_bench(path: Path) -> Bench:
    """Read a bench file and the files of its instruments.

    `path`: the bench file, or the name of one in configs/benches.
    It is checked: every device's line and instrument exist, every role is a channel. Raises ConfigError: all mistakes,
    a line each.
    """
    path = bench_path(path)
    source = configs.read_source(path)
    data = configs.parse_toml(source, str(path))
    sources = {BENCH_SOURCE: source}
    devices = data.get("devices")
    tables = devices.values() if isinstance(devices, dict) else ()
    for name in {table.get("instrument") for table in tables if isinstance(table, dict)}:
        found = configs.find("instruments", name, path.parent) if isinstance(name, str) else None
        if found is not None:
            sources[instrument_source(str(name))] = configs.read_source(found)
    motor = data.get("motor")
    found = configs.find("motors", motor, path.parent) if isinstance(motor, str) else None
    if found is not None and found.parent != configs.FOLDER / "motors":
        sources[motor_source(str(motor))] = configs.read_source(found)
    bench = bench_of(path.stem, sources, str(path))
    mistakes = checks.now(bench)
    if isinstance(motor, str) and found is None:
        mistakes.append(f"motor: there is no motor '{motor}'{checks.meant(motor, 'motors')}")
    if mistakes:
        raise ConfigError("\n".join(f"{path}: {mistake}" for mistake in mistakes))
    return bench


def bench_path(path: Path) -> Path:
    """The bench file that a person means: a path, or the name of one in the project or in configs/benches."""
    path = Path(path)
    if path.suffix or path.is_file():
        return path
    if not path.name:
        raise ConfigError(f"{path}: a folder; name a bench, or its file")
    return configs.find("benches", path.name) or FOLDER / f"{path.name}.toml"


def motor_source(motor: str) -> str:
    """The key of a motor's file among the sources of a bench."""
    return f"motors/{motor}.toml"


def instrument_source(instrument: str) -> str:
    """The key of an instrument's file among the sources of a bench."""
    return f"instruments/{instrument}.toml"


def bench_of(name: str, sources: Mapping[str, bytes], place: str) -> Bench:
    """A bench from the texts of its files: those on disk, or those that a run has kept.

    It is checked: every device's line and instrument exist, every role is a channel. Raises ConfigError: all mistakes,
    a line each.
    """
    file = configs.validate(BenchFile, configs.parse_toml(sources[BENCH_SOURCE], place), place)
    mistakes = checks.of_lines(file) + checks.of_addresses(file)
    instruments = {}
    for device, table in file.devices.items():
        if table.line not in file.lines:
            mistakes.append(f"devices.{device}.line: there is no line '{table.line}' ({', '.join(file.lines)})")
        source = sources.get(instrument_source(table.instrument))
        if source is None:
            mistakes.append(f"devices.{device}.instrument: {checks.no_instrument(table.instrument, INSTRUMENTS)}")
            continue
        try:
            instruments[device] = instrument_of(source, instrument_source(table.instrument))
        except ConfigError as error:
            mistakes += [f"devices.{device}.instrument: {line}" for line in str(error).splitlines()]
    bench = Bench(name, file, instruments, dict(sources))
    if not mistakes:
        mistakes += checks.of_roles(bench)
    if mistakes:
        raise ConfigError("\n".join(f"{place}: {mistake}" for mistake in mistakes))
    return bench
