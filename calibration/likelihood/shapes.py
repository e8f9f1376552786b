"""Torques, flows and errors of any shape: along what they act, and what they do to the readings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from calibration.likelihood.mode import Mode

SAME = 0.98  # rank correlation above which two coordinates are one
NEAR = 0.1  # of the top of a coordinate: thresholds closer than this are one

Pieces = Callable[[np.ndarray], np.ndarray]  # shares of k pieces at n values, shape (n, k)


@dataclass(frozen=True)
class Along:
    """One coordinate, at every reading.

    `plateaus`, shape (n,): its value at each plateau; nan where it has none [own unit].
    `runs`, shape (n_i,): its values at each run's samples that are compared; nan where it has none [own unit].
    """

    name: str
    unit: str
    plateaus: np.ndarray
    runs: tuple[np.ndarray, ...]

    @property
    def everything(self) -> np.ndarray:
        """All values that there are, in no order [own unit]."""
        values = np.concatenate([self.plateaus, *self.runs])
        found: np.ndarray = values[np.isfinite(values)]
        return found


@dataclass(frozen=True)
class Force:
    """A free-form force or error along one coordinate.

    `columns`, shape (m, k): change of the readings per unit of each piece [SI].
    `places`, shape (k, 2): where each piece acts [own unit].
    `file`, `recording`: of the run in time, where it is of one run alone; of the recording, where there are several.
    """

    channel: str
    balance: str
    coordinate: str
    unit: str
    columns: np.ndarray
    places: np.ndarray
    file: str = ""
    recording: str = ""


@dataclass(frozen=True)
class Balance:
    """What may be off, and along what.

    `scale`: what its sizes are shares of [N m], [m3/s], [Pa] or [rad/s].
    `values`: of the coordinate, where it would show [own unit].
    `columns`: from pieces of the coordinate to changes of the readings by 1 of each piece, shape (m, k) [SI].
    """

    channel: str
    balance: str
    along: Along
    scale: float
    values: np.ndarray
    columns: Callable[[Pieces], np.ndarray]
    recording: str = ""


@dataclass(frozen=True)
class Form:
    """A term that may be in the law.

    `balance`, `kind`: torque or mass; its form without numbers.
    `unit`: from the size at the top of the coordinate to the coefficient.
    `threshold`: where it sets in, in shares of the top; 0 where it has none [-].
    `columns`, shape (m, k): change of the readings by one sd of its prior [SI]; a harmonic has two for each run.
    `size`: that sd, at the top of the coordinate [N m] or [m3/s].
    """

    balance: str
    kind: str
    text: str
    unit: float
    threshold: float
    columns: np.ndarray
    size: float

    def is_like(self, other: Form) -> bool:
        """Whether two terms are one, but for where they set in."""
        return (self.balance, self.kind) == (other.balance, other.kind) and abs(
            self.threshold - other.threshold
        ) <= NEAR


@dataclass(frozen=True)
class StepsInTime:
    """What is otherwise from one moment on, for each of several moments.

    `moments`, shape (k,): on the recording's clock [s].
    `end_s`: the recording's end [s].
    `within`, shape (m, k): readings of the plateau during which each moment may be.
    `columns`: from a comparison and a mode to what one sd of each kind of step, by channel and balance, does to the
        readings [SI], shape (m, k).
    """

    moments: np.ndarray
    end_s: float
    within: np.ndarray
    columns: Callable[..., dict[tuple[str, str], np.ndarray]]


@dataclass(frozen=True, slots=True)
class Places:
    """Where something may be missing of a recording: what is asked of it at a mode. What is left out, it has none of.

    `forces`: the free-form forces that a mismatch is tested with.
    `angle_force`: a torque along the shaft's angle; None where the readings do not resolve it.
    `balances`: what may be off, and along what.
    `forms`: terms that a law may be made of.
    `steps_in_time`: steps in the running time; None where the recording has no clock for one.
    `same_coordinates`: coordinates that the recording cannot tell from one.
    `not_observable`: coordinates along which the recording can show nothing, each in a sentence.
    `ordinary_speed`: root mean square of the speed [rad/s]; 0 where nobody knows it.
    """

    forces: Callable[[Mode], list[Force]] = lambda _: []
    angle_force: Callable[[Mode], Force | None] = lambda _: None
    balances: Callable[[Mode], list[Balance]] = lambda _: []
    forms: Callable[[Mode], list[Form]] = lambda _: []
    steps_in_time: Callable[[Mode], StepsInTime | None] = lambda _: None
    same_coordinates: Callable[[Mode, str], tuple[str, ...]] = lambda *_: ()
    not_observable: Callable[[Mode], list[str]] = lambda _: []
    ordinary_speed: Callable[[Mode], float] = lambda _: 0.0


def hats(x: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Smooth pieces, each 1 in the middle of its span and 0 one span away [-], shape (n, k).

    `x`, shape (n,): where [own unit].
    `edges`, shape (k + 1,): of the spans [own unit].
    """
    middle, width = 0.5 * (edges[:-1] + edges[1:]), np.diff(edges)
    found: np.ndarray = np.maximum(0.0, 1.0 - np.abs(x[:, None] - middle) / width)
    return found


def spans(edges: np.ndarray) -> np.ndarray:
    """Where the pieces of `hats` act [own unit], shape (k, 2). `edges`, shape (k + 1,): of the spans [own unit]."""
    return np.column_stack([edges[:-1], edges[1:]])


def alike(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two coordinates rise and fall together. `a`, `b`, shape (n,): of the same readings [own units]."""
    from scipy.stats import rankdata  # takes a third of a second, which most recordings are spared

    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return False
    return abs(float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])) > SAME


def first_order(pushes: np.ndarray, keeps: np.ndarray, first: np.ndarray) -> np.ndarray:
    """What keeps a share of itself in each step and is pushed, after each step [own unit], shape (n, k).

    `pushes`, shape (n, k): what each step takes off [own unit].
    `keeps`, shape (n,): the share that each step leaves [-].
    `first`, shape (k,): before the first step [own unit].
    """
    found, now = np.empty_like(pushes), first
    for k, keep in enumerate(keeps):
        now = now * keep - pushes[k]
        found[k] = now
    return found
