"""A run as the tool writes it, made without a bench: the recorded sweep's numbers, up and down, through the run log."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.bench.bench import BENCH_SOURCE
from rig.readings import NS, Event, Exchange, Quality, Reading
from rig.runlog import AmbientRecord, RunWriter, StartRecord
from rig.runlog.folder import END, sha256_of
from rig.runlog.schema import ChannelRecord, ClockRecord, DeviceRecord
from rig.runlog.start import source
from tests.declared import FIGURES

UTC_START_NS = 1_780_000_000 * NS
PRESSURE, FLOW, SPEED, TEMPERATURE = "pressure_bar_abs", "flow_l_min", "speed_rpm", "temperature_c"
LEVELS = Path(__file__).resolve().parents[1] / "logs" / "published_sweep" / "sweep.csv"
# Pressure [bar abs], flow [L/min], speed [rpm] of the article's seven plateaus.
SWEEP = tuple(tuple(map(float, line.split(","))) for line in LEVELS.read_text(encoding="utf-8").split()[1:])
NOISE = {name: FIGURES[name]["noise_sd"] for name in (PRESSURE, FLOW, SPEED)} | {TEMPERATURE: 0.05}
UNITS = {PRESSURE: "bar", FLOW: "L/min", SPEED: "rpm", TEMPERATURE: "degC"}
ROLES = {
    "pressure": f"gauge.{PRESSURE}",
    "flow": f"meter.{FLOW}",
    "speed": f"tach.{SPEED}",
    "temperature": f"gauge.{TEMPERATURE}",
    "regulator": None,
}
PERIOD_S = 0.1
DWELL = 30  # readings of a plateau


def made_with(file: Path) -> dict[str, Any]:
    """What a start record keeps of a bench file."""
    return {"bench": file.stem, "sources": {BENCH_SOURCE: source(file.read_bytes())}}


def start_of(kind: str = "sweep", **changes: Any) -> StartRecord:
    """A start record of the synthetic bench."""
    devices = {
        "gauge": {
            PRESSURE: ChannelRecord(unit="bar", **FIGURES[PRESSURE]),
            TEMPERATURE: ChannelRecord(unit="degC", noise_sd=0.05, bias_sd=0.5, scale_sd=0.0, resolution=0.1),
        },
        "meter": {FLOW: ChannelRecord(unit="L/min", **FIGURES[FLOW])},
        "tach": {SPEED: ChannelRecord(unit="rpm", **FIGURES[SPEED])},
    }
    record: dict[str, Any] = {
        "kind": kind,
        "bench": "synthetic",
        "utc_start": "2026-05-28T20:26:40.000000Z",
        "clock": ClockRecord(utc_start_ns=UTC_START_NS),
        "operator": "a test",
        "simulated": True,
        "ambient": AmbientRecord(
            pressure_bar_abs=1.0130, pressure_sd_bar=0.0015, temperature_c=20.0, relative_humidity=0.4
        ),
        "roles": ROLES,
        "devices": {
            name: DeviceRecord(instrument=f"{name}_file", line=name, channels=channels)
            for name, channels in devices.items()
        },
    }
    return StartRecord(**(record | changes))


def reading(
    device: str, channel: str, value: float | None, time_ns: int, quality: Quality = Quality.SIMULATED, **more: Any
) -> Reading:
    """A reading of the synthetic bench."""
    unit = UNITS.get(channel, "1")
    return Reading(device, channel, value, unit, quality, time_ns, time_ns - 2_000_000, time_ns + 1_000_000, **more)


def poll(device: str, values: Mapping[str, float | None], time_ns: int, **more: Any) -> Exchange:
    """A poll of a device: two events on the wire, a reading a channel."""
    readings = tuple(reading(device, channel, value, time_ns, **more) for channel, value in values.items())
    events = (Event("tx", time_ns - 2_000_000, b"\x01\x03"), Event("rx", time_ns + 1_000_000, repr(values).encode()))
    return Exchange(device, device, "poll", None, events, readings)


class Bench:
    """Writes readings of the synthetic bench, a tenth of a second apart."""

    def __init__(self, writer: RunWriter, seed: int = 1) -> None:
        self.writer = writer
        self.random = random.Random(seed)
        self.time_ns = 0

    def noisy(self, channel: str, value: float) -> float:
        """A value with the channel's noise, never below zero."""
        return max(value + self.random.gauss(0.0, NOISE[channel]), 0.0)

    def tick(self, pressure: float, flow: float, speed: float) -> dict[str, float]:
        """One poll of each device."""
        self.time_ns += round(PERIOD_S * NS)
        values = {PRESSURE: pressure, TEMPERATURE: 20.5, FLOW: flow, SPEED: speed}
        read = {channel: self.noisy(channel, value) for channel, value in values.items()}
        if speed == 0.0:
            read[SPEED] = 0.0
        self.writer.exchange(poll("gauge", {PRESSURE: read[PRESSURE], TEMPERATURE: read[TEMPERATURE]}, self.time_ns))
        self.writer.exchange(poll("meter", {FLOW: read[FLOW]}, self.time_ns + 10_000_000))
        self.writer.exchange(poll("tach", {SPEED: read[SPEED]}, self.time_ns + 20_000_000))
        return read

    def zero(self, which: str) -> None:
        """A zero phase."""
        start_s = self.time_ns / NS
        for _ in range(10):
            self.tick(1.0130, 0.0, 0.0)
        span = {"start_s": start_s, "end_s": self.time_ns / NS + 0.05}
        self.writer.event("zero", self.time_ns, which=which, vented=True, **span)

    def plateau(self, n: int, level: tuple[float, ...], direction: str, **changes: Any) -> None:
        """A plateau, and its row."""
        self.writer.event("set-point", self.time_ns, pressure_bar_abs=level[0])
        start_s = self.time_ns / NS + 0.05
        read = [self.tick(*level) for _ in range(DWELL)]
        row: dict[str, Any] = {"n": n, "level_bar_abs": level[0], "direction": direction, "repeat": 1}
        row |= {"start_s": start_s, "end_s": self.time_ns / NS + 0.05, "settled": True}
        for channel, column in (
            (PRESSURE, PRESSURE),
            (FLOW, FLOW),
            (SPEED, SPEED),
            (TEMPERATURE, "inlet_temperature_c"),
        ):
            row[column] = sum(one[channel] for one in read) / DWELL
            row |= {f"{column}_se": NOISE[channel] / math.sqrt(DWELL), f"{column}_n_eff": float(DWELL)}
            row[f"{column}_n"] = DWELL
        self.writer.plateau(row | changes)

    def capture(self, which: str, gauge_until: int = 300, lowest: float = 1.013, **details: Any) -> None:
        """Half a second of lead, then the speed falls or rises with a time constant of 0.08 s.

        The gauge is read up to a step, and shows no less than the lowest pressure.
        """
        start_ns = self.time_ns
        event_s = start_ns / NS + 0.5
        for step in range(300):
            time_ns = start_ns + step * 5_000_000
            passed = max(time_ns / NS - event_s, 0.0)
            share = math.exp(-passed / 0.08)
            speed = 394.8 * (share if which == "coast-down" else 1.0 - share)
            self.writer.exchange(poll("tach", {SPEED: max(speed, 0.0)}, time_ns))
            if step % 20 == 0 and step < gauge_until:
                shown = max(1.013 + (2.0 - 1.013) * share, lowest)
                self.writer.exchange(poll("gauge", {PRESSURE: shown}, time_ns + 1_000_000))
        self.time_ns = start_ns + 1_500_000_000
        span = {"start_s": start_ns / NS, "event_s": event_s, "end_s": self.time_ns / NS}
        self.writer.event("capture end", self.time_ns, capture=which, **span, **details)


def write_sweep(root: Path, seal: bool = True, wire: bool = True, captures: bool = True, **changes: Any) -> Path:
    """A full sweep up and down with zero phases and captures; returned is the run's folder."""
    with RunWriter.create(root, start_of(**changes), wire=wire) as writer:
        bench = Bench(writer)
        bench.zero("start")
        for n, level in enumerate((*SWEEP, *reversed(SWEEP)), start=1):
            bench.plateau(n, level, "up" if n <= len(SWEEP) else "down")
        if captures:
            bench.capture("coast-down")
            bench.capture("spin-up")
        bench.zero("end")
        if seal:
            writer.end("finished", ambient_end=AmbientRecord(pressure_bar_abs=1.0134, temperature_c=20.4), vented=True)
    return writer.folder


def reseal(folder: Path) -> None:
    """Let the end record of a run have the hashes of its files as they are now."""
    end = json.loads((folder / END).read_text())
    (folder / END).write_text(json.dumps(end | {"sha256": {name: sha256_of(folder / name) for name in end["sha256"]}}))
