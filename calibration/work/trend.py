"""A straight line through figures of many recordings, weighed by their uncertainties."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

FEWEST = 2  # figures that a line is drawn through; with as few nothing is said of the scatter
LARGER_P = 0.01  # below it the scatter is larger than the uncertainties say


@dataclass(frozen=True)
class Line:
    """A weighed straight line.

    `slope`, `slope_sd`: per unit of the coordinate; the sd grown with the scatter where that is larger than the
        uncertainties say.
    `value`, `value_sd`, shape (n,): the line at the figures.
    `scatter`: root of chi-squared over the degrees of freedom; 1 where it is as the uncertainties say [-].
    `scatter_p`: how often the scatter would be as large, were the uncertainties right and independent [-].
    `change_p`: how often figures of one constant would slope, or lie apart, as much as these [-].
    """

    slope: float
    slope_sd: float
    value: np.ndarray
    value_sd: np.ndarray
    scatter: float
    scatter_p: float
    change_p: float = 1.0

    @property
    def is_scattered(self) -> bool:
        """Whether the figures scatter about the line by more than their uncertainties say."""
        return self.scatter_p < LARGER_P


def line_through(at: Sequence[float], mean: Sequence[float], sd: Sequence[float]) -> Line | None:
    """The line; None where there are too few figures, or all at one place.

    `at`: coordinates [any unit].
    `mean`, `sd`: figures and their standard deviations [the figure's unit].
    """
    x, y, s = (np.asarray(one, dtype=float) for one in (at, mean, sd))
    if x.size < FEWEST or np.ptp(x) == 0.0 or not np.all(s > 0.0):
        return None
    X = np.column_stack([np.ones(x.size), x - np.average(x, weights=s**-2)]) / s[:, None]
    covariance = np.linalg.inv(X.T @ X)
    a, b = covariance @ (X.T @ (y / s))
    value = a + b * (X[:, 1] * s)
    free = x.size - FEWEST
    chi_squared = float(np.sum(((y - value) / s) ** 2))
    p = float(chdtrc(free, chi_squared)) if free else 1.0
    scatter = float(np.sqrt(chi_squared / free)) if free else 1.0
    constant = float(np.sum(((y - np.average(y, weights=s**-2)) / s) ** 2))
    apart, sloped = float(chdtrc(x.size - 1, constant)), float(chdtrc(1, max(constant - chi_squared, 0.0)))
    change_p = min(2.0 * min(apart, sloped), 1.0) if free else apart
    grown = scatter if p < LARGER_P else 1.0
    value_sd = grown * s * np.sqrt(np.einsum("ij,jk,ik->i", X, covariance, X))
    return Line(float(b), grown * float(np.sqrt(covariance[1, 1])), value, value_sd, scatter, p, change_p)
