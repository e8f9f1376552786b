"""Whether a recording can tell what is concealed from every other effect, by the second rig's own signatures.

D is the size of the effect's change of the readings in units of noise, once the nuisances with their declared priors
are projected out; rho is its largest correlation with the change that another single effect makes. A best fit prefers
the right one of two with probability Phi(D sqrt((1 - rho) / 2)).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import ndtr

from calibration.challenge.second_rig import bench
from calibration.challenge.second_rig.signatures import Whitened, asked_of
from calibration.challenge.second_rig.truth import Truth
from rig.recording import read_recording

LEAST_D = 7.0
LEAST_PROBABILITY = 0.99
FREE = 10.0  # another concealed effect is free within ten times its size


def separable(truth: Truth, folder: Path) -> dict[str, Any]:
    """Size and likeness of what is concealed, for the files of one recording.

    Of two effects each is weighed with the other one free, and the worse one counts.

    Parameters
    ----------
    truth : Truth
        The case.
    folder : Path
        Its recording, with or without a further test.

    Returns
    -------
    dict
        ``D``, ``rho``, ``rival`` (the id that rho is with) and ``separable``; D 0 where nothing is concealed.
    """
    if not truth.effects:
        return {"D": 0.0, "rho": 0.0, "rival": None, "separable": False}
    recording = read_recording(Path(folder))
    rig = truth.rig(recording.added_inertia_kg_m2)
    base = bench.without(rig, ())
    whitened = Whitened(asked_of(recording, truth.errors), base)
    everything = whitened.readings(rig)
    nuisances = whitened.nuisances()
    rivals = [one for one in whitened.effects() if one[0] not in truth.ids]
    rows = whitened.rows() if "bad_reading" not in truth.ids else np.empty((everything.size, 0))
    own = []
    for k, effect in enumerate(rig.effects):
        others = tuple(other for i, other in enumerate(rig.effects) if i != k)
        own.append((effect.id, everything - whitened.readings(bench.without(rig, others))))
    worst: dict[str, Any] = {}
    for k, (_, change) in enumerate(own):
        free = [FREE * other for i, (_, other) in enumerate(own) if i != k]
        found = _weighed(change, np.column_stack([nuisances, *free]), rivals, rows)
        if not worst or found["probability"] < worst["probability"]:
            worst = found | {"D": min(found["D"], worst.get("D", np.inf))}
        else:
            worst["D"] = min(found["D"], worst["D"])
    probability = worst.pop("probability")
    enough = worst["D"] >= LEAST_D and probability >= LEAST_PROBABILITY
    return worst | {"separable": bool(enough and truth.ids != ["unknown"])}


def _weighed(
    change: np.ndarray, nuisances: np.ndarray, rivals: list[tuple[str, np.ndarray, bool]], rows: np.ndarray
) -> dict[str, Any]:
    """D, rho and rival of one change of the readings."""
    lower = cholesky(np.eye(change.size) + nuisances @ nuisances.T, lower=True)

    def seen(columns: np.ndarray) -> np.ndarray:
        found: np.ndarray = solve_triangular(lower, columns, lower=True)
        return found

    g = seen(change)
    D = float(np.linalg.norm(g))
    unit = g / D if D > 0.0 else g
    like = [(_likeness(name, unit, seen(columns), one_sided), name) for name, columns, one_sided in rivals]
    if rows.size:
        like.append((_likeness("bad_reading", unit, seen(rows), False), "bad_reading"))
    rho, rival = max(like, default=(0.0, None))
    rho = min(max(rho, 0.0), 1.0)
    return {"D": D, "rho": rho, "rival": rival, "probability": float(ndtr(D * np.sqrt((1.0 - rho) / 2.0)))}


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
