"""A cheap stand-in for a log posterior: the readings as polynomials of what is sampled.

The readings are expanded about the most probable point, in steps that are straight in the quantities themselves, to
second order and with the cube of each step; the coefficients are fitted to simulations at points drawn about it. The
log posterior is then a polynomial too, some hundred times as fast as simulating. It is never trusted: it proposes, and
the true posterior accepts (`calibration.fit.moves.DelayedAcceptance`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from calibration.fit.integrated import Integrated
from calibration.work.threads import each
from configs.compiled import njit

WIDER = 1.2  # than the curvature says: where coefficients are fitted
POINTS_PER_TERM, FEWEST_POINTS = 4.0, 100
ROUNDS = 3  # of fitting: about the mode first, then where the stand-in before has its mass
KEPT = 2  # last rounds whose simulations count: those about the mode lie off a bent valley
START = 2000  # points about the mode that a first look at the stand-in begins with
PENALTY = 1e-3  # on each coefficient, of a coordinate with unit spread
FARTHEST = 9.0  # sds of an unknown from the mode; farther out polynomials go anywhere
NODES = np.linspace(-5.0, 5.0, 41)  # prior sds of a noise scale about the mode's
FORMS = np.array([-4.0, -1.5, 0.0, 1.5, 4.0])  # the same, where the misfit is expanded
LEFT_OUT = 0.01  # of twice a nat: what directions that are left out may add at a typical point


@dataclass(frozen=True)
class _AlongNoise:
    """How the misfit and the normalisation go with the noise scales.

    `form`, shape (p, p): the misfit as a quadratic form of `Surrogate.terms` at the mode's noise.
    `changes`: what the form changes by with the noise scales of each recording.
    `tables`, shape (NODES.size, k): minus the log likelihood at the mode along each scale, at `NODES`, less that at the
        mode's noise, and less half of what the form there changes by [-].
    `together`: of each recording, shape (FORMS.size to the number of scales,): what is added to the tables where
        several scales change, as `_Changes.forms` [-].
    """

    form: np.ndarray
    changes: list[_Changes]
    tables: np.ndarray
    together: list[np.ndarray]


@dataclass(frozen=True)
class _Changes:
    """Quadratic forms of `Surrogate.terms`, in the few directions in which they are not 0.

    `basis`, shape (p, r): the directions.
    `forms`, shape (FORMS.size to the number of scales, r, r): at all combinations of `FORMS`, the last scale running
        fastest.
    """

    basis: np.ndarray
    forms: np.ndarray

    def added_to(self, misfit: np.ndarray, terms: np.ndarray, shares: np.ndarray) -> None:
        """Add the forms' values, each by its share."""
        _add_changes(terms @ self.basis, shares, self.forms, misfit)


class Surrogate:
    """The stand-in for a target.

    `points`, shape (n_points, n_unknowns): where the target was simulated [-].
    `readings`, shape (n_points, m): what was expected there [SI].
    """

    def __init__(self, target: Integrated, points: np.ndarray, readings: np.ndarray) -> None:
        self.target = target
        n = target.shared.size
        self._root = np.linalg.cholesky(target.mode.covariance[np.ix_(target.shared, target.shared)])
        self._pairs = np.triu_indices(n)
        terms = self.terms(self.steps(points))
        gram = terms.T @ terms + PENALTY * np.eye(terms.shape[1])
        coefficients = np.linalg.solve(gram, terms.T @ (readings - target.raw))
        self._along = self._expanded(coefficients, np.linalg.cholesky(gram / len(terms)))

    def steps(self, z: np.ndarray) -> np.ndarray:
        """Straight steps from the mode, shape (n_points, n_shared); ``z`` as `log_prob` [-]."""
        target, n = self.target, self.target.shared.size
        moved = z[:, :n] - target.mode.z[target.shared]
        rate = target.f.log_step[target.shared]
        curved = rate != 0.0
        moved[:, curved] = np.expm1(np.clip(moved[:, curved] * rate[curved], -30.0, 30.0)) / rate[curved]
        return moved

    def terms(self, steps: np.ndarray) -> np.ndarray:
        """1, the steps in the mode's spread, all their products of two and their cubes, shape (n_points, p) [-]."""
        x = np.linalg.solve(self._root, steps.T).T
        return np.hstack([np.ones((len(x), 1)), x, x[:, self._pairs[0]] * x[:, self._pairs[1]], x**3])

    def log_prob(self, z: np.ndarray) -> np.ndarray:
        """Log posterior density up to a constant, shape (n,) [-]. `z`, shape (n, n_unknowns): points [-]."""
        target, n = self.target, self.target.shared.size
        found = np.full(len(z), -np.inf)
        near = target.inside(z)
        if not near.any():
            return found
        z = z[near]
        steps = self.steps(z)
        terms = self.terms(steps)
        change = z[:, n:] - target.centre()[n:]
        at_noise_of_mode = np.maximum(_squared(terms, self._along.form), 0.0)
        misfit = at_noise_of_mode.copy()
        normalisation = np.zeros(len(z))
        for scales, changes, together in zip(target.scales_of, self._along.changes, self._along.together, strict=True):
            changes.added_to(misfit, terms, _shares(change[:, scales], target.spread[scales]))
            normalisation += _of_all(_hats(change[:, scales])) @ together
        for k in range(target.spread.size):
            normalisation += np.interp(change[:, k], NODES, self._along.tables[:, k])
        # No misfit falls faster than the square of the scale that grows most, nor grows faster.
        factor = np.exp(-2.0 * change * target.spread)
        misfit = np.clip(misfit, *(at_noise_of_mode * one for one in _fastest(factor)))
        full = np.repeat(target.mode.z[None, :], len(z), axis=0)
        full[:, target.shared] = z[:, :n]
        log_prob = -0.5 * misfit - normalisation - 0.5 * (z * z).sum(axis=1) + target.tails(full)
        # Of each unknown, not of what the readings tell best: a bent valley leaves that spread far behind.
        is_far = (np.abs(steps) > FARTHEST * np.linalg.norm(self._root, axis=1)).any(axis=1)
        log_prob[is_far | (np.abs(change) > NODES[-1]).any(axis=1)] = -np.inf
        found[near] = log_prob
        return found

    def _expanded(self, coefficients: np.ndarray, typical: np.ndarray) -> _AlongNoise:
        form = self._form(self.target.mode.u, coefficients)
        target, changes, together = self.target, [], []
        own = self._at_mode(target.mode.u)
        tables = np.empty((NODES.size, target.spread.size))
        at_mode = np.zeros((1, len(form)))
        at_mode[:, 0] = 1.0  # the terms there
        for scales in target.scales_of:
            steps = np.array(list(itertools.product(FORMS, repeat=scales.size)))
            forms = np.array([self._form(self._noise(scales, one), coefficients) - form for one in steps])
            changes.append(_in_few_directions(forms, typical))

            def rest(moved: np.ndarray, scales: np.ndarray = scales) -> np.ndarray:
                of_forms = np.zeros(len(moved))
                terms = np.repeat(at_mode, len(moved), axis=0)
                changes[-1].added_to(of_forms, terms, _shares(moved, target.spread[scales]))
                return np.array([self._at_mode(self._noise(scales, one)) for one in moved]) - own - 0.5 * of_forms

            for place, k in enumerate(scales):
                tables[:, k] = rest(np.outer(NODES, np.eye(scales.size)[place]))
            alone = sum(np.interp(steps[:, place], NODES, tables[:, k]) for place, k in enumerate(scales))
            together.append(rest(steps) - alone)
        return _AlongNoise(form, changes, tables, together)

    def _noise(self, scales: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """The mode's noise with some scales moved by prior sds [-]."""
        target, u = self.target, self.target.mode.u.copy()
        moved = np.zeros(target.spread.size)
        moved[scales] = steps * target.spread[scales]
        u[target.comparison.noise.scales] += moved
        return u

    def _at_mode(self, u: np.ndarray) -> float:
        """Minus the log likelihood at the mode with another noise, up to a constant [-]."""
        target = self.target
        point = target.given(target.mode.z.copy(), u, target.mode.prediction)
        if point is None:
            return math.inf
        prior = 0.5 * float(np.sum((u[target.comparison.noise.scales] / target.spread) ** 2))
        return -(point.log_prob + prior)

    def _form(self, u: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """What the misfit is in terms of `terms`, what is the runs' own integrated out."""
        target, comparison = self.target, self.target.comparison
        white = comparison.whitener(target.mode.prediction, u)
        root = np.sqrt(target.weight)[:, None]
        K = -white(coefficients.T) * root
        K[:, 0] += white(comparison.read - target.raw) * root[:, 0]
        J = white(target.D) * root
        A = J.T @ J + np.eye(target.own.size)
        taken = J.T @ K
        taken[:, 0] -= target.mode.z[target.own]
        form: np.ndarray = K.T @ K - taken.T @ np.linalg.solve(A, taken)
        form[0, 0] += target.off @ A @ target.off
        return form


def _squared(terms: np.ndarray, form: np.ndarray) -> np.ndarray:
    return ((terms @ form) * terms).sum(axis=1)


def _in_few_directions(forms: np.ndarray, typical: np.ndarray) -> _Changes:
    """Forms in the directions that matter where terms are as typical: ``typical`` is the root of their mean square."""
    F = typical.T @ forms @ typical
    directions = np.linalg.eigh(np.sum(F @ F, axis=0))[1][:, ::-1]
    F = directions.T @ F @ directions
    squares = np.cumsum(np.cumsum(F**2, axis=1), axis=2)[:, np.arange(len(typical)), np.arange(len(typical))]
    rest = np.sqrt(np.maximum(squares[:, -1:] - squares, 0.0)).max(axis=0)
    most = 1 + int(np.argmax(rest < LEFT_OUT))
    return _Changes(np.linalg.solve(typical.T, directions[:, :most]), np.ascontiguousarray(F[:, :most, :most]))


def _fastest(factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The least and the most that a misfit is multiplied by, each shape (n,), where its parts are by these or by 1."""
    return factor.min(axis=1, initial=1.0), factor.max(axis=1, initial=1.0)


def _shares(change: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """How much each of `FORMS` counts where noise scales have changed by prior sds, shape (n, k, FORMS.size): straight
    in 1 over the square of each scale."""
    found = np.empty((*change.shape, FORMS.size))
    for k, sd in enumerate(spread):
        grid, there = np.exp(-2.0 * sd * FORMS), np.exp(-2.0 * sd * np.clip(change[:, k], FORMS[0], FORMS[-1]))
        found[:, k] = _between(grid[::-1], there)[:, ::-1]
    return found


def _hats(change: np.ndarray) -> np.ndarray:
    """The same, straight in the logarithm of each scale."""
    return np.stack([_between(FORMS, one) for one in change.T], axis=1)


def _between(nodes: np.ndarray, x: np.ndarray) -> np.ndarray:
    """How much each node counts at each place, straight between them, shape (x.size, nodes.size)."""
    return np.stack([np.interp(x, nodes, unit) for unit in np.eye(nodes.size)], axis=1)


def _of_all(shares: np.ndarray) -> np.ndarray:
    """How much each combination of nodes counts, the last scale running fastest, shape (n, nodes to the power k)."""
    found = np.ones((len(shares), 1))
    for one in np.moveaxis(shares, 1, 0):
        found = (found[:, :, None] * one[:, None, :]).reshape(len(shares), -1)
    return found


@njit(cache=True, nogil=True, fastmath=True)
def _add_changes(terms: np.ndarray, shares: np.ndarray, forms: np.ndarray, misfit: np.ndarray) -> None:
    """Add what the forms change the misfit by: of all combinations of `FORMS`, the last scale running fastest."""
    points, scales, each_scale = shares.shape
    for i in range(points):
        for combination in range(len(forms)):
            share, rest = 1.0, combination
            for k in range(scales - 1, -1, -1):
                share *= shares[i, k, rest % each_scale]
                rest //= each_scale
            if share > 0.0:
                for a in range(terms.shape[1]):
                    along = 0.0
                    for b in range(terms.shape[1]):
                        along += forms[combination, a, b] * terms[i, b]
                    misfit[i] += share * terms[i, a] * along


def simulated(target: Integrated, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points at which the model gives readings, and these, shape (n, n_unknowns) [-] and (n, m) [SI]."""
    readings = each(lambda z: target.predicted(target.whole(z)[0]), points)
    told = [i for i, reading in enumerate(readings) if reading is not None]
    return points[told], np.nan_to_num(np.array([readings[i] for i in told]).reshape(len(told), target.raw.size))


def scattered(target: Integrated, rng: np.random.Generator, n: int) -> np.ndarray:
    """Points about the mode with a wider spread than its own, within the bounds, shape (n, n_unknowns) [-]."""
    mode, k = target.mode, target.mode.z.size
    root = np.linalg.cholesky(mode.covariance)
    found = np.empty((n, len(target.unknowns)))
    noise = target.centre()[target.shared.size :]
    for row in found:
        z = target.f.clip(target.f.advance(mode.z, WIDER * root @ rng.standard_normal(k)))
        row[:] = np.append(z[target.shared], noise + 0.3 * rng.standard_normal(noise.size))
    return np.clip(found, target.low, target.high)


def wanted(target: Integrated) -> int:
    """Simulations that the stand-in's coefficients are fitted to, in each round [-]."""
    n = target.shared.size
    return max(FEWEST_POINTS, int(POINTS_PER_TERM * (1 + 2 * n + n * (n + 1) // 2) / KEPT))
