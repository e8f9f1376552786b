"""The compiled shape-preserving interpolation, held against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from model.solvers import monotone


@pytest.mark.parametrize("kind", ["rising", "falling", "to and fro", "with level pieces"])
def test_it_gives_what_scipy_gives_to_the_bit_even_beyond_the_ends(kind: str) -> None:
    rng = np.random.default_rng(3)
    for count in (3, 4, 8, 20):
        x = np.cumsum(0.01 + rng.random(count))
        y = np.cumsum(rng.random(count)) * (-1.0 if kind == "falling" else 1.0)
        if kind == "to and fro":
            y = rng.standard_normal(count)
        if kind == "with level pieces":
            y = np.round(y)
        asked = np.sort(np.concatenate([x, rng.uniform(x[0] - 1.0, x[-1] + 1.0, 50)]))
        found = np.empty(asked.size)
        monotone.interpolate(x, y, asked, found)
        assert np.array_equal(found, PchipInterpolator(x, y)(asked))
