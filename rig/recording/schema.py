"""recording.toml, key by key, and the inline motors."""

from __future__ import annotations

import re
from datetime import date, time
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, Field, field_validator, model_validator

import configs
from configs import FOLDER, ConfigError, Strict, validate
from rig.recording.columns import FIGURES, MEASURED, NAMES, NUMERIC, nearest, other_spelling
from rig.recording.contents import Channel, Kind
from rig.recording.mistakes import Mistakes, shown

FORMAT = "recording/1"
NotNegative = Annotated[float, Field(ge=0.0, le=1e9)]
Inertia = Annotated[float, Field(ge=0.0, le=100.0)]  # of a flywheel; a bench file has the same bound
Positive = Annotated[float, Field(gt=0.0, le=1e9)]
Seconds = Annotated[float, Field(ge=0.0, le=1e4)]
PositiveSeconds = Annotated[float, Field(gt=0.0, le=1e4)]
MOST_TEXT = 2000
Text = Annotated[str, Field(min_length=1, max_length=MOST_TEXT), BeforeValidator(lambda value: _in_quotes(value))]
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def _in_quotes(value: Any) -> Any:
    """A value of a text's key. Raises ValueError where it is a number or a date, which quotes make a text."""
    if isinstance(value, date | time | int | float):
        raise ValueError(f'is not in quotes; write "{value}"')
    return value


def _check_pair(table: Strict, value: str, deviation: str) -> None:
    if getattr(table, value) is None and getattr(table, deviation) is not None:
        raise ValueError(f"{deviation} is given without {value}; give both, or neither")


class Air(BaseModel):
    """The air around a rig."""

    pressure_bar_abs: Annotated[float, Field(ge=0.3, le=1.2)] | None = None
    pressure_sd_bar: NotNegative | None = None
    temperature_c: Annotated[float, Field(ge=-60.0, le=80.0)] | None = None
    temperature_sd_k: NotNegative | None = None
    relative_humidity: Annotated[float, Field(ge=0.0, le=1.0)] | None = None


class AmbientTable(Air, Strict):
    """[ambient]: the air around the rig."""

    @model_validator(mode="after")
    def _a_deviation_needs_its_value(self) -> AmbientTable:
        for value, deviation in (("pressure_bar_abs", "pressure_sd_bar"), ("temperature_c", "temperature_sd_k")):
            _check_pair(self, value, deviation)
        return self


class AirLine(BaseModel):
    """The line between regulator and motor; a figure and its standard deviation."""

    regulator_time_s: Seconds | None = None
    regulator_time_s_sd: PositiveSeconds | None = None
    line_volume_l: Annotated[float, Field(ge=0.0, le=1e4)] | None = None
    line_volume_l_sd: Annotated[float, Field(gt=0.0, le=1e4)] | None = None
    valve_time_s: Seconds | None = None
    valve_time_s_sd: PositiveSeconds | None = None


class SupplyTable(AirLine, Strict):
    """[supply]: the line between regulator and motor, and how well it is known."""

    @model_validator(mode="after")
    def _a_deviation_needs_its_value(self) -> SupplyTable:
        for value in ("regulator_time_s", "line_volume_l", "valve_time_s"):
            _check_pair(self, value, f"{value}_sd")
        return self


class OriginTable(Strict):
    """[origin]: who took the recording, when and on what."""

    date: Text | None = None
    operator: Text | None = None
    motor_serial: Text | None = None
    oil: Text | None = None
    note: Text | None = None
    parent: Text | None = None


class SpeedKeys(Strict):
    """How a tachometer makes a speed."""

    pulses_per_rev: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    pitch_error_sd: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    window_s: PositiveSeconds | None = None
    lag_s: Seconds | None = None


OF_SPEED = tuple(SpeedKeys.model_fields)


class ChannelTable(SpeedKeys):
    """[channels.COLUMN]: one instrument's figures, one standard deviation each, in the column's unit."""

    noise_sd: NotNegative | None = None
    bias_sd: NotNegative | None = None
    scale_sd: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    resolution: NotNegative | None = None
    drift_sd: NotNegative | None = None
    serial: Text | None = None
    calibrated: Text | None = None

    @model_validator(mode="after")
    def _a_pitch_needs_teeth(self) -> ChannelTable:
        if self.pitch_error_sd is not None and self.pulses_per_rev is None:
            raise ValueError("pitch_error_sd is given without pulses_per_rev; give both, or neither")
        return self


class FileTable(Strict):
    """[[files]]: one CSV file."""

    file: str
    kind: Kind
    start_s: Annotated[float, Field(ge=-1e12, le=1e12)] = 0.0
    noise_scale: Positive = 1.0
    added_inertia_kg_m2: Inertia = 0.0


class RigTable(Strict):
    """[rig]: what was mounted on the shaft."""

    added_inertia_kg_m2: Inertia = 0.0


class RecordingTable(Strict):
    """recording.toml."""

    format: str
    motor: str | dict[str, Any]
    ambient: AmbientTable = AmbientTable()
    channels: dict[str, ChannelTable] = Field(default_factory=dict)
    rig: RigTable = RigTable()
    supply: SupplyTable = SupplyTable()
    origin: OriginTable = OriginTable()
    files: Annotated[list[FileTable], Field(min_length=1, max_length=1000)]

    @field_validator("format")
    @classmethod
    def _is_known(cls, text: str) -> str:
        if text != FORMAT:
            raise ValueError(f'this version reads the format "{FORMAT}" only; write format = "{FORMAT}"')
        return text


class MotorTable(Strict):
    """The viscous coefficient of an inline motor and its prior; flat and positive when left out."""

    name: str = ""
    viscous_friction: NotNegative | None = None
    viscous_friction_sd: Positive | None = None

    @model_validator(mode="after")
    def _a_prior_needs_its_mean(self) -> MotorTable:
        if self.viscous_friction is None and self.viscous_friction_sd is not None:
            raise ValueError("viscous_friction_sd is given without viscous_friction; give both, or neither")
        return self


class FreeRotor(MotorTable):
    """A rotor that nothing drives."""

    kind: Literal["free_rotor"]
    inertia_kg_m2: Positive


class DrivenAxis(MotorTable):
    """A shaft with a measured torque, or a slide with a measured force."""

    kind: Literal["driven_axis"]
    inertia_kg_m2: Positive | None = None
    mass_kg: Positive | None = None

    @model_validator(mode="after")
    def _turns_or_slides(self) -> DrivenAxis:
        if (self.inertia_kg_m2 is None) == (self.mass_kg is None):
            raise ValueError("give either inertia_kg_m2 (with torque_nm) or mass_kg (with force_n and velocity_m_s)")
        return self


class DisplacementMachine(MotorTable):
    """A machine that turns a volume each revolution."""

    kind: Literal["displacement_machine"]
    displacement_m3_per_rev: Positive
    inertia_kg_m2: Positive | None = None


_OTHER_RIGS: dict[str, type[Strict]] = {
    "free_rotor": FreeRotor,
    "driven_axis": DrivenAxis,
    "displacement_machine": DisplacementMachine,
}


def add_motor_table(kind: str, table: type[MotorTable]) -> None:
    """Have recordings read whose motor table is of a further kind, until this process ends."""
    _OTHER_RIGS[kind] = table


def motor_of(motor: str | dict[str, Any], folder: Path) -> str | dict[str, Any]:
    """A motor by its shipped name or in full: one of a project is written out, so that nothing else has to find it."""
    path = configs.find("motors", motor, folder) if isinstance(motor, str) else None
    return motor if path is None or path.parent == FOLDER / "motors" else configs.read_toml(path)


def check_motor(motor: str | dict[str, Any], folder: Path, place: str, mistakes: Mistakes) -> None:
    """Check a motor's name, or its inline table as far as it is known here.

    A radial piston motor's table is the business of the motor's own reader.
    """
    if isinstance(motor, str):
        _check_motor_name(motor, folder, place, mistakes)
        return
    kind = motor.get("kind")
    known = ("radial_piston", *_OTHER_RIGS)
    if not isinstance(kind, str) or kind not in known:
        given = "is missing" if kind is None else f"'{shown(str(kind))}' is not known"
        mistakes.add(place, f"motor.kind {given}; expected one of {', '.join(known)}")
    elif kind in _OTHER_RIGS:
        try:
            validate(_OTHER_RIGS[kind], motor, f"{place}: [motor]")
        except ConfigError as error:
            for line in str(error).splitlines():
                mistakes.add(place, shown(line.removeprefix(f"{place}: "), 300))


def _check_motor_name(name: str, folder: Path, place: str, mistakes: Mistakes) -> None:
    known = sorted({path.stem for one in configs.places("motors", folder)[1:] for path in one.glob("*.toml")})
    path = FOLDER / "motors" / f"{name}.toml"
    if not _NAME.fullmatch(name):
        what = "is not a name; a motor is a file in configs/motors, named without folder and .toml"
    elif path.is_symlink():
        what = "is a symbolic link in configs/motors, which is refused; put the file itself there"
    elif configs.find("motors", name, folder) is None:
        what = "is not in configs/motors, nor in the project"
    else:
        return
    mistakes.add(place, f"motor '{shown(name)}' {what} (known: {', '.join(known) or 'none'})")


def channel_of(column: str, table: ChannelTable | None) -> Channel:
    """One instrument's figures, the documented default for each that is left out; in the column's unit."""
    defaults = dict(zip(FIGURES, NUMERIC[column].figures or (), strict=True))
    stated = {} if table is None else table.model_dump(exclude_none=True)
    left_out = tuple(name for name in FIGURES if name not in stated)
    return Channel(column=column, defaulted=left_out, **{**defaults, **stated})


def check_channels(channels: dict[str, ChannelTable], place: str, mistakes: Mistakes) -> None:
    """Check that each [channels.NAME] names a measured column, and that its figures leave some noise."""
    for name, table in channels.items():
        where = f"{place}, [channels.{shown(name)}]"
        if name in MEASURED:
            channel = channel_of(name, table)
            if channel.noise_sd == 0.0 and channel.resolution == 0.0:
                mistakes.add(where, "noise_sd and resolution are both 0; no instrument is exact, state one of them")
            for key in OF_SPEED if name != "speed_rpm" else ():
                if getattr(table, key) is not None:
                    mistakes.add(where, f"{key} is for [channels.speed_rpm] only; take it out, or move it there")
        elif name in NAMES:
            mistakes.add(where, f"this column is no instrument; those with figures are {', '.join(MEASURED)}")
        elif (spelling := other_spelling(name)) is not None:
            mistakes.add(where, f"expected {spelling[0]}, figures in its unit ({spelling[1]})")
        else:
            mistakes.add(where, f"no such column{nearest(name, MEASURED)}; known: {', '.join(MEASURED)}")


def default_warnings(channels: dict[str, Channel]) -> list[str]:
    """One sentence for each instrument that took a default."""
    return [
        f"[channels.{channel.column}] leaves out "
        + ", ".join(f"{name} (taken: {getattr(channel, name):g})" for name in channel.defaulted)
        for channel in channels.values()
        if channel.defaulted
    ]
