"""A run that no fit has seen: what the base model and the set that was named say of it beforehand.

The motor's own unknowns, and the effects', are those that the diagnosed recording left; the instruments' offsets and
scales, the weather and the starting angles are anybody's guess again.
"""

from __future__ import annotations

import math

import numpy as np

from calibration.diagnosis.steps.confirm import HeldOut, Predicted, by_channel
from calibration.likelihood.compared import Compared, Prediction
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode
from rig.recording import Recording

SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a step, tried in turn until one lowers the cost
PASSES = 6


def predict_unseen(seen: Compared, base: Mode, chosen: Mode, unseen: Recording) -> HeldOut:
    """What a run says of the set over the base model, both fitted without it.

    `base`, `chosen`: the base model and the named set, fitted to it.
    Raises RecordingError when it is of another motor.
    """
    there = seen.of(unseen)
    found = {}
    for key, mode in (("before", base), ("after", chosen)):
        found[key] = _density(seen, mode, there)
    gains = found["after"][0] - found["before"][0]
    index = np.flatnonzero(there.known)
    rmse = {key: by_channel(there, index, found[key][1][index]) for key in found}
    blocks = [float(np.sum(gains[block])) for block in there.folds()[0]]
    se = float(np.std(blocks, ddof=1) * math.sqrt(len(blocks))) if len(blocks) > 1 else 0.0
    size = by_channel(there, index, there.read[index]) if there.rig else {}
    scheme = f"unseen run {unseen.folder.name}"
    return HeldOut(1, 1, rmse["before"], rmse["after"], float(np.sum(gains)), se, scheme, Predicted.UNSEEN_RUN, size)


def _density(seen: Compared, mode: Mode, there: Compared) -> tuple[np.ndarray, np.ndarray]:
    """Log density of each of a run's readings given those before it, 0 where there is none, and their errors [SI].

    Lines and starting angles are looked for first.
    """
    f = Function(there, mode.names)
    z, covariance, u = there.carried(seen, mode)
    z, predicted = there.begun(f, z, u)
    precision = np.linalg.inv(covariance)
    start, D = z, np.zeros((there.read.size, z.size))

    def cost(at_z: np.ndarray, found: Prediction) -> float:
        r = there.whitener(found, u)(there.read - there.raw(found))
        return float(r @ r + (at_z - start) @ precision @ (at_z - start))

    # The density is taken at the most probable point, where its curve is that of a normal.
    for _ in range(PASSES):
        D = f.derivatives(z, predicted, D, u)
        white = there.whitener(predicted, u)
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
    white = there.whitener(predicted, u)
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
