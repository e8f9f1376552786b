"""Several recordings of one motor as one vector of readings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from calibration.data.rows_used import FileUse
from calibration.likelihood.compared import Compared, Row
from calibration.likelihood.descent import find
from calibration.likelihood.expected import Expected, Taken, Test
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, starting_at
from calibration.likelihood.shapes import Places
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.several.noise import Noises, Whiteners
from calibration.systems.several.places import places_of
from calibration.systems.several.problem import Predictions, SeveralProblem
from calibration.systems.several.sharing import SHARED, Sharing
from rig.recording import Recording


class Several(Compared):
    """Recordings of one motor as one vector.

    Its first readings are all plateaus, then come the samples of all runs, then what is read beside them.

    `names`: what each recording is called, each another.
    `sharing`: of which effects each has its own sizes.
    """

    problem: SeveralProblem
    noise: Noises

    def __init__(self, parts: Sequence[Comparison], names: Sequence[str], sharing: Sharing = SHARED) -> None:
        self.parts, self.names = list(parts), list(names)
        self.problem = SeveralProblem([part.problem for part in parts], names, sharing)
        self.noise = Noises(parts, names)
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
        self.thorough = sharing.changes and not self.in_time  # what else could explain a change is to be complete
        self.check = parts[0].check

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

    def whitener(self, predicted: Predictions, u: np.ndarray) -> Whiteners:
        """The map to standard normal numbers."""
        each = [part.whitener(predicted[k], u[self.noise.places(k)]) for k, part in enumerate(self.parts)]
        return Whiteners(each, self.at, self.read.size)

    def noise_step(
        self,
        difference: np.ndarray,
        predicted: Predictions,
        u: np.ndarray,
        weight: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """One scoring step of each recording's noise, and the information that there is of it [-]."""
        step, information = np.zeros(u.size), np.zeros((u.size, u.size))
        for k, part in enumerate(self.parts):
            at, places = self.at[k], self.noise.places(k)
            mine = None if columns is None else columns[at]
            of_part = part.noise_step(difference[at], predicted[k], u[places], weight[at], mine, correlated)
            step[places], information[np.ix_(places, places)] = of_part
        return step, information

    def drawn_noise(self, predicted: Predictions, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the readings about a prediction [SI], shape (m,)."""
        each = [part.drawn_noise(predicted[k], u[self.noise.places(k)], rng) for k, part in enumerate(self.parts)]
        return self._joined(each)

    def giving(self, given: Mapping[tuple[str, str], float]) -> Several:
        """The same, with other parameters of effects given, by (effect, parameter) [own unit]."""
        return Several([part.giving(given) for part in self.parts], self.names, self.problem.sharing)

    def of(self, recording: Recording) -> Comparison:
        """Another recording of the same motor."""
        return self.parts[-1].of(recording)

    def carried(self, other: Any, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Several recordings are never held out. Raises NotImplementedError: always."""
        raise NotImplementedError("several recordings are never held out")

    def base(self) -> Mode:
        """The base model: from where each recording alone leads, the motor by the mean that their spreads weigh."""
        alone = [part.base() for part in self.parts]
        z, weight = np.zeros(len(self.problem.nuisances)), np.zeros(len(self.problem.nuisances))
        for k, mode in enumerate(alone):
            precision = 1.0 / np.diag(mode.covariance)
            places = self.problem.at[k].copy()
            for place, first in self.problem.before[k].items():
                places[place] = first  # a drift begins at 0
            np.add.at(z, places, mode.z * precision)
            np.add.at(weight, places, precision)
        z[weight > 0.0] /= weight[weight > 0.0]
        return find(self, (), starting_at(Function(self, ()), z, self.noise.joined([mode.u for mode in alone])))

    def middle(self) -> np.ndarray:
        """Where a search starts: each recording's own, the motor at its prior's middle [-]."""
        z = np.zeros(len(self.problem.nuisances))
        for k, part in enumerate(self.parts):
            z[self.problem.at[k]] = part.middle()
        return z

    def turned(self, f: Function, z: np.ndarray, u: np.ndarray, here: Predictions) -> tuple[np.ndarray, Predictions]:
        """A point with the shaft's angles at the best of a few, and the predictions there."""
        found, there = z.copy(), list(here)
        for k, part in enumerate(self.parts):
            own = self._own(k, f, found)
            mine = Function(part, self.problem.names_in(f.names))
            moved, there[k] = part.turned(mine, own, u[self.noise.places(k)], there[k])
            self._take_up(k, f, found, own, moved)
        return found, tuple(there)

    def relined(self, f: Function, z: np.ndarray, u: np.ndarray) -> np.ndarray | None:
        """A point with the lines of each recording's runs where they suit it better; None where none does."""
        found, gained = z.copy(), False
        for k, part in enumerate(self.parts):
            own = self._own(k, f, found)
            moved = part.relined(Function(part, self.problem.names_in(f.names)), own, u[self.noise.places(k)])
            if moved is not None:
                self._take_up(k, f, found, own, moved)
                gained = True
        return found if gained else None

    def loosened(self, f: Function, z: np.ndarray, here: Predictions, D: np.ndarray) -> list[np.ndarray]:
        """Points at which each level of one of the recordings that was seen to turn does."""
        found = []
        for k, part in enumerate(self.parts):
            if not part.n:
                continue
            own, mine = self._own(k, f, z), Function(part, self.problem.names_in(f.names))
            for moved in part.loosened(mine, own, here[k], self._derivatives(k, f.names, D)):
                if moved is not own:
                    ahead = z.copy()
                    self._take_up(k, f, ahead, own, moved)
                    found.append(f.clip(ahead))
        return found or [z]

    def along_valley(
        self, f: Function, z: np.ndarray, tried: np.ndarray, here: Predictions, D: np.ndarray
    ) -> np.ndarray:
        """A step along the valley of the recording with the most plateaus."""
        k = max(range(len(self.parts)), key=lambda i: self.parts[i].n)
        part, own, ahead = self.parts[k], self._own(k, f, z), self._own(k, f, tried)
        columns = self._derivatives(k, f.names, D)
        moved = part.along_valley(Function(part, self.problem.names_in(f.names)), own, ahead, here[k], columns)
        found: np.ndarray = tried.copy()
        self._take_up(k, f, found, ahead, moved)
        return f.clip(found)

    def known_derivative(self, i: int, z: np.ndarray, raw: np.ndarray, names: Sequence[str]) -> np.ndarray | None:
        """What a nuisance of recordings does to their readings [SI], shape (m,), where that needs no simulation."""
        if self.problem.is_of_the_motor(i):
            return None
        found, mine = np.zeros(self.read.size), self.problem.names_in(names)
        for k, part in enumerate(self.parts):
            for place, share in self.problem.moved_by(k, i):
                own = self.problem.of_part(k, z, names)
                column = part.known_derivative(place, own, raw[self.at[k]], mine)
                if column is None:
                    return None
                found[self.at[k]] += share * column
        return found

    def channels(self) -> dict[str, np.ndarray]:
        """Which readings are flows and which speeds: masks of shape (m,)."""
        each = [part.channels() for part in self.parts]
        return {name: self._joined([one[name] for one in each]) for name in each[0]}

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Masks of the readings that are held out together: those of each recording."""
        found = [self.lifted(k, mask) for k, part in enumerate(self.parts) for mask in part.folds()[0]]
        return found, f"{self.parts[0].folds()[1]} of each recording"

    def drawn_together(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Places of readings that are always there, and of those that are drawn together."""
        each = [part.drawn_together() for part in self.parts]
        always = np.concatenate([self.at[k][one] for k, (one, _) in enumerate(each)])
        return always, [self.at[k][block] for k, (_, blocks) in enumerate(each) for block in blocks]

    @property
    def places(self) -> Places:
        """Where something may be missing in one of the recordings."""
        return places_of(self)

    def not_described(self, base: Mode) -> str:
        """How far the base model is from the readings of the first recording that it does not describe at all."""
        each = [(name, part.not_described(self.of_part(k, base))) for k, (name, part) in self._numbered()]
        return next((f"{name}: {words}" for name, words in each if words), "")

    def tests(self, rivals: Sequence[Mode]) -> Iterator[Test]:
        """Tests that the bench of the last recording with plateaus could make, with what all of them say.

        How it takes runs in time the last recording with one shows.
        """
        k = max((k for k, part in enumerate(self.parts) if part.n), default=0)
        last = max((i for i, part in enumerate(self.parts) if part.problem.blocks.runs), default=k)
        runs = self.parts[last], self.of_part(last, rivals[0])

        def parts(of: Sequence[Mode]) -> list[Mode]:
            return [self.of_part(k, mode) for mode in of]

        def read(test: Test, of: Sequence[Mode]) -> list[Expected]:
            return test.expected(parts(of))

        def taken(test: Test, of: Sequence[Mode]) -> Taken | None:
            # An effect that is each recording's own would be another in the test.
            return test.taken(parts(of)) if test.taken and self.problem.sharing == SHARED else None

        for test in self.parts[k].tests(parts(rivals), runs):
            yield replace(test, expected=partial(read, test), taken=partial(taken, test))

    def rows_used(self) -> list[FileUse]:
        """Rows used of each file, with the name of its recording ahead."""
        return [
            one | {"file": f"{name}/{one['file']}"} for _, (name, part) in self._numbered() for one in part.rows_used()
        ]

    def of_part(self, k: int, mode: Mode) -> Mode:
        """A mode as one of the recordings has it. `mode`: of all recordings."""
        at, share = self.at[k], self.problem.share(k, mode.names)
        return replace(
            mode,
            names=self.problem.names_in(mode.names),
            z=self.problem.of_part(k, mode.z, mode.names),
            u=mode.u[self.noise.places(k)],
            D=self._derivatives(k, mode.names, mode.D),
            J=self._derivatives(k, mode.names, mode.J),
            r=mode.r[at],
            covariance=share @ mode.covariance @ share.T,
            bad=mode.bad[at],
            prediction=mode.prediction[k],
        )

    def _numbered(self) -> Iterator[tuple[int, tuple[str, Comparison]]]:
        return enumerate(zip(self.names, self.parts, strict=True))

    def _derivatives(self, k: int, names: Sequence[str], D: np.ndarray) -> np.ndarray:
        """A recording's share of derivatives, with its own unknowns."""
        columns = self.problem.columns(k, names)
        return D[np.ix_(self.at[k], columns)] / self.problem.scales(k, columns.size)

    def _own(self, k: int, f: Function, z: np.ndarray) -> np.ndarray:
        """A recording's share of a point."""
        return self.problem.of_part(k, z, f.names)

    def _take_up(self, k: int, f: Function, found: np.ndarray, own: np.ndarray, moved: np.ndarray) -> None:
        """Put what a recording moved of its share into a point of all."""
        columns = self.problem.columns(k, f.names)
        found[columns] += (moved - own) / self.problem.scales(k, columns.size)

    def _joined(self, each: Sequence[np.ndarray]) -> np.ndarray:
        out = np.zeros(sum(one.shape[0] for one in each), dtype=each[0].dtype)
        for at, one in zip(self.at, each, strict=True):
            out[at] = one
        return out

    def lifted(self, k: int, values: np.ndarray) -> np.ndarray:
        """What one recording has, with zeros for all the others."""
        out = np.zeros((self.read.size, *values.shape[1:]), dtype=values.dtype)
        out[self.at[k]] = values
        return out
