"""A recording whose motor is written out in it: its unknowns, and the predictions of its readings, in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.data.clock import needs_clock
from calibration.likelihood import compared
from calibration.systems.machines.readings import Flat
from calibration.systems.machines.system import has_system, systems
from calibration.systems.machines.table import table_of
from calibration.unknowns.priors import OfInstrument, OfRun, Unknown
from model.effects import Effect, EffectParameter, effects
from model.effects.laws import Chosen
from model.rigs.state import scaled
from rig.recording import Recording, RecordingError
from rig.recording.columns import Known, quantity

COMMON = ("coulomb_friction", "stribeck_friction", "windage", "friction_warm_up")  # what any machine may have
OF_AXIS, OF_SLIDE = {"drive": "torque"}, {"drive": "force", "speed": "velocity"}  # quantities by another name
WIDE = 10.0  # sizes: the prior's deviation of an unknown of which nothing is known
LEAST = 1e-9  # share of their prior's middle to which friction and displacement may fall


class Problem(compared.Problem):
    """A recording of a machine that is not the article's motor.

    `recording`: with an inline motor of another kind than the radial piston motor.
    `wide`, shape (n_nuisances,): nuisances of which nothing is known.
    Raises RecordingError when the columns that its kind needs are missing.
    """

    friction = "viscous_friction"

    def __init__(self, recording: Recording) -> None:
        if isinstance(recording.motor, str) or not has_system(recording):
            raise RecordingError(
                f"{recording.folder}: [motor] is not a rig of another kind; expected one of {', '.join(systems())}"
            )
        self.recording = recording
        self.motor: Mapping[str, Any] = recording.motor
        self.kind = str(self.motor["kind"])
        self.table = table_of(recording, self.motor)
        self.slides = self.table.slides
        self.system = systems()[self.kind](self.table)
        self.readings, self.sizes = self.system.readings, self.system.sizes
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
        flats, unknowns = list(self.system.flats), list(self.system.unknowns)
        self._add_friction(flats, unknowns)
        self.nuisances = [
            Unknown(one.name, one.unit, "normal", one.start, WIDE * one.size, "nothing is known of it", one.of)
            for one in flats
        ] + unknowns
        self.wide = np.arange(len(self.nuisances)) < len(flats)
        self._lows = {one.name: one.low for one in flats}
        self._parameters = {
            (effect.id, one.name): scaled(one, self.sizes) for effect in effects().values() for one in effect.parameters
        }

    def effects_that_could(self) -> list[Effect]:
        """The effects that this rig could show, in the order of their ids."""
        moves = any(one.channel in ("drive", "speed") for one in self.readings)
        found = [*(COMMON if moves else ()), *self.system.could_show()]
        if not self.system.timed:
            found = [name for name in found if not needs_clock(effects()[name])]
        return [effects()[name] for name in sorted(found)]

    def parameter(self, effect: str, name: str) -> EffectParameter:
        """A parameter of an effect: its bounds and its scale on this rig."""
        return self._parameters[effect, name]

    def values(self, z: np.ndarray) -> dict[str, float]:
        """Values of the nuisances by their names [SI]. `z`, shape (n_nuisances,): nuisances [-]."""
        return {one.name: float(one.value(np.asarray(at_z))) for one, at_z in zip(self.nuisances, z, strict=True)}

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the nuisances [-], each shape (n_nuisances,)."""
        low, high = super().bounds()
        for i, one in enumerate(self.nuisances):
            least = self._lows.get(one.name, -np.inf)
            if one.name in (self.friction, "displacement"):
                least = max(least, LEAST * one.a)
            if np.isfinite(least):
                low[i] = max(low[i], one.z(least))
        return low, high

    def quantity(self, name: str) -> Known:
        """What a channel or a coordinate is measured in; "drive" is a torque, and a slide's a force."""
        return quantity((OF_SLIDE if self.slides else OF_AXIS).get(name, name))

    def run_of(self, i: int) -> int | None:
        """The file that a nuisance belongs to alone; None where it is of the whole recording [-]."""
        of = self.nuisances[i].of
        file = of.file if isinstance(of, (OfInstrument, OfRun)) else ""
        return next((k for k, one in enumerate(self.recording.files) if one.file == file), None)

    def predict(
        self,
        z: np.ndarray,
        chosen: Chosen,
        like: np.ndarray | None = None,
        runs: Sequence[int] | None = None,
        smooth: bool = False,
        around: None = None,
    ) -> np.ndarray:
        """What the instruments would read, one array after the other [SI], shape (m,)."""
        return np.concatenate(self.system.predict(self.values(z), chosen))

    def _add_friction(self, flats: list[Flat], unknowns: list[Unknown]) -> None:
        if not any(one.channel in ("drive", "speed") for one in self.readings):
            return  # a flow tells nothing of friction
        mean, sd = self.motor.get("viscous_friction"), self.motor.get("viscous_friction_sd")
        unit = "N s/m" if self.slides else "N m s"
        if mean is not None and sd is not None:
            unknowns.insert(0, Unknown(self.friction, unit, "normal", float(mean), float(sd), "recording"))
            return
        size = self.sizes.torque / self.sizes.speed
        flats.insert(0, Flat(self.friction, unit, float(mean) if mean else 0.5 * size, size, 0.0))
