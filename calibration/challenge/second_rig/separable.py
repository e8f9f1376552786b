"""Whether a recording can tell what is concealed from every other effect, by the second rig's own signatures.

D is the size of the effect's change of the readings in units of noise, once the nuisances with their declared priors
have taken up what they can. They are followed as they are, not along straight lines: what moves f_overall by a tenth
moves everything by hundreds of sds, and then the bend of a line alone would pass for something seen. rho is the
change's largest correlation with the change that another single effect makes, in any form that the rig knows of it: a
leak through a hole adds what an offset of the flow meter does, one through a gap does not. A best fit prefers the right
one of two with probability Phi(D sqrt((1 - rho) / 2)).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import ndtr

from calibration.challenge.second_rig import bench
from calibration.challenge.second_rig.concealed import USUAL
from calibration.challenge.second_rig.signatures import Probed, Whitened, asked_of
from calibration.challenge.second_rig.truth import Truth
from rig.recording import read_recording

LEAST_D = 7.0
LEAST_PROBABILITY = 0.99
FREE = 10.0  # another concealed effect is free within ten times its size
STEPS = 12  # most that the nuisances go
SHARES = (1.0, 0.5, 0.25, 0.1)  # of a step, tried in turn until one comes nearer
SETTLED = 1e-3  # share of the distance that a step has to gain
FARTHEST = 5.0  # declared sds that a nuisance may go


def separable(truth: Truth, folder: Path) -> dict[str, Any]:
    """Size and likeness of what is concealed, for the files of one recording.

    Of two effects each is weighed with the other one free, and the worse one counts. The other one in another form is a
    rival too: it alone may pass for both.

    Parameters
    ----------
    truth : Truth
        The case.
    folder : Path
        Its recording, with or without a further test.

    Returns
    -------
    dict
        ``D``, ``rho``, ``rival`` (the id that rho is with), ``form`` (its form) and ``separable``; D 0 where nothing is
        concealed.
    """
    if not truth.effects:
        return {"D": 0.0, "rho": 0.0, "rival": None, "form": None, "separable": False}
    recording = read_recording(Path(folder))
    rig = truth.rig(recording.added_inertia_kg_m2)
    base = bench.without(rig, ())
    whitened = Whitened(asked_of(recording, truth.errors), base)
    everything = whitened.readings(rig)
    nuisances = whitened.nuisances()
    probed = whitened.effects()
    rows = whitened.rows() if "bad_reading" not in truth.ids else np.empty((everything.size, 0))
    own = []
    for k in range(len(rig.effects)):
        others = tuple(other for i, other in enumerate(rig.effects) if i != k)
        rest = bench.without(rig, others)
        own.append((rest, everything - whitened.readings(rest)))
    worst: dict[str, Any] = {}
    for k, (rest, change) in enumerate(own):
        free = np.column_stack([np.empty((change.size, 0)), *(FREE * c for i, (_, c) in enumerate(own) if i != k)])
        rivals = [one for one in probed if one.id not in truth.ids]
        for other in others:
            same = (one for one in probed if one.id == other.id and one.form != other.form)
            rivals += [replace(one, one_sided=False) for one in same]
        found = _weighed(*_taken_up(whitened, everything, rest, change, nuisances, free), rivals, rows)
        if not worst or found["probability"] < worst["probability"]:
            worst = found | {"D": min(found["D"], worst.get("D", np.inf))}
        else:
            worst["D"] = min(found["D"], worst["D"])
    probability = worst.pop("probability")
    enough = worst["D"] >= LEAST_D and probability >= LEAST_PROBABILITY
    return worst | {"separable": bool(enough and truth.ids != ["unknown"])}


def _taken_up(
    whitened: Whitened,
    everything: np.ndarray,
    rest: bench.Rig,
    change: np.ndarray,
    nuisances: np.ndarray,
    free: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """A change of the readings less what the nuisances take up of it beyond what straight lines would, and those lines.

    Projected on them it has the size that is left at the nearest point which the nuisances reach: there N^T e = z, so
    that (e + N z)^T (1 + N N^T)^-1 (e + N z) = e^T e + z^T z.
    """
    z, e = np.zeros(nuisances.shape[1] + free.shape[1]), change
    k, far, N = nuisances.shape[1], float(change @ change), np.column_stack([nuisances, free])
    for _ in range(STEPS):
        step, nearer = np.linalg.solve(np.eye(z.size) + N.T @ N, N.T @ e - z), False
        for share in SHARES:
            tried = z + share * step
            tried[:k] = np.clip(tried[:k], -FARTHEST, FARTHEST)
            there = everything - whitened.moved(rest, tried[:k]) - free @ tried[k:]
            distance = float(there @ there + tried @ tried)
            if distance < far:
                nearer = distance < (1.0 - SETTLED) * far
                z, e, far = tried, there, distance
                N = np.column_stack([nuisances * whitened.grown(z[:k]), free])
                break
        if not nearer:
            break
    return e + N @ z, N


def _weighed(change: np.ndarray, nuisances: np.ndarray, rivals: list[Probed], rows: np.ndarray) -> dict[str, Any]:
    """D, rho and rival of one change of the readings."""
    lower = cholesky(np.eye(change.size) + nuisances @ nuisances.T, lower=True)

    def seen(columns: np.ndarray) -> np.ndarray:
        found: np.ndarray = solve_triangular(lower, columns, lower=True)
        return found

    g = seen(change)
    D = float(np.linalg.norm(g))
    unit = g / D if D > 0.0 else g
    like = [(_likeness(one.id, unit, seen(one.change), one.one_sided), one.id, one.form) for one in rivals]
    if rows.size:
        like.append((_likeness("bad_reading", unit, seen(rows), False), "bad_reading", USUAL["bad_reading"]))
    rho, rival, form = max(like, default=(0.0, None, None))
    rho = min(max(rho, 0.0), 1.0)
    probability = float(ndtr(D * np.sqrt((1.0 - rho) / 2.0)))
    return {"D": D, "rho": rho, "rival": rival, "form": form, "probability": probability}


def _likeness(name: str, unit: np.ndarray, columns: np.ndarray, one_sided: bool) -> float:
    """Correlation of a unit change with the best of an effect's shapes [-]."""
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)]
    if not columns.size:
        return 0.0
    if name == "once_per_rev_torque":  # sine and cosine: any phase
        return float(np.linalg.norm(np.linalg.qr(columns)[0].T @ unit))
    found = unit @ (columns / np.linalg.norm(columns, axis=0))
    return float(found.max() if one_sided else np.abs(found).max())
