"""Whether anything is missing from the model of another rig; the p-value is uniform where nothing is.

The noise of real data is neither as large as declared nor white. So the noise level and the correlation of neighbours
of each array of readings are estimated by restricted likelihood beside all signatures and free-form forces, that a
misfit may not pass for noise. The statistic is the smallest tail probability over signatures (one-sided where an effect
cannot be negative) and forces. Its law is drawn: unknowns and noise anew, noise estimated anew.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from calibration.diagnosis.other_rigs.linear import Linear, Signature
from calibration.diagnosis.other_rigs.noise import CORRELATIONS, NOISE_SD, uncorrelated
from calibration.diagnosis.other_rigs.places import Force
from calibration.diagnosis.steps.detect import log_tail, rarity

DRAWS = 300
SHARE, SERIAL_SHARE = 4, 10  # readings for each direction that the noise is estimated beside; in time more are needed
SMALL = 1e-9


@dataclass(frozen=True)
class Detection:
    """Whether anything is missing.

    Attributes
    ----------
    gain : float
        What the free-form forces together take off the sum of squares [-].
    """

    p_value: float
    extrapolated: bool
    statistic: float
    gain: float
    force_log_p: np.ndarray
    force_scores: list[np.ndarray]
    scale: tuple[float, ...]
    correlation: tuple[float, ...]


def detect(
    view: Linear,
    found: Sequence[Signature],
    free: Sequence[Force],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> Detection:
    """Test a model."""
    arrays = [_Array(view, i, found, free) for i in range(len(view.residual)) if view.residual[i].size]
    test = _Test(view, arrays, found, free)
    data = view.data
    real, noise = test([data[a.index][:, None] for a in arrays])[0]
    z = rng.standard_normal((view.fit.point.size, draws)) * view.nuisance[:, None]
    drawn = []
    for array, (rho, scale) in zip(arrays, noise, strict=True):
        drawn.append(view.jacobian[array.index] @ z + scale * _correlated(rng, array.size, draws, rho))
    p, beyond = rarity(real.statistic, np.array([one.statistic for one, _ in test(drawn)]))
    return Detection(
        max(p, 1e-300),
        beyond,
        real.statistic,
        real.gain,
        real.force_log_p,
        real.force_scores,
        tuple(scale for _, scale in noise),
        tuple(rho for rho, _ in noise),
    )


def _correlated(rng: np.random.Generator, n: int, draws: int, rho: float) -> np.ndarray:
    noise = rng.standard_normal((n, draws))
    for k in range(1, n):
        noise[k] = rho * noise[k - 1] + math.sqrt(1.0 - rho * rho) * noise[k]
    return noise


class _Array:
    """One array of readings: products of its columns, and the directions beside which its noise is estimated."""

    def __init__(self, view: Linear, index: int, found: Sequence[Signature], free: Sequence[Force]) -> None:
        self.index = index
        J = view.jacobian[index]
        more = [s.columns[index][:, None] for s in found] + [f.columns[index] for f in free]
        self.X = np.column_stack([J, *more])
        self.size = J.shape[0]
        self.rhos = CORRELATIONS if view.problem.readings[index].serial else np.zeros(1)
        basis = _span(J, np.zeros((self.size, 0)), self.size)
        rest = self.X[:, J.shape[1] :]
        share = SERIAL_SHARE if view.problem.readings[index].serial else SHARE
        room = max(self.size // share - basis.shape[1], 0)
        basis = np.column_stack([basis, _span(rest, basis, room)])
        self.free = max(self.size - basis.shape[1], 1)
        self.gram, self.Q, self.cost = [], [], []
        for rho in self.rhos:
            white = uncorrelated(self.X, float(rho))
            self.gram.append(white.T @ white)
            Q, R = np.linalg.qr(uncorrelated(basis, float(rho)))
            self.Q.append(Q)
            log_det = float(np.sum(np.log(np.maximum(np.abs(np.diag(R)), 1e-300))))
            self.cost.append(0.5 * max(self.size - 1, 0) * math.log(1.0 - rho * rho) + log_det)

    def noise(self, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place in the grid of correlations, and noise scale, of each draw; Y has shape (n, draws)."""
        best = np.full(Y.shape[1], np.inf)
        place, scale = np.zeros(Y.shape[1], dtype=int), np.ones(Y.shape[1])
        for k, rho in enumerate(self.rhos):
            white = uncorrelated(Y, float(rho))
            rest = np.sum(white**2, axis=0) - np.sum((self.Q[k].T @ white) ** 2, axis=0)
            u = 0.5 * np.log(np.maximum(rest, SMALL) / self.free)
            cost = self.free * u + self.cost[k]
            better = cost < best
            best[better], place[better] = cost[better], k
            scale[better] = np.exp(u[better] * 2.0 * self.free / (2.0 * self.free + NOISE_SD**-2))
        return place, scale

    def products(self, Y: np.ndarray, place: np.ndarray) -> np.ndarray:
        """Products of the columns with each draw, shape (p, draws)."""
        out = np.zeros((self.X.shape[1], Y.shape[1]))
        for k in np.unique(place):
            rho = float(self.rhos[k])
            mine = place == k
            out[:, mine] = uncorrelated(self.X, rho).T @ uncorrelated(Y[:, mine], rho)
        return out


def _span(columns: np.ndarray, beside: np.ndarray, most: int) -> np.ndarray:
    """Orthonormal directions of some columns that others do not have, the strongest first."""
    rest = columns - beside @ (beside.T @ columns)
    rest = rest - beside @ (beside.T @ rest)
    norm = np.linalg.norm(rest, axis=0)
    keep = norm > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), SMALL)
    if not keep.any() or most <= 0:
        return np.zeros((columns.shape[0], 0))
    U, s, _ = np.linalg.svd(rest[:, keep] / norm[keep], full_matrices=False)
    return np.asarray(U[:, : min(most, int(np.sum(s > 1e-5 * s[0])))])


class _Test:
    def __init__(
        self, view: Linear, arrays: Sequence[_Array], found: Sequence[Signature], free: Sequence[Force]
    ) -> None:
        self.arrays, self.prior = arrays, np.diag(view.nuisance.astype(float))
        self.m, self.n_signatures = view.nuisance.size, len(found)
        self.one_sided = np.array([s.one_sided for s in found], dtype=bool)
        ends = np.cumsum([len(found), *(f.places.shape[0] for f in free)])
        self.slices = [slice(a, b) for a, b in itertools.pairwise(ends)]

    def __call__(self, data: Sequence[np.ndarray]) -> list[tuple[Detection, list[tuple[float, float]]]]:
        noises = [array.noise(Y) for array, Y in zip(self.arrays, data, strict=True)]
        products = [array.products(Y, place) for array, Y, (place, _) in zip(self.arrays, data, noises, strict=True)]
        found = []
        for d in range(data[0].shape[1]):
            gram = sum(
                array.gram[place[d]] / scale[d] ** 2 for array, (place, scale) in zip(self.arrays, noises, strict=True)
            )
            b = sum(p[:, d] / scale[d] ** 2 for p, (_, scale) in zip(products, noises, strict=True))
            noise = [
                (float(array.rhos[place[d]]), float(scale[d]))
                for array, (place, scale) in zip(self.arrays, noises, strict=True)
            ]
            found.append((self._of(np.asarray(gram), np.asarray(b)), noise))
        return found

    def _of(self, gram: np.ndarray, b: np.ndarray) -> Detection:
        m, n = self.m, self.n_signatures
        inside = gram[:m, :m] + self.prior
        inside = inside + 1e-9 * np.diag(np.maximum(np.diag(inside), SMALL))
        share = np.linalg.solve(inside, np.column_stack([gram[:m, m:], b[:m]]))
        P = gram[m:, m:] - gram[m:, :m] @ share[:, :-1]
        q = b[m:] - gram[m:, :m] @ share[:, -1]
        own = np.diag(gram)[m:]
        size = np.sqrt(np.maximum(np.diag(P), SMALL))
        seen = size > 1e-3 * np.sqrt(np.maximum(own, SMALL))
        scores = np.where(seen, q / size, 0.0)
        log_p = [0.0]
        if n:
            tails = np.where(self.one_sided, log_ndtr(-scores[:n]), math.log(2.0) + log_ndtr(-np.abs(scores[:n])))
            log_p.append(float(np.min(tails)))
        of_forces, of_pieces = [], []
        for part in self.slices:
            of_forces.append(log_tail(*_quadratic(P[part, part], q[part])))
            of_pieces.append(scores[part])
        log_p += of_forces
        gain = _quadratic(P[n:, n:], q[n:])[0] if self.slices else 0.0
        return Detection(1.0, False, -min(log_p), gain, np.array(of_forces), of_pieces, (), ())


def _quadratic(P: np.ndarray, q: np.ndarray) -> tuple[float, int]:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(P), SMALL))
    value, vector = np.linalg.eigh(P * scale[:, None] * scale)
    use = value > 1e-6 * max(value[-1], SMALL)
    return float(np.sum((vector[:, use].T @ (q * scale)) ** 2 / value[use])), int(use.sum())
