"""Whether the named set predicts readings of another rig that it has not seen: blocks held out, or an unseen run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.other_rigs.coordinates import Coordinates
from calibration.diagnosis.other_rigs.fit import RigFit
from calibration.diagnosis.other_rigs.linear import Linear, linear
from calibration.diagnosis.other_rigs.noise import uncorrelated
from calibration.diagnosis.other_rigs.problem import RigProblem
from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.confirm import HeldOut
from calibration.diagnosis.steps.name import log_prior
from calibration.diagnosis.steps.unseen import SCHEME
from calibration.systems.system import FOLDS

WEIGHED = 6  # most probable sets among which each fold chooses
RIDGE = 1e-9


@dataclass(frozen=True)
class _View:
    """A candidate whose readings are made independent, one after the other."""

    one: Candidate
    linear: Linear
    r: np.ndarray
    J: np.ndarray
    log_scale: np.ndarray
    error: np.ndarray
    D: np.ndarray


def cross_validate(problem: RigProblem, found: Sequence[Candidate], names: tuple[str, ...]) -> HeldOut:
    """Predict each block from the others, the sets weighed anew in each fold."""
    allowed = [c for c in found if c.names and not c.refused][:WEIGHED]
    views = [_view(problem, c) for c in [*(c for c in found if not c.names), *allowed]]
    blocks, scheme = problem.system.folds()
    K = len(problem.could_show)
    whole = [_fit(view, np.ones(view.r.size, dtype=bool))[2] for view in views]
    gains, same = [], 0
    before, after, rows = [], [], []
    for held in blocks:
        fits = [_fit(view, ~held) for view in views]
        scored = [
            view.one.log_evidence + fit[2] - all_of + log_prior(len(view.one.names), K)
            for view, fit, all_of in zip(views, fits, whole, strict=True)
        ]
        best = int(np.argmax(scored))
        same += views[best].one.names == names
        density0, error0 = _predict(views[0], *fits[0][:2], held)
        density, error = _predict(views[best], *fits[best][:2], held)
        gains.append(density - density0)
        before.append(error0)
        after.append(error)
        rows.append(np.flatnonzero(held))
    channel = np.concatenate([np.full(one.value.size, _key(problem, one.channel)) for one in problem.readings])
    value = np.concatenate([one.value for one in problem.readings])
    index = np.concatenate(rows)
    return HeldOut(
        len(blocks),
        int(same),
        _rms(channel[index], np.concatenate(before)),
        _rms(channel[index], np.concatenate(after)),
        float(np.sum(gains)),
        _se(gains),
        f"{scheme}, selection repeated in each fold",
        _rms(channel[index], value[index]),
    )


def unseen(problem: RigProblem, base: RigFit, best: RigFit, other: RigProblem) -> HeldOut:
    """Predict another recording of the same rig, of which nothing was used."""
    densities, errors = [], []
    for fit in (base, best):
        x, covariance = _carried(problem, fit, other)
        view = linear(other, fit, x)
        density = []
        for one, r, J in zip(other.readings, view.residual, view.jacobian, strict=True):
            scale, rho = _noise_of(problem, fit, one.channel)
            white, columns = uncorrelated(r / scale, rho), uncorrelated(J / scale, rho)
            for part in np.array_split(np.arange(r.size), FOLDS):
                C = np.eye(part.size) + columns[part] @ covariance @ columns[part].T
                value = -0.5 * float(white[part] @ np.linalg.solve(C, white[part]))
                density.append(value - 0.5 * float(np.linalg.slogdet(C)[1]) - part.size * _log(scale, rho))
        densities.append(np.array(density))
        errors.append(np.concatenate(view.raw))
    channel = np.concatenate([np.full(one.value.size, _key(other, one.channel)) for one in other.readings])
    gains = densities[1] - densities[0]
    return HeldOut(
        1,
        1,
        _rms(channel, errors[0]),
        _rms(channel, errors[1]),
        float(gains.sum()),
        _se(gains),
        SCHEME,
        _rms(channel, np.concatenate([one.value for one in other.readings])),
    )


def _view(problem: RigProblem, one: Candidate) -> _View:
    view = linear(problem, one.mode)
    r, J, logs = [], [], []
    for readings, white, columns in zip(problem.readings, view.residual, view.jacobian, strict=True):
        scale, rho = one.mode.noise_scale[readings.label], one.mode.correlation[readings.label]
        r.append(uncorrelated(white / scale, rho))
        J.append(uncorrelated(columns / scale, rho))
        logs.append(np.full(white.size, _log(scale, rho)))
    return _View(one, view, *(np.concatenate(part) for part in (r, J, logs, view.raw, view.slopes)))


def _log(scale: float, rho: float) -> float:
    return math.log(scale) + 0.5 * math.log(1.0 - rho * rho)


def _fit(view: _View, used: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Most probable point, precision and log evidence on some of the readings, in the linear model."""
    x, prior = view.one.mode.point, view.linear.prior.astype(float)
    J = view.J * used[:, None]
    r = (view.r + view.J @ x) * used
    A = J.T @ J + np.diag(prior)
    A = A + RIDGE * np.diag(np.maximum(np.diag(A), RIDGE))
    z = np.linalg.solve(A, J.T @ r)
    rest = r - J @ z
    cost = 0.5 * float(rest @ rest + prior @ z**2) + float(np.sum(view.log_scale[used]))
    return z, A, -cost - 0.5 * float(np.linalg.slogdet(A)[1])


def _predict(view: _View, z: np.ndarray, A: np.ndarray, held: np.ndarray) -> tuple[float, np.ndarray]:
    """Log density of held-out readings, and their errors [SI]."""
    moved = view.one.mode.point - z
    r, J = (view.r + view.J @ moved)[held], view.J[held]
    C = np.eye(r.size) + J @ np.linalg.solve(A, J.T)
    density = -0.5 * float(r @ np.linalg.solve(C, r)) - 0.5 * float(np.linalg.slogdet(C)[1])
    return density - float(np.sum(view.log_scale[held])), (view.error + view.D @ moved)[held]


def _carried(problem: RigProblem, fit: RigFit, other: RigProblem) -> tuple[np.ndarray, np.ndarray]:
    """A fit's point and covariance in the coordinates of another recording; its own unknowns start as they would."""
    here, there = Coordinates(problem, fit.names), Coordinates(other, fit.names)
    x = there.x.copy()
    covariance = np.diag(np.where(np.arange(x.size) < there.n_flat, 0.0, 1.0))
    shared = [(here.labels.index(label), i) for i, label in enumerate(there.labels) if label in here.labels]
    ratio = np.ones(x.size)
    for k, i in shared:
        if i < there.n_flat and k < here.n_flat:
            ratio[i] = here.flats[k].size / there.flats[i].size
            x[i] = fit.point[k] * ratio[i]
            continue
        unknown, mine = there.unknowns[i - there.n_flat], here.unknowns[k - here.n_flat]
        x[i] = unknown.z(float(mine.value(np.asarray(fit.point[k]))))
        ratio[i] = mine.b / unknown.b if unknown.kind == "normal" else math.log(mine.b) / math.log(unknown.b)
    old, new = ([pair[j] for pair in shared] for j in (0, 1))
    covariance[np.ix_(new, new)] = fit.covariance[np.ix_(old, old)] * np.outer(ratio[new], ratio[new])
    return np.clip(x, there.low, there.high), covariance


def _noise_of(problem: RigProblem, fit: RigFit, channel: str) -> tuple[float, float]:
    """Noise scale and correlation of a channel, the mean over its arrays."""
    labels = [one.label for one in problem.readings if one.channel == channel and one.value.size]
    scale = float(np.exp(np.mean([math.log(fit.noise_scale[label]) for label in labels])))
    return scale, float(np.mean([fit.correlation[label] for label in labels]))


def _key(problem: RigProblem, channel: str) -> str:
    if channel == "drive":
        return "force_n" if problem.slides else "torque_nm"
    return {"speed": "speed_rad_s", "flow": "flow_m3_s"}[channel]


def _rms(channel: np.ndarray, values: np.ndarray) -> dict[str, float]:
    return {str(key): float(np.sqrt(np.mean(values[channel == key] ** 2))) for key in np.unique(channel)}


def _se(gains: Sequence[float] | np.ndarray) -> float:
    gain = np.asarray(gains, dtype=float)
    return float(np.std(gain, ddof=1) * math.sqrt(gain.size)) if gain.size > 1 else 0.0
