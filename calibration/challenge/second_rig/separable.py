"""Whether a recording can tell what is concealed from every other effect, by the second rig's own signatures.

D is the size of the effect's change of the readings in units of noise, once the nuisances with their declared priors
have taken up what they can. They are followed as they are, not along straight lines: what moves f_overall by a tenth
moves everything by hundreds of sds, and then the bend of a line alone would pass for something seen. rho is the
change's largest correlation with the change that another single effect makes, in any form that the rig knows of it: a
leak through a hole adds what an offset of the flow meter does, one through a gap does not. A best fit prefers the right
one of two with probability Phi(D sqrt((1 - rho) / 2)).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import ndtr

from calibration.challenge.second_rig import bench
from calibration.challenge.second_rig.concealed import USUAL, Concealed
from calibration.challenge.second_rig.draws import WIDTHS
from calibration.challenge.second_rig.machine.marches import roller_arm
from calibration.challenge.second_rig.signatures import INERTIA, ROLLER, Probed, Whitened, asked_of
from calibration.challenge.second_rig.sizes import SEAL_PER_ROLLER_M3
from calibration.challenge.second_rig.truth import Truth
from rig.recording import read_recording

LEAST_D = 7.0
LEAST_PROBABILITY = 0.99
FREE = 10.0  # another concealed effect is free within ten times its size
STEPS = 16  # most that the nuisances go
SHARES = (1.0, 0.5, 0.25, 0.1)  # of a step, tried in turn until one comes nearer
GAINED, AGAIN = 0.1, 0.1  # share of the distance that a step of f_overall has to gain; sds after which lines are new
SETTLED = 1e-3  # share of the distance that a step has to gain
FARTHEST = 5.0  # declared sds that a nuisance may go
FAINT = 3.0  # D below which it does not matter how small it is


def separable(truth: Truth, folder: Path) -> dict[str, Any]:
    """Size and likeness of what is concealed, for the files of one recording.

    Of two effects each is weighed with the other one free, and the worse one counts. The other one in another form is a
    rival too: it alone may pass for both. What is too small to be seen, or in no library, is not held against rivals.

    Returns ``D``, ``rho``, ``rival`` (the id that rho is with), ``form`` (its form) and ``separable``; D 0 where
    nothing is concealed, None for rho, rival and form where no rival was tried.
    """
    found: dict[str, Any] = {"D": 0.0, "rho": None, "rival": None, "form": None, "separable": False}
    if not truth.effects:
        return found
    recording = read_recording(Path(folder))
    rig = truth.rig(recording.added_inertia_kg_m2)
    base = bench.without(rig, ())
    whitened = Whitened(asked_of(recording, truth), base)
    everything = whitened.readings(rig)
    nuisances = whitened.nuisances()
    rests = [bench.without(rig, [*rig.effects[:k], *rig.effects[k + 1 :]]) for k in range(len(rig.effects))]
    changes = [everything - whitened.readings(rest) for rest in rests]
    seen = []
    for k, (rest, change) in enumerate(zip(rests, changes, strict=True)):
        others = [np.empty((change.size, 0)), *(FREE * other for i, other in enumerate(changes) if i != k)]
        free, alike = np.column_stack(others), hidden_in(rig.effects[k], rest, whitened)
        seen.append(Seen(*_taken_up(whitened, everything, rest, change, nuisances, free, alike)))
    found["D"] = min(one.D for one in seen)
    if found["D"] < LEAST_D or truth.ids == ["unknown"]:
        return found
    probed = whitened.effects()
    rows = whitened.rows() if "bad_reading" not in truth.ids else np.empty((everything.size, 0))
    nearest = []
    for one, rest in zip(seen, rests, strict=True):
        rivals = [rival for rival in probed if rival.id not in truth.ids]
        for other in rest.effects:
            same = (rival for rival in probed if rival.id == other.id and rival.form != other.form)
            rivals += [replace(rival, one_sided=False) for rival in same]
        nearest.append(one.nearest(rivals, rows))
    worst = min(nearest, key=lambda like: like["probability"])
    found["separable"] = bool(worst.pop("probability") >= LEAST_PROBABILITY)
    return found | worst


class Seen:
    """A change of the readings as it is seen once the nuisances have taken up what they can.

    `change`, shape (m,): of the readings [-].
    `nuisances`, shape (m, k): what each of them changes per declared sd [-].
    """

    def __init__(self, change: np.ndarray, nuisances: np.ndarray) -> None:
        self._lower = cholesky(np.eye(change.size) + nuisances @ nuisances.T, lower=True)
        seen = self._seen(change)
        self.D = float(np.linalg.norm(seen))
        self._unit = seen / self.D if self.D > 0.0 else seen

    def _seen(self, columns: np.ndarray) -> np.ndarray:
        return solve_triangular(self._lower, columns, lower=True)

    def nearest(self, rivals: Sequence[Probed], rows: np.ndarray) -> dict[str, Any]:
        """The likest of the rivals: ``rho``, ``rival``, ``form`` and the probability that a best fit prefers the truth.

        `rows`, shape (m, rows): what one misread reading changes [-].
        """
        like = [(self._likeness(one.id, one.change, one.one_sided), one.id, one.form) for one in rivals]
        if rows.size:
            like.append((self._likeness("bad_reading", rows, False), "bad_reading", USUAL["bad_reading"]))
        rho, rival, form = max(like)
        rho = min(max(rho, 0.0), 1.0)
        probability = float(ndtr(self.D * np.sqrt((1.0 - rho) / 2.0)))
        return {"rho": rho, "rival": rival, "form": form, "probability": probability}

    def _likeness(self, name: str, change: np.ndarray, one_sided: bool) -> float:
        """Correlation with the best of an effect's shapes [-]."""
        columns = self._seen(change)
        size = np.linalg.norm(columns, axis=0)
        columns = columns[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)]
        if not columns.size:
            return 0.0
        if name == "once_per_rev_torque":  # sine and cosine: any phase
            return float(np.linalg.norm(np.linalg.qr(columns)[0].T @ self._unit))
        found = self._unit @ (columns / np.linalg.norm(columns, axis=0))
        return float(found.max() if one_sided else np.abs(found).max())


def hidden_in(effect: Concealed, rest: bench.Rig, whitened: Whitened) -> np.ndarray | None:
    """Where a nuisance alone makes about the same of the readings as an effect, shape (k,); None where none does.

    A roller factor several times its own, or an inertia, lies at the end of a curved valley along which a search from
    the middle of the priors stops: of an effect in the form of one it is told where that ends.
    """
    z, v = np.zeros(whitened.steps.size), effect.values
    if effect.id == "inertia":
        z[INERTIA] = np.log1p(v["share"]) / WIDTHS["declared"]["inertia"]
    elif effect.id in ("load_friction", "coulomb_friction"):
        if effect.id == "coulomb_friction":
            extra = v["torque_nm"] / roller_arm(whitened.mean_line - rest.nuisances["ambient_pa"])
        else:
            extra = v.get("roller_factor", v.get("torque_per_pressure_m3", 0.0) / SEAL_PER_ROLLER_M3)
        own = rest.nuisances["roller_factor"]
        z[ROLLER] = np.log(1.0 + max(extra, 0.0) / own) / WIDTHS["declared"]["roller_factor"]
    else:
        return None
    return np.clip(z, -FARTHEST, FARTHEST)


def _taken_up(
    whitened: Whitened,
    everything: np.ndarray,
    rest: bench.Rig,
    change: np.ndarray,
    nuisances: np.ndarray,
    free: np.ndarray,
    alike: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """A change of the readings less what the nuisances take up of it beyond what straight lines would, and those lines.

    Projected on them it has the size that is left at the nearest point which the nuisances reach: there N^T e = z, so
    that (e + N z)^T (1 + N N^T)^-1 (e + N z) = e^T e + z^T z. The point is looked for from the middle of the priors,
    and from where a nuisance is known to be alike.
    """
    k, f = nuisances.shape[1], free.shape[1]

    def left(z: np.ndarray) -> np.ndarray:
        return everything - whitened.moved(rest, z[:k]) - free @ z[k:]

    z = np.zeros(k + f)
    ends = [_nearest(whitened, rest, left, z, change, np.column_stack([nuisances, free]), free, False)]
    if alike is not None and _distance(ends[0]) > FAINT**2:
        z = np.append(alike, np.zeros(f))
        ends.append(_nearest(whitened, rest, left, z, left(z), _lines(whitened, rest, z, free), free, True))
    z, e, N = min(ends, key=_distance)
    return e + N @ z, N


def _distance(end: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """Of the readings from what the nuisances reach at the end of a search, and of that from the priors' middle."""
    z, e, _ = end
    return float(e @ e + z @ z)


def _lines(whitened: Whitened, rest: bench.Rig, z: np.ndarray, free: np.ndarray) -> np.ndarray:
    """What nuisances and free effects change at a point, shape (m, k + f)."""
    return np.column_stack([whitened.nuisances(rest, z[: z.size - free.shape[1]]), free])


def _nearest(
    whitened: Whitened,
    rest: bench.Rig,
    left: Callable[[np.ndarray], np.ndarray],
    z: np.ndarray,
    e: np.ndarray,
    N: np.ndarray,
    free: np.ndarray,
    fresh: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest point that steps from one lead to: the unknowns, what is left there, and the lines.

    Old lines are used as long as they lead nearer, what multiplies growing with its value; then they are taken anew.
    """
    k = z.size - free.shape[1]
    moved = False
    if whitened.asked.runs:
        z, e, moved = _friction_first(whitened, left, z, e, N[:, 0])
    if moved:
        N, fresh = _lines(whitened, rest, z, free), True
    far = float(e @ e + z @ z)
    per_one = N[:, :k] / whitened.grown(z[:k])
    for _ in range(STEPS):
        step, nearer = np.linalg.solve(np.eye(z.size) + N.T @ N, N.T @ e - z), False
        for share in SHARES:
            tried = z + share * step
            tried[:k] = np.clip(whitened.wrapped(rest, tried[:k]), -FARTHEST, FARTHEST)
            there = left(tried)
            distance = float(there @ there + tried @ tried)
            if distance < far:
                nearer = distance < (1.0 - SETTLED) * far
                z, e, far = tried, there, distance
                N, fresh = np.column_stack([per_one * whitened.grown(z[:k]), free]), False
                break
        if nearer:
            continue
        if fresh or far < FAINT**2:
            break  # where old lines lead nowhere, new ones may
        N, fresh = _lines(whitened, rest, z, free), True
        per_one = N[:, :k] / whitened.grown(z[:k])
    return z, e, N


def _friction_first(
    whitened: Whitened, left: Callable[[np.ndarray], np.ndarray], z: np.ndarray, e: np.ndarray, line: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """The point to which f_overall alone leads, what is left there, and whether that is another one.

    It is the one nuisance that nothing declares: it goes far, and on a bent way the others would go astray with it.
    """
    start, far = z[0], float(e @ e + z @ z)
    for _ in range(STEPS):
        step = float(line @ e - z[0]) / (1.0 + float(line @ line))
        for share in SHARES:
            tried = z.copy()
            tried[0] = np.clip(z[0] + share * step, -FARTHEST, FARTHEST)
            there = left(tried)
            distance = float(there @ there + tried @ tried)
            if distance < far:
                break
        else:
            break
        gained, line = far - distance, line * whitened.grown(tried)[0] / whitened.grown(z)[0]
        z, e, far = tried, there, distance
        if gained < GAINED * far:
            break
    return z, e, abs(z[0] - start) > AGAIN
