"""Where a mismatch of a machine may be: free-form forces, a piece of a balance along one coordinate each."""

from __future__ import annotations

import numpy as np

from calibration.likelihood.mode import Mode
from calibration.likelihood.shapes import Force, alike, spans
from calibration.systems.machines.problem import Problem
from calibration.systems.machines.readings import LEVEL

PIECES = 6
SIZE = 0.1  # of a piece, of the rig's ordinary torque or flow


def forces(problem: Problem, mode: Mode) -> list[Force]:
    """Free-form forces of a recording: a rotor forgets them by the viscous friction of a mode."""
    friction = problem.values(mode.z[: len(problem.nuisances)]).get(problem.friction, 0.0)
    found = []
    for channel, balance, coordinate in problem.system.balances:
        mine = [not channel or one.channel == channel for one in problem.readings]
        if any(mine):
            found += _along(problem, mine, balance, coordinate, friction)
    return found


def _along(problem: Problem, mine: list[bool], balance: str, coordinate: str, friction: float) -> list[Force]:
    known = problem.system.coordinates()
    used = [i for i, yes in enumerate(mine) if yes and coordinate in known[i] and known[i][coordinate].size]
    if not used:
        return []
    values = {i: np.abs(known[i][coordinate]) if coordinate == "speed" else known[i][coordinate] for i in used}
    edges = _edges(np.concatenate(list(values.values())), coordinate)
    if edges.size < 3:
        return []
    columns: list[np.ndarray] = []
    size = SIZE * (problem.sizes.flow if balance == "mass" else problem.sizes.torque)
    for i, one in enumerate(problem.readings):
        pieces = np.zeros((one.value.size, edges.size - 1))
        if i in values:
            piece = np.clip(np.searchsorted(edges, values[i], side="right") - 1, 0, edges.size - 2)
            pieces[np.arange(piece.size), piece] = size
            pieces = problem.system.answer(i, pieces, balance, friction)
        columns.append(pieces)
    unit, channel = problem.quantity(coordinate).si, problem.readings[used[0]].channel
    if channel == "drive":
        channel = problem.quantity(channel).channel
    return [Force(channel, balance, coordinate, unit, np.vstack(columns), spans(edges))]


def _edges(values: np.ndarray, coordinate: str) -> np.ndarray:
    """Edges of pieces that hold about as many readings each, or of levels where there are few."""
    ordered = np.sort(values)
    gap = LEVEL * max(abs(ordered[0]), abs(ordered[-1])) if coordinate == "pressure" else 0.0
    cuts = np.flatnonzero(np.diff(ordered) > gap) + 1
    if cuts.size == 0:
        return ordered[[0, -1]]
    if cuts.size < PIECES:
        inner = 0.5 * (ordered[cuts - 1] + ordered[cuts])
    else:
        inner = np.quantile(ordered, np.linspace(0.0, 1.0, PIECES + 1)[1:-1])
    return np.unique(np.concatenate([[ordered[0]], inner, [ordered[-1]]]))


def same_coordinates(problem: Problem, _mode: Mode, coordinate: str) -> tuple[str, ...]:
    """Coordinates that this recording cannot tell from one."""
    known = [one for one in problem.system.coordinates() if coordinate in one]
    found = []
    for other in dict.fromkeys(("speed", "pressure", "time", *(name for one in known for name in one))):
        if other == coordinate or not known or any(other not in one for one in known):
            continue
        a, b = (np.concatenate([np.abs(one[name]) for one in known]) for name in (coordinate, other))
        if alike(a, b):
            found.append(other)
    return tuple(found)
