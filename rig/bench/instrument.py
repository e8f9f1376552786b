"""What an instrument is to the rest of the rig, and what its file in configs/instruments says.

A family is a module of rig.instruments, named as the files name it, with two things in it: `Settings`, a child of
`InstrumentFile`, and `build(device, settings, place)`. Nothing else has to know of a new one.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Protocol, runtime_checkable

import pydantic

import configs
from configs import ConfigError, Strict
from rig.lines import Line
from rig.readings import Reading
from rig.recording.schema import OF_SPEED, SpeedKeys
from rig.recording.units import not_of_the_name

FOLDER = configs.FOLDER / "instruments"
SPEED = "speed_rpm"


def _not_zero(scale: float) -> float:
    if scale == 0.0:
        raise ValueError("a channel's scale is 0; it would read the same always")
    return scale


Positive = Annotated[float, pydantic.Field(gt=0.0)]
NotNegative = Annotated[float, pydantic.Field(ge=0.0)]
Scale = Annotated[float, pydantic.Field(ge=-1e12, le=1e12), pydantic.AfterValidator(_not_zero)]
Wait = Annotated[float, pydantic.Field(gt=0.0, le=3600.0)]  # for an answer [s]


class IdentityError(Exception):
    """Another device answers than the bench file says. The text names both."""


class InstrumentError(Exception):
    """An instrument refused an order, or did not do it. The text says what was ordered and what it reads back."""


class Reference(Strict):
    """The state that a standard-volume or mass flow, or a rotameter's scale, refers to."""

    kind: Literal["standard_volume", "rotameter_scale"]
    pressure_bar_abs: Annotated[float, pydantic.Field(ge=0.3, le=50.0)]
    temperature_c: Annotated[float, pydantic.Field(ge=-60.0, le=150.0)]
    note: str = ""


def refuse_doubles(*states: Sequence[float | str]) -> None:
    """Refuse a number, or a text, that stands for two states. Raises ValueError."""
    seen = [one for state in states for one in set(state)]
    double = next((one for one in seen if seen.count(one) > 1), None)
    if double is not None:
        raise ValueError(f"over_range, under_range, invalid: {double} stands in two of them; keep one")


class ChannelFile(SpeedKeys):
    """One channel of an instrument: unit, limits, 1-sigma figures in that unit and, of speed_rpm, how it is made."""

    unit: str
    lowest: float | None = None  # outside, the reading is over-range
    highest: float | None = None
    noise_sd: NotNegative | None = None
    bias_sd: NotNegative | None = None
    drift_sd: NotNegative | None = None  # of the offset, from one day to another
    scale_sd: NotNegative | None = None
    resolution: NotNegative | None = None
    repeatability_sd: NotNegative | None = None  # scatter from plateau to plateau that averaging within one leaves
    figures_source: str = ""
    reference: Reference | None = None

    @pydantic.model_validator(mode="after")
    def _has_a_scale(self) -> ChannelFile:
        if self.lowest is not None and self.highest is not None and self.lowest >= self.highest:
            raise ValueError(f"lowest ({self.lowest:g}) lies below highest ({self.highest:g})")
        return self


class InstrumentFile(Strict):
    """What every instrument file holds; a family adds its own keys."""

    converts_units: ClassVar[bool] = False  # whether the driver makes the unit of a channel's name of its `unit`

    format: Literal["instrument/1"]
    family: str
    title: str  # maker and model, for people
    source: str  # where the register map or the frames come from
    trust: Literal["documented", "simulated", "verified"]  # documented < run against our simulation < on hardware
    update_s: NotNegative = 0.0  # the instrument's own; a value repeated within it is not news
    timeout_s: Wait | None = None  # the line's when left out
    slowest_reply_s: Wait | None = None

    @pydantic.model_validator(mode="after")
    def _only_a_speed_is_made_of_pulses(self) -> InstrumentFile:
        channels: dict[str, ChannelFile] = getattr(self, "channels", {})
        teeth = getattr(self, "teeth", None)
        mistakes = [
            f"channels.{name}.{key}: is for channels.{SPEED} only; take it out, or move it there"
            for name, channel in channels.items()
            for key in OF_SPEED
            if name != SPEED and getattr(channel, key) is not None
        ]
        if (speed := channels.get(SPEED)) is not None:
            if teeth is not None and speed.pulses_per_rev is not None:
                mistakes.append(f"channels.{SPEED}.pulses_per_rev: take it out; teeth says it")
            if teeth is None and speed.pulses_per_rev is None and speed.pitch_error_sd is not None:
                mistakes.append(f"channels.{SPEED}.pitch_error_sd: is given without pulses_per_rev; give both")
        if mistakes:
            raise ValueError("\n".join(mistakes))
        return self

    @pydantic.model_validator(mode="after")
    def _units_are_those_of_the_names(self) -> InstrumentFile:
        """Nothing converts a number whose name says bar and whose unit says psi."""
        channels: dict[str, ChannelFile] = {} if self.converts_units else getattr(self, "channels", {})
        mistakes = [
            f"channels.{name}.unit: '{channel.unit}', and {what_to_do}"
            for name, channel in channels.items()
            if (what_to_do := not_of_the_name(name, channel.unit))
        ]
        if mistakes:
            raise ValueError("\n".join(mistakes))
        return self

    def speed_made(self) -> dict[str, float | None]:
        """How the instrument makes its speed: the keys of `SpeedKeys`, as far as they are known.

        Pulses are those of the wheel. A display that makes a new value every so often shows the mean over that time,
        unless its file says otherwise.
        """
        channel = getattr(self, "channels", {}).get(SPEED, SpeedKeys())
        found: dict[str, float | None] = {key: getattr(channel, key) for key in OF_SPEED}
        teeth = getattr(self, "teeth", None)
        if teeth is not None:
            found["pulses_per_rev"] = float(teeth)
        elif found["window_s"] is None and self.update_s > 0.0:
            found["window_s"] = self.update_s
        return found


@runtime_checkable
class Instrument(Protocol):
    """A device on a line. Only the line's own thread calls it."""

    device: str
    channels: dict[str, ChannelFile]

    @property
    def failing(self) -> bool:
        """Whether the last polls all failed."""

    def open(self, line: Line) -> None:
        """Forget what was known, and prepare the device; called after each opening of the line."""

    def identify(self, line: Line) -> str:
        """Who answers, with the firmware where the device tells it.

        Raises IdentityError when it is another device than configured, LineError when nobody answers.
        """

    def poll(self, line: Line) -> list[Reading]:
        """Read every channel once; a failure of the device is a reading without a value.

        Raises LostError when the port failed.
        """


@runtime_checkable
class Regulator(Instrument, Protocol):
    """A device that takes a set-point. `unit`: of the set-points, which lie between `lowest` and `highest`."""

    unit: str
    lowest: float
    highest: float

    def write(self, line: Line, value: float) -> float:
        """Order a set-point, and return what the device reads back [own unit].

        Raises InstrumentError when it refuses or holds another one, LineError when nobody answers.
        """

    def set_failsafe(self, line: Line) -> str:
        """Have it vent by itself when it hears nothing, read that back, and say what was set.

        Raises InstrumentError when it has no such thing, or did not take it.
        """


@runtime_checkable
class EdgeReader(Instrument, Protocol):
    """A tachometer that can give the time of each tooth."""

    def poll_edges(self, line: Line) -> list[Reading]:
        """A speed for each edge since the last poll."""


def families() -> list[str]:
    """Names of the families: the modules of rig.instruments that have settings."""
    room = importlib.import_module("rig.instruments")
    return [
        module.name
        for module in pkgutil.iter_modules(room.__path__)
        if hasattr(importlib.import_module(f"{room.__name__}.{module.name}"), "Settings")
    ]


def instrument_of(source: bytes, place: str) -> InstrumentFile:
    """An instrument's settings from the text of its file.

    Raises ConfigError when the text is wrong, or names no family of rig.instruments.
    """
    data = configs.parse_toml(source, place)
    family = data.get("family")
    if family not in families():
        raise ConfigError(f"{place}: family {family!r} is not one of {', '.join(families())}")
    module = importlib.import_module(f"rig.instruments.{family}")
    return configs.validate(module.Settings, data, place)
