"""A recording of a machine as a vector of readings: its arrays, one after the other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from calibration.data.rows_used import FileUse
from calibration.likelihood.compared import Compared
from calibration.likelihood.descent import find
from calibration.likelihood.expected import Test
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Places
from calibration.systems.machines.forces import forces, same_coordinates
from calibration.systems.machines.next_tests import tests
from calibration.systems.machines.noise import Noise, Whitener, ends
from calibration.systems.machines.noise_test import NoiseTest
from calibration.systems.machines.problem import WIDE, Problem
from calibration.systems.machines.table import rows_used
from calibration.unknowns.priors import Error, OfInstrument, Unknown
from rig.recording import Recording

# Share of a reading by which the base model may miss it, at the median: a drive that all goes into dry friction is
# missed by half; units mixed up, or a drive of the other sign, are missed by nearly all of it and more.
MOST_MISSED = 0.8
LOUD = 5.0  # ... and how many times the declared noise that is
CHECK = (
    "the units of each column",
    "the motor's table: its inertia, mass or displacement",
    "the clock",
    "the tachometer's pulses per turn",
    "the sign of the drive",
    "whether the pressures are absolute or gauge",
)
NOT_LOOKED_AT = "of a kind, or without the columns, that this rig is judged by"
OF_SLIDE = {"N m": "N", "rad/s": "m/s", "N m s2": "N s2/m2", "N m s": "N s/m"}


class Comparison(Compared):
    """A recording as a vector.

    `readings`: its arrays, of which each is a kind by itself.
    """

    problem: Problem
    noise: Noise
    trusting = True  # foreign noise has tails of its own
    end = 0
    check = CHECK

    def __init__(self, problem: Problem) -> None:
        self.problem, self.readings, self.rig = problem, problem.readings, problem.kind
        self.friction_unit = "N s/m" if problem.slides else "N m s"
        self.read = np.concatenate([one.value for one in self.readings])
        self.known = np.ones(self.read.size, dtype=bool)
        self.noise = Noise(self.readings)
        self._channels = {one.channel for one in self.readings}
        self.of_a_kind = tuple(np.split(np.arange(self.read.size), ends(self.readings)[:-1]))

    def unit(self, unknown: Unknown) -> str:
        """The unit of an effect's parameter: a slide's torques are forces, and its speeds are m/s."""
        return OF_SLIDE.get(unknown.unit, unknown.unit) if self.problem.slides else unknown.unit

    def raw(self, predicted: np.ndarray) -> np.ndarray:
        """A prediction as a vector [SI], which it is."""
        return predicted

    def whitener(self, predicted: np.ndarray, u: np.ndarray) -> Whitener:
        """The map to standard normal numbers with a noise."""
        return Whitener(self.readings, u)

    def noise_step(
        self,
        difference: np.ndarray,
        predicted: np.ndarray,
        u: np.ndarray,
        weight: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The step to the noise that suits differences best, and the information that there is of it [-]."""
        return self.noise.step_of(difference, u, columns, correlated)

    def drawn_noise(self, predicted: np.ndarray, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the readings [SI], shape (m,)."""
        return self.noise.draw(u, rng)

    def free_in_test(self, mode: Mode) -> np.ndarray:
        """Factors on a mode's unknowns in the test for a mismatch [-], shape (m,).

        How large an effect is says nothing against the model that holds it.
        """
        return np.where(self._unknown(mode), WIDE, 1.0)

    def _unknown(self, mode: Mode) -> np.ndarray:
        """Unknowns of which nothing is known beforehand: those that are wide, and the effects' [-], shape (m,)."""
        return np.append(self.problem.wide, np.ones(mode.z.size - self.problem.wide.size, dtype=bool))

    def noise_test(self, mode: Mode, every: np.ndarray, good: np.ndarray) -> NoiseTest:
        """The noise in the test for a mismatch."""
        return NoiseTest(self.readings, mode, every)

    def of(self, recording: Recording) -> Comparison:
        """Another recording of the same machine."""
        return Comparison(Problem(recording))

    def carried(self, other: Comparison, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What another recording of the machine says of this one's unknowns, its instruments' errors included.

        Returns `z`: the point [-]; `covariance`: of it [-]; of what is this recording's alone nothing is known; `u`:
        the noise of each array: that of its channel in the other one [-].
        """
        here = [*self.problem.nuisances, *(one for _, one in self.problem.effect_unknowns(mode.names))]
        there = [*other.problem.nuisances, *(one for _, one in other.problem.effect_unknowns(mode.names))]
        k, old = len(self.problem.nuisances), len(other.problem.nuisances)
        names = {one.name: i for i, one in enumerate(other.problem.nuisances)}
        own = [self.problem.run_of(i) is not None for i in range(k)]  # a run's, whatever its file is called
        pairs = [
            (names[one.name], i) for i, one in enumerate(self.problem.nuisances) if one.name in names and not own[i]
        ]
        pairs += [(old + i, k + i) for i in range(len(here) - k)]
        z, covariance, ratio = np.zeros(len(here)), np.eye(len(here)), np.ones(len(here))
        for mine, i in pairs:
            z[i] = here[i].z(float(there[mine].value(np.asarray(mode.z[mine]))))
            normal = here[i].kind == "normal"
            ratio[i] = there[mine].b / here[i].b if normal else math.log(there[mine].b) / math.log(here[i].b)
        seen, new = ([pair[j] for pair in pairs] for j in (0, 1))
        covariance[np.ix_(new, new)] = mode.covariance[np.ix_(seen, seen)] * np.outer(ratio[new], ratio[new])
        count = len(other.readings)
        u = np.zeros(2 * len(self.readings))
        for i, one in enumerate(self.readings):
            alike = [j for j, each in enumerate(other.readings) if each.channel == one.channel and each.value.size]
            if alike:
                u[i] = np.mean(mode.u[alike])
                u[len(self.readings) + i] = np.mean(mode.u[count + np.array(alike)])
        return z, covariance, u

    def base(self) -> Mode:
        """The base model at its most probable point."""
        return find(self, ())

    def known_derivative(self, i: int, z: np.ndarray, raw: np.ndarray, names: Sequence[str]) -> np.ndarray | None:
        """What an offset or a scale of an instrument does to the readings [SI], shape (m,); None of the rest."""
        unknown = self.problem.nuisances[i]
        of = unknown.of
        if not isinstance(of, OfInstrument) or of.channel not in self._channels:
            return None
        values, found = self.problem.values(z[: len(self.problem.nuisances)]), []
        for one, true in zip(self.readings, self.noise.split(raw), strict=True):
            own = one.label.partition(" ")[2]
            if of.file:
                found.append(np.full_like(true, 1.0 if own == of.file else 0.0))
                continue
            offset = values.get(f"{one.channel}_offset", 0.0) + values.get(f"{own}.drive_offset", 0.0)
            part = np.ones_like(true)
            if of.error is Error.SCALE:
                weight, scale = self.problem.system.weight, 1.0 + values.get(unknown.name, 0.0)
                part = (true - offset) / scale if weight is None else np.full_like(true, weight)
            found.append(part if one.channel == of.channel else np.zeros_like(true))
        return np.concatenate(found) * unknown.b

    def channels(self) -> dict[str, np.ndarray]:
        """Which readings are of which channel: masks of shape (m,)."""
        keys = [self.problem.quantity(one.channel).name_si for one in self.readings]
        each = np.repeat(keys, [one.value.size for one in self.readings])
        return {key: each == key for key in sorted(set(each.tolist()))}

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Masks of the readings that are held out together, and what they are."""
        return self.problem.system.folds()

    def drawn_together(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Places of readings that are always there, and of those that are drawn together."""
        return np.zeros(0, dtype=int), list(self.of_a_kind)

    @property
    def places(self) -> Places:
        """Where something may be missing: no smooth correction, no law and no step in time is looked for."""
        return Places(forces=partial(forces, self.problem), same_coordinates=partial(same_coordinates, self.problem))

    def not_described(self, base: Mode) -> str:
        """How far the base model is from the readings where it does not describe them at all; empty where it does."""
        far = []
        missed = self.noise.split(self.read - base.prediction)
        for one, off, u in zip(self.readings, missed, base.u, strict=False):
            size = np.abs(one.value)
            if not np.any(size > 0.0):
                continue
            share = float(np.median(np.abs(off[size > 0.0]) / size[size > 0.0]))
            # A reading that is all noise is missed too, and says nothing; nan: nothing is predicted there.
            if not share <= MOST_MISSED and not math.exp(u) <= LOUD:
                far.append(f"{one.label} is off by {100.0 * share:.0f} % at the median")
        return "; ".join(far)

    def tests(self, rivals: Sequence[Mode]) -> Iterator[Test]:
        """Tests that this rig could make."""
        return tests(self.problem, rivals)

    def rows_used(self) -> list[FileUse]:
        """Rows used of each file, as ``files`` of diagnosis/1."""
        seen = {one["file"]: one for one in self.problem.system.files}
        return [
            seen.get(file.file) or rows_used(file, {NOT_LOOKED_AT: np.ones(file.rows, dtype=bool)})
            for file in self.problem.recording.files
        ]
