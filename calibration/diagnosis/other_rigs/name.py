"""Which set of effects explains the recording of another rig: all effects, then pairs grown from the best of them.

Evidence is Laplace's at each set's own noise level and correlation. The prior of a set falls tenfold with each further
member and is even over the sets of a size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import logsumexp

from calibration.diagnosis.other_rigs.fit import RigFit, fit_rig
from calibration.diagnosis.other_rigs.linear import linear, signatures
from calibration.diagnosis.other_rigs.noise import uncorrelated
from calibration.diagnosis.other_rigs.problem import RigProblem
from calibration.diagnosis.steps.candidate import Candidate, Refusal, at_bound, no_larger, vanishes
from calibration.diagnosis.steps.name import BEYOND_SD, log_prior
from model.effects import effects

SEEDS = 3  # single effects that pairs are grown from
SCREEN = 1.5  # nats that a further effect has to promise
WORTH = 3.0  # nats that a single effect gains before a pair is grown from it


def search(problem: RigProblem, base: RigFit, tell: Callable[[str], None]) -> list[Candidate]:
    """Sets of effects with their probabilities, the most probable first; the base model is always among them."""
    K = len(problem.could_show)
    fits: dict[tuple[str, ...], RigFit] = {(): base}
    for name in problem.could_show:
        tell(f"fit {name}")
        fits[(name,)] = fit_rig(problem, [name])
    singles = sorted((key for key in fits if key), key=lambda key: -fits[key].log_evidence)
    for seed in singles[:SEEDS]:
        if fits[seed].log_evidence < base.log_evidence + WORTH:
            break
        gains = screen(problem, fits[seed])
        for name in problem.could_show:
            key = tuple(sorted({*seed, name}))
            if key not in fits and gains.get(name, 0.0) > SCREEN:
                tell(f"fit {' and '.join(key)}")
                fits[key] = _better(problem, key, fits[seed])
    weight = {key: fit.log_evidence + log_prior(len(key), K) for key, fit in fits.items()}
    total = float(logsumexp(list(weight.values())))
    found = [
        Candidate(key, fit, fit.log_evidence, math.exp(weight[key] - total), refusal(problem, fit) if key else None)
        for key, fit in fits.items()
    ]
    return sorted(found, key=lambda one: -one.probability)


def screen(problem: RigProblem, fit: RigFit) -> dict[str, float]:
    """What each further effect would gain at most in the linear model, by its id [nats]."""
    view = linear(problem, fit)

    def white(parts: Sequence[np.ndarray]) -> np.ndarray:
        known = zip(problem.readings, parts, strict=True)
        scaled = [uncorrelated(part / fit.noise_scale[one.label], fit.correlation[one.label]) for one, part in known]
        return np.concatenate(scaled)

    J, r = white(view.jacobian), white(view.residual)
    A = J.T @ J + np.diag(view.prior.astype(float))
    A = A + 1e-9 * np.diag(np.maximum(np.diag(A), 1e-9))
    gains: dict[str, float] = {}
    for signature in signatures(view):
        g = white(signature.columns)
        size = float(g @ g - (J.T @ g) @ np.linalg.solve(A, J.T @ g))
        if size <= 1e-6 * float(g @ g) or size <= 0.0:
            continue
        z = float(g @ r - (J.T @ g) @ np.linalg.solve(A, J.T @ r + fit.point * view.prior * -1.0)) / math.sqrt(size)
        gain = 0.5 * z * z if z > 0.0 or not signature.one_sided else 0.0
        gains[signature.name] = max(gains.get(signature.name, 0.0), gain)
    return gains


def _better(problem: RigProblem, names: tuple[str, ...], start: RigFit) -> RigFit:
    """The better of two searches: an effect that vanishes on the way takes its shape's gradient with it."""
    both = [fit_rig(problem, names), fit_rig(problem, names, start)]
    return max(both, key=lambda fit: fit.log_evidence)


def refusal(problem: RigProblem, fit: RigFit) -> Refusal | None:
    """Why a set cannot be named: an amplitude at a bound, or a size that is its instrument's own."""
    for name in fit.names:
        amplitude = effects()[name].amplitude
        label = f"{name}.{amplitude.name}"
        if label in fit.at_bound:
            absent = amplitude.low == 0.0 and abs(fit.estimates[label].mean) < 1e-3 * abs(_high(problem, name))
            return vanishes(name) if absent else at_bound(name, amplitude.name)
        nuisance = effects()[name].nuisance  # where the rig has no such unknown, nothing is refused
        if nuisance:
            sd = next((u.b for u in problem.unknowns if u.name == nuisance), 0.0)
            instrument = fit.estimates.get(nuisance)
            size = fit.estimates[label].mean + (instrument.mean if instrument is not None else 0.0)
            if abs(size) < BEYOND_SD * sd:
                return no_larger(name)
    return None


def _high(problem: RigProblem, name: str) -> float:
    amplitude = effects()[name].amplitude.name
    found = [high for _, unknown, _, high in problem.effect_unknowns([name]) if unknown.name == amplitude]
    return float(np.max(found))
