"""Readings against predictions as one vector, and its whitening: a linear map that a few noise scales set.

The vector holds the plateaus' flows, then their speeds, then the samples of each run in time, then what the gauge reads
with the line vented. The gauge's noise moves
flow and speed of a plateau together; the map takes that out, so a whitened residual is standard normal where the model
is right. Readings that are missing are 0 in it.

The phase of the cylinders' pulses late in a run in time hangs on everything that came before. So the shaft's angle at a
sample is known to no better than the pulses swing it, and a speed reading, which is a difference of two angles, has a
part of noise that its neighbours take back: what the readings say on average over a pulse stays as sharp as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from calibration.diagnosis.problem import CHANNELS, Prediction, Problem
from calibration.priors import NOISE_FACTOR

NOISE_SD = math.log(NOISE_FACTOR)
LARGEST_NOISE_STEP = 0.5
BLUR = 0.5  # share of the swing of the pulses that is left to chance
VENTED, FLOW, SPEED, RUN = -1, 0, 1, 2  # kinds of entries; run i is RUN + i


@dataclass(frozen=True)
class Whitener:
    """The map from differences of readings to standard normal numbers.

    Attributes
    ----------
    flow, share, speed : ndarray, shape (n,)
        Of each plateau: sd of the flow, what of the speed follows the flow, sd of the rest.
    vented : ndarray, shape (v,)
        sd of the gauge's readings with the line vented.
    run, before : ndarray, shape (m - 2 n - v,)
        Of the runs' samples: sd given the samples before, and what of a sample follows the one before.
    log_scale : float
        Sum of the logarithms of the sds over the readings that there are [-].
    known : ndarray of bool, shape (m,)
        Entries that there are.
    """

    flow: np.ndarray
    share: np.ndarray
    speed: np.ndarray
    vented: np.ndarray
    run: np.ndarray
    before: np.ndarray
    log_scale: float
    known: np.ndarray

    def __call__(self, difference: np.ndarray) -> np.ndarray:
        """Whitened differences.

        Parameters
        ----------
        difference : ndarray, shape (m,) or (m, k)
            Differences of readings [SI].
        """
        n = self.flow.size
        column = difference.ndim > 1
        rows = (slice(None), None) if column else (slice(None),)
        given = np.where(self.known[rows], difference, 0.0)
        out = np.empty_like(given)
        out[:n] = given[:n] / self.flow[rows]
        out[n : 2 * n] = (given[n : 2 * n] - self.share[rows] * out[:n]) / self.speed[rows]
        out[n : 2 * n][~self.known[n : 2 * n]] = 0.0
        end = 2 * n + self.run.size
        if self.run.size:
            band = np.vstack([self.run, np.append(self.before[1:], 0.0)])
            out[2 * n : end] = solve_banded((1, 0), band, given[2 * n : end])
        out[end:] = given[end:] / self.vented[rows]
        return out

    @property
    def scale(self) -> np.ndarray:
        """sd of each reading given those before it [SI], shape (m,)."""
        return np.concatenate([self.flow, self.speed, self.run, self.vented])


class Comparison:
    """A recording as a vector.

    Parameters
    ----------
    problem : Problem
        The recording.

    Attributes
    ----------
    read : ndarray, shape (m,)
        Readings [SI]; nan where there is none.
    kind : ndarray of int, shape (m,)
        FLOW, SPEED, RUN + i, or VENTED.
    index : ndarray of int, shape (m,)
        Row of the plateaus, or sample of the run.
    end : int
        Where the runs' samples end and the readings with the line vented begin [-].
    swing : ndarray, shape (end - 2 n,)
        How far the pulses of the cylinders swing the shaft's angle at the runs' samples, rms [rad].
    blur : float
        Share of that swing to which the pulses' phase is not trusted [-].
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        plateaus = problem.blocks.plateaus
        self.used = tuple(run.used for run in problem.blocks.runs)
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
        rest = problem.blocks.vented
        self.read = np.concatenate([self.read, rest.pressure])
        kinds.append(np.full(rest.pressure.size, VENTED))
        places.append(np.full(rest.pressure.size, -1))
        self.kind, self.index = np.concatenate(kinds), np.concatenate(places)
        self.known = np.isfinite(self.read)
        self.n = n
        self.end = self.read.size - rest.pressure.size
        self.swing = np.zeros(self.end - 2 * n)
        self.blur = BLUR
        self.step = np.concatenate(
            [np.full(int(used.sum()), _step(run.time)) for run, used in zip(runs, self.used, strict=True)]
            or [np.zeros(0)]
        )
        self.sizes = tuple(int(used.sum()) for used in self.used)
        self.see_pulses(np.zeros(len(problem.nuisances)))

    def see_pulses(self, z: np.ndarray) -> None:
        """Take the swing of the pulses anew, from simulations at a point of the base model.

        Parameters
        ----------
        z : ndarray, shape (n_nuisances,)
            The point [-].
        """
        self.problem.see_starts(z)
        for i, used in enumerate(self.used):
            mine = self.kind[2 * self.n : self.end] == RUN + i
            self.swing[mine] = self.problem.swing(z, i)[used]

    @property
    def size(self) -> int:
        """Number of readings [-]."""
        return int(self.known.sum())

    def raw(self, predicted: Prediction) -> np.ndarray:
        """A prediction as a vector [SI].

        Parameters
        ----------
        predicted : Prediction
            Of the problem.
        """
        runs = (speed[used] for speed, used in zip(predicted.runs, self.used, strict=True))
        return np.concatenate([predicted.flow, predicted.speed, *runs, predicted.vented])

    def variances(self, u: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Variances of the plateaus' readings by channel [SI], and those of the runs' samples, pulses apart.

        Parameters
        ----------
        u : ndarray, shape (3,)
            Logarithms of the noise scales of pressure, flow and speed [-].
        """
        problem, plateaus = self.problem, self.problem.blocks.plateaus
        noise = {c: problem.noise[c] * math.exp(u[i]) for i, c in enumerate(CHANNELS)}
        var = {c: (noise[c] * plateaus.noise_scale) ** 2 + problem.resolution[c] ** 2 / 12.0 for c in CHANNELS}
        scale = np.repeat([run.noise_scale for run in problem.blocks.runs], self.sizes)
        runs = (noise["speed"] * scale) ** 2 + problem.resolution["speed"] ** 2 / 12.0
        return var, runs

    @property
    def angle_sd(self) -> np.ndarray:
        """To what the shaft's angle is known at the runs' samples [rad], shape (end - 2 n,).

        The angle at which a rotor stood is not known: after a start from rest the pulses are left to chance wholly.
        """
        runs = self.problem.blocks.runs
        share = np.repeat([1.0 if run.from_rest else self.blur for run in runs], self.sizes)
        return share * self.swing if runs else self.swing

    def following(self, runs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cholesky factor of the runs' covariance: its diagonal, and what is left of it, shape (m - 2 n,) each [SI].

        Parameters
        ----------
        runs : ndarray, shape (m - 2 n,)
            Variances of the samples, pulses apart [SI].
        """
        if not runs.size:
            return np.zeros(0), np.zeros(0)
        first = np.zeros(runs.size, dtype=bool)
        first[np.cumsum([0, *self.sizes[:-1]])] = True
        now = (self.angle_sd / self.step) ** 2
        last = np.where(first, now, np.roll(now, 1))
        band = np.vstack([runs + now + last, np.append(np.where(first, 0.0, -last)[1:], 0.0)])
        factor = cholesky_banded(band, lower=True)
        return factor[0], np.append(0.0, factor[1, :-1])

    def whitener(self, predicted: Prediction, u: np.ndarray) -> Whitener:
        """The map at a prediction, whose slopes say what the gauge's noise does.

        Parameters
        ----------
        predicted : Prediction
            Of the problem.
        u : ndarray, shape (3,)
            Logarithms of the noise scales [-].
        """
        var, runs = self.variances(u)
        a, b = predicted.flow_slope, predicted.speed_slope
        flow = np.sqrt(var["flow"] + var["pressure"] * a * a)
        has_flow = self.known[: self.n]
        share = np.where(has_flow, var["pressure"] * a * b / flow, 0.0)
        speed = np.sqrt(var["speed"] + var["pressure"] * b * b - share * share)
        run, before = self.following(runs)
        known_speed = self.known[self.n : 2 * self.n]
        log_scale = float(np.log(flow[has_flow]).sum() + np.log(speed[known_speed]).sum())
        log_scale += float(np.log(run).sum())
        vented = self.problem.blocks.vented.sd
        return Whitener(flow, share, speed, vented, run, before, log_scale, self.known)

    def noise_step(
        self, difference: np.ndarray, predicted: Prediction, u: np.ndarray, weight: np.ndarray
    ) -> np.ndarray:
        """One scoring step of the noise scales for given differences [-], shape (3,).

        Parameters
        ----------
        difference : ndarray, shape (m,)
            Readings less predictions [SI].
        predicted : Prediction
            For its slopes.
        u : ndarray, shape (3,)
            Where to step from [-].
        weight : ndarray, shape (m,)
            Of each entry, below 1 where a reading is bad [-].
        """
        n = self.n
        var, runs = self.variances(u)
        problem, plateaus = self.problem, self.problem.blocks.plateaus
        a, b = predicted.flow_slope, predicted.speed_slope
        far = 1e12
        has_q, has_n = self.known[:n], self.known[n : 2 * n]
        q = np.where(has_q, var["flow"] + var["pressure"] * a * a, far)
        s = np.where(has_n, var["speed"] + var["pressure"] * b * b, far)
        m = np.where(has_q & has_n, var["pressure"] * a * b, 0.0)
        det = q * s - m * m
        iq, is_, im = s / det, q / det, -m / det
        dq = np.where(has_q, difference[:n], 0.0)
        dn = np.where(has_n, difference[n : 2 * n], 0.0)
        yq, yn = iq * dq + im * dn, im * dq + is_ * dn
        w = np.minimum(weight[:n], weight[n : 2 * n])
        pure = {
            c: 2.0 * (problem.noise[c] * math.exp(u[i]) * plateaus.noise_scale) ** 2 for i, c in enumerate(CHANNELS)
        }
        none = np.zeros(n)
        change = [
            (pure["pressure"] * a * a, pure["pressure"] * b * b, pure["pressure"] * a * b),
            (pure["flow"], none, none),
            (none, pure["speed"], none),
        ]
        change = [
            (np.where(has_q, x, 0.0), np.where(has_n, y, 0.0), np.where(has_q & has_n, z, 0.0)) for x, y, z in change
        ]
        slope = np.empty(3)
        fisher = np.eye(3) / NOISE_SD**2
        products = []
        for i, (x, y, z) in enumerate(change):
            trace = iq * x + is_ * y + 2.0 * im * z
            slope[i] = 0.5 * np.sum(w * (x * yq * yq + y * yn * yn + 2.0 * z * yq * yn - trace)) - u[i] / NOISE_SD**2
            products.append((iq * x + im * z, iq * z + im * y, im * x + is_ * z, im * z + is_ * y))
        for i in range(3):
            for j in range(3):
                p, o = products[i], products[j]
                fisher[i, j] += 0.5 * np.sum(w * (p[0] * o[0] + p[1] * o[2] + p[2] * o[1] + p[3] * o[3]))
        if runs.size:
            scale = np.repeat([run.noise_scale for run in problem.blocks.runs], self.sizes)
            own, beside = self.following(runs)
            wr = weight[2 * n : self.end]
            white = solve_banded((1, 0), np.vstack([own, np.append(beside[1:], 0.0)]), difference[2 * n : self.end])
            y = solve_banded((0, 1), np.vstack([np.append(0.0, beside[1:]), own]), white)
            rate = 2.0 * (problem.noise["speed"] * math.exp(u[2]) * scale) ** 2
            inverse = _diagonal_of_inverse(own, beside)
            slope[2] += 0.5 * np.sum(wr * rate * (y * y - inverse))
            fisher[2, 2] += 0.5 * np.sum(wr * (rate * inverse) ** 2)
        step = np.linalg.solve(fisher, slope)
        found: np.ndarray = u + np.clip(step, -LARGEST_NOISE_STEP, LARGEST_NOISE_STEP)
        return found


def _step(time: np.ndarray) -> float:
    return float(np.median(np.diff(time))) if time.size > 1 else 1.0


def _diagonal_of_inverse(own: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Diagonal of (L L')^-1 for an L with that diagonal and that left of it."""
    out = np.empty_like(own)
    after = 0.0
    for k in range(own.size - 1, -1, -1):
        share = beside[k + 1] / own[k] if k + 1 < own.size else 0.0
        after = 1.0 / own[k] ** 2 + share * share * after
        out[k] = after
    return out
