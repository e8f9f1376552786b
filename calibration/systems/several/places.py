"""Where something may be missing in several recordings: what each of them answers, among the readings of all."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Balance, Force, Pieces, Places

if TYPE_CHECKING:
    from calibration.systems.several.comparison import Several


def places_of(several: Several) -> Places:
    """The questions of all recordings: no law and no step in time is looked for in several at once."""
    return Places(
        forces=partial(_forces, several),
        angle_force=partial(_angle_force, several),
        balances=partial(_balances, several),
        same_coordinates=partial(_same_coordinates, several),
        not_observable=partial(_not_observable, several),
        ordinary_speed=partial(_ordinary_speed, several),
    )


def _forces(several: Several, mode: Mode) -> list[Force]:
    return [
        _of_all(several, k, one)
        for k, part in enumerate(several.parts)
        for one in part.places.forces(several.of_part(k, mode))
    ]


def _angle_force(several: Several, mode: Mode) -> Force | None:
    """Of the first recording that resolves it."""
    for k, part in enumerate(several.parts):
        one = part.places.angle_force(several.of_part(k, mode))
        if one is not None:
            return _of_all(several, k, one)
    return None


def _balances(several: Several, mode: Mode) -> list[Balance]:
    return [
        replace(one, columns=partial(_lifted_columns, several, k, one), recording=several.names[k])
        for k, part in enumerate(several.parts)
        for one in part.places.balances(several.of_part(k, mode))
    ]


def _same_coordinates(several: Several, mode: Mode, coordinate: str) -> tuple[str, ...]:
    """Those that none of the recordings can tell from one."""
    parts = enumerate(several.parts)
    each = [part.places.same_coordinates(several.of_part(k, mode), coordinate) for k, part in parts]
    return tuple(name for name in each[0] if all(name in one for one in each))


def _not_observable(several: Several, mode: Mode) -> list[str]:
    """Those along which none of the recordings can show anything."""
    each = [part.places.not_observable(several.of_part(k, mode)) for k, part in enumerate(several.parts)]
    return [words for words in each[0] if all(words in one for one in each)]


def _ordinary_speed(several: Several, mode: Mode) -> float:
    parts = enumerate(several.parts)
    each = [part.places.ordinary_speed(several.of_part(k, mode)) for k, part in parts if part.n]
    return float(np.sqrt(np.mean(np.square(each)))) if each else 0.0


def _of_all(several: Several, k: int, force: Force) -> Force:
    return replace(force, columns=several.lifted(k, force.columns), recording=several.names[k])


def _lifted_columns(several: Several, k: int, of: Balance, pieces: Pieces) -> np.ndarray:
    return several.lifted(k, of.columns(pieces))
