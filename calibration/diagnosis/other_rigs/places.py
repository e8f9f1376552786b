"""Where a mismatch of another rig may be: free-form forces, a piece of a balance along one coordinate each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.other_rigs.problem import RigProblem

PIECES = 6
LEVEL = 0.02  # readings of pressure closer than this, relative, are one level
SIZE = 0.1  # of a piece, of the rig's ordinary torque or flow
SAME = 0.98  # rank correlation above which two coordinates are one


@dataclass(frozen=True)
class Force:
    """A force of any shape along one coordinate.

    Attributes
    ----------
    places : ndarray, shape (k, 2)
        Of its pieces, in the coordinate's unit [SI].
    columns : list of ndarray, each of shape (n_i, k)
        What the pieces do to the problem's readings, in units of the declared noise [-].
    """

    channel: str
    balance: str
    coordinate: str
    unit: str
    places: np.ndarray
    columns: list[np.ndarray]


def coordinates(problem: RigProblem) -> list[dict[str, np.ndarray]]:
    """What is known of each reading: its speed (with its sign), the time on its own clock, and the pressure [SI]."""
    found = []
    if problem.kind == "driven_axis":
        for _, blocks in problem.seen.blocks:
            one = {name: blocks.mean(getattr(blocks, name))[blocks.used] for name in ("speed", "time", "pressure")}
            found.append({name: values for name, values in one.items() if np.all(np.isfinite(values))})
    elif problem.kind == "free_rotor":
        for readings, (_, time, compared) in zip(problem.readings, problem.seen.coasts, strict=True):
            found.append({"speed": readings.value, "time": time[compared]})
    else:
        speed, pressure, _, time = problem.seen.rows
        found = [{"speed": speed[has], "pressure": pressure[has], "time": time[has]} for has in problem.seen.has]
    return found


def forces_of(problem: RigProblem, friction: float) -> list[Force]:
    """Free-form forces of a recording.

    Parameters
    ----------
    friction : float
        Viscous coefficient, by which a rotor forgets a force [N m s].
    """
    known = coordinates(problem)
    wanted = [("drive", "torque"), ("flow", "mass")] if problem.kind == "displacement_machine" else [("", "torque")]
    found = []
    for channel, balance in wanted:
        mine = [not channel or one.channel == channel for one in problem.readings]
        if not any(mine):
            continue
        for coordinate in ("speed", "pressure", "time"):
            found += _along(problem, known, mine, balance, coordinate, friction)
        if problem.kind == "driven_axis":
            found += _along(problem, known, mine, "sensor", "time", friction)
    return found


def _along(
    problem: RigProblem,
    known: list[dict[str, np.ndarray]],
    mine: list[bool],
    balance: str,
    coordinate: str,
    friction: float,
) -> list[Force]:
    used = [i for i, yes in enumerate(mine) if yes and coordinate in known[i] and known[i][coordinate].size]
    if not used:
        return []
    signed = problem.kind == "driven_axis" and balance == "torque"
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
            if signed:
                pieces *= np.sign(known[i]["speed"])[:, None]
            if problem.kind == "free_rotor":
                pieces = _slowed(problem, known[i]["time"], pieces, friction)
        columns.append(one.white(pieces))
    unit = {"speed": "m/s" if problem.slides else "rad/s", "pressure": "Pa", "time": "s"}[coordinate]
    channel = problem.readings[used[0]].channel
    if channel == "drive":
        channel = "force" if problem.slides else "torque"
    return [Force(channel, balance, coordinate, unit, np.column_stack([edges[:-1], edges[1:]]), columns)]


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


def _slowed(problem: RigProblem, time: np.ndarray, torque: np.ndarray, friction: float) -> np.ndarray:
    """What torques along a coast-down do to its speed: each is forgotten as viscous friction slows the rotor."""
    out = np.zeros_like(torque)
    rate = friction / problem.inertia
    for k in range(1, time.size):
        dt = time[k] - time[k - 1]
        keep = np.exp(-rate * dt)
        per = (1.0 - keep) / (rate * problem.inertia) if rate > 0.0 else dt / problem.inertia
        out[k] = out[k - 1] * keep - 0.5 * (torque[k] + torque[k - 1]) * per
    return 0.5 * (out + np.concatenate([out[:1], out[:-1]]))


def same_coordinates(problem: RigProblem, coordinate: str) -> tuple[str, ...]:
    """Coordinates that this recording cannot tell from one."""
    from scipy.stats import rankdata  # takes a third of a second, which most recordings are spared

    known = [one for one in coordinates(problem) if coordinate in one]
    found = []
    for other in ("speed", "pressure", "time"):
        if other == coordinate or not known or any(other not in one for one in known):
            continue
        a, b = (np.concatenate([np.abs(one[name]) for one in known]) for name in (coordinate, other))
        if np.ptp(a) > 0.0 and np.ptp(b) > 0.0 and abs(np.corrcoef(rankdata(a), rankdata(b))[0, 1]) > SAME:
            found.append(other)
    return tuple(found)
