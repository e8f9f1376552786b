"""The noise of several recordings: each has its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibration.likelihood import compared
from calibration.likelihood.compared import Whitener
from calibration.systems.radial_piston.comparison import Comparison
from calibration.unknowns.priors import Unknown

SCALES = 3  # of a recording's noise


class Whiteners:
    """Each recording's map, in the order of all readings."""

    def __init__(self, parts: Sequence[Whitener], at: Sequence[np.ndarray], size: int) -> None:
        self._parts, self._at, self._size = parts, at, size

    def __call__(self, difference: np.ndarray) -> np.ndarray:
        """Whitened differences, shape (m,) or (m, k)."""
        out = np.zeros_like(difference)
        for part, at in zip(self._parts, self._at, strict=True):
            out[at] = part(difference[at])
        return out

    @property
    def scale(self) -> np.ndarray:
        """sd of each reading given those before it [SI], shape (m,)."""
        out = np.zeros(self._size)
        for part, at in zip(self._parts, self._at, strict=True):
            out[at] = part.scale
        return out

    @property
    def log_scale(self) -> float:
        """Sum of the logarithms of the sds that hang on the noise [-]."""
        return sum(part.log_scale for part in self._parts)


class Noises(compared.Noise):
    """The noise of each recording; the scales of all come first in u."""

    def __init__(self, parts: Sequence[Comparison], names: Sequence[str]) -> None:
        self._parts, self._names = parts, names
        spread, free = ([getattr(part.noise, what) for part in parts] for what in ("spread", "free"))
        self.scales = slice(0, SCALES * len(parts))
        self.spread, self.free = self.joined(spread), self.joined(free)

    def joined(self, each: Sequence[np.ndarray]) -> np.ndarray:
        """One vector of what each recording has in the order of its own u."""
        return np.concatenate([*(one[:SCALES] for one in each), *(one[SCALES:] for one in each)])

    def scale_unknowns(self) -> list[Unknown]:
        """What the scales in u stand for, each with the name of its recording ahead."""
        return [
            replace(one, whose=name)
            for part, name in zip(self._parts, self._names, strict=True)
            for one in part.noise.scale_unknowns()
        ]

    def places(self, k: int) -> np.ndarray:
        """Where a recording's u stands in that of all [-], shape (5,)."""
        further = self._parts[0].noise.spread.size - SCALES
        first = SCALES * len(self._parts) + further * k
        return np.r_[SCALES * k : SCALES * (k + 1), first : first + further]

    def too_loud(self, u: np.ndarray) -> tuple[str, float] | None:
        """The first recording's channel that is too loud to be believed; None where none is."""
        found = (part.noise.too_loud(u[self.places(k)]) for k, part in enumerate(self._parts))
        return next((one for one in found if one), None)
