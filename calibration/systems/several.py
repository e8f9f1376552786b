"""Several recordings of one motor, each with its own day: one vector of readings, one posterior.

The motor's own unknowns and the effects are shared. Of each recording alone are its ambient, the errors of its
instruments, its supply, the angles at which its runs begin, and its noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from calibration.likelihood.compared import Chosen, Row, Whitener
from calibration.likelihood.descent import find
from calibration.likelihood.expected import Expected, Test
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode
from calibration.likelihood.noise_test import NoiseTest
from calibration.likelihood.shapes import Balance, Force, Form, StepsInTime
from calibration.systems.radial_piston.comparison import OF_THE_MOTOR, Comparison
from calibration.systems.radial_piston.predict.problem import Prediction, Problem
from calibration.unknowns.priors import Unknown
from model.effects import Effect, EffectParameter
from rig.recording import Recording

SCALES = 3  # of a recording's noise

Predictions = tuple[Prediction, ...]


class SeveralProblem:
    """The unknowns of several recordings.

    Attributes
    ----------
    parts : sequence of Problem
        Of each recording.
    at : list of ndarray of int
        Where each recording's nuisances stand among those of all.
    """

    friction = "f_overall"

    def __init__(self, parts: Sequence[Problem], names: Sequence[str]) -> None:
        self.parts, self.names = list(parts), list(names)
        self.recording = parts[0].recording
        self.nuisances: list[Unknown] = []
        self.at: list[np.ndarray] = []
        self._of: list[tuple[int, int]] = []  # the recording that a nuisance stands in first, and its place there
        shared: dict[str, int] = {}
        for k, (part, name) in enumerate(zip(parts, names, strict=True)):
            places = []
            for i, one in enumerate(part.nuisances):
                if one.name in OF_THE_MOTOR and one.name in shared:
                    places.append(shared[one.name])
                    continue
                places.append(len(self.nuisances))
                if one.name in OF_THE_MOTOR:
                    shared[one.name] = len(self.nuisances)
                    self.nuisances.append(one)
                else:
                    self.nuisances.append(replace(one, name=f"{name}: {one.name}"))
                self._of.append((k, i))
            self.at.append(np.array(places, dtype=int))
        self._added = [part.recording.added_inertia_kg_m2 for part in parts]

    def of_part(self, k: int, z: np.ndarray) -> np.ndarray:
        """One recording's nuisances [-]: with another flywheel the rotor keeps its own inertia.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Of all [-].
        """
        found: np.ndarray = z[self.at[k]].copy()
        place = self.parts[k].place("inertia")
        if place is not None and self._added[k] != self._added[0]:
            i = self.at[k][place]
            rotor = float(self.nuisances[i].value(z[i])) - self._added[0]
            found[place] = self.parts[k].nuisances[place].z(max(rotor, 1e-12) + self._added[k])
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
        """Values of the effects' parameters [own units], by effect.

        Parameters
        ----------
        z : ndarray, shape (k,)
            The effects' share of the point [-].
        """
        return self.parts[0].chosen(names, z)

    def place(self, name: str) -> int | None:
        """Where a nuisance stands among the unknowns; None where it is none of them."""
        return next((i for i, unknown in enumerate(self.nuisances) if unknown.name == name), None)

    def in_si(self, nuisance: str) -> float:
        """What a nuisance's value is multiplied by to be SI [-]."""
        return self.parts[0].in_si(nuisance.rpartition(": ")[2])

    def run_of(self, i: int) -> int | None:
        """The run in time that a nuisance belongs to alone, counted through all recordings [-]; else None."""
        k, place = self._of[i]
        run = self.parts[k].run_of(place)
        return None if run is None else run + self._before(k)

    def predict(
        self,
        z: np.ndarray,
        chosen: Chosen,
        like: Predictions | None = None,
        runs: Sequence[int] | None = None,
        smooth: bool = False,
        around: Sequence[Any] | None = None,
    ) -> Predictions:
        """What the instruments of each recording would read.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].
        """
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
        """The plateaus of each recording close to a point.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            Nuisances [-].
        """
        return [part.neighbourhood(self.of_part(k, z), chosen, here[k]) for k, part in enumerate(self.parts)]

    def _before(self, k: int) -> int:
        return sum(len(part.blocks.runs) for part in self.parts[:k])


class _Whitener:
    """Each recording's map, in the order of all readings."""

    def __init__(self, parts: Sequence[Whitener], at: Sequence[np.ndarray], size: int) -> None:
        self._parts, self._at, self._size = parts, at, size

    def __call__(self, difference: np.ndarray) -> np.ndarray:
        """Whitened differences, shape (m,) or (m, k)."""
        out = np.zeros_like(difference)
        for part, at in zip(self._parts, self._at, strict=True):
            out[at] = part(difference[at])
        return out

    @property
    def scale(self) -> np.ndarray:
        """sd of each reading given those before it [SI], shape (m,)."""
        out = np.zeros(self._size)
        for part, at in zip(self._parts, self._at, strict=True):
            out[at] = part.scale
        return out

    @property
    def log_scale(self) -> float:
        """Sum of the logarithms of the sds that hang on the noise [-]."""
        return sum(part.log_scale for part in self._parts)


class _Noise:
    """The noise of each recording; the scales of all come first in u."""

    def __init__(self, parts: Sequence[Comparison]) -> None:
        self._parts = parts
        spread, free = ([getattr(part.noise, what) for part in parts] for what in ("spread", "free"))
        self.scales = slice(0, SCALES * len(parts))
        self.spread, self.free = self.joined(spread), self.joined(free)

    def joined(self, each: Sequence[np.ndarray]) -> np.ndarray:
        """One vector of what each recording has in the order of its own u."""
        return np.concatenate([*(one[:SCALES] for one in each), *(one[SCALES:] for one in each)])

    def places(self, k: int) -> np.ndarray:
        """Where a recording's u stands in that of all [-], shape (5,)."""
        further = self._parts[0].noise.spread.size - SCALES
        first = SCALES * len(self._parts) + further * k
        return np.r_[SCALES * k : SCALES * (k + 1), first : first + further]

    def told(self, u: np.ndarray) -> list[dict[str, Any]]:
        """Nothing: the pages have the noise of each instrument."""
        return []

    def too_loud(self, u: np.ndarray) -> tuple[str, float] | None:
        """The first recording's channel that is too loud to be believed; None where none is."""
        found = (part.noise.too_loud(u[self.places(k)]) for k, part in enumerate(self._parts))
        return next((one for one in found if one), None)


class Several:
    """Recordings of one motor as one vector.

    Its first readings are all plateaus, then come the samples of all runs, then what is read beside them.

    Parameters
    ----------
    names : sequence of str
        What each recording is called, each another.
    """

    rig = ""

    def __init__(self, parts: Sequence[Comparison], names: Sequence[str]) -> None:
        self.parts, self.names = list(parts), list(names)
        self.problem = SeveralProblem([part.problem for part in parts], names)
        self.noise = _Noise(parts)
        cuts = [(0, 2 * part.n, part.end, part.read.size) for part in parts]
        ends = np.cumsum([[cut[j + 1] - cut[j] for cut in cuts] for j in range(3)])
        begins = np.append(0, ends[:-1]).reshape(3, len(parts))
        self.at = [
            np.concatenate([begins[j, k] + np.arange(cut[j + 1] - cut[j]) for j in range(3)])
            for k, cut in enumerate(cuts)
        ]
        self.end = int(sum(part.end for part in parts))
        self.read, self.known = self._joined([part.read for part in parts]), self._joined([p.known for p in parts])
        self.of_a_kind = tuple(self.at[k][mine] for k, part in enumerate(parts) for mine in part.of_a_kind)
        self.again = tuple(self.at[k][mine] for k, part in enumerate(parts) for mine in part.again)
        self.in_time = any(part.in_time for part in parts)
        self.check: tuple[str, ...] = parts[0].check
        self.trusting = False

    @property
    def size(self) -> int:
        """Number of readings [-]."""
        return int(self.known.sum())

    @property
    def rows(self) -> list[Row]:
        """The plateaus' readings, with the name of their recording ahead of the file."""
        found: list[Row | None] = [None] * sum(2 * part.n for part in self.parts)
        for k, part in enumerate(self.parts):
            for i, row in enumerate(part.rows):
                found[self.at[k][i]] = row._replace(file=f"{self.names[k]}/{row.file}")
        return [row for row in found if row is not None]

    def raw(self, predicted: Predictions) -> np.ndarray:
        """Predictions as a vector [SI], shape (m,)."""
        return self._joined([part.raw(one) for part, one in zip(self.parts, predicted, strict=True)])

    def is_told(self, predicted: Predictions) -> bool:
        """Whether the predictions have a value for every reading that there is."""
        return all(part.is_told(one) for part, one in zip(self.parts, predicted, strict=True))

    def whitener(self, predicted: Predictions, u: np.ndarray) -> _Whitener:
        """The map to standard normal numbers.

        Parameters
        ----------
        u : ndarray, shape (5 parts,)
            The noise [-].
        """
        each = [part.whitener(predicted[k], u[self.noise.places(k)]) for k, part in enumerate(self.parts)]
        return _Whitener(each, self.at, self.read.size)

    def noise_step(
        self,
        difference: np.ndarray,
        predicted: Predictions,
        u: np.ndarray,
        weight: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """One scoring step of each recording's noise, and the information that there is of it [-].

        Parameters
        ----------
        difference : ndarray, shape (m,)
            Readings less predictions [SI].
        u : ndarray, shape (5 parts,)
            Where to step from [-].
        weight : ndarray, shape (m,)
            Of each entry, below 1 where a reading is bad [-].
        columns : ndarray, shape (m, k) or None
            Derivatives that the prediction was fitted with [SI].
        """
        step, information = np.zeros(u.size), np.zeros((u.size, u.size))
        for k, part in enumerate(self.parts):
            at, places = self.at[k], self.noise.places(k)
            mine = None if columns is None else columns[at]
            of_part = part.noise_step(difference[at], predicted[k], u[places], weight[at], mine, correlated)
            step[places], information[np.ix_(places, places)] = of_part
        return step, information

    def drawn_noise(self, predicted: Predictions, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the readings about a prediction [SI], shape (m,).

        Parameters
        ----------
        u : ndarray, shape (5 parts,)
            The noise [-].
        """
        each = [part.drawn_noise(predicted[k], u[self.noise.places(k)], rng) for k, part in enumerate(self.parts)]
        return self._joined(each)

    def free_in_test(self, mode: Mode) -> np.ndarray:
        """Factors on a mode's unknowns in the test for a mismatch [-], shape (m,): their priors hold."""
        return np.ones(mode.z.size)

    def noise_test(self, mode: Mode, every: np.ndarray, good: np.ndarray) -> NoiseTest:
        """The noise in the test for a mismatch.

        Parameters
        ----------
        every : ndarray, shape (m, k)
            What all that may be missing does to the readings [SI].
        good : ndarray, shape (m,)
            1, or 0 where a reading is bad [-].
        """
        return NoiseTest(self, mode, every, good)

    def giving(self, given: Mapping[tuple[str, str], float]) -> Several:
        """The same, with other parameters of effects given, by (effect, parameter) [own unit]."""
        return Several([part.giving(given) for part in self.parts], self.names)

    def of(self, recording: Recording) -> Comparison:
        """Another recording of the same motor."""
        return self.parts[-1].of(recording)

    def carried(self, other: Any, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Several recordings are never held out.

        Raises
        ------
        NotImplementedError
            Always.
        """
        raise NotImplementedError("several recordings are never held out")

    def begun(self, f: Function, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, Predictions]:
        """The point itself, and what it predicts.

        Parameters
        ----------
        z : ndarray, shape (k,)
            The point [-].
        u : ndarray, shape (5 parts,)
            The noise [-].
        """
        return z, f(z)

    def base(self) -> Mode:
        """The base model: from where each recording alone leads, the motor by the mean that their spreads weigh."""
        alone = [part.base() for part in self.parts]
        z, weight = np.zeros(len(self.problem.nuisances)), np.zeros(len(self.problem.nuisances))
        for k, mode in enumerate(alone):
            precision = 1.0 / np.diag(mode.covariance)
            np.add.at(z, self.problem.at[k], mode.z * precision)
            np.add.at(weight, self.problem.at[k], precision)
        z /= weight
        predicted = self.problem.predict(z, {})
        D, nothing = np.zeros((self.read.size, z.size)), np.zeros(self.read.size)
        u = self.noise.joined([mode.u for mode in alone])
        start = Mode((), z, u, D, D, nothing, np.eye(z.size), 0.0, nothing, predicted)
        return find(self, (), start)

    def middle(self) -> np.ndarray:
        """Where a search starts: each recording's own, the motor at its prior's middle [-]."""
        z = np.zeros(len(self.problem.nuisances))
        for k, part in enumerate(self.parts):
            z[self.problem.at[k]] = part.middle()
        return z

    def turned(self, f: Function, z: np.ndarray, u: np.ndarray, here: Predictions) -> tuple[np.ndarray, Predictions]:
        """A point with the shaft's angles at the best of a few, and the predictions there.

        Parameters
        ----------
        z : ndarray, shape (k,)
            The point [-].
        u : ndarray, shape (5 parts,)
            The noise [-].
        """
        found, there = z.copy(), list(here)
        for k, part in enumerate(self.parts):
            own = self._own(k, f, found)
            moved, there[k] = part.turned(Function(part, f.names), own, u[self.noise.places(k)], there[k])
            self._take_up(k, found, own, moved)
        return found, tuple(there)

    def loosened(self, f: Function, z: np.ndarray, here: Predictions, D: np.ndarray) -> list[np.ndarray]:
        """The point itself.

        Parameters
        ----------
        z : ndarray, shape (k,)
            The point [-].
        D : ndarray, shape (m, k)
            Derivatives there [SI].
        """
        return [z]

    def along_valley(
        self, f: Function, z: np.ndarray, tried: np.ndarray, here: Predictions, D: np.ndarray
    ) -> np.ndarray:
        """A step along the valley of the recording with the most plateaus.

        Parameters
        ----------
        z, tried : ndarray, shape (k,)
            Where from, and the end of the straight step [-].
        D : ndarray, shape (m, k)
            Derivatives there [SI].
        """
        k = max(range(len(self.parts)), key=lambda i: self.parts[i].n)
        part, own, ahead = self.parts[k], self._own(k, f, z), self._own(k, f, tried)
        columns = D[np.ix_(self.at[k], self._columns(k, z.size))]
        moved = part.along_valley(Function(part, f.names), own, ahead, here[k], columns)
        found: np.ndarray = tried.copy()
        self._take_up(k, found, ahead, moved)
        return f.clip(found)

    def known_derivative(self, i: int, z: np.ndarray, raw: np.ndarray, names: Sequence[str]) -> np.ndarray | None:
        """What a nuisance of one recording does to the readings [SI], shape (m,), where that needs no simulation.

        Parameters
        ----------
        z : ndarray, shape (k,)
            The point [-].
        raw : ndarray, shape (m,)
            The predictions there [SI].
        """
        k, place = self.problem._of[i]
        if self.problem.nuisances[i].name in OF_THE_MOTOR:
            return None
        n = len(self.problem.nuisances)
        own = np.append(self.problem.of_part(k, z[:n]), z[n:])
        column = self.parts[k].known_derivative(place, own, raw[self.at[k]], names)
        return None if column is None else self._lifted(k, column)

    def channels(self) -> dict[str, np.ndarray]:
        """Which readings are flows and which speeds: masks of shape (m,)."""
        each = [part.channels() for part in self.parts]
        return {name: self._joined([one[name] for one in each]) for name in each[0]}

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Masks of the readings that are held out together: those of each recording."""
        found = [self._lifted(k, mask) for k, part in enumerate(self.parts) for mask in part.folds()[0]]
        return found, f"{self.parts[0].folds()[1]} of each recording"

    def drawn_together(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Places of readings that are always there, and of those that are drawn together."""
        each = [part.drawn_together() for part in self.parts]
        always = np.concatenate([self.at[k][one] for k, (one, _) in enumerate(each)])
        return always, [self.at[k][block] for k, (_, blocks) in enumerate(each) for block in blocks]

    def ordinary_speed(self, mode: Mode) -> float:
        """Root mean square of the plateaus' speeds [rad/s]."""
        each = [part.ordinary_speed(self.of_part(k, mode)) for k, part in enumerate(self.parts) if part.n]
        return float(np.sqrt(np.mean(np.square(each)))) if each else 0.0

    def forces(self, mode: Mode) -> list[Force]:
        """The free-form forces of each recording."""
        return [
            replace(one, columns=self._lifted(k, one.columns), recording=self.names[k])
            for k, part in enumerate(self.parts)
            for one in part.forces(self.of_part(k, mode))
        ]

    def angle_force(self, mode: Mode) -> Force | None:
        """A torque along the shaft's angle, of the first recording that resolves it."""
        for k, part in enumerate(self.parts):
            one = part.angle_force(self.of_part(k, mode))
            if one is not None:
                return replace(one, columns=self._lifted(k, one.columns), recording=self.names[k])
        return None

    def balances(self, mode: Mode) -> list[Balance]:
        """What may be off in each recording, and along what."""
        found = []
        for k, part in enumerate(self.parts):
            for one in part.balances(self.of_part(k, mode)):
                columns = partial(self._lifted_columns, k, one)
                found.append(replace(one, columns=columns, recording=self.names[k]))
        return found

    def forms(self, mode: Mode) -> list[Form]:
        """None: no law is looked for in several recordings at once."""
        return []

    def steps_in_time(self, mode: Mode) -> StepsInTime | None:
        """None: no step is looked for in several recordings at once."""
        return None

    def same_coordinates(self, mode: Mode, coordinate: str) -> tuple[str, ...]:
        """Coordinates that none of the recordings can tell from one."""
        each = [part.same_coordinates(self.of_part(k, mode), coordinate) for k, part in enumerate(self.parts)]
        return tuple(name for name in each[0] if all(name in one for one in each))

    def not_observable(self, mode: Mode) -> list[str]:
        """Coordinates along which none of the recordings can show anything, each in a sentence."""
        each = [part.not_observable(self.of_part(k, mode)) for k, part in enumerate(self.parts)]
        return [words for words in each[0] if all(words in one for one in each)]

    def not_described(self, base: Mode) -> str:
        """How far the base model is from the readings of the first recording that it does not describe at all."""
        each = [(name, part.not_described(self.of_part(k, base))) for k, (name, part) in self._numbered()]
        return next((f"{name}: {words}" for name, words in each if words), "")

    def tests(self, rivals: Sequence[Mode]) -> Iterator[Test]:
        """Tests that the bench of the last recording could make, with what all of them say.

        Parameters
        ----------
        rivals : sequence of Mode
            The explanations, the most probable first.
        """
        k = len(self.parts) - 1

        def read(test: Test, of: Sequence[Mode]) -> list[Expected]:
            return test.expected([self.of_part(k, mode) for mode in of])

        for test in self.parts[k].tests([self.of_part(k, mode) for mode in rivals]):
            yield replace(test, expected=partial(read, test))

    friction_unit = "N m s"

    def unit(self, unknown: Unknown) -> str:
        """The unit of an effect's parameter."""
        return unknown.unit

    def rows_used(self) -> list[dict[str, Any]]:
        """Rows used of each file, with the name of its recording ahead."""
        return [
            one | {"file": f"{name}/{one['file']}"} for _, (name, part) in self._numbered() for one in part.rows_used()
        ]

    def of_part(self, k: int, mode: Mode) -> Mode:
        """A mode as one of the recordings has it.

        Parameters
        ----------
        mode : Mode
            Of all recordings.
        """
        at, columns = self.at[k], self._columns(k, mode.z.size)
        n = len(self.problem.nuisances)
        z = np.append(self.problem.of_part(k, mode.z[:n]), mode.z[n:])
        return replace(
            mode,
            z=z,
            u=mode.u[self.noise.places(k)],
            D=mode.D[np.ix_(at, columns)],
            J=mode.J[np.ix_(at, columns)],
            r=mode.r[at],
            covariance=mode.covariance[np.ix_(columns, columns)],
            bad=mode.bad[at],
            prediction=mode.prediction[k],
        )

    def _numbered(self) -> Iterator[tuple[int, tuple[str, Comparison]]]:
        return enumerate(zip(self.names, self.parts, strict=True))

    def _columns(self, k: int, size: int) -> np.ndarray:
        """Places of a recording's unknowns among those of all, the effects' behind."""
        return np.append(self.problem.at[k], np.arange(len(self.problem.nuisances), size))

    def _own(self, k: int, f: Function, z: np.ndarray) -> np.ndarray:
        """A recording's share of a point."""
        return np.append(self.problem.of_part(k, z[: f.k]), z[f.k :])

    def _take_up(self, k: int, found: np.ndarray, own: np.ndarray, moved: np.ndarray) -> None:
        """Put what a recording moved of its share into a point of all."""
        found[self._columns(k, found.size)] += moved - own

    def _joined(self, each: Sequence[np.ndarray]) -> np.ndarray:
        out = np.zeros(sum(one.shape[0] for one in each), dtype=each[0].dtype)
        for at, one in zip(self.at, each, strict=True):
            out[at] = one
        return out

    def _lifted(self, k: int, values: np.ndarray) -> np.ndarray:
        """What one recording has, with zeros for all the others."""
        out = np.zeros((self.read.size, *values.shape[1:]), dtype=values.dtype)
        out[self.at[k]] = values
        return out

    def _lifted_columns(self, k: int, of: Balance, pieces: Any) -> np.ndarray:
        return self._lifted(k, of.columns(pieces))
