"""What may be there beside a set without being seen: each further effect, in the linear model about the set.

An effect that the recording hardly shows is never named, and yet f_overall would be another with it. So f_overall is
averaged over the set alone and the set with each further effect, every one of them there or not by itself: one of the
listed effects is expected per rig. That is the prior of an interval; names are given by a harsher one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.diagnosis.steps.candidate import Candidate
from calibration.diagnosis.steps.name import BEYOND_SD, declared_sizes
from calibration.likelihood.compared import Compared
from calibration.likelihood.linearized import linearize
from calibration.likelihood.mode import Mode
from calibration.likelihood.signatures import Signature, log_gain, project

HARDLY = 0.05  # odds of an effect to the base model from which a recording hardly speaks against it,
ANOTHER = 4.0  # ... and sds of f_overall by which it then is another
DRAWS = 4000
FEWEST = 40  # draws that are possible; with fewer the effect is next to impossible


@dataclass(frozen=True)
class Undetected:
    """A further effect beside a set.

    `f_overall_z`, shape (n,): draws of f_overall with it, as its standard normal number [-].
    """

    effect: str
    odds: float
    f_overall_z: np.ndarray


def undetected(
    comparison: Compared, mode: Mode, found: Sequence[Signature], rng: np.random.Generator
) -> list[Undetected]:
    """Every further effect beside a set, with what f_overall would be."""
    problem = comparison.problem
    f = problem.place(problem.friction)
    if f is None:
        return []
    here = linearize(comparison, mode, mode.u)
    J = here.J
    A_inverse = np.linalg.inv(J.T @ J + np.eye(J.shape[1]))
    r = project(J, here.y)
    of_shapes: dict[str, list[tuple[float, np.ndarray]]] = {}
    for one in found:
        g = here.white(one.column) * here.good
        g_perp = project(J, g)
        gain, mean = log_gain(replace(one, one_sided=False), g, g_perp, r)
        sd = (float(g @ g_perp) + one.sd**-2) ** -0.5
        of_size = declared_sizes(problem, one.effect, next(iter(one.unknowns))[1])
        declared = {place: ratio for ratio, place in of_size if place is not None}
        places = [f, *declared]
        a = mean + sd * rng.standard_normal(DRAWS)
        others = rng.multivariate_normal(mode.z[places], A_inverse[np.ix_(places, places)], DRAWS, method="cholesky")
        others -= np.outer(a, (A_inverse @ (J.T @ g))[places])
        before = one.mean + one.sd * rng.standard_normal(DRAWS)
        possible, likely = np.ones(DRAWS, dtype=bool), np.ones(DRAWS, dtype=bool)
        if one.one_sided:
            possible, likely = a >= 0.0, before >= 0.0
        if declared:
            ratios = np.array(list(declared.values()))
            possible &= (np.abs(np.outer(a, ratios) + others[:, 1:]) >= BEYOND_SD).any(axis=1)
            drawn = rng.standard_normal((DRAWS, ratios.size))
            likely &= (np.abs(np.outer(before, ratios) + drawn) >= BEYOND_SD).any(axis=1)
        if possible.sum() < FEWEST or likely.sum() < FEWEST:
            continue
        bayes = gain + math.log(possible.mean() / likely.mean())
        of_shapes.setdefault(one.effect, []).append((bayes, others[possible, 0]))
    K = len(problem.effects_that_could())
    return [_over_shapes(name, shapes, K, rng) for name, shapes in of_shapes.items()]


def _over_shapes(name: str, shapes: Sequence[tuple[float, np.ndarray]], K: int, rng: np.random.Generator) -> Undetected:
    """One of K effects, averaged over the shapes of its law by their evidence."""
    factors = np.exp([bayes for bayes, _ in shapes])
    count = np.round(DRAWS * factors / factors.sum()).astype(int)
    drawn = [rng.choice(draws, n) for n, (_, draws) in zip(count, shapes, strict=True)]
    return Undetected(name, float(factors.mean()) / K, np.concatenate(drawn))


def behind_friction(comparison: Compared, base: Candidate, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Single effects that a recording hardly speaks against, and with which f_overall would be another."""
    f = comparison.problem.place(comparison.problem.friction)
    if f is None or comparison.rig:  # of other machines it was not tried
        return []
    far = ANOTHER * math.sqrt(base.mode.covariance[f, f])
    single = (c for c in candidates if len(c.names) == 1 and not c.refused)
    return [c for c in single if c.probability > HARDLY * base.probability and abs(c.mode.z[f] - base.mode.z[f]) > far]
