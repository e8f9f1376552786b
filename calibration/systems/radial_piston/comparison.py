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

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from functools import partial

import numpy as np

from calibration.data.blocks import Blocks, levels
from calibration.data.rows_used import FileUse, by_diagnosis
from calibration.likelihood.compared import Compared, Row
from calibration.likelihood.expected import Test
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Places
from calibration.systems.radial_piston import derivatives, not_described, run_starts, valley
from calibration.systems.radial_piston.base import base_of
from calibration.systems.radial_piston.next_tests.planned import Planned, planned
from calibration.systems.radial_piston.next_tests.quantities import Quantity, expected_quantity, quantities
from calibration.systems.radial_piston.next_tests.readings import as_taken, expected_readings, line_of
from calibration.systems.radial_piston.noise import Noise, Whitener
from calibration.systems.radial_piston.places.balances import balances
from calibration.systems.radial_piston.places.coordinates import same_coordinates
from calibration.systems.radial_piston.places.forces import forces
from calibration.systems.radial_piston.places.further_forces import angle_force, not_observable
from calibration.systems.radial_piston.places.steps_in_time import steps_in_time
from calibration.systems.radial_piston.places.terms import forms
from calibration.systems.radial_piston.predict.carried import OF_THE_MOTOR, carried
from calibration.systems.radial_piston.predict.kinds import FLOW, LINE, RUN, SPEED, STANDING, VENTED
from calibration.systems.radial_piston.predict.problem import Prediction, Problem
from calibration.systems.radial_piston.predict.wheel import rest_sd
from rig.recording import Recording

SEGMENTS = 3  # of each run in time, held out in turn
SEVERAL = 3  # runs in time from which on each is held out whole
MOST_LEVELS = 6  # folds of plateaus
DRAWN_SEGMENTS = 6  # of each run in time, drawn like the pressure levels


class Comparison(Compared):
    """A recording as a vector.

    `kind`, shape (m,): FLOW, SPEED, RUN + i, VENTED, STANDING, or LINE.
    `index`, shape (m,): row of the plateaus, or sample of the run.
    `n`: number of plateaus [-].
    `angle_sd`, shape (end - 2 n,): to what the shaft's angle is known at the runs' samples, which the pulses of the
        cylinders swing [rad].
    """

    problem: Problem
    noise: Noise
    check = not_described.CHECK
    base = base_of
    turned = run_starts.turned
    relined = run_starts.relined
    loosened = run_starts.loosened
    along_valley = valley.along_valley
    known_derivative = derivatives.known_derivative
    not_described = not_described.not_described

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        plateaus = problem.blocks.plateaus
        self.used = tuple(run.used for run in problem.blocks.runs)
        self.sizes = tuple(int(used.sum()) for used in self.used)
        n, runs = plateaus.size, problem.blocks.runs
        self.read, self.kind, self.index = _vector(problem.blocks)
        self.end = 2 * n + sum(self.sizes)
        self.known = np.isfinite(self.read)
        self.n = n
        self._middle: np.ndarray | None = None
        self.in_time = bool(runs)
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

    def see_pulses(self, z: np.ndarray) -> None:
        """Take the swing of the pulses anew, from simulations at a point of the base model.

        `z`, shape (n_nuisances,): the point [-].
        """
        swings = self.problem.see_pulses(z)
        swing = np.concatenate([swing[used] for swing, used in zip(swings, self.used, strict=True)] or [np.zeros(0)])
        self.angle_sd = np.hypot(swing, self.pitch_sd)

    def giving(self, given: Mapping[tuple[str, str], float]) -> Comparison:
        """The same comparison, with other parameters of effects given, as `Problem.giving` does."""
        other = copy(self)
        other.problem, other._middle = self.problem.giving(given), None
        return other

    def raw(self, predicted: Prediction) -> np.ndarray:
        """A prediction as a vector [SI]."""
        runs = (speed[used] for speed, used in zip(predicted.runs, self.used, strict=True))
        return np.concatenate(
            [predicted.flow, predicted.speed, *runs, predicted.vented, predicted.standing, predicted.line]
        )

    def whitener(self, predicted: Prediction, u: np.ndarray) -> Whitener:
        """The map at a prediction, whose slopes say what the gauge's noise does."""
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

        Returns `step`: to add to u [-]; `information`: with the prior's [-].
        """
        return self.noise.step_of(difference, u, _slopes(predicted), self.angle_sd, weight, columns, correlated)

    def of(self, recording: Recording) -> Comparison:
        """Another recording of the same motor; how the shaft stood in it is not known, of no run."""
        return Comparison(Problem(recording, any_turn=True))

    def drawn_noise(self, predicted: Prediction, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noise of the readings about a prediction, rounding and pulses included [SI], shape (m,)."""
        problem, n, end = self.problem, self.n, self.end
        out = np.zeros(self.read.size)
        pressure, flow, speed = self.noise.draw_plateaus(u, rng)
        pressure += problem.resolution["pressure"] * (rng.random(n) - 0.5)
        out[:n] += predicted.flow_slope * pressure + flow + problem.resolution["flow"] * (rng.random(n) - 0.5)
        out[n : 2 * n] += predicted.speed_slope * pressure + speed
        out[2 * n : end] += self.noise.draw_samples(u, rng)
        out[n:end] += problem.resolution["speed"] * (rng.random(end - n) - 0.5)
        out[end:] += self.noise.beside * rng.standard_normal(out.size - end)
        sd = self.angle_sd
        angle = sd * rng.standard_normal(end - 2 * n)
        first = np.flatnonzero(self.noise.first)
        before = np.roll(angle, 1)
        before[first] = sd[first] * rng.standard_normal(first.size)
        out[2 * n : end] += (angle - before) / self.step
        return out

    def middle(self) -> np.ndarray:
        """Where a search starts: the prior's middle, the lines of the runs where they suit the readings best [-]."""
        if self._middle is None:  # the same for every set
            z, u = np.zeros(len(self.problem.nuisances)), np.zeros(self.noise.spread.size)
            self._middle = run_starts.with_lines(self, Function(self, ()), z, u)
        return self._middle

    def carried(self, other: Comparison, mode: Mode) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What another recording says of the motor and the effects of this one.

        Returns `z`: the point [-]; `covariance`: of it [-]; `u`: the noise [-].
        """
        z, covariance, _ = carried(other.problem, mode, self.problem, OF_THE_MOTOR)
        return z, covariance, mode.u

    def begun(self, f: Function, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, Prediction]:
        """A point with the lines and the angles of the runs where they suit the readings best, and what it predicts."""
        z = run_starts.with_lines(self, f, self.turned(f, z, u, f(z))[0], u)
        self.see_pulses(z[: f.k])
        return self.turned(f, z, u, f(z))

    def channels(self) -> dict[str, np.ndarray]:
        """Which readings are flows and which speeds: masks of shape (m,)."""
        return {"flow_m3_s": self.kind == FLOW, "speed_rad_s": self.kind > FLOW}

    @property
    def rows(self) -> list[Row]:
        """The first readings, each of a row of its own: the plateaus' flows, then their speeds."""
        plateaus = self.problem.blocks.plateaus
        return [
            Row(plateaus.file[i], int(plateaus.row[i]), channel, float(plateaus.pressure[i]))
            for channel in ("flow", "speed")
            for i in range(self.n)
        ]

    def folds(self) -> tuple[list[np.ndarray], str]:
        """Masks of the readings that are held out together: pressure levels, and parts of the runs in time.

        The levels of a fold lie apart, so that what goes with the running time has readings before and after.
        """
        found = []
        groups = levels(self.problem.blocks.plateaus) if self.n else []
        if groups:
            count = min(MOST_LEVELS, len(groups))
            for i in range(count):
                rows = np.concatenate(groups[i::count])
                found.append((self.kind < RUN) & np.isin(self.index, rows) & self.known)
        count = len(self.problem.blocks.runs)
        for i in range(count):
            mine = np.flatnonzero(self.kind == RUN + i)
            for part in np.array_split(mine, 1 if count >= SEVERAL else SEGMENTS):
                mask = np.zeros(self.read.size, dtype=bool)
                mask[part] = True
                found.append(mask)
        parts = " and whole runs" if count >= SEVERAL else " and transient segments" if count else ""
        return [mask for mask in found if mask.any()], f"pressure levels{parts}"

    def drawn_together(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Places of readings that are always there, and of those that are drawn together: a level, a part of a run."""
        beside, steady = self.kind < FLOW, (self.kind >= FLOW) & (self.kind < RUN)
        groups = levels(self.problem.blocks.plateaus) if self.n else []
        found = [np.flatnonzero(steady & np.isin(self.index, level)) for level in groups]
        for i in range(len(self.problem.blocks.runs)):
            found += np.array_split(np.flatnonzero(self.kind == RUN + i), DRAWN_SEGMENTS)
        return np.flatnonzero(beside), found

    @property
    def places(self) -> Places:
        """Where something may be missing at this motor."""
        return Places(
            forces=partial(forces, self),
            angle_force=partial(angle_force, self),
            balances=partial(balances, self),
            forms=partial(forms, self),
            steps_in_time=partial(steps_in_time, self),
            same_coordinates=partial(same_coordinates, self),
            not_observable=partial(not_observable, self),
            ordinary_speed=ordinary_speed,
        )

    def tests(self, rivals: Sequence[Mode], runs: tuple[Comparison, Mode] | None = None) -> Iterator[Test]:
        """Tests that this bench could make, then quantities that could be read; none without plateaus.

        `runs`: a recording whose runs in time show how the bench takes them, and its most probable point; this one's
            own, when left out.
        """
        if not self.n:
            return
        on, likeliest = runs or (self, rivals[0])
        line = line_of(on, likeliest)
        for plan in planned(self, on, line):
            there = {} if plan.needs else line
            read = partial(expected_readings, plan, self, line=there)
            yield Test(_with_needs(plan), plan.needs, read, plan.capture, partial(as_taken, plan, self, line=there))
        for one in quantities(self, rivals[0]):
            yield Test(_with_needs(one), one.needs, partial(expected_quantity, one, self.problem))

    def rows_used(self) -> list[FileUse]:
        """Rows used of each file, as ``files`` of diagnosis/1."""
        return by_diagnosis(self.problem.recording, self.problem.blocks)


def _with_needs(test: Planned | Quantity) -> str:
    return f"{test.words}: {test.needs}" if test.needs else test.words


def ordinary_speed(mode: Mode) -> float:
    """Root mean square of the plateaus' speeds [rad/s]."""
    return float(np.sqrt(float(np.mean(np.nan_to_num(mode.prediction.speed) ** 2))))


def _slopes(predicted: Prediction) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of flow and speed with pressure [SI]; 0 where the model gives no reading."""
    flow, speed = predicted.flow_slope, predicted.speed_slope
    return np.where(np.isfinite(flow), flow, 0.0), np.where(np.isfinite(speed), speed, 0.0)


def _vector(blocks: Blocks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The readings [SI], the kind of each, and its row of the plateaus or sample of the run, shape (m,) each."""
    plateaus, rows = blocks.plateaus, np.arange(blocks.plateaus.size)
    parts = [(plateaus.flow, FLOW, rows), (plateaus.speed, SPEED, rows)]
    parts += [(run.speed[run.used], RUN + i, np.flatnonzero(run.used)) for i, run in enumerate(blocks.runs)]
    beside = [(blocks.vented.pressure, VENTED), (blocks.standing.flow, STANDING)]
    beside += [(run.line.pressure, LINE) for run in blocks.runs]
    parts += [(values, kind, np.full(values.size, -1)) for values, kind in beside]
    kinds = [np.full(values.size, kind) for values, kind, _ in parts]
    return np.concatenate([one[0] for one in parts]), np.concatenate(kinds), np.concatenate([one[2] for one in parts])
