"""Which test on another rig would part explanations that its recording cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from calibration.diagnosis.next_test.information import Expected
from calibration.diagnosis.next_test.recommend import MODEL_SD, NOTHING, NextTest, ranked, weigh
from calibration.diagnosis.other_rigs.coordinates import Coordinates
from calibration.diagnosis.other_rigs.problem import RigProblem
from calibration.diagnosis.steps.candidate import Candidate
from calibration.systems.system import Simulate

MOST_RIVALS = 3


def propose(problem: RigProblem, rivals: Sequence[Candidate]) -> list[NextTest]:
    """Tests ranked by what they would tell of the first few rivals, the mean over their pairs."""
    tests = problem.system.tests(partial(_noise, problem, rivals))
    weighed = rivals[:MOST_RIVALS]
    if len(weighed) < 2:
        return []
    names = [_words(one) for one in weighed]
    found = (weigh(text, names, partial(_each, problem, weighed, simulate)) for text, simulate in tests.items())
    return ranked([one for one in found if one])


def _words(one: Candidate) -> str:
    return "+".join(one.names) or NOTHING


def _each(problem: RigProblem, rivals: Sequence[Candidate], simulate: Simulate) -> list[Expected]:
    return [_expected(problem, one, simulate) for one in rivals]


def _expected(problem: RigProblem, one: Candidate, simulate: Simulate) -> Expected:
    """What a test would read if an explanation holds, with what the fit leaves open, in its noise."""
    at, x = Coordinates(problem, one.names), one.mode.point
    here, sd = simulate(*at.values(x))
    slopes = np.empty((here.size, x.size))
    for i in range(x.size):
        step = min(0.1, max(1e-3, 0.1 * float(np.sqrt(one.mode.covariance[i, i]))))
        step = step if x[i] + step <= at.high[i] else -step
        moved = x.copy()
        moved[i] += step
        slopes[:, i] = (simulate(*at.values(moved))[0] - here) / step
    shared = slopes @ one.mode.covariance @ slopes.T + np.diag((MODEL_SD * here) ** 2)
    return Expected(here / sd, shared / np.outer(sd, sd), np.eye(here.size))


def _noise(problem: RigProblem, rivals: Sequence[Candidate], channel: str) -> float:
    """Noise of one reading of a channel as the best explanation has it [SI]; infinite where there is none."""
    of_channel = [one for one in problem.readings if one.channel == channel and one.value.size]
    if not of_channel:
        return float("inf")
    return float(np.median([np.median(one.sd) * rivals[0].mode.noise_scale[one.label] for one in of_channel]))
