"""A fitted model of another rig made linear: what each unknown, each effect and a free-form force do.

Every column is in units of the declared noise, one array for each of the problem's readings; their own noise level and
the correlation of neighbours are taken into account later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.other_rigs.coordinates import Coordinates
from calibration.diagnosis.other_rigs.fit import RigFit
from calibration.diagnosis.other_rigs.places import Force, forces_of
from calibration.diagnosis.other_rigs.problem import RigProblem
from model.effects import effects

STEP = 1e-3
UNSEEN = 1e-12  # of the largest reading
SHAPES = (-1.0, 0.0, 1.0)  # standard normal numbers at which the shape of an effect is tried
Parts = list[np.ndarray]  # one array for each of the problem's readings


@dataclass(frozen=True)
class Signature:
    """What an effect of ordinary size would do.

    Attributes
    ----------
    columns : list of ndarray, each of shape (n_i,)
        In units of the declared noise [-].
    """

    name: str
    columns: Parts
    one_sided: bool


@dataclass(frozen=True)
class Linear:
    """A recording around a fitted model.

    Attributes
    ----------
    raw : list of ndarray
        Readings less predictions [SI].
    residual : list of ndarray
        Readings less predictions, in units of the declared noise [-].
    jacobian : list of ndarray, each of shape (n_i, m)
        What the unknowns do to the predictions, likewise [-].
    slopes : list of ndarray, each of shape (n_i, m)
        The same as the readings are [SI].
    prior : ndarray of bool, shape (m,)
        Unknowns with a standard normal prior; the others are flat.
    nuisance : ndarray of bool, shape (m,)
        Those of them that are no effect's: how large an effect is says nothing against the model that holds it.
    """

    problem: RigProblem
    fit: RigFit
    raw: Parts
    residual: Parts
    jacobian: Parts
    slopes: Parts
    prior: np.ndarray
    nuisance: np.ndarray

    @property
    def data(self) -> Parts:
        """Residuals as they would be with all nuisances at the middle of their priors [-]."""
        z = self.fit.point * self.nuisance
        return [r + J @ z for r, J in zip(self.residual, self.jacobian, strict=True)]


def linear(problem: RigProblem, fit: RigFit, x: np.ndarray | None = None) -> Linear:
    """Make a fitted model linear.

    Parameters
    ----------
    fit : RigFit
        Of it, or of another recording of the same rig.
    x : ndarray, shape (m,), or None
        Where; the fit's own point when left out [-].
    """
    at = Coordinates(problem, fit.names)
    x = fit.point if x is None else x
    here = at.residuals(x)
    columns: list[Parts] = []
    for i in range(x.size):
        step = STEP * max(abs(x[i]), 1.0)
        step = step if x[i] + step <= at.high[i] else -step
        moved = x.copy()
        moved[i] += step
        columns.append([(r - m) / step for r, m in zip(here, at.residuals(moved), strict=True)])
    slopes = [np.column_stack([column[k] for column in columns]) for k in range(len(here))]
    jacobian = [one.white(slope) for one, slope in zip(problem.readings, slopes, strict=True)]
    residual = [one.white(r) for one, r in zip(problem.readings, here, strict=True)]
    place = np.arange(x.size)
    prior, nuisance = place >= at.n_flat, (place >= at.n_flat) & (place < at.n_flat + len(problem.unknowns))
    return Linear(problem, fit, here, residual, jacobian, slopes, prior, nuisance)


def signatures(view: Linear) -> list[Signature]:
    """What the effects that the model does not hold would do, at a few shapes each."""
    problem = view.problem
    values, chosen = Coordinates(problem, view.fit.names).values(view.fit.point)
    here = problem.predict(values, chosen)
    found = []
    for name in problem.could_show:
        if name in view.fit.names:
            continue
        unknowns = [unknown for _, unknown, _, _ in problem.effect_unknowns([name])]
        shapes = {parameter.name for parameter in effects()[name].parameters if parameter.shape}
        for z in SHAPES if shapes else (0.0,):
            of_shapes = {u.name: float(u.value(np.asarray(z))) for u in unknowns if u.name in shapes}
            for amplitude in (u for u in unknowns if u.name not in shapes):
                size = float(amplitude.value(np.asarray(1.0 if amplitude.a == 0.0 else 0.0)))
                zero = {u.name: 0.0 for u in unknowns if u.name not in shapes}
                tried = {name: {**zero, **of_shapes, amplitude.name: size}}
                there = problem.predict(values, {**chosen, **tried})
                columns = [one.white(_seen(b - a, a)) for one, a, b in zip(problem.readings, here, there, strict=True)]
                found.append(Signature(name, columns, effects()[name].amplitude.low >= 0.0))
    return found


def _seen(change: np.ndarray, size: np.ndarray) -> np.ndarray:
    """A change without its parts that no instrument sees; numbers near underflow are slow, too."""
    least = UNSEEN * max(float(np.max(np.abs(size), initial=0.0)), UNSEEN)
    return np.where(np.abs(change) < least, 0.0, change)


def forces(view: Linear) -> list[Force]:
    """Free-form forces along what the recording knows of each reading."""
    friction = view.fit.estimates.get("viscous_friction")
    return forces_of(view.problem, friction.mean if friction is not None else 0.0)
