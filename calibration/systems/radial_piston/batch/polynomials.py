"""Speed and flow of every plateau as polynomials of the third degree of what moves them.

In the unknowns' values, not in their logarithms, the steady state is smooth: over a posterior's width the polynomials
miss it by some millionths, and they take about a tenth of its time. A fit proposes by them; the true model accepts.
"""

from __future__ import annotations

import itertools

import numpy as np
from numba import prange

from calibration.systems.radial_piston.batch.rows import of_set
from configs.compiled import njit
from model.solvers import steady

COLUMNS = np.array([steady.SPEED_OUT, steady.VOLUME_FLOW, steady.SPEED_SLOPE, steady.FLOW_SLOPE])
PENALTY = 1e-6  # on each coefficient, of coordinates with unit spread


class Polynomials:
    """The polynomials, fitted to what the model gives at some points.

    `values`, shape (n_points, k): of the unknowns that move the plateaus [own units].
    `states`, shape (n_points, n_rows, 9): of `model.solvers.steady.solve` there [SI].
    `coefficients`, shape (n_terms, n_rows, 4): of each product of three of 1 and the coordinates, for `COLUMNS` [SI].
    """

    def __init__(self, values: np.ndarray, states: np.ndarray) -> None:
        self._centre, self._spread = values.mean(axis=0), values.std(axis=0)
        x = self.coordinates(values)
        ones = np.column_stack([np.ones(len(x)), x])
        terms = np.column_stack([ones[:, a] * ones[:, b] * ones[:, c] for a, b, c in _products(x.shape[1])])
        told = states[..., COLUMNS].reshape(len(x), -1)
        scale = np.abs(told).mean(axis=0)
        gram = terms.T @ terms + PENALTY * np.eye(terms.shape[1])
        found = np.linalg.solve(gram, terms.T @ (told / scale)) * scale
        self.coefficients = np.ascontiguousarray(found.reshape(-1, states.shape[1], COLUMNS.size))

    def coordinates(self, values: np.ndarray) -> np.ndarray:
        """Steps from the points' middle in units of their spread, same shape as ``values`` [-]."""
        found: np.ndarray = (values - self._centre) / self._spread
        return found


def n_terms(k: int) -> int:
    """Coefficients of the polynomials of ``k`` coordinates [-]."""
    return len(_products(k))


def _products(k: int) -> list[tuple[int, ...]]:
    return list(itertools.combinations_with_replacement(range(k + 1), 3))


@njit(cache=True, parallel=True)
def sum_rows_by(
    x: np.ndarray,
    coefficients: np.ndarray,
    errors: np.ndarray,
    noise_sd: np.ndarray,
    resolution: np.ndarray,
    bad_share: float,
    reading: np.ndarray,
    state: np.ndarray,
    noise_scale: np.ndarray,
    found: np.ndarray,
) -> None:
    """`rows.sum_rows` with polynomials in the place of the model.

    `x`, shape (n, k): of `Polynomials.coordinates` [-].
    `coefficients`, shape (n_terms, n_rows, 4): of `Polynomials` [SI].
    """
    n_rows, n_columns = coefficients.shape[1:]
    flat = coefficients.reshape(len(coefficients), n_rows * n_columns)
    for s in prange(len(x)):
        ones, sums = np.ones(x.shape[1] + 1), np.zeros(flat.shape[1])
        ones[1:] = x[s]
        term = 0
        for a in range(ones.size):
            for b in range(a, ones.size):
                two = ones[a] * ones[b]
                for c in range(b, ones.size):
                    three = two * ones[c]
                    for i in range(sums.size):
                        sums[i] += three * flat[term, i]
                    term += 1
        states = np.zeros((n_rows, steady.N_OUT))
        for j in range(n_columns):
            states[:, COLUMNS[j]] = sums[j::n_columns]
        found[s] = of_set(states, errors[s], noise_sd, resolution, bad_share, reading, state, noise_scale)
