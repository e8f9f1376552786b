"""The law of a bad reading: a slip of the eye, a lost digit, a jammed needle.

One prior, `BAD`, and one density at 0, that of a normal law of `BAD_WIDTH` sds; two tails. A search for the most
probable point has Cauchy's, so that the size of a slip is no argument for louder noise. A fit of plateaus alone
integrates each row over its true pressure, which has a closed form for normal laws only: there the tail is normal, and
as wide as a slip of a tenth of the reading besides.
"""

from __future__ import annotations

import math

import numpy as np

from configs.compiled import njit

BAD = 0.01  # probability that a single reading is bad, before looking
BAD_WIDTH = 10.0  # a bad reading's error is as dense at 0 as a normal one of so many sds of a good one
CAUCHY = BAD_WIDTH * math.sqrt(2.0 / math.pi)  # the scale of such a law
BAD_SHARE = 0.1  # of the reading, added to the width of the normal tail


def log_bad(r: np.ndarray) -> np.ndarray:
    """Log of the share of bad readings times their density over the normal law's at 0 [-], same shape as ``r``."""
    price: np.ndarray = math.log(BAD / BAD_WIDTH) - np.log1p((r / CAUCHY) ** 2)
    return price


def bad_weight(r: np.ndarray) -> np.ndarray:
    """Weight in least squares of a reading that is bad [-], same shape as ``r``."""
    weight: np.ndarray = 2.0 / (CAUCHY**2 + r * r)
    return weight


@njit(cache=True)
def variances(noise: float, resolution: float, reading: float) -> tuple[float, float]:
    """Of a good reading and of a bad one, with a normal tail, in the square of their unit."""
    good = noise * noise + resolution * resolution / 12.0
    wide = BAD_WIDTH * math.sqrt(good) + BAD_SHARE * abs(reading)
    return good, wide * wide
