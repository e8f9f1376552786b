"""What each effect would do to the readings at a point: columns of a linear model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from calibration.likelihood.compared import Compared
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode
from calibration.unknowns.effects import is_size, unchanged
from model.effects.effect import Effect

PROBE = 0.1  # amplitude at which a signature is taken, in ordinary sizes of the effect, at most
MOVED = 3.0  # whitened size of what it should change
PROBES = 3
LEAST_PROBE = 1e-5
FADES = 0.1  # share of its size per amplitude that a signature keeps, or it is taken at the larger one
SHAPES = (-1.0, 0.0, 1.5)  # shape parameters scanned, in sds of their prior


@dataclass(frozen=True)
class Signature:
    """One effect with its shape parameters fixed.

    `unknowns`: (effect, parameter) to its standard normal number where the column was taken [-].
    `column`, shape (m,): change of the readings per unit of the amplitude: its prior's sd, or its centre where that is
        not 0 [SI].
    """

    effect: str
    unknowns: dict[tuple[str, str], float]
    column: np.ndarray
    mean: float
    sd: float
    one_sided: bool


def signatures(comparison: Compared, mode: Mode) -> list[Signature]:
    """Signatures of the effects that a mode does not hold."""
    problem, found = comparison.problem, []
    of_set = {unchanged(name) for name in mode.names}
    for effect in problem.effects_that_could():
        if unchanged(effect.id) in of_set:  # shared or each recording's own, a set holds it once
            continue
        unknown = [u for _, u in problem.effect_unknowns([effect.id])]
        shapes = [u.name for u in unknown if u.kind != "normal"]
        for amplitude in (u for u in unknown if u.kind == "normal"):
            for at_z in SHAPES if shapes else (0.0,):
                same = _of_the_nuisance(comparison, mode, effect, amplitude.name)
                column, probe = (
                    answer(comparison, mode, effect, amplitude.name, at_z) if same is None else (same, PROBE)
                )
                where = {(effect.id, amplitude.name): probe} | {(effect.id, name): at_z for name in shapes}
                size = problem.amplitude(effect.id)
                bounded = size.low >= 0.0 and is_size(amplitude.name, size)
                unit = amplitude.a or amplitude.b
                found.append(Signature(effect.id, where, column, amplitude.a / unit, amplitude.b / unit, bounded))
    return found


def _of_the_nuisance(comparison: Compared, mode: Mode, effect: Effect, amplitude: str) -> np.ndarray | None:
    """The signature of an effect that has the form of a nuisance: that nuisance's own derivative, in its unit [SI]."""
    nuisance = comparison.problem.nuisance_of(effect.id, amplitude)
    i = comparison.problem.place(nuisance) if nuisance else None
    if i is None:
        return None
    one, scale = comparison.problem.nuisances[i], comparison.problem.amplitude(effect.id).scale
    if one.kind == "lognormal":  # an effect is a share of the inertia, or adds to the roller factor
        size = scale if effect.factors else scale / float(one.value(mode.z[i]))
        return mode.D[:, i] * size / math.log(one.b)
    unit = one.b * comparison.problem.in_si(one.name)
    return mode.D[:, i] * scale / unit


def answer(
    comparison: Compared, mode: Mode, effect: Effect, amplitude: str, shape_z: float = 0.0
) -> tuple[np.ndarray, float]:
    """What the readings do per unit of an effect's amplitude: its prior's sd, or its centre where that is not 0.

    It is taken along the valley that f_overall makes, and written as if on a straight line: what f_overall takes up is
    projected out later in any case.

    `mode`: the point; it does not hold the effect.
    Returns `column`: change per unit [SI]; `probe`: amplitude at which it was taken, in that unit [-].
    """
    f = Function(comparison, (*mode.names, effect.id))
    unknown = [u for _, u in comparison.problem.effect_unknowns([effect.id])]
    place = mode.z.size + next(i for i, u in enumerate(unknown) if u.name == amplitude)
    one = unknown[place - mode.z.size]
    off = [-u.a / u.b if u.kind == "normal" else shape_z for u in unknown]
    z = np.append(mode.z, off)
    D = np.hstack([mode.D, np.zeros((mode.D.shape[0], len(unknown)))])
    start, white = comparison.raw(f(z)), comparison.whitener(mode.prediction, mode.u)
    whole = one.a != 0.0  # there or not: nothing in between is likely
    unit, probe = (one.a, 1.0) if whole else (one.b, PROBE)
    column, size = np.zeros(0), 0.0
    for _ in range(PROBES):
        straight = z.copy()
        straight[place] += probe * unit / one.b
        end = f.along_valley(z, straight, mode.prediction, D)
        tried = np.nan_to_num((comparison.raw(f(end)) - start - D @ (end - straight)) / probe)
        before, size = size, float(np.linalg.norm(white(tried)))
        if column.size and size < FADES * before:
            break  # a law that has no slope at 0, as a lag shorter than a sample
        column, taken = tried, probe
        if size == 0.0 and probe < 1.0:
            probe = 1.0  # what shows nothing while it is small may show at its ordinary size
            continue
        if whole or probe * size < 3.0 * MOVED:
            break
        probe = max(MOVED / size, LEAST_PROBE)
    return column, taken


def log_gain(signature: Signature, g: np.ndarray, g_perp: np.ndarray, r: np.ndarray) -> tuple[float, float]:
    """Log evidence that a signature adds in the linear model, and the amplitude's most probable z [-].

    `g`, `g_perp`, shape (m,): whitened column, and the same with the nuisances projected out [-].
    `r`, shape (m,): whitened residuals at the most probable nuisances [-].
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

    `J`, shape (m, k): whitened derivatives with the nuisances [-].
    `columns`, shape (m,) or (m, l): whitened columns [-].
    """
    projected: np.ndarray = columns - J @ np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ columns)
    return projected
