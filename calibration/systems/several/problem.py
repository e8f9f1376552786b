"""The unknowns of several recordings of one motor, and the predictions of their readings."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.data.dates import date_of, day_of
from calibration.likelihood import compared
from calibration.systems.radial_piston.predict.carried import OF_THE_MOTOR
from calibration.systems.radial_piston.predict.problem import Prediction, Problem
from calibration.systems.several.sharing import CHANGE, OF_THE_MOTOR_CHANGED, SHARED, Sharing, shared
from calibration.unknowns.effects import changed, searched, unchanged
from calibration.unknowns.priors import Unknown, column_of, drift_of, figures_of, full_name
from model.effects import Effect, effects
from model.effects.laws import Chosen

END = 1e-6  # share by which a value keeps from the end of its prior
Predictions = tuple[Prediction, ...]


@dataclass(frozen=True)
class _Last:
    """The last prediction of a recording: the derivative with an unknown of another one leaves its point the same."""

    key: Hashable
    near: Any
    predicted: Prediction


class SeveralProblem(compared.Problem):
    """The unknowns of several recordings.

    `parts`: of each recording.
    `at`: where each recording's nuisances stand among those of all. Where an instrument has drifted since another day,
        it is where the drift stands, the offset of that day being in ``before``.
    `scale`: what a nuisance of all is multiplied by to be that of each recording: of a drift its sd over the offset's
        [-].
    `before`: for each recording, the places of offsets that are another day's and a drift, and where that day's stands.
    """

    friction = "f_overall"

    def __init__(self, parts: Sequence[Problem], names: Sequence[str], sharing: Sharing = SHARED) -> None:
        self.parts, self.names, self.sharing = list(parts), list(names), sharing
        self.recording, self.given = parts[0].recording, parts[0].given
        self.nuisances: list[Unknown] = []
        self.at: list[np.ndarray] = []
        self._of: list[tuple[int, int]] = []  # the recording that a nuisance stands in first, and its place there
        self.scale: list[np.ndarray] = []
        self.before: list[dict[int, int]] = []
        places_of: dict[Hashable, int] = {}
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
                drift = drift_of(part.recording, one)
                if drift is not None and day_of_first.get(key, day) != day:
                    self.scale[k][i], self.before[k][i] = drift.b / one.b, places_of[key]
                    key, of, one = (key, day), name, drift
                if key in places_of:
                    mine.append(places_of[key])
                    continue
                places_of[key], day_of_first[key] = len(self.nuisances), day
                mine.append(len(self.nuisances))
                if any((known.own, known.whose) == (one.own, of) for known in self.nuisances):  # calibrated anew
                    of = f"{of} in {name}"
                self.nuisances.append(replace(one, whose=of))
                self._of.append((k, i))
            self.at.append(np.array(mine, dtype=int))
        self._last: list[_Last | None] = [None] * len(parts)
        # Parts of one recording, with other flywheels, are of one day: an effect has the same sizes in all of them.
        folders = [Path(folder).name for folder, _ in dict.fromkeys(places)]
        self.day_of = [
            name if not whole else folder if folders.count(folder) == 1 else self.names[places.index(place)]
            for name, whole, place in zip(names, is_whole, places, strict=True)
            for folder in [Path(place[0]).name]
        ]
        self.days = list(dict.fromkeys(self.day_of))
        self.dates = {day: date_of(part.recording) for day, part in zip(self.day_of, parts, strict=True)}

    def along_dates(self) -> list[str]:
        """The recordings by their dates; in the order given where one has none."""
        dated = [(taken, day) for day, taken in self.dates.items() if taken is not None]
        return [day for _, day in sorted(dated)] if len(dated) == len(self.days) else self.days

    def of_part(self, k: int, z: np.ndarray, names: Sequence[str] = ()) -> np.ndarray:
        """One recording's share of a point [-].

        `z`, shape (m,): of all: nuisances, then the unknowns of the effects ``names`` [-].
        """
        n = len(self.nuisances)
        chosen = self.chosen(names, z[n:])
        return np.append(self._nuisances_of(k, z[:n], chosen), z[self.columns(k, names)[self.at[k].size :]])

    def columns(self, k: int, names: Sequence[str]) -> np.ndarray:
        """Places of a recording's unknowns among those of all, those of its effects behind [-]."""
        mine = [
            i
            for i, (name, unknown) in enumerate(self.effect_unknowns(names), start=len(self.nuisances))
            if name not in OF_THE_MOTOR_CHANGED and unknown.whose in ("", self.day_of[k])
        ]
        return np.append(self.at[k], np.array(mine, dtype=int))

    def names_in(self, names: Sequence[str]) -> tuple[str, ...]:
        """The effects of a set as a recording by itself has them."""
        return tuple(unchanged(name) for name in names if name not in OF_THE_MOTOR_CHANGED)

    def _nuisances_of(self, k: int, z: np.ndarray, chosen: Chosen) -> np.ndarray:
        found: np.ndarray = z[self.at[k]] * self.scale[k]
        for i, first in self.before[k].items():
            found[i] += z[first]
        for name in OF_THE_MOTOR:
            place = self.parts[k].place(name)
            change = chosen.get(changed(name), {}).get(CHANGE.name, 0.0) if self.day_of[k] == self.days[-1] else 0.0
            if place is None or change == 0.0:
                continue
            i = self.at[k][place]
            own = float(self.nuisances[i].value(z[i])) * (1.0 + change)
            found[place] = _z_within(self.parts[k].nuisances[place], own)
        return found

    def moved_by(self, k: int, i: int) -> list[tuple[int, float]]:
        """Places of a recording's nuisances that one of all moves, and by how much [-]."""
        found = [(int(place), float(self.scale[k][place])) for place in np.flatnonzero(self.at[k] == i)]
        return found + [(place, 1.0) for place, first in self.before[k].items() if first == i]

    def scales(self, k: int, size: int) -> np.ndarray:
        """``scale`` with ones behind it for the effects, shape (size,) [-]."""
        return np.append(self.scale[k], np.ones(size - self.scale[k].size))

    def share(self, k: int, names: Sequence[str] = ()) -> np.ndarray:
        """How a recording's unknowns follow from those of all, its effects' behind, shape (n, m) [-]."""
        columns = self.columns(k, names)
        found = np.zeros((columns.size, len(self.nuisances) + len(self.effect_unknowns(names))))
        found[np.arange(columns.size), columns] = self.scales(k, columns.size)
        for i, first in self.before[k].items():
            found[i, first] = 1.0
        return found

    def _chosen_of(self, k: int, chosen: Chosen) -> Chosen:
        """The effects of one recording, of those of all."""
        return {
            unchanged(name): {
                one.name: values[key]
                for one in shared(name).parameters
                for mine in self._whose(name)
                if mine in ("", self.day_of[k]) and (key := full_name(one.name, mine)) in values
            }
            for name, values in chosen.items()
            if name not in OF_THE_MOTOR_CHANGED
        }

    def effects_that_could(self) -> list[Effect]:
        """The effects that any of the recordings could show."""
        found = dict.fromkeys(effect.id for part in self.parts for effect in part.effects_that_could())
        names = list(found)
        if self.sharing.changes:
            names += [changed(name) for name in found if self._could_change(name)]
            in_time = any(part.blocks.runs for part in self.parts)
            mine = [name for name in OF_THE_MOTOR if self.place(name) is not None and (in_time or name != "inertia")]
            names += [changed(name) for name in mine]
        return [self.effect(name) for name in names]

    def _could_change(self, name: str) -> bool:
        """Whether an effect may be another in one recording: not what a parameter of the motor says, nor one and the
        same instrument's error."""
        effect = effects()[name]
        channels = effect.reads or (("speed",) if effect.lag is not None else ())
        return effect.nuisance not in OF_THE_MOTOR and not any(self._is_one_instrument(one) for one in channels)

    def _is_one_instrument(self, channel: str) -> bool:
        figures = [part.recording.channels.get(column_of(part.recording, channel) or "") for part in self.parts]
        serials = {(one.serial, one.calibrated) if one is not None and one.serial else None for one in figures}
        return len(serials) == 1 and None not in serials

    def effect(self, name: str) -> Effect:
        """An effect by its id, with a size for each recording where it is each one's own."""
        return self.sharing.effect(name, self.days)

    def nuisance_of(self, effect: str, parameter: str) -> str:
        """The nuisance that a parameter of an effect has the form of; empty where there is none."""
        nuisance = self.effect(effect).nuisance
        day = next((one.whose for _, one in self.effect_unknowns([effect]) if one.name == parameter), "")
        if not day or not nuisance:
            return nuisance
        k = self.day_of.index(day)
        place = self.parts[k].place(nuisance)
        return "" if place is None or nuisance in OF_THE_MOTOR else self.nuisances[self.at[k][place]].name

    def effect_unknowns(self, names: Sequence[str]) -> list[tuple[str, Unknown]]:
        """Effect id and unknown of each parameter of a set, in its order."""
        found = [
            (name, replace(searched(one), whose=mine))
            for name in names
            for mine in self._whose(name)
            for one in shared(name).parameters
        ]
        return [(name, one) for name, one in found if (name, one.name) not in self.given]

    def _whose(self, effect: str) -> Sequence[str]:
        return self.sharing.whose(effect, self.days)

    def of_change(
        self, change: str, names: Sequence[str], z: np.ndarray
    ) -> list[tuple[Unknown, np.ndarray, np.ndarray]]:
        """What changed, in the first recording and in the last: the quantity and its values there, shape (n,) each.

        `change`: a member of a set of effects ``names``.
        `z`, shape (n, m): points: nuisances, then the unknowns of the set [-].
        """
        n = len(self.nuisances)
        mine = {
            one.name: z[:, i] for i, (name, one) in enumerate(self.effect_unknowns(names), start=n) if name == change
        }
        if change not in OF_THE_MOTOR_CHANGED:
            pairs: list[tuple[Unknown, np.ndarray, np.ndarray]] = []
            for parameter in effects()[unchanged(change)].parameters:
                one = replace(searched(parameter), why=parameter.text)
                before, after = (one.value(mine[full_name(one.name, day)]) for day in (self.days[0], self.days[-1]))
                pairs.append((one, before, after))
            return pairs
        i = next(i for i, one in enumerate(self.nuisances) if one.name == unchanged(change))
        before = self.nuisances[i].value(z[:, i])
        return [(self.nuisances[i], before, before * (1.0 + searched(CHANGE).value(mine[CHANGE.name])))]

    def in_si(self, nuisance: str) -> float:
        """What a nuisance's value is multiplied by to be SI [-]."""
        k, place = self._of[next(i for i, one in enumerate(self.nuisances) if one.name == nuisance)]
        return self.parts[k].in_si(self.parts[k].nuisances[place].name)

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
            own, mine_of = self._nuisances_of(k, z, chosen), self._chosen_of(k, chosen)
            if mine is not None:
                found.append(part.predict(own, mine_of, before, mine, smooth, near))
                continue
            key = (part.times_seen, own.tobytes(), repr(mine_of), smooth)
            last = self._last[k]
            if last is None or last.key != key or last.near is not near:
                last = self._last[k] = _Last(key, near, part.predict(own, mine_of, smooth=smooth, around=near))
            found.append(last.predicted)
        return tuple(found)

    def neighbourhood(self, z: np.ndarray, chosen: Chosen, here: Predictions) -> list[Any]:
        """The plateaus of each recording close to a point."""
        return [
            part.neighbourhood(self._nuisances_of(k, z, chosen), self._chosen_of(k, chosen), here[k])
            for k, part in enumerate(self.parts)
        ]

    def _before(self, k: int) -> int:
        return sum(len(part.blocks.runs) for part in self.parts[:k])


def _z_within(unknown: Unknown, value: float) -> float:
    """The standard normal number of a value [-], of one beyond the prior's ends that of the end."""
    if unknown.kind == "loguniform":
        value = min(max(value, unknown.a * (1.0 + END)), unknown.b * (1.0 - END))
    return unknown.z(value)


def _whose(part: Problem, i: int, name: str, is_whole: bool) -> tuple[Hashable, str]:
    """What an unknown is shared by, and what stands ahead of its name: nothing, a serial number or a recording.

    The motor's parameters are shared by all recordings; an instrument's errors by those that give the same serial
    number, calibration and figure; whatever no run has for itself by the parts of one recording.
    """
    one, recording = part.nuisances[i], part.recording
    if one.name in OF_THE_MOTOR:
        return one.name, ""
    figures = figures_of(recording, one)
    if figures is not None and figures.serial and part.run_of(i) is None:
        return (figures.serial, figures.calibrated, one.name, one.b), figures.serial
    if is_whole and part.run_of(i) is None:
        return (str(recording.folder), one.name), recording.folder.resolve().name
    return (name, one.name), name
