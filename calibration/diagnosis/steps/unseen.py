"""A run that no fit has seen: what the base model and the set that was named say of it beforehand.

The motor's own unknowns, and the effects', are those that the diagnosed recording left; the instruments' offsets and
scales, the weather and the starting angles are anybody's guess again.
"""

from __future__ import annotations

import math

import numpy as np

from calibration.diagnosis.steps.confirm import HeldOut, by_channel, folds_of
from calibration.likelihood.carried import carried
from calibration.likelihood.descent import turned, with_lines
from calibration.likelihood.function import Function
from calibration.likelihood.linear import Comparison
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.problem import Prediction, Problem
from rig.recording import Recording, RecordingError

OF_THE_MOTOR = ("port_lap", "roller_friction", "f_overall", "inertia")
SCHEME = "unseen run"
SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried in turn until one lowers the cost
PASSES = 6


def predict_unseen(seen: Comparison, base: Mode, chosen: Mode, unseen: Recording) -> HeldOut:
    """What a run says of the set over the base model, both fitted without it.

    Parameters
    ----------
    base, chosen : Mode
        The base model and the named set, fitted to it.

    Raises
    ------
    RecordingError
        When it is of another motor.
    """
    refuse_another_motor(seen.problem.recording, unseen)
    there = Comparison(Problem(unseen, any_turn=True))
    found = {}
    for key, mode in (("before", base), ("after", chosen)):
        found[key] = _density(seen, mode, there)
    gains = found["after"][0] - found["before"][0]
    index = np.flatnonzero(there.known)
    rmse = {key: by_channel(there, index, found[key][1][index]) for key in found}
    blocks = [float(np.sum(gains[block])) for block in folds_of(there)]
    se = float(np.std(blocks, ddof=1) * math.sqrt(len(blocks))) if len(blocks) > 1 else 0.0
    return HeldOut(1, 1, rmse["before"], rmse["after"], float(np.sum(gains)), se, f"{SCHEME} {unseen.folder.name}")


def refuse_another_motor(seen: Recording, unseen: Recording) -> None:
    """Refuse a run of another motor, of which nothing can be predicted.

    Parameters
    ----------
    seen, unseen : Recording
        The recording that is diagnosed, and the run held out.

    Raises
    ------
    RecordingError
        When their motors differ.
    """
    if unseen.motor != seen.motor:
        raise RecordingError(f"{unseen.folder}: of the motor {unseen.motor}, not {seen.motor}")


def _density(seen: Comparison, mode: Mode, there: Comparison) -> tuple[np.ndarray, np.ndarray]:
    """Log density of each of a run's readings given those before it, 0 where there is none, and their errors [SI].

    Lines and starting angles are looked for first.
    """
    f = Function(there, mode.names)
    z, covariance, _ = carried(seen.problem, mode, there.problem, OF_THE_MOTOR)
    z = with_lines(f, there, turned(f, there, z, mode.u, f(z))[0], mode.u)
    there.see_pulses(z[: f.k])
    z, predicted = turned(f, there, z, mode.u, f(z))
    precision = np.linalg.inv(covariance)
    start, D = z, np.zeros((there.read.size, z.size))

    def cost(at_z: np.ndarray, found: Prediction) -> float:
        r = there.whitener(found, mode.u)(there.read - there.raw(found))
        return float(r @ r + (at_z - start) @ precision @ (at_z - start))

    # The density is taken at the most probable point, where its curve is that of a normal.
    for _ in range(PASSES):
        D = f.derivatives(z, predicted, D, mode.u)
        white = there.whitener(predicted, mode.u)
        J, r = white(D), white(there.read - there.raw(predicted))
        move = np.linalg.solve(J.T @ J + precision, J.T @ r - precision @ (z - start))
        for share in SHARES:
            tried = f.clip(f.advance(z, share * move))
            found = f(tried)
            if there.is_told(found) and cost(tried, found) <= cost(z, predicted):
                z, predicted = tried, found
                break
        else:
            break
    predicted = f(z)
    white = there.whitener(predicted, mode.u)
    J = white(D)
    r = white(there.read - there.raw(predicted)) + J @ (z - start)
    error = there.read - there.raw(predicted) + D @ (z - start)
    known = there.known
    C = np.eye(int(known.sum())) + J[known] @ covariance @ J[known].T
    L = np.linalg.cholesky(C)
    apart = np.linalg.solve(L, r[known])
    density = np.zeros(known.size)
    density[known] = -0.5 * apart**2 - np.log(np.diag(L) * white.scale[known]) - 0.5 * math.log(2.0 * math.pi)
    return density, np.nan_to_num(error)
