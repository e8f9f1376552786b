"""The unknowns of several recordings of one motor, and the predictions of their readings."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from calibration.data.clock import day_of
from calibration.likelihood.compared import Chosen
from calibration.systems.radial_piston.predict.carried import OF_THE_MOTOR
from calibration.systems.radial_piston.predict.problem import Prediction, Problem
from calibration.unknowns.priors import Unknown, column_of
from model.effects import Effect, EffectParameter

Predictions = tuple[Prediction, ...]
DRIFT = "_drift"


class SeveralProblem:
    """The unknowns of several recordings.

    Attributes
    ----------
    parts : sequence of Problem
        Of each recording.
    at : list of ndarray of int
        Where each recording's nuisances stand among those of all. Where an instrument has drifted since another day, it
        is where the drift stands, the offset of that day being in ``before``.
    scale : list of ndarray
        What a nuisance of all is multiplied by to be that of each recording: of a drift its sd over the offset's [-].
    before : list of dict of int to int
        For each recording, the places of offsets that are another day's and a drift, and where that day's stands.
    """

    friction = "f_overall"

    def __init__(self, parts: Sequence[Problem], names: Sequence[str]) -> None:
        self.parts, self.names = list(parts), list(names)
        self.recording = parts[0].recording
        self.nuisances: list[Unknown] = []
        self.at: list[np.ndarray] = []
        self._of: list[tuple[int, int]] = []  # the recording that a nuisance stands in first, and its place there
        self.scale: list[np.ndarray] = []
        self.before: list[dict[int, int]] = []
        shared: dict[Hashable, int] = {}
        day_of_first: dict[Hashable, str] = {}
        # What was read from one folder was taken with the same instruments on one day, whatever was on the shaft.
        places = [(str(part.recording.folder), part.recording.sha256) for part in parts]
        is_whole = [bool(place[1]) and places.count(place) > 1 for place in places]
        for k, (part, name) in enumerate(zip(parts, names, strict=True)):
            mine: list[int] = []
            self.scale.append(np.ones(len(part.nuisances)))
            self.before.append({})
            day = day_of(part.recording)
            for i, one in enumerate(part.nuisances):
                key, of = _whose(part, i, name, is_whole[k])
                drift = _drift(part, one)
                if drift is not None and day_of_first.get(key, day) != day:
                    self.scale[k][i], self.before[k][i] = drift.b / one.b, shared[key]
                    key, of, one = (key, day), name, drift
                if key in shared:
                    mine.append(shared[key])
                    continue
                shared[key], day_of_first[key] = len(self.nuisances), day
                mine.append(len(self.nuisances))
                self.nuisances.append(replace(one, name=f"{of}: {one.name}") if of else one)
                self._of.append((k, i))
            self.at.append(np.array(mine, dtype=int))
        self._added = [part.recording.added_inertia_kg_m2 for part in parts]

    def of_part(self, k: int, z: np.ndarray) -> np.ndarray:
        """One recording's nuisances [-]: with another flywheel the rotor keeps its own inertia.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Of all [-].
        """
        found: np.ndarray = z[self.at[k]] * self.scale[k]
        for i, first in self.before[k].items():
            found[i] += z[first]
        place = self.parts[k].place("inertia")
        if place is not None and self._added[k] != self._added[0]:
            i = self.at[k][place]
            rotor = float(self.nuisances[i].value(z[i])) - self._added[0]
            found[place] = self.parts[k].nuisances[place].z(max(rotor, 1e-12) + self._added[k])
        return found

    def moved_by(self, k: int, i: int) -> list[tuple[int, float]]:
        """Places of a recording's nuisances that one of all moves, and by how much [-]."""
        found = [(int(place), float(self.scale[k][place])) for place in np.flatnonzero(self.at[k] == i)]
        return found + [(place, 1.0) for place, first in self.before[k].items() if first == i]

    def scales(self, k: int, size: int) -> np.ndarray:
        """``scale`` with ones behind it for the effects, shape (size,) [-]."""
        return np.append(self.scale[k], np.ones(size - self.scale[k].size))

    def share(self, k: int, size: int) -> np.ndarray:
        """How a recording's unknowns follow from those of all, the effects' behind, shape (n, size) [-]."""
        n, own = len(self.nuisances), self.at[k].size
        found = np.zeros((own + size - n, size))
        found[np.arange(own), self.at[k]] = self.scale[k]
        found[own:, n:] = np.eye(size - n)
        for i, first in self.before[k].items():
            found[i, first] = 1.0
        return found

    def effects_that_could(self) -> list[Effect]:
        """The effects that any of the recordings could show."""
        found = {effect.id: effect for part in self.parts for effect in part.effects_that_could()}
        return list(found.values())

    def effect_unknowns(self, names: Sequence[str]) -> list[tuple[str, Unknown]]:
        """Effect id and unknown of each parameter of a set, in its order."""
        return self.parts[0].effect_unknowns(names)

    def parameter(self, effect: str, name: str) -> EffectParameter:
        """A parameter of an effect: its bounds and its scale."""
        return self.parts[0].parameter(effect, name)

    def amplitude(self, effect: str) -> EffectParameter:
        """The parameter of an effect that says how large it is."""
        return self.parts[0].amplitude(effect)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the nuisances [-], each shape (n_nuisances,)."""
        each = [part.bounds() for part in self.parts]
        low, high = (np.array([each[k][side][i] for k, i in self._of]) for side in (0, 1))
        return low, high

    def chosen(self, names: Sequence[str], z: np.ndarray) -> Chosen:
        """Values of the effects' parameters [own units], by effect."""
        return self.parts[0].chosen(names, z)

    def place(self, name: str) -> int | None:
        """Where a nuisance stands among the unknowns; None where it is none of them."""
        return next((i for i, unknown in enumerate(self.nuisances) if unknown.name == name), None)

    def in_si(self, nuisance: str) -> float:
        """What a nuisance's value is multiplied by to be SI [-]."""
        return self.parts[0].in_si(nuisance.rpartition(": ")[2].removesuffix(DRIFT))

    def run_of(self, i: int) -> int | None:
        """The run in time that a nuisance belongs to alone, counted through all recordings [-]; else None."""
        k, place = self._of[i]
        run = self.parts[k].run_of(place)
        return None if run is None else run + self._before(k)

    def is_of_the_motor(self, i: int) -> bool:
        """Whether a nuisance is a parameter of the motor."""
        return self.nuisances[i].name in OF_THE_MOTOR

    def predict(
        self,
        z: np.ndarray,
        chosen: Chosen,
        like: Predictions | None = None,
        runs: Sequence[int] | None = None,
        smooth: bool = False,
        around: Sequence[Any] | None = None,
    ) -> Predictions:
        """What the instruments of each recording would read."""
        found = []
        for k, part in enumerate(self.parts):
            before = None if like is None else like[k]
            mine = None if runs is None else [run - self._before(k) for run in runs]
            if mine is not None:
                mine = [run for run in mine if 0 <= run < len(part.blocks.runs)]
                if runs and not mine and before is not None:  # a run of another recording
                    found.append(before)
                    continue
            near = None if around is None else around[k]
            found.append(part.predict(self.of_part(k, z), chosen, before, mine, smooth, near))
        return tuple(found)

    def neighbourhood(self, z: np.ndarray, chosen: Chosen, here: Predictions) -> list[Any]:
        """The plateaus of each recording close to a point."""
        return [part.neighbourhood(self.of_part(k, z), chosen, here[k]) for k, part in enumerate(self.parts)]

    def _before(self, k: int) -> int:
        return sum(len(part.blocks.runs) for part in self.parts[:k])


def _drift(part: Problem, one: Unknown) -> Unknown | None:
    """How far an instrument's offset may have drifted since another day; None where it is not said to."""
    column = column_of(part.recording, one.name.partition("_")[0]) if one.name.endswith("_offset") else None
    figures = None if column is None else part.recording.channels[column]
    if figures is None or not figures.serial or figures.drift_sd == 0.0:
        return None
    why = f"recording, channels.{column} drift_sd"
    return Unknown(f"{one.name}{DRIFT}", one.unit, "normal", 0.0, figures.drift_sd, why)


def _whose(part: Problem, i: int, name: str, is_whole: bool) -> tuple[Hashable, str]:
    """What an unknown is shared by, and what stands ahead of its name: nothing, a serial number or a recording.

    The motor's parameters are shared by all recordings; an instrument's errors by those that give the same serial
    number, calibration and figure; whatever no run has for itself by the parts of one recording.
    """
    one, recording = part.nuisances[i], part.recording
    if one.name in OF_THE_MOTOR:
        return one.name, ""
    column = column_of(recording, one.name.partition("_")[0]) if one.name.endswith(("_offset", "_scale")) else None
    figures = recording.channels[column] if column is not None else None
    if figures is not None and figures.serial and part.run_of(i) is None:
        return (figures.serial, figures.calibrated, one.name, one.b), figures.serial
    if is_whole and part.run_of(i) is None:
        return (str(recording.folder), one.name), recording.folder.name
    return (name, one.name), name
