"""How large the effects of a set are, and how well that is known."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from calibration.diagnosis.steps.candidate import Candidate
from calibration.likelihood.compared import Problem
from calibration.likelihood.tails import reweighed_sizes
from calibration.unknowns.priors import Unknown
from model.effects import EffectParameter

# Share of a size that is not known (1 sd), for an effect's law is no more exact than the motor's. In the challenge's
# sixth to tenth campaign, opened, 104 instead of 94 intervals of 112 held the size of what was rightly named then.
LAW = 0.04
STEP = 1e-3  # in z, for the slope of a value


@dataclass(frozen=True)
class Size:
    """One parameter of an effect.

    `z`, `sd`: of a size the mean, in its scale, and its spread, with what is not known of the law; of a figure of the
        shape its most probable standard normal number, and likewise [-].
    """

    effect: str
    parameter: EffectParameter
    unknown: Unknown
    z: float
    sd: float


def sizes_of(problem: Problem, one: Candidate) -> list[Size]:
    """The parameters of a set's effects, in the set's order."""
    k, members = len(problem.nuisances), problem.effect_unknowns(one.names)
    z, sd = one.mode.z[k:].copy(), np.sqrt(np.maximum(np.diag(one.mode.covariance)[k:], 0.0))
    sizes, pulled_less = reweighed_sizes(problem, one.names, one.mode.z, one.mode.covariance)
    places = [i for i, (name, unknown) in enumerate(members) if (name, unknown.name) in sizes]
    z[places], sd[places] = pulled_less.z, pulled_less.sd
    chosen = problem.chosen(one.names, z)
    found = []
    for i, (name, unknown) in enumerate(members):
        declared = {p.name: problem.parameter(name, p.name) for p in problem.effect(name).parameters}
        parameter = declared[unknown.name]
        # Sine and cosine are one size in two parts; a figure of the shape stands alone.
        whose = {one.name: one.whose for effect, one in members if effect == name}
        own = [p for p in chosen[name] if whose.get(p, "") == unknown.whose]
        mine = [unknown.name] if parameter.shape else [p for p in own if not declared[p].shape]
        off = LAW * math.hypot(*(chosen[name][p] for p in mine))
        low, high = unknown.value(z[i] + STEP * np.array([-1.0, 1.0]))
        slope = float(high - low) / (2.0 * STEP)
        found.append(Size(name, parameter, unknown, float(z[i]), math.hypot(sd[i], off / slope)))
    return found
