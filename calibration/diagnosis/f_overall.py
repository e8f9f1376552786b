"""f_overall of a diagnosis: of the base model alone, and averaged over what the verdict leaves open."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from calibration.diagnosis.result import Diagnosis
from calibration.likelihood.mode import Mode

DRAWS = 8000  # that an average is made of
# Share of what a set moves f_overall by that is not known (1 sd), for a law may have another form than the list's. In
# the challenge's sixth to ninth campaign, opened, 181 instead of 165 intervals of 210 beside effects held it then.
FORM = 0.2
# How far two solutions of the article's equations, one with ports that open at a finite rate, disagree about f_overall
# where spin-ups and coast-downs weigh in: 0.8 % twice, where the noise alone allowed 0.3 %.
SOLVERS_DIFFER = 0.006

Draw = Callable[[int, np.random.Generator], np.ndarray]  # so many draws of f_overall's standard normal number
Part = tuple[float, Draw]  # what f_overall is averaged over: a weight, and draws


def f_overall_before(found: Diagnosis) -> dict[str, float] | None:
    """Mean, spread and 5 and 95 % quantiles of f_overall in the base model [N m s]; None where it is no unknown."""
    problem = found.comparison.problem
    place = problem.place(problem.friction)
    return None if place is None else _summary(found, place, [_alone(found, place, found.base, 1.0)])


def f_overall_after(found: Diagnosis) -> dict[str, float] | None:
    """The same, averaged over what the verdict leaves open [N m s]."""
    problem = found.comparison.problem
    place = problem.place(problem.friction)
    return None if place is None else _summary(found, place, _averaged(found, place))


def of_solvers(found: Diagnosis) -> float:
    """Share of f_overall that is not known for its solver (1 sd) [-]."""
    return SOLVERS_DIFFER if found.comparison.in_time else 0.0


def _averaged(found: Diagnosis, place: int) -> list[Part]:
    """Sets named or listed, each alone and with every further effect that may be there unseen.

    A further effect is there with the odds that the linear model gives it, at most even ones: else it would have been
    said. Where the two were refitted together, the refit is taken, or none where that could not be believed.
    """
    if found.nuisances_corrected is not None:
        return [(1.0, _normal(found.nuisances_corrected[0][place], found.nuisances_corrected[1][place]))]
    if not found.undetected:  # unresolved, and nothing to stand beside the model: all that was refitted may be there
        return [_alone(found, place, c.mode, c.probability) for c in found.candidates if not c.refused]
    refitted = {c.names: c for c in found.candidates}
    log_K = math.log(len(found.comparison.problem.effects_that_could()))
    parts: list[Part] = []
    for names, further in found.undetected.items():
        one = refitted[names]
        parts.append(_alone(found, place, one.mode, one.probability))
        for extra in further:
            both = refitted.get(tuple(sorted((*names, extra.effect))))
            if both is None:
                form = FORM * abs(one.mode.z[place] - found.base.z[place])
                parts.append((one.probability * min(extra.odds, 1.0), _among(extra.f_overall_z, form)))
            elif not both.refused and both.names not in found.undetected:
                odds = math.exp(min(both.log_evidence - one.log_evidence, log_K) - log_K)
                parts.append(_alone(found, place, both.mode, max(one.probability * odds, both.probability)))
    return parts


def _alone(found: Diagnosis, place: int, mode: Mode, weight: float) -> Part:
    # Without an effect that is all there is, a machine's friction is another one: that move is no doubt about its form.
    form = 0.0 if found.comparison.rig else FORM * (mode.z[place] - found.base.z[place])
    return weight, _normal(mode.z[place], math.hypot(math.sqrt(mode.covariance[place, place]), form))


def _normal(mean: float, sd: float) -> Draw:
    def draw(n: int, rng: np.random.Generator) -> np.ndarray:
        return mean + sd * rng.standard_normal(n)

    return draw


def _among(draws: np.ndarray, sd: float) -> Draw:
    def draw(n: int, rng: np.random.Generator) -> np.ndarray:
        return rng.choice(draws, n) + sd * rng.standard_normal(n)

    return draw


def _summary(found: Diagnosis, place: int, parts: list[Part]) -> dict[str, float]:
    problem, rng = found.comparison.problem, np.random.default_rng(0)
    total = sum(weight for weight, _ in parts) or 1.0
    z = np.concatenate([draw(round(DRAWS * weight / total), rng) for weight, draw in parts])
    low, high = (bound[place] for bound in problem.bounds())
    x = problem.nuisances[place].value(np.clip(z, low, high))
    x = x * (1.0 + of_solvers(found) * rng.standard_normal(z.size))
    q05, q95 = np.quantile(x, [0.05, 0.95])
    return {"mean": float(x.mean()), "sd": float(x.std()), "q05": float(q05), "q95": float(q95)}
