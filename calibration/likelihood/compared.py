"""What a system is to the likelihood and to the diagnosis: a recording as a vector of readings, and its unknowns.

A system is `calibration.systems.radial_piston`, the article's motor, or one that obeys the smaller protocol of
`calibration.systems.machines.system`. The unknowns are standard normal numbers z: every nuisance first, then the
parameters of the effects in question. The noise is a few numbers u, normal a priori with deviations ``spread``: the
logarithms of noise scales first, then what tells how alike neighbours are.

What most systems answer alike, `Problem`, `Noise` and `Compared` answer here: a system inherits them and says the rest.

In all that obeys the protocol: m readings, n unknowns, k numbers of the noise. A point ``z`` has the shape (n,) [-], a
noise ``u`` the shape (k,) [-], derivatives ``D`` the shape (m, n) [SI], differences of readings the shape (m,) [SI].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from calibration.data.rows_used import FileUse
from calibration.likelihood.noise_test import NoiseTest
from calibration.likelihood.shapes import Places
from calibration.unknowns.effects import searched
from calibration.unknowns.priors import Unknown
from model.effects import Effect, EffectParameter, effects
from model.effects.laws import Chosen
from rig.recording import Recording

if TYPE_CHECKING:
    from calibration.likelihood.expected import Test
    from calibration.likelihood.function import Function
    from calibration.likelihood.mode import Mode

Prediction = Any  # what a system says at a point; what is in it, the system and its report know
FARTHEST = 9.0  # sds of a nuisance from the middle of its prior


class Row(NamedTuple):
    """A reading that is a row of a file by itself. `pressure_pa`: of the row [Pa]."""

    file: str
    row: int
    channel: str
    pressure_pa: float


class Problem(Protocol):
    """The unknowns of a recording, and the predictions of its readings.

    `friction`: the nuisance that every machine has: its viscous friction.
    `given`: values of effects' parameters that are no unknowns, by (effect, parameter) [own unit].
    """

    friction: str
    recording: Recording
    nuisances: list[Unknown]
    given: Mapping[tuple[str, str], float] = MappingProxyType({})

    def effects_that_could(self) -> list[Effect]:
        """The effects that this recording could show."""

    def effect(self, name: str) -> Effect:
        """An effect that could be, by its id."""
        return effects()[name]

    def nuisance_of(self, effect: str, parameter: str) -> str:
        """The nuisance that a parameter of an effect has the form of; empty where there is none."""
        return self.effect(effect).nuisance

    def effect_unknowns(self, names: Sequence[str]) -> list[tuple[str, Unknown]]:
        """Effect id and unknown of each parameter of a set, in its order."""
        return [
            (name, searched(self.parameter(name, one.name)))
            for name in names
            for one in self.effect(name).parameters
            if (name, one.name) not in self.given
        ]

    def parameter(self, effect: str, name: str) -> EffectParameter:
        """A parameter of an effect: its bounds and its scale on this system."""
        return next(one for one in self.effect(effect).parameters if one.name == name)

    def amplitude(self, effect: str) -> EffectParameter:
        """The parameter of an effect that says how large it is."""
        return self.parameter(effect, self.effect(effect).amplitude.name)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of the nuisances [-], each shape (n_nuisances,)."""
        return np.full(len(self.nuisances), -FARTHEST), np.full(len(self.nuisances), FARTHEST)

    def chosen(self, names: Sequence[str], z: np.ndarray) -> Chosen:
        """Values of the effects' parameters [own units], by effect.

        `z`, shape (k,): the effects' share of the point [-].
        """
        found: dict[str, dict[str, float]] = {name: {} for name in names}
        for (name, parameter), value in self.given.items():
            if name in found:
                found[name][parameter] = value
        for (name, unknown), at_z in zip(self.effect_unknowns(names), z, strict=True):
            found[name][unknown.name] = float(unknown.value(np.asarray(at_z)))
        return found

    def place(self, name: str) -> int | None:
        """Where a nuisance stands among the unknowns; None where it is none of this recording."""
        return next((i for i, unknown in enumerate(self.nuisances) if unknown.name == name), None)

    def in_si(self, nuisance: str) -> float:
        """What a nuisance's value is multiplied by to be SI [-]."""
        return 1.0

    def run_of(self, i: int) -> int | None:
        """The run in time that a nuisance belongs to alone; None where it is of the whole recording [-]."""

    def predict(
        self,
        z: np.ndarray,
        chosen: Chosen,
        like: Prediction | None = None,
        runs: Sequence[int] | None = None,
        smooth: bool = False,
        around: Any = None,
    ) -> Prediction:
        """What the instruments would read.

        `z`, shape (n_nuisances,): nuisances [-].
        `like`, `runs`: a prediction that all but these runs are taken from.
        `smooth`: whether pulses whose phase nobody knows are left out.
        `around`: of `neighbourhood`, where first order will do.
        """

    def neighbourhood(self, z: np.ndarray, chosen: Chosen, here: Prediction) -> Any:
        """What makes predictions close to a point cheap; None where nothing does."""
        return None


class Whitener(Protocol):
    """The map from differences of readings to standard normal numbers.

    `scale`, shape (m,): sd of each reading given those before it [SI]; 1 where there is none.
    `log_scale`: sum of the logarithms of the sds that hang on the noise [-].
    """

    @property
    def scale(self) -> np.ndarray: ...

    @property
    def log_scale(self) -> float: ...

    def __call__(self, difference: np.ndarray) -> np.ndarray:
        """Whitened differences, shape (m,) or (m, k)."""


class Noise(Protocol):
    """The noise as a function of u.

    `spread`, shape (k,): standard deviations of u's prior [-].
    `scales`: places of the scales in u, the first ones.
    `free`, shape (k,): places of u that the recording can speak of.
    """

    spread: np.ndarray
    scales: slice
    free: np.ndarray

    def told(self, u: np.ndarray) -> list[dict[str, Any]]:
        """The noise of each array of readings with its label, scale and correlation; empty where that is not told."""
        return []

    def too_loud(self, u: np.ndarray) -> tuple[str, float] | None:
        """What is loudest and its noise in declared ones [-], where that is not believable; None where it is."""
        return None


class NoiseEstimates(Protocol):
    """Estimates of the noise in the test for a mismatch, beside everything that may be missing."""

    def of(self, difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The noise of the readings' differences from a mode, whose own is given [-], shape (k,)."""

    def of_a_draw(self, difference: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """The noise of drawn differences, drawn about a given one [-], shape (k,)."""

    def law(self, difference: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and spread of the noise that differences are drawn with [-], shape (k,) each."""


class Compared(Protocol):
    """A recording as a vector of readings.

    `read`, shape (m,): readings [SI]; nan where there is none.
    `known`, shape (m,): where there is one.
    `end`: readings behind this place are means of many, of which none is bad by itself [-].
    `of_a_kind`, `again`: places of the readings of each kind, and of those of a state that was visited more than once.
    `in_time`: whether there are runs in time: a refit takes seconds.
    `thorough`: whether every effect is refitted, whatever the linear model says of it.
    `trusting`: whether no reading is taken for bad.
    `check`: what to look at where the base model does not describe the readings.
    `rig`: the kind of a machine that is written out in its recording; empty for the article's motor. Of such a machine
        noise and zeros are known less well than they are declared, and a fit takes milliseconds.
    """

    problem: Problem
    noise: Noise
    read: np.ndarray
    known: np.ndarray
    end: int
    of_a_kind: tuple[np.ndarray, ...]
    again: tuple[np.ndarray, ...] = ()
    in_time: bool = False
    thorough: bool = False
    trusting: bool = False
    check: tuple[str, ...]
    rig: str = ""
    friction_unit: str = "N m s"

    @property
    def size(self) -> int:
        """Number of readings [-]."""
        return int(self.known.sum())

    @property
    def rows(self) -> list[Row]:
        """Those that are rows of a file by themselves, the first of all."""
        return []

    @property
    def places(self) -> Places:
        """Where something may be missing, and along what."""
        return Places()

    def raw(self, predicted: Prediction) -> np.ndarray:
        """A prediction as a vector [SI], shape (m,)."""

    def is_told(self, predicted: Prediction) -> bool:
        """Whether a prediction has a value for every reading that there is."""
        return bool(np.all(np.isfinite(self.raw(predicted)[self.known])))

    def whitener(self, predicted: Prediction, u: np.ndarray) -> Whitener:
        """The map to standard normal numbers at a prediction, with a noise."""

    def noise_step(
        self,
        difference: np.ndarray,
        predicted: Prediction,
        u: np.ndarray,
        weight: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """One step of the noise towards what suits differences, and the information that there is of it [-].

        `difference`, shape (m,): readings less predictions [SI].
        `weight`, shape (m,): of each, below 1 where a reading is bad [-].
        `columns`, shape (m, l): derivatives that the prediction was fitted with, whose share of the noise is allowed
            for [SI].
        `correlated`: whether more than the scales is stepped.
        """

    def drawn_noise(self, predicted: Prediction, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the readings about a prediction, rounding included [SI], shape (m,)."""

    def free_in_test(self, mode: Mode) -> np.ndarray:
        """Factors on a mode's unknowns in the test for a mismatch [-], shape (n,): 1, or more where a prior says less.

        How large an effect is says nothing against the model that holds it.
        """
        return np.ones(mode.z.size)

    def noise_test(self, mode: Mode, every: np.ndarray, good: np.ndarray) -> NoiseEstimates:
        """The noise beside everything that may be missing, columns of shape (m, k) [SI]."""
        return NoiseTest(self, mode, every, good)

    def giving(self, given: Mapping[tuple[str, str], float]) -> Compared:
        """The same with some parameters of effects given, by (effect, parameter) [own unit]."""
        return self

    def of(self, recording: Recording) -> Compared:
        """Another recording of the same machine."""

    def carried(self, other: Any, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Point and covariance that another recording's mode leaves of this one's unknowns, and the noise [-]."""

    def begun(self, f: Function, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, Prediction]:
        """A point with what is this recording's alone where it suits the readings best, and what it predicts."""
        z = f.clip(z)
        return z, f(z)

    def base(self) -> Mode:
        """The base model at its most probable point."""

    def middle(self) -> np.ndarray:
        """Where a search starts: the prior's middle, or a better guess [-], shape (n_nuisances,)."""
        return np.zeros(len(self.problem.nuisances))

    def relined(self, f: Function, z: np.ndarray, u: np.ndarray) -> np.ndarray | None:
        """A point with what is a run's own where it suits the readings better, all else as it is; None without."""
        return None

    def turned(self, f: Function, z: np.ndarray, u: np.ndarray, here: Prediction) -> tuple[np.ndarray, Prediction]:
        """A point with its angles at the best of a few, and the prediction there."""
        return z, here

    def loosened(self, f: Function, z: np.ndarray, here: Prediction, D: np.ndarray) -> list[np.ndarray]:
        """Points to start from once more where a search took readings for bad."""
        return [z]

    def along_valley(
        self, f: Function, z: np.ndarray, tried: np.ndarray, here: Prediction, D: np.ndarray
    ) -> np.ndarray:
        """A step that follows the curved valley in which the good fits lie [-], shape (n,)."""
        return tried

    def known_derivative(self, i: int, z: np.ndarray, raw: np.ndarray, names: Sequence[str]) -> np.ndarray | None:
        """What a nuisance does to the readings [SI], shape (m,), where that needs no simulation; None elsewhere."""
        return None

    def channels(self) -> dict[str, np.ndarray]:
        """Masks of the readings of each channel whose errors are told, by its name with its unit."""

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Masks of the readings that are held out together, and what they are."""

    def drawn_together(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Places of readings that are always there, and of those that are drawn together."""

    def not_described(self, base: Mode) -> str:
        """How far the base model is from the readings where it does not describe them at all; empty where it does."""
        return ""

    def tests(self, rivals: Sequence[Mode]) -> Iterable[Test]:
        """Tests that this rig could make, the explanations given with the most probable first."""
        return ()

    def unit(self, unknown: Unknown) -> str:
        """The unit of an effect's parameter on this machine."""
        return unknown.unit

    def rows_used(self) -> list[FileUse]:
        """Rows used of each file, as ``files`` of diagnosis/1."""
