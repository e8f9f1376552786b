"""A recording of another rig (a motor table in the recording) as readings, predictions and unknowns, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.data.clock import needs_clock
from calibration.systems.readings import Flat
from calibration.systems.system import has_system, systems
from calibration.systems.table import rows_used, table_of
from calibration.unknowns.effects import searched
from calibration.unknowns.priors import Unknown
from model.effects import effects
from model.effects.laws import Chosen
from model.rigs.state import scaled
from rig.recording import Recording, RecordingError

COMMON = ("coulomb_friction", "stribeck_friction", "windage", "friction_warm_up")  # what any machine may have
NOT_LOOKED_AT = "of a kind, or without the columns, that this rig is judged by"


class RigProblem:
    """A recording of another rig.

    Parameters
    ----------
    recording : Recording
        With an inline motor of another kind than the radial piston motor.

    Raises
    ------
    RecordingError
        When the columns that its kind needs are missing.
    """

    def __init__(self, recording: Recording) -> None:
        if isinstance(recording.motor, str) or not has_system(recording):
            raise RecordingError(
                f"{recording.folder}: [motor] is not a rig of another kind; expected one of {', '.join(systems())}"
            )
        self.recording = recording
        self.motor: Mapping[str, Any] = recording.motor
        self.kind = str(self.motor["kind"])
        self.table = table_of(recording, self.motor)
        self.ambient, self.room = self.table.ambient, self.table.room
        self.slides, self.inertia = self.table.slides, self.table.inertia
        self.system = systems()[self.kind](self.table)
        self.readings, self.sizes = self.system.readings, self.system.sizes
        self.flats, self.unknowns = list(self.system.flats), list(self.system.unknowns)
        if not any(one.value.size for one in self.readings):
            raise RecordingError(
                f"{recording.folder}: {self.kind}: no reading is left to compare; is the axis ever in motion?"
            )
        for one in self.readings:
            if one.value.size and not np.all(one.sd > 0.0):
                raise RecordingError(
                    f"{recording.folder}: {one.label}: noise_sd and resolution are both 0, and nothing can be weighed; "
                    "state noise_sd > 0"
                )
        self._friction_prior()

    @property
    def files(self) -> list[dict[str, Any]]:
        """Rows used of each file of the recording, as ``files`` of diagnosis/1."""
        seen = {one["file"]: one for one in self.system.files}
        return [
            seen.get(file.file) or rows_used(file, {NOT_LOOKED_AT: np.ones(file.rows, dtype=bool)})
            for file in self.recording.files
        ]

    @property
    def could_show(self) -> list[str]:
        """The effects that this rig could show."""
        found = [*COMMON, *self.system.could_show()]
        if not any(one.channel in ("drive", "speed") for one in self.readings):
            found = [name for name in found if effects()[name].torque is None]
        if not any(one.channel == "flow" for one in self.readings):
            found = [name for name in found if "flow" not in effects()[name].reads and name != "leakage"]
        if not self.system.timed:
            found = [name for name in found if not needs_clock(effects()[name])]
        return sorted(found)

    def effect_unknowns(self, names: Sequence[str]) -> list[tuple[str, Unknown, float, float]]:
        """Effect id, unknown, and bounds of its value, for the parameters of a set of effects."""
        return [
            (name, searched(parameter), parameter.low, parameter.high)
            for name in names
            for parameter in (scaled(one, self.sizes) for one in effects()[name].parameters)
        ]

    def predict(self, values: Mapping[str, float], chosen: Chosen) -> list[np.ndarray]:
        """What the instruments would read, an array for each of ``readings``.

        Parameters
        ----------
        values : mapping of str to float
            Of flats and unknowns by their names [SI].
        """
        return self.system.predict(values, chosen)

    def slope(self, name: str, values: Mapping[str, float], predicted: Sequence[np.ndarray]) -> list[np.ndarray] | None:
        """What an instrument's offset or scale does to the predictions, which needs no model [SI]; None for the rest.

        Parameters
        ----------
        values : mapping of str to float
            Of flats and unknowns by their names [SI].
        predicted : sequence of ndarray
            At them, of `predict` [SI].
        """
        place, _, error = name.rpartition("." if name.endswith(".drive_offset") else "_")
        found = []
        for one, true in zip(self.readings, predicted, strict=True):
            own = one.label.partition(" ")[2]
            offset = values.get(f"{one.channel}_offset", 0.0) + values.get(f"{own}.drive_offset", 0.0)
            if error == "drive_offset":
                found.append(np.full_like(true, 1.0 if own == place else 0.0))
            elif place in ("drive", "flow", "speed") and error in ("offset", "scale"):
                scale = 1.0 + values.get(f"{place}_scale", 0.0)
                part = np.ones_like(true) if error == "offset" else (true - offset) / scale
                if error == "scale" and self.system.weight is not None:
                    part = np.full_like(true, self.system.weight)
                found.append(part if one.channel == place else np.zeros_like(true))
            else:
                return None
        return found

    def _friction_prior(self) -> None:
        if not any(one.channel in ("drive", "speed") for one in self.readings):
            return  # a flow tells nothing of friction
        mean, sd = self.motor.get("viscous_friction"), self.motor.get("viscous_friction_sd")
        unit = "N s/m" if self.slides else "N m s"
        if mean is not None and sd is not None:
            self.unknowns.insert(0, Unknown("viscous_friction", unit, "normal", float(mean), float(sd), "recording"))
            return
        size = self.sizes.torque / self.sizes.speed
        self.flats.insert(0, Flat("viscous_friction", unit, float(mean) if mean else 0.5 * size, size, 0.0))
