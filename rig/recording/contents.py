"""What a recording holds, as the calibration sees it: columns in the units of their names, arrays read-only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

# How a run in time is taken, from the valve's move on. Its event is over once the speed is down to a tenth of that
# before, or up to nine tenths of that which it reaches.
DOWN_TO, UP_TO = 0.1, 0.9
LONGER, LEAST_S = 3.0, 2.0  # of the event, and no shorter: valves and regulators have their own delay
LEAST_IN_A_RUN = 20  # readings of the speed while a run in time goes on; fewer do not show its course
Kind = Literal["steady", "transient", "zero"]


def captured_s(event_s: float) -> float:
    """How long is recorded of a run in time whose event lasts so long, from the valve's move on [s]."""
    return max(LONGER * event_s, LEAST_S)


class RecordingError(ValueError):
    """A recording cannot be used. One line a mistake: file, row, column, what was expected, what to do."""


@dataclass(frozen=True)
class Channel:
    """One instrument's figures, each one standard deviation.

    `column`: the CSV column it fills; its unit is the unit of noise_sd, bias_sd and resolution.
    `scale_sd`: relative scale error, shared by the whole recording; no unit.
    `resolution`: the step that readings are rounded to; 0 for none.
    `defaulted`: the figures that the recording left out and that took the documented default.
    `pitch_error_sd`: speed_rpm only: error of a tooth's place, one standard deviation, as a share of the tooth pitch;
        no unit.
    `window_s`: speed_rpm only: a sample is the mean over this time [s]; None: since the sample before.
    `lag_s`: speed_rpm only: time constant of a first-order lag [s].
    `drift_sd`: of the offset, from one day to another; for an instrument that is known by its serial number.
    `serial`: the instrument's serial number; the same instrument in several recordings shares its errors.
    """

    column: str
    noise_sd: float
    bias_sd: float
    scale_sd: float
    resolution: float
    defaulted: tuple[str, ...] = ()
    pulses_per_rev: float | None = None
    pitch_error_sd: float | None = None
    window_s: float | None = None
    lag_s: float | None = None
    drift_sd: float = 0.0
    serial: str | None = None
    calibrated: str | None = None


@dataclass(frozen=True)
class Ambient:
    """The air around the rig. None: not recorded, the fit takes the motor's default and its prior.

    `temperature_c`, `temperature_sd_k`: ambient temperature in degrees Celsius and its standard deviation in K.
    """

    pressure_bar_abs: float | None = None
    pressure_sd_bar: float | None = None
    temperature_c: float | None = None
    temperature_sd_k: float | None = None
    relative_humidity: float | None = None


@dataclass(frozen=True)
class SupplyFigures:
    """The line between regulator and motor. None: not stated, whoever needs it takes a default.

    `regulator_time_s`, `regulator_time_s_sd`: time constant of the regulator and its standard deviation, s.
    `line_volume_l`, `line_volume_l_sd`: volume between regulator and motor, and its standard deviation, L.
    `valve_time_s`, `valve_time_s_sd`: time that the valve takes to open or close, and its standard deviation, s.
    """

    regulator_time_s: float | None = None
    regulator_time_s_sd: float | None = None
    line_volume_l: float | None = None
    line_volume_l_sd: float | None = None
    valve_time_s: float | None = None
    valve_time_s_sd: float | None = None


@dataclass(frozen=True, eq=False)
class Column:
    """One column of numbers.

    `values`, shape (n,): in the unit of the column's name; NaN where not sampled.
    `censor`, shape (n,): 0: measured. -1: the true value is below `values` (a cell `<10`; speed_rpm 0, at 0). +1: above
        (`>100`).
    """

    values: NDArray[np.float64]
    censor: NDArray[np.int8]

    def __post_init__(self) -> None:
        for name, kind in (("values", np.float64), ("censor", np.int8)):
            array = np.asarray(getattr(self, name), dtype=kind).view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)


@dataclass(frozen=True, eq=False)
class RecordingFile:
    """One CSV file.

    `kind`: one row a plateau, one row a sample, or instruments read with the line vented and the rotor at rest.
    `start_s`: where the file's time 0 stands on the recording's clock, s.
    `columns`: the known columns that hold numbers, in the file's order.
    `direction`, shape (rows,): "up", "down" or "" where not noted.
    `extra`, shape (rows,): columns that this tool does not know, as text; empty for a file above `table.EXTRA_BYTES`.
    `added_inertia_kg_m2`: of a flywheel that was mounted for this file alone, beside what the recording says.
    `left_out`: rows that the user leaves out, 1 the first; nothing is read in them.
    """

    file: str
    kind: Kind
    start_s: float
    noise_scale: float
    rows: int
    columns: Mapping[str, Column]
    direction: NDArray[np.str_] | None = None
    extra: Mapping[str, NDArray[np.object_]] = field(default_factory=dict)
    added_inertia_kg_m2: float = 0.0
    left_out: tuple[int, ...] = ()

    @property
    def is_open(self) -> NDArray[np.bool_] | None:
        """Whether the supply is open in each row, shape (rows,); None where the file does not say.

        `supply_open` holds until the next row that says it.
        """
        flags = self.columns.get("supply_open")
        return None if flags is None else held(flags.values) > 0.5


def held(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values with the last one before in place of each nan, shape (n,); what has none before it stays nan."""
    return values[np.maximum.accumulate(np.where(np.isnan(values), 0, np.arange(values.size)))]


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording: its files, the instruments that took them and the motor they belong to.

    `sha256`: over recording.toml and the data files, in their order; of several as one that of each; empty where
        nothing was read.
    `joined`: the folders, where it is several recordings as one.
    `without`: what was left out of it, as it was asked for; `left_out`: the same by the names of its own files.
    `read_sha256`: what `sha256` was before something was left out; empty where nothing was. Of several as one, both of
        these are empty.
    `supply`: what is stated of the line between regulator and motor.
    `origin`: who took it, when and on what: date, operator, motor_serial, oil, note, parent, as far as stated.
    """

    folder: Path
    motor: str | dict[str, Any]
    ambient: Ambient
    channels: Mapping[str, Channel]
    files: tuple[RecordingFile, ...]
    added_inertia_kg_m2: float = 0.0
    warnings: tuple[str, ...] = ()
    sha256: str = ""
    supply: SupplyFigures = SupplyFigures()
    origin: Mapping[str, str] = field(default_factory=dict)
    joined: tuple[Path, ...] = ()
    without: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    read_sha256: str = ""

    @property
    def folders(self) -> tuple[Path, ...]:
        """Where it was read, in order."""
        return self.joined or (self.folder,)

    @property
    def is_of_radial_piston(self) -> bool:
        """Whether its motor is a radial piston motor, named or written out in it."""
        return isinstance(self.motor, str) or self.motor.get("kind") == "radial_piston"
