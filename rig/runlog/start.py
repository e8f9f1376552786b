"""The start record of a bench: what is known when a run begins, whole files included."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rig.bench.bench import Bench
from rig.bench.instrument import SPEED
from rig.clock import Clock
from rig.runlog.rows import clean, plain, utc_text
from rig.runlog.schema import (
    AmbientRecord,
    ChannelRecord,
    ClockRecord,
    DeviceRecord,
    Kind,
    SourceRecord,
    StartRecord,
    SupplyRecord,
)

PACKAGES = ("spinbench", "numpy", "scipy", "pandas", "pydantic", "pyserial", "pymodbus")


@dataclass(frozen=True)
class Circumstances:
    """What no instrument tells.

    `ambient`: the room; the bench file's when left out.
    `lubrication`, `motor_serial`: the bench file's when left out.
    `minutes_running`: how long the motor has run before [min].
    """

    operator: str = ""
    ambient: AmbientRecord | None = None
    lubrication: str | None = None
    minutes_running: float | None = None
    parent: str | None = None
    motor_serial: str | None = None
    note: str = ""


def start_record(
    bench: Bench,
    kind: Kind,
    clock: Clock,
    identities: Mapping[str, str],
    circumstances: Circumstances = Circumstances(),
    simulated: bool = False,
    more: Mapping[str, Any] | None = None,
) -> StartRecord:
    """What start.json says of a run on a bench.

    `more`: further keys, such as ``sweep``; they replace those of the bench file.
    """
    file = bench.file
    record: dict[str, Any] = {
        "kind": kind,
        "bench": bench.name,
        "title": file.title,
        "utc_start": utc_text(clock.utc_start_ns),
        "clock": ClockRecord(rate=clock.rate, utc_start_ns=clock.utc_start_ns),
        "operator": clean(circumstances.operator),
        "note": clean(circumstances.note),
        "simulated": simulated,
        "parent": circumstances.parent,
        "motor": bench.motor,
        "motor_serial": clean(file.motor_serial if circumstances.motor_serial is None else circumstances.motor_serial),
        "lubrication": file.lubrication if circumstances.lubrication is None else circumstances.lubrication,
        "added_inertia_kg_m2": file.added_inertia_kg_m2,
        "minutes_running": circumstances.minutes_running,
        "ambient": circumstances.ambient or AmbientRecord(**file.ambient.model_dump()),
        "supply": SupplyRecord(**file.supply.model_dump()),
        "roles": file.roles.model_dump(),
        "devices": {name: _device(bench, name, identities.get(name, "")) for name in file.devices},
        "versions": versions(),
        "sources": {name: source(data) for name, data in bench.sources.items()},
        "sweep": file.sweep.model_dump(),
        "safety": file.safety.model_dump(),
    }
    return StartRecord(**(record | {key: plain(value) for key, value in (more or {}).items()}))


def _device(bench: Bench, name: str, identity: str) -> DeviceRecord:
    table, settings = bench.file.devices[name], bench.instruments[name]
    channels = {
        channel: ChannelRecord(**(figures.model_dump() | (settings.speed_made() if channel == SPEED else {})))
        for channel, figures in bench.build(name).channels.items()
    }
    return DeviceRecord(
        instrument=table.instrument,
        line=table.line,
        identity=clean(identity)[:2000],
        trust=settings.trust,
        calibration=table.calibration,
        channels=channels,
        title=settings.title,
        serial_number=table.serial_number,
        period_s=table.period_s,
    )


def versions() -> dict[str, str]:
    """The program's version, Python's, and those of the packages that carry the data."""
    found = {"python": platform.python_version(), "system": platform.platform()[:200]}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def source(data: bytes) -> SourceRecord:
    """A configuration file as it is kept in start.json."""
    return SourceRecord(sha256=hashlib.sha256(data).hexdigest(), text=data.decode("utf-8", "backslashreplace"))
