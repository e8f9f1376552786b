"""start.json, end.json and the lines of events.jsonl and wire.jsonl, key by key.

Known keys are checked strictly. Unknown ones are kept: a later version may add keys to run/1, never change one.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, TypeVar

import pydantic
from pydantic import Field

from rig.recording.mistakes import shown
from rig.recording.schema import Air, AirLine
from rig.runlog.folder import RunError

MAX_SHOWN = 20  # mistakes
# Events that an export looks for.
ZERO, CAPTURE, ZERO_TAKEN_BACK = "zero", "capture end", "zero taken back"
ADDED = "added"  # of a state: its level is none of the course's, and is measured on the way to one that is
COURSE, EXPECTED = "course", "expected"  # what is to be taken, and what the guard holds for possible
Kind = Literal["sweep", "coast-down", "spin-up", "zero", "plateaus", "manual", "import", "replay"]
Outcome = Literal["finished", "aborted", "failed"]


def ending(outcome: str, stopped_by: str | None) -> str:
    """How a run ended, in the word that people are shown: finished, stopped, tripped or failed."""
    if outcome != "aborted":
        return outcome
    return "tripped" if stopped_by == "interlock" else "stopped"


def ended(outcome: str, stopped_by: str | None, reason: str) -> str:
    """How a run ended and why, as people are told it."""
    word = ending(outcome, stopped_by)
    return reason if reason.startswith(word) else f"{word}: {reason}" if reason else word


Text = Annotated[str, Field(max_length=20_000)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e12)]
Seconds = Annotated[float, Field(ge=-1e10, le=1e10)]
Schema = TypeVar("Schema", bound=pydantic.BaseModel)


class Record(pydantic.BaseModel):
    """Base of what a run holds: strict in what is known, keeping what is not."""

    model_config = pydantic.ConfigDict(strict=True, extra="allow", frozen=True, allow_inf_nan=False)


class ClockRecord(Record):
    """The bench's clock, whose 0 is the run's start."""

    rate: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0  # seconds of the bench in one of the wall
    utc_start_ns: Annotated[int, Field(ge=0, le=10**19)]


class AmbientRecord(Air, Record):
    """The room."""


class ChannelRecord(Record):
    """One channel of a device: its unit and 1-sigma figures in that unit, from the instrument's file."""

    unit: Text = ""
    noise_sd: NotNegative | None = None
    bias_sd: NotNegative | None = None
    drift_sd: NotNegative | None = None
    scale_sd: NotNegative | None = None
    resolution: NotNegative | None = None
    repeatability_sd: NotNegative | None = None
    pulses_per_rev: Annotated[float, Field(gt=0.0, le=1e6)] | None = None  # of speed_rpm, as the three below
    pitch_error_sd: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    window_s: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    lag_s: Annotated[float, Field(ge=0.0, le=1e4)] | None = None
    reference: dict[str, Any] | None = None


class DeviceRecord(Record):
    """One device as it was when the run began."""

    instrument: Text = ""
    title: Text = ""
    line: Text = ""
    identity: Text = ""
    serial_number: Text = ""
    trust: Text = ""
    calibration: Text = ""
    period_s: NotNegative | None = None
    channels: dict[str, ChannelRecord] = Field(default_factory=dict)


class SourceRecord(Record):
    """A configuration file that the run was started with."""

    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    text: Annotated[str, Field(max_length=2_000_000)]


class SupplyRecord(AirLine, Record):
    """The line between regulator and motor, from the bench file."""


class StartRecord(Record):
    """start.json."""

    format: Literal["run/1"] = "run/1"
    kind: Kind
    bench: Text
    title: Text = ""
    utc_start: Text
    clock: ClockRecord
    operator: Text = ""
    note: Text = ""
    simulated: bool = False
    seal: Text = ""  # SHA-256 of what a bench conceals
    parent: Text | None = None
    motor: Text | dict[str, Any] = "ptm3600"
    motor_serial: Text = ""
    lubrication: Text = ""
    added_inertia_kg_m2: NotNegative = 0.0  # a flywheel on the shaft
    minutes_running: NotNegative | None = None
    ambient: AmbientRecord = AmbientRecord()
    supply: SupplyRecord = SupplyRecord()
    roles: dict[str, Text | None] = Field(default_factory=dict)
    devices: dict[str, DeviceRecord] = Field(default_factory=dict)
    versions: dict[str, Text] = Field(default_factory=dict)
    sources: dict[str, SourceRecord] = Field(default_factory=dict)
    sweep: dict[str, Any] = Field(default_factory=dict)
    safety: dict[str, Any] = Field(default_factory=dict)
    imported: dict[str, Text] = Field(default_factory=dict)  # title, source, licence and date of data taken elsewhere

    @property
    def goes_on_from(self) -> str:
        """The name of the run before it; a replay's parent holds the same readings, and is none."""
        return self.parent if self.parent and self.kind != "replay" else ""

    @property
    def taken(self) -> str:
        """When it was taken: of data taken elsewhere as stated; of a bench that runs fast the day alone."""
        if self.imported:
            return self.imported.get("date", "")
        return self.utc_start if self.clock.rate == 1.0 else self.utc_start[: len("2026-05-28")]


class EndRecord(Record):
    """end.json."""

    outcome: Outcome
    reason: Text = ""
    utc_end: Text = ""
    counts: dict[str, Annotated[int, Field(ge=0)]] = Field(default_factory=dict)
    sha256: dict[str, Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]] = Field(default_factory=dict)
    ambient_end: AmbientRecord | None = None
    statistics: dict[str, Any] = Field(default_factory=dict)
    vented: bool | None = None
    stopped_by: Literal["operator", "interlock"] | None = None  # of a run that was aborted
    wall_s: float | None = None  # the run's length by the clock on the wall
    repair: dict[str, Any] | None = None  # what `spinbench runs repair` did


class EventLine(Record):
    """One line of events.jsonl; its details are the keys beyond these."""

    n: Annotated[int, Field(ge=1)]
    time_s: Seconds
    utc: Text = ""
    event: Text

    @property
    def details(self) -> dict[str, Any]:
        """What the event says beyond its kind and its time."""
        return self.model_extra or {}


class WireLine(Record):
    """One line of wire.jsonl."""

    n: Annotated[int, Field(ge=1)]
    line: Text
    device: Text
    action: Text
    argument: float | None = None
    events: list[tuple[Literal["tx", "rx", "silence", "lost"], int, str]]
    readings: Annotated[int, Field(ge=0)]
    outcome: Text = ""


def parse(schema: type[Schema], data: bytes, place: str) -> Schema:
    """Read a JSON object.

    `place`: file, and line where there are several.
    Raises RunError: a line for each mistake.
    """
    try:
        return schema.model_validate_json(data)
    except pydantic.ValidationError as error:
        mistakes = error.errors(include_url=False, include_input=False)[:MAX_SHOWN]
    raise RunError("\n".join(f"{place}: {_sentence(mistake)}" for mistake in mistakes))


def _sentence(mistake: Any) -> str:
    if mistake["type"] == "json_invalid":
        return (
            f"not a JSON object in UTF-8 ({shown(str(mistake['ctx']['error']), 100)}); the file is damaged, or no run"
        )
    where = shown(".".join(str(part) for part in mistake["loc"]), 80)
    if mistake["type"] == "missing":
        return f"the key '{where}' is missing"
    words = shown(mistake["msg"].removeprefix("Value error, "), 200)
    return f"'{where}': {words[:1].lower()}{words[1:]}" if where else f"{words[:1].lower()}{words[1:]}"


def dump(record: pydantic.BaseModel) -> bytes:
    """A record as an indented JSON file."""
    return (json.dumps(record.model_dump(mode="json"), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode(
        "utf-8", "backslashreplace"
    )
