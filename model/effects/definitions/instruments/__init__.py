"""What instruments make of the true values."""

from __future__ import annotations

import numpy as np

from model.effects.effect import State, Values


def scaled(p: Values, true: np.ndarray, state: State) -> np.ndarray:
    """Readings that are high or low in proportion, by ``scale`` [as the true value]."""
    return true * (1.0 + p["scale"])
