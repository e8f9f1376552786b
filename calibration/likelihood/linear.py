"""Readings against predictions as one vector, and its whitening: a linear map that a few noise scales set.

The vector holds the plateaus' flows, then their speeds, then the samples of each run in time, then what is read beside
them: the gauge with the line vented, the flow meter while the rotor stands. The gauge's noise moves flow and speed of a
plateau together; the map takes that out, so a whitened residual is standard normal where the model is right. A reading
that is missing is 0 once whitened.

The phase of the cylinders' pulses in a run in time hangs on everything that came before, and nobody noted how the shaft
stood. So the shaft's angle at a sample is known to no better than the pulses swing it, and a speed reading, which is a
difference of two angles, has a part of noise that its neighbours take back: what the readings say on average over a
pulse stays as sharp as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import numpy as np

from calibration.data.blocks import levels
from calibration.likelihood.noise import Noise, Whitener
from calibration.systems.radial_piston.problem import Prediction, Problem
from calibration.systems.radial_piston.wheel import rest_sd

LINE, STANDING, VENTED, FLOW, SPEED, RUN = -3, -2, -1, 0, 1, 2  # kinds of entries; run i is RUN + i


class Comparison:
    """A recording as a vector.

    Attributes
    ----------
    read : ndarray, shape (m,)
        Readings [SI]; nan where there is none.
    kind : ndarray of int, shape (m,)
        FLOW, SPEED, RUN + i, VENTED, STANDING, or LINE.
    index : ndarray of int, shape (m,)
        Row of the plateaus, or sample of the run.
    of_a_kind : tuple of ndarray of int
        Places of the readings that there are, kind by kind.
    again : tuple of ndarray of int
        Places of an instrument's readings at each pressure level that was visited more than once.
    end : int
        Where the runs' samples end and the readings beside them begin [-].
    swing : ndarray, shape (end - 2 n,)
        How far the pulses of the cylinders swing the shaft's angle at the runs' samples, rms [rad].
    middle : ndarray or None
        The prior's middle with the lines of the runs where they suit the readings best [-], once a search began there.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        plateaus = problem.blocks.plateaus
        self.used = tuple(run.used for run in problem.blocks.runs)
        self.sizes = tuple(int(used.sum()) for used in self.used)
        n = plateaus.size
        runs = problem.blocks.runs
        self.read = np.concatenate(
            [plateaus.flow, plateaus.speed, *(run.speed[used] for run, used in zip(runs, self.used, strict=True))]
        )
        kinds = [np.full(n, FLOW), np.full(n, SPEED)]
        places = [np.arange(n), np.arange(n)]
        for i, used in enumerate(self.used):
            kinds.append(np.full(int(used.sum()), RUN + i))
            places.append(np.flatnonzero(used))
        beside = (
            (VENTED, problem.blocks.vented.pressure),
            (STANDING, problem.blocks.standing.flow),
            *((LINE, run.line.pressure) for run in runs),
        )
        self.end = self.read.size
        for kind, values in beside:
            self.read = np.append(self.read, values)
            kinds.append(np.full(values.size, kind))
            places.append(np.full(values.size, -1))
        self.kind, self.index = np.concatenate(kinds), np.concatenate(places)
        self.known = np.isfinite(self.read)
        self.n = n
        self.swing = np.zeros(self.end - 2 * n)
        self.trusting = False
        self.middle: np.ndarray | None = None
        pairs = list(zip(runs, self.used, strict=True))
        self.step = np.concatenate([(run.time - run.begin)[used] for run, used in pairs] or [np.zeros(0)])
        ends = np.concatenate([run.start_s + run.time[used] for run, used in pairs] or [np.zeros(0)])
        begins = np.concatenate([run.start_s + run.begin[used] for run, used in pairs] or [np.zeros(0)])
        apart = np.abs(begins - np.roll(ends, 1)) > 1e-9  # no sample that ends where this one begins
        self.pitch_sd = rest_sd(problem.recording)
        known = np.flatnonzero(self.known)
        self.of_a_kind = tuple(known[self.kind[known] == kind] for kind in np.unique(self.kind[known]))
        rows = levels(plateaus) if n else []
        spots = (level[self.known[level + of * n]] + of * n for level in rows for of in (FLOW, SPEED))
        self.again = tuple(spot for spot in spots if spot.size > 1)
        self.noise = Noise(problem, self.known, self.sizes, self.step, apart)
        self.see_pulses(np.zeros(len(problem.nuisances)))

    @property
    def angle_sd(self) -> np.ndarray:
        """To what the shaft's angle is known at the runs' samples [rad], shape (end - 2 n,)."""
        return np.hypot(self.swing, self.pitch_sd)

    def see_pulses(self, z: np.ndarray) -> None:
        """Take the swing of the pulses anew, from simulations at a point of the base model.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            The point [-].
        """
        swings = self.problem.see_pulses(z)
        self.swing = np.concatenate(
            [swing[used] for swing, used in zip(swings, self.used, strict=True)] or [np.zeros(0)]
        )

    def giving(self, given: Mapping[tuple[str, str], float]) -> Comparison:
        """The same comparison, with other parameters of effects given, as `Problem.giving` does.

        Parameters
        ----------
        given : mapping
            Values by (effect, parameter) [own unit].
        """
        other = copy(self)
        other.problem, other.middle = self.problem.giving(given), None
        return other

    @property
    def size(self) -> int:
        """Number of readings [-]."""
        return int(self.known.sum())

    def raw(self, predicted: Prediction) -> np.ndarray:
        """A prediction as a vector [SI]."""
        runs = (speed[used] for speed, used in zip(predicted.runs, self.used, strict=True))
        return np.concatenate(
            [predicted.flow, predicted.speed, *runs, predicted.vented, predicted.standing, predicted.line]
        )

    def is_told(self, predicted: Prediction) -> bool:
        """Whether a prediction has a value for every reading that there is."""
        return bool(np.all(np.isfinite(self.raw(predicted)[self.known])))

    def whitener(self, predicted: Prediction, u: np.ndarray) -> Whitener:
        """The map at a prediction, whose slopes say what the gauge's noise does.

        Parameters
        ----------
        u : ndarray, shape (5,)
            The noise, as in `calibration.likelihood.noise` [-].
        """
        return self.noise.whitener(u, _slopes(predicted), self.angle_sd)

    def noise_step(
        self,
        difference: np.ndarray,
        predicted: Prediction,
        u: np.ndarray,
        weight: np.ndarray,
        columns: np.ndarray | None = None,
        correlated: bool = True,
    ) -> tuple[np.ndarray, np.ndarray]:
        """One scoring step of the noise for given differences, and the information that there is of it [-].

        Parameters
        ----------
        difference : ndarray, shape (m,)
            Readings less predictions [SI].
        u : ndarray, shape (5,)
            Where to step from [-].
        weight : ndarray, shape (m,)
            Of each entry, below 1 where a reading is bad [-].
        columns : ndarray, shape (m, k) or None
            Derivatives that the prediction was fitted with [SI].

        Returns
        -------
        step : ndarray, shape (5,)
            To add to u [-].
        information : ndarray, shape (5, 5)
            With the prior's [-].
        """
        return self.noise.step_of(difference, u, _slopes(predicted), self.angle_sd, weight, columns, correlated)


def _slopes(predicted: Prediction) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of flow and speed with pressure [SI]; 0 where the model gives no reading."""
    return np.nan_to_num(predicted.flow_slope), np.nan_to_num(predicted.speed_slope)
