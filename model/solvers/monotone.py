"""Cubic interpolation that keeps the shape of the data, compiled: Fritsch and Butland's slopes, as scipy has them.

`scipy.interpolate.PchipInterpolator` gives the same to the bit; with a table of a few points its time goes into checks.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def interpolate(x: np.ndarray, y: np.ndarray, at: np.ndarray, out: np.ndarray) -> None:
    """Values between given ones; beyond the ends the last cubics go on.

    Parameters
    ----------
    x, y : ndarray, shape (k,)
        Increasing places, three at least, and finite values there.
    at : ndarray, shape (n,)
        Increasing places asked for.
    out : ndarray, shape (n,)
        Filled.
    """
    h, m = np.diff(x), np.diff(y) / np.diff(x)
    d = np.zeros(x.size)
    for k in range(1, x.size - 1):
        if np.sign(m[k]) == np.sign(m[k - 1]) and m[k] != 0.0:
            w1, w2 = 2.0 * h[k] + h[k - 1], h[k] + 2.0 * h[k - 1]
            d[k] = 1.0 / ((w1 / m[k - 1] + w2 / m[k]) / (w1 + w2))
    d[0] = _at_an_end(h[0], h[1], m[0], m[1])
    d[-1] = _at_an_end(h[-1], h[-2], m[-1], m[-2])
    k = 0
    for i in range(at.size):
        while k < x.size - 2 and at[i] >= x[k + 1]:
            k += 1
        t = (d[k] + d[k + 1] - 2.0 * m[k]) / h[k]
        s = at[i] - x[k]
        out[i] = y[k] + d[k] * s + ((m[k] - d[k]) / h[k] - t) * (s * s) + t / h[k] * (s * s * s)


@njit(cache=True, nogil=True)
def _at_an_end(h0: float, h1: float, m0: float, m1: float) -> float:
    """A slope at an end, of the three points there."""
    d = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    if np.sign(d) != np.sign(m0):
        return 0.0
    return 3.0 * m0 if np.sign(m0) != np.sign(m1) and abs(d) > 3.0 * abs(m0) else d
