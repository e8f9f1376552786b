"""What each effect, and a force of any shape, would do to the readings at a point: columns of a linear model."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from calibration.diagnosis.function import Function
from calibration.diagnosis.linear import RUN, Comparison
from calibration.diagnosis.mode import Mode
from calibration.diagnosis.problem import SI_OF
from model import layout as at
from model.effects import effects
from model.effects.effect import Effect

PROBE = 0.1  # amplitude at which a signature is taken, in ordinary sizes of the effect, at most
MOVED = 3.0  # whitened size of what it should change
PROBES = 3
LEAST_PROBE = 1e-5
FADES = 0.1  # share of its size per amplitude that a signature keeps, or it is taken at the larger one
SHAPES = (-1.0, 0.0, 1.5)  # shape parameters scanned, in sds of their prior
HATS = 7  # pieces of a force along speed


@dataclass(frozen=True)
class Signature:
    """One effect with its shape parameters fixed.

    Attributes
    ----------
    effect : str
        Its id.
    unknowns : dict
        (effect, parameter) to its standard normal number where the column was taken [-].
    column : ndarray, shape (m,)
        Change of the readings per unit of the amplitude: its prior's sd, or its centre where that is not 0 [SI].
    mean, sd : float
        Prior of the amplitude in that unit [-].
    one_sided : bool
        Whether it cannot be negative.
    """

    effect: str
    unknowns: dict[tuple[str, str], float]
    column: np.ndarray
    mean: float
    sd: float
    one_sided: bool


@dataclass(frozen=True)
class Force:
    """A free-form force or error along one coordinate.

    Attributes
    ----------
    channel, balance, coordinate, unit : str
        As in diagnosis/1.
    columns : ndarray, shape (m, k)
        Change of the readings per unit of each piece [SI].
    places : ndarray, shape (k, 2)
        Where each piece acts [own unit].
    """

    channel: str
    balance: str
    coordinate: str
    unit: str
    columns: np.ndarray
    places: np.ndarray


def signatures(comparison: Comparison, mode: Mode) -> list[Signature]:
    """Signatures of the effects that a mode does not hold.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The point.
    """
    problem, found = comparison.problem, []
    for effect in problem.effects_that_could():
        if effect.id in mode.names:
            continue
        unknown = [u for _, u in problem.effect_unknowns([effect.id])]
        shapes = [u.name for u in unknown if u.kind != "normal"]
        for amplitude in (u for u in unknown if u.kind == "normal"):
            for at_z in SHAPES if shapes else (0.0,):
                same = _of_the_nuisance(comparison, mode, effect)
                column, probe = (
                    answer(comparison, mode, effect, amplitude.name, at_z) if same is None else (same, PROBE)
                )
                where = {(effect.id, amplitude.name): probe} | {(effect.id, name): at_z for name in shapes}
                bounded = effect.amplitude.low >= 0.0 and amplitude.name == effect.amplitude.name
                unit = amplitude.a or amplitude.b
                found.append(Signature(effect.id, where, column, amplitude.a / unit, amplitude.b / unit, bounded))
    return found


def _of_the_nuisance(comparison: Comparison, mode: Mode, effect: Effect) -> np.ndarray | None:
    """The signature of an effect that has the form of a nuisance: that nuisance's own derivative, in its unit [SI]."""
    nuisances = comparison.problem.nuisances
    i = next((i for i, u in enumerate(nuisances) if effect.nuisance and u.name == effect.nuisance), None)
    if i is None:
        return None
    one, scale = nuisances[i], effect.amplitude.scale
    if one.kind == "lognormal":  # an effect is a share of the inertia, or adds to the roller factor
        size = scale if effect.factors else scale / float(one.value(mode.z[i]))
        return mode.D[:, i] * size / math.log(one.b)
    unit = one.b * (SI_OF[one.name.partition("_")[0]] if one.name.endswith("_offset") else 1.0)
    return mode.D[:, i] * scale / unit


def answer(
    comparison: Comparison, mode: Mode, effect: Effect, amplitude: str, shape_z: float = 0.0
) -> tuple[np.ndarray, float]:
    """What the readings do per unit of an effect's amplitude: its prior's sd, or its centre where that is not 0.

    It is taken along the valley that f_overall makes, and written as if on a straight line: what f_overall takes up is
    projected out later in any case.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The point; it does not hold the effect.
    effect : Effect
        The effect.
    amplitude : str
        Name of the parameter.
    shape_z : float
        Of its shape parameters [-].

    Returns
    -------
    column : ndarray, shape (m,)
        Change per unit [SI].
    probe : float
        Amplitude at which it was taken, in that unit [-].
    """
    f = Function(comparison, (*mode.names, effect.id))
    unknown = [u for _, u in comparison.problem.effect_unknowns([effect.id])]
    place = mode.z.size + next(i for i, u in enumerate(unknown) if u.name == amplitude)
    one = unknown[place - mode.z.size]
    off = [-u.a / u.b if u.kind == "normal" else shape_z for u in unknown]
    z = np.append(mode.z, off)
    D = np.hstack([mode.D, np.zeros((mode.D.shape[0], len(unknown)))])
    of = f.with_pulses if effect.periodic else f.smooth
    start, white = of(z), comparison.whitener(mode.prediction, mode.u)
    whole = one.a != 0.0  # there or not: nothing in between is likely
    unit, probe = (one.a, 1.0) if whole else (one.b, PROBE)
    column, size = np.zeros(0), 0.0
    for _ in range(PROBES):
        straight = z.copy()
        straight[place] += probe * unit / one.b
        end = f.along_valley(z, straight, mode.prediction, D)
        tried = np.nan_to_num((of(end) - start - D @ (end - straight)) / probe)
        before, size = size, float(np.linalg.norm(white(tried)))
        if column.size and size < FADES * before:
            break  # a law that has no slope at 0, as a lag shorter than a sample
        column, taken = tried, probe
        if whole or probe * size < 3.0 * MOVED:
            break
        probe = max(MOVED / size, LEAST_PROBE)
    return column, taken


def log_gain(signature: Signature, g: np.ndarray, g_perp: np.ndarray, r: np.ndarray) -> tuple[float, float]:
    """Log evidence that a signature adds in the linear model, and the amplitude's most probable z [-].

    Parameters
    ----------
    signature : Signature
        Of an effect.
    g, g_perp : ndarray, shape (m,)
        Whitened column, and the same with the nuisances projected out [-].
    r : ndarray, shape (m,)
        Whitened residuals at the most probable nuisances [-].
    """
    n, s, w = float(g @ g_perp), float(g @ r), signature.sd**-2
    precision = n + w
    mean = (s + signature.mean * w) / precision
    gain = 0.5 * math.log(w / precision) + 0.5 * mean * mean * precision - 0.5 * signature.mean**2 * w
    if signature.one_sided and signature.mean == 0.0:
        gain += math.log(2.0) + float(log_ndtr(mean * math.sqrt(precision)))
        mean = max(mean, 0.0)
    return gain, mean


def project(J: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Columns with the nuisances, whose priors are standard normal, projected out.

    Parameters
    ----------
    J : ndarray, shape (m, k)
        Whitened derivatives with the nuisances [-].
    columns : ndarray, shape (m,) or (m, l)
        Whitened columns [-].
    """
    projected: np.ndarray = columns - J @ np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ columns)
    return projected


def forces(comparison: Comparison, mode: Mode, torque: np.ndarray | None = None) -> list[Force]:
    """Free-form forces: a torque along speed and time, a flow along speed and time, and the difference of directions.

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The point.
    torque : ndarray, shape (m,) or None
        Change of the readings per N m of a constant torque [SI]; simulated when left out.
    """
    if torque is None:
        torque = torque_column(comparison, mode)
    problem, plateaus = comparison.problem, comparison.problem.blocks.plateaus
    omega, time, up = mode.prediction.speed, plateaus.time, plateaus.up
    n = comparison.n
    found = []
    top = float(np.nanmax([*omega, *(np.nanmax(run) for run in mode.prediction.runs)])) if n else 40.0
    edges = np.linspace(0.0, top, HATS + 1)
    inside = [lambda w, lo=lo, hi=hi: _hat(w, lo, hi) for lo, hi in itertools.pairwise(edges)]
    columns = np.column_stack([force_column(comparison, mode, torque, piece) for piece in inside])
    found.append(Force("speed", "torque", "speed", "rad/s", columns, np.column_stack([edges[:-1], edges[1:]])))
    flowing = np.zeros((comparison.read.size, HATS))
    flowing[:n] = np.column_stack([piece(omega) for piece in inside]) * float(np.nanmedian(np.abs(plateaus.flow)))
    kept = np.abs(flowing).sum(axis=0) > 0
    if np.isfinite(plateaus.flow).any():
        places = np.column_stack([edges[:-1], edges[1:]])
        found.append(Force("flow", "mass", "speed", "rad/s", flowing[:, kept], places[kept]))
    span = np.ptp(time) if n else 0.0
    if n >= 8 and span > 0.0:
        parts = np.linspace(time.min(), time.max() + 1e-9, 5)
        pieces = np.column_stack([_hat(time, lo, hi) for lo, hi in itertools.pairwise(parts)])
        places = np.column_stack([parts[:-1], parts[1:]])
        for channel, balance, rows in (("speed", "torque", slice(0, 2 * n)), ("flow", "mass", slice(0, n))):
            per = torque if channel == "speed" else np.full(comparison.read.size, np.nanmedian(np.abs(plateaus.flow)))
            columns = np.zeros((comparison.read.size, 4))
            count = (rows.stop - rows.start) // n
            columns[rows] = np.tile(pieces, (count, 1)) * per[rows, None]
            found.append(Force(channel, balance, "time", "s", columns, places))
        if np.any(up > 0) and np.any(up < 0):
            columns = np.zeros((comparison.read.size, 1))
            columns[: 2 * n, 0] = np.tile(up, 2) * torque[: 2 * n]
            found.append(Force("speed", "torque", "direction", "1", columns, np.array([[-1.0, 1.0]])))
    for i, run in enumerate(problem.blocks.runs):
        mine = comparison.kind == RUN + i
        clock = run.time[comparison.index[mine]]
        parts = np.linspace(clock.min(), clock.max() + 1e-9, 5)
        columns = np.zeros((comparison.read.size, 4))
        for j, (lo, hi) in enumerate(itertools.pairwise(parts)):
            columns[mine, j] = _hat(clock, lo, hi)
        found.append(Force("speed", "torque", "phase", "s", columns, np.column_stack([parts[:-1], parts[1:]])))
    return found


def torque_column(comparison: Comparison, mode: Mode) -> np.ndarray:
    """Change of the readings per N m of a constant torque [SI], shape (m,).

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The point.
    """
    dry = effects()["coulomb_friction"]
    if dry.id in mode.names:  # its own column, brought from z to N m
        k = len(comparison.problem.nuisances)
        place = [name for name, _ in comparison.problem.effect_unknowns(mode.names)].index(dry.id)
        return mode.D[:, k + place] / dry.amplitude.scale
    return answer(comparison, mode, dry, dry.amplitude.name)[0] / dry.amplitude.scale


def force_column(comparison: Comparison, mode: Mode, torque: np.ndarray, law: object) -> np.ndarray:
    """Change of the readings by a torque that is a function of speed, of first order [SI], shape (m,).

    Parameters
    ----------
    comparison : Comparison
        The recording.
    mode : Mode
        The point.
    torque : ndarray, shape (m,)
        Of `torque_column`.
    law : callable
        Torque [N m] of speed [rad/s].
    """
    n = comparison.n
    out = np.zeros_like(torque)
    steady = law(np.nan_to_num(mode.prediction.speed))  # type: ignore[operator]
    out[: 2 * n] = torque[: 2 * n] * np.tile(steady, 2)
    problem = comparison.problem
    J = problem.motor.vector()[at.J]
    for i, run in enumerate(problem.blocks.runs):
        mine = comparison.kind == RUN + i
        omega = mode.prediction.runs[i][comparison.used[i]]
        time = run.time[comparison.used[i]]
        rate = _rate(torque[mine], time, J, run.from_rest)
        force = law(omega)  # type: ignore[operator]
        first = 0.0 if run.from_rest else -force[0] / (J * rate)
        out[mine] = _follow(force, time, J, rate, first)
    return out


def _rate(column: np.ndarray, time: np.ndarray, J: float, from_rest: bool) -> float:
    """Damping rate [1/s] with which a run answers a torque, from its answer to a constant one."""
    best = (math.inf, 10.0)
    for rate in np.geomspace(2.0, 60.0, 18):
        answer = _follow(np.ones_like(time), time, J, rate, 0.0 if from_rest else -1.0 / (J * rate))
        best = min(best, (float(np.sum((answer - column) ** 2)), float(rate)))
    return best[1]


def _follow(force: np.ndarray, time: np.ndarray, J: float, rate: float, first: float) -> np.ndarray:
    out = np.empty_like(force)
    x, before = first, time[0] - (time[1] - time[0])
    for k in range(time.size):
        decay = math.exp(-rate * (time[k] - before))
        x = x * decay - force[k] / (J * rate) * (1.0 - decay)
        out[k], before = x, time[k]
    return out


def _hat(x: np.ndarray, lo: float, hi: float) -> np.ndarray:
    """A smooth piece: 1 in the middle of a span, 0 one span away."""
    found: np.ndarray = np.maximum(0.0, 1.0 - np.abs(x - 0.5 * (lo + hi)) / (hi - lo))
    return found
