"""What the tests that a machine could make would read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from calibration.likelihood.expected import MODEL_SD, Expected, Test, directions
from calibration.likelihood.mode import Mode
from calibration.systems.machines.problem import Problem
from calibration.systems.machines.system import Simulate

STEP, LEAST_STEP, SHARE = 0.1, 1e-5, 0.1  # of a derivative: at most, at least, and in standard deviations


def tests(problem: Problem, rivals: Sequence[Mode]) -> Iterator[Test]:
    """Tests that a machine could make. `rivals`: the explanations, the most probable first."""
    for words, simulate in problem.system.tests(partial(_noise, problem, rivals[0])).items():
        yield Test(words, "", partial(_each, problem, simulate))


def _each(problem: Problem, simulate: Simulate, rivals: Sequence[Mode]) -> list[Expected]:
    return [_expected(problem, one, simulate) for one in rivals]


def _expected(problem: Problem, one: Mode, simulate: Simulate) -> Expected:
    """What a test would read if an explanation holds, with what the recording leaves open, in its noise."""
    k = len(problem.nuisances)

    def read(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return simulate(problem.values(z[:k]), problem.chosen(one.names, z[k:]))

    here, sd = read(one.z)
    slopes = np.empty((here.size, one.z.size))
    for i in range(one.z.size):
        step = min(STEP, max(LEAST_STEP, SHARE * float(np.sqrt(one.covariance[i, i]))))
        slopes[:, i] = (read(one.z + step * np.eye(one.z.size)[i])[0] - here) / step
    open_ = slopes @ directions(one.covariance) / sd[:, None]
    return Expected(here / sd, open_, np.diag((MODEL_SD * here / sd) ** 2), np.eye(here.size))


def _noise(problem: Problem, best: Mode, channel: str) -> float:
    """Noise of one reading of a channel as the best explanation has it [SI]; infinite where there is none."""
    found = [
        float(np.median(one.sd) * np.exp(u))
        for one, u in zip(problem.readings, best.u, strict=False)
        if one.channel == channel and one.value.size
    ]
    return float(np.median(found)) if found else float("inf")
