"""What a force of any shape would do to the readings at a point: columns of a linear model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Force, first_order, hats, spans
from calibration.likelihood.signatures import answer
from calibration.systems.radial_piston.predict.kinds import RUN
from model.effects import effects

if TYPE_CHECKING:
    from calibration.systems.radial_piston.comparison import Comparison

HATS = 7  # pieces of a force along speed


def forces(comparison: Comparison, mode: Mode) -> list[Force]:
    """Free-form forces: torques and flows along speed and time, between directions, each run along its time."""
    torque = torque_column(comparison, mode)
    problem, plateaus = comparison.problem, comparison.problem.blocks.plateaus
    omega, time, up = mode.prediction.speed, plateaus.time, plateaus.up
    n = comparison.n
    found = []
    top = float(np.nanmax([*omega, *(np.nanmax(run) for run in mode.prediction.runs)])) if n else 40.0
    edges = np.linspace(0.0, top, HATS + 1)
    speeds = [mode.prediction.runs[i][used] for i, used in enumerate(comparison.used)]
    columns = TorqueAnswer(comparison, torque)(hats(np.nan_to_num(omega), edges), [hats(w, edges) for w in speeds])
    found.append(Force("speed", "torque", "speed", "rad/s", columns, spans(edges)))
    if np.isfinite(plateaus.flow).any():
        flowing = np.zeros((comparison.read.size, HATS))
        flowing[:n] = hats(omega, edges) * float(np.nanmedian(np.abs(plateaus.flow)))
        kept = np.abs(flowing).sum(axis=0) > 0
        found.append(Force("flow", "mass", "speed", "rad/s", flowing[:, kept], spans(edges)[kept]))
    span = np.ptp(time) if n else 0.0
    if n >= 8 and span > 0.0:
        parts = np.linspace(time.min(), time.max() + 1e-9, 5)
        pieces = hats(time, parts)
        for channel, balance, rows in (("speed", "torque", slice(0, 2 * n)), ("flow", "mass", slice(0, n))):
            if channel == "flow" and not np.isfinite(plateaus.flow).any():
                continue
            per = torque if channel == "speed" else np.full(comparison.read.size, np.nanmedian(np.abs(plateaus.flow)))
            columns = np.zeros((comparison.read.size, 4))
            count = (rows.stop - rows.start) // n
            columns[rows] = np.tile(pieces, (count, 1)) * per[rows, None]
            found.append(Force(channel, balance, "time", "s", columns, spans(parts)))
    if n >= 8 and np.any(up > 0) and np.any(up < 0):
        columns = np.zeros((comparison.read.size, 1))
        columns[: 2 * n, 0] = np.tile(up, 2) * torque[: 2 * n]
        found.append(Force("speed", "torque", "direction", "1", columns, np.array([[-1.0, 1.0]])))
    for i, run in enumerate(problem.blocks.runs):
        mine = comparison.kind == RUN + i
        clock = run.time[comparison.index[mine]]
        parts = np.linspace(clock.min(), clock.max() + 1e-9, 5)
        columns = np.zeros((comparison.read.size, 4))
        columns[mine] = hats(clock, parts)
        found.append(Force("speed", "torque", "phase", "s", columns, spans(parts), run.file))
    return found


def torque_column(comparison: Comparison, mode: Mode) -> np.ndarray:
    """Change of the readings per N m of a constant torque [SI], shape (m,)."""
    dry = effects()["coulomb_friction"]
    if dry.id in mode.names:  # its own column, brought from z to N m
        k = len(comparison.problem.nuisances)
        place = [name for name, _ in comparison.problem.effect_unknowns(mode.names)].index(dry.id)
        return mode.D[:, k + place] / dry.amplitude.scale
    return answer(comparison, mode, dry, dry.amplitude.name)[0] / dry.amplitude.scale


class TorqueAnswer:
    """What torques do to the readings, of first order: a plateau's speed at once, a run's with its damping.

    `torque`, shape (m,): of `torque_column`: change of the readings per N m of a constant torque [SI].
    """

    def __init__(self, comparison: Comparison, torque: np.ndarray) -> None:
        self.comparison, self.torque = comparison, torque
        problem = comparison.problem
        self.inertia = problem.motor.si("inertia") + problem.recording.added_inertia_kg_m2
        self.rates = []
        for i, run in enumerate(comparison.problem.blocks.runs):
            mine = comparison.kind == RUN + i
            self.rates.append(_rate(torque[mine], run.time[comparison.used[i]], self.inertia, run.from_rest))

    def __call__(self, steady: np.ndarray, runs: Sequence[np.ndarray]) -> np.ndarray:
        """Changes of the readings [SI], shape (m, k).

        `steady`, shape (n, k): torques at the plateaus [N m].
        `runs`, shape (n_i, k): torques at the samples of each run that are compared [N m].
        """
        comparison = self.comparison
        n = comparison.n
        out = np.zeros((self.torque.size, steady.shape[1]))
        out[: 2 * n] = self.torque[: 2 * n, None] * np.tile(steady, (2, 1))
        for i, run in enumerate(comparison.problem.blocks.runs):
            first = np.zeros(steady.shape[1]) if run.from_rest else -runs[i][0] / (self.inertia * self.rates[i])
            time = run.time[comparison.used[i]]
            out[comparison.kind == RUN + i] = _follow(runs[i], time, self.inertia, self.rates[i], first)
        return out


def _rate(column: np.ndarray, time: np.ndarray, J: float, from_rest: bool) -> float:
    """Damping rate [1/s] with which a run answers a torque, from its answer to a constant one."""
    best = (math.inf, 10.0)
    for rate in np.geomspace(2.0, 60.0, 18):
        first = np.array([0.0 if from_rest else -1.0 / (J * rate)])
        answer = _follow(np.ones((time.size, 1)), time, J, rate, first)[:, 0]
        best = min(best, (float(np.sum((answer - column) ** 2)), float(rate)))
    return best[1]


def _follow(force: np.ndarray, time: np.ndarray, J: float, rate: float, first: np.ndarray) -> np.ndarray:
    """What a torque does to a rotor that forgets it at a rate [rad/s], shape (n, k). `force`, shape (n, k): [N m]."""
    keeps = np.array([math.exp(-rate * step) for step in np.diff(time, prepend=time[0] - (time[1] - time[0]))])
    return first_order(force / (J * rate) * (1.0 - keeps)[:, None], keeps, first)
