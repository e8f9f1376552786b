"""A shaft or slide with a measured drive: F = m dv/dt + f v + T, taken as a balance of momentum over short blocks.

Over a block of some rows the means of both sides are compared: the mean of dv/dt is the difference of the speed at its
ends over its length, so nothing is differentiated twice, and what is smoothed is smoothed on both sides alike.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from model.effects import laws
from model.effects.effect import State
from model.rigs.state import AMBIENT_PA, inertia_factor, state_of

LOAD_AREA = 1e-4  # m2; friction may grow with the gauge pressure on a square centimetre


@dataclass(frozen=True)
class Blocks:
    """Rows of a transient and the blocks over which they are averaged.

    `time`, `drive`, `speed`, `angle`, `pressure`, shape (n,): of the rows [s], [N m], [rad/s], [rad], [Pa]; angle and
        pressure nan where they are not known.
    `ends`, shape (m + 1,) of int: rows where the blocks end, each block from one end to the next.
    `used`, shape (m,) of bool: blocks in which the axis moves one way throughout: at rest friction may be anything.
    """

    time: np.ndarray
    drive: np.ndarray
    speed: np.ndarray
    angle: np.ndarray
    pressure: np.ndarray
    ends: np.ndarray
    used: np.ndarray

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over each block by the trapezoidal rule, shape (m,).

        `values`, shape (n,): of the rows [own unit].
        """
        dt = np.diff(self.time)
        total = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * dt)])
        return np.diff(total[self.ends]) / np.diff(self.time[self.ends])


def blocks_of(
    time: np.ndarray,
    drive: np.ndarray,
    speed: np.ndarray,
    rows: int,
    slowest: float,
    angle: np.ndarray | None = None,
    pressure: np.ndarray | None = None,
) -> Blocks:
    """Cut a transient into blocks.

    `time`, `drive`, `speed`, shape (n,): [s], [N m], [rad/s].
    `rows`: of a block [-].
    `slowest`: speed below which the axis may be at rest [rad/s].
    `angle`, `pressure`, shape (n,): [rad], [Pa].
    """
    ends = np.arange(0, time.size, rows)
    moves = [
        bool(np.all(speed[i : j + 1] > slowest) or np.all(speed[i : j + 1] < -slowest))
        for i, j in itertools.pairwise(ends)
    ]
    nothing = np.full(time.size, np.nan)
    return Blocks(
        time,
        drive,
        speed,
        nothing if angle is None else angle,
        nothing if pressure is None else pressure,
        ends,
        np.array(moves, dtype=bool),
    )


def drive(
    inertia: float,
    friction: float,
    blocks: Blocks,
    chosen: laws.Chosen,
    clock: float = 0.0,
    ambient: float = AMBIENT_PA,
    flywheel: float = 0.0,
) -> np.ndarray:
    """Mean drive of each block that the motion tells of [N m], shape (m,).

    `inertia`: J [kg m2], or a slide's mass [kg].
    `blocks`: the motion.
    `flywheel`: share of J that the effects leave as it is [kg m2].
    """
    chosen = laws.switched_on(chosen)
    state = _state(friction, blocks, clock, ambient)
    opposing = friction * blocks.speed + np.sign(blocks.speed) * laws.torque(chosen, state)
    ends = blocks.ends
    acceleration = np.diff(blocks.speed[ends]) / np.diff(blocks.time[ends])
    J = (inertia - flywheel) * inertia_factor(chosen) + flywheel
    return J * acceleration + blocks.mean(opposing)


def _state(friction: float, blocks: Blocks, clock: float, ambient: float) -> State:
    load = np.where(np.isfinite(blocks.pressure), np.abs(blocks.pressure - ambient) * LOAD_AREA, 0.0)
    return state_of(
        blocks.speed,
        friction,
        time=clock + blocks.time,
        angle=blocks.angle,
        pressure=np.where(np.isfinite(blocks.pressure), blocks.pressure, ambient),
        ambient=ambient,
        load=load,
    )
