"""Simulation-based calibration of the most probable point and its spread, in strata, and against emcee.

A case is a recording drawn from the priors (`strata_draw`). The model that it was drawn from is found as a diagnosis
finds it, and the truth is ranked in Laplace's approximation: f_overall, the effect's size, the log likelihood. Where
all is right, ranks are uniform (Talts et al. 2018, arXiv:1804.06788). Some cases are sampled by emcee too. What a
diagnosis adds to its intervals for what no model has (`FORM`, `LAW`) is left out.

    python -m calibration.studies.strata -o out/strata       # resumable: a case that is there is not made again
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import numpy as np
from scipy.special import ndtr

from calibration.fit import whole
from calibration.fit.fit import NotConvergedError
from calibration.fit.peak import NoPeakError
from calibration.fit.sampling import Settings
from calibration.likelihood.compared import Prediction
from calibration.likelihood.descent import find
from calibration.likelihood.function import Function
from calibration.likelihood.mode import Mode, cost_at, robust_weights
from calibration.likelihood.tails import log_ratio, reweighed_sizes
from calibration.studies import strata_table
from calibration.studies.campaigns import Study, main, whole_number
from calibration.studies.strata_draw import STRATA, Case, case_of
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.noise import SAMPLES
from calibration.work.many import Item
from calibration.work.sources import DIAGNOSIS

DRAWS = 63  # that a log likelihood is ranked among
POOL = 4096  # of which they are chosen, by what the longer tails and the bounds say
SWEEPS, WITH_RUNS, EMCEE = 200, 60, 50
SETTINGS = {"effective_samples": 500, "most_steps": 2000}
EMCEE_STRATA = ("sweep", "sweep_effect", "two_days", "sweep_effect", "runs") * 2 + ("runs_effect",)  # in turn
EMCEE_SEEDS = 50_000  # from the first on, of cases that emcee samples


def calibrate(argument: Mapping[str, Any]) -> dict[str, Any]:
    """One case.

    `argument`: ``stratum``, ``seed``, and whether ``emcee`` samples it too.
    Returns ``stratum``, ``effect``, ``tries``; ``behind``, how far the point found is less probable than the truth
    [nats]; ``at_bound``, whether the effect's size is at a bound there; ``truth`` of each quantity in prior sds;
    ``laplace`` and ``emcee``, of each quantity the ``mean`` and the ``sd`` in prior sds and the truth's ``rank`` (0 to
    1), and ``seconds``; where emcee has none, ``emcee`` is None and ``why`` says why.
    """
    case = case_of(STRATA[argument["stratum"]], argument["seed"])
    rng, comparison = np.random.default_rng([argument["seed"], 1]), case.comparison
    f, begun = Function(comparison, case.names), time.monotonic()
    mode = _most_probable(case)
    laplace = _by_laplace(case, f, mode, rng) | {"seconds": time.monotonic() - begun}
    found_cost = cost_at(comparison, mode.z, mode.u, mode.prediction, found=True)
    found: dict[str, Any] = {
        "stratum": argument["stratum"],
        "effect": "".join(case.names),
        "tries": case.tries,
        "behind": found_cost - cost_at(comparison, case.z, case.u, f(case.z), found=True),
        "at_bound": bool(np.any(((mode.z == f.low) | (mode.z == f.high))[f.k :])),
        "truth": {name: float(case.z[place]) for name, place in _places(case, f)},
        "laplace": laplace,
        "emcee": None,
        "why": "",
    }
    if argument["emcee"]:
        begun = time.monotonic()
        try:
            found["emcee"] = _by_emcee(case, f, mode, rng, argument["seed"]) | {"seconds": time.monotonic() - begun}
        except (NotConvergedError, NoPeakError) as problem:
            found["why"] = str(problem)
    return found


def _most_probable(case: Case) -> Mode:
    """The most probable point, from the starts that a diagnosis has."""
    base = case.comparison.base()
    if not case.names:
        return base
    return find(case.comparison, case.names, base, *([] if case.comparison.in_time else [None]))


def _places(case: Case, f: Function) -> list[tuple[str, int]]:
    """Where what is ranked stands among the unknowns: f_overall, and the effect's size."""
    problem = case.comparison.problem
    place = problem.place(problem.friction)
    found = [] if place is None else [(problem.friction, place)]
    for i, (name, unknown) in enumerate(problem.effect_unknowns(case.names), start=f.k):
        if not problem.parameter(name, unknown.name).shape:
            found.append(("size", i))
    return found


def _by_laplace(case: Case, f: Function, mode: Mode, rng: np.random.Generator) -> dict[str, Any]:
    """Means, sds and ranks of a normal law, of a size with its longer tails and its bounds as a diagnosis states it."""
    size = reweighed_sizes(case.comparison.problem, case.names, mode.z, mode.covariance)[1]
    found: dict[str, Any] = {}
    for name, place in _places(case, f):
        mean, sd = float(mode.z[place]), float(np.sqrt(mode.covariance[place, place]))
        if name == "size":
            mean, sd = float(size.z[0]), float(size.sd[0])
        found[name] = {"mean": mean, "sd": sd, "rank": float(ndtr((case.z[place] - mean) / sd))}
    truth = log_likelihood(case, case.z, case.u, f(case.z))
    drawn = [_log_likelihood_drawn(case, f, *point) for point in _drawn(case, f, mode, rng)]
    return found | {"log_likelihood": {"rank": _rank(truth, np.array(drawn), rng)}}


def log_likelihood(case: Case, z: np.ndarray, u: np.ndarray, predicted: Prediction) -> float:
    """The log likelihood of a point, up to a constant [-].

    `z`, shape (m,): the point [-].
    `u`, shape (k,): the noise [-].
    """
    comparison = case.comparison
    prior = 0.5 * float(z @ z) + 0.5 * float(np.sum((u / comparison.noise.spread) ** 2))
    return prior - cost_at(comparison, z, u, predicted, found=True)


def _log_likelihood_drawn(case: Case, f: Function, z: np.ndarray, u: np.ndarray) -> float:
    """The same of a draw; minus infinity where the model gives no reading."""
    try:
        predicted = f(z)
    except ArithmeticError:
        return -np.inf
    return log_likelihood(case, z, u, predicted) if case.comparison.is_told(predicted) else -np.inf


def _drawn(case: Case, f: Function, mode: Mode, rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Draws of Laplace's approximation, along the curved valley as a search steps, with the noise that suits them."""
    comparison = case.comparison
    root = np.linalg.cholesky(mode.covariance)
    moves = rng.standard_normal((POOL, mode.z.size)) @ root.T
    there = mode.z + moves
    sizes = [place for name, place in _places(case, f) if name == "size"]
    inside = np.all((there >= f.low) & (there <= f.high), axis=1)
    weight = np.exp(log_ratio(there[:, sizes]).sum(axis=1)) * inside
    if not weight.any():
        weight = np.ones(POOL)
    chosen = moves[rng.choice(POOL, DRAWS, p=weight / weight.sum())]
    difference = comparison.read - comparison.raw(mode.prediction)
    good = robust_weights(mode.r, comparison, found=True)[0]
    information = comparison.noise_step(difference, mode.prediction, mode.u, good, mode.D)[1]
    of_noise = np.linalg.cholesky(np.linalg.inv(information))
    found = []
    for move in chosen:
        z = f.along_valley(mode.z, f.clip(f.advance(mode.z, move)), mode.prediction, mode.D)
        u = np.where(comparison.noise.free, mode.u + of_noise @ rng.standard_normal(mode.u.size), 0.0)
        if isinstance(comparison, Comparison):
            u[SAMPLES] = max(u[SAMPLES], 0.0)
        found.append((z, u))
    return found


def _by_emcee(case: Case, f: Function, mode: Mode, rng: np.random.Generator, seed: int) -> dict[str, Any]:
    """Means, sds and ranks of a chain; its likelihood has what is a run's or a recording's own integrated out."""
    settings = Settings(seed=seed, **SETTINGS)
    fitted = whole.fit(case.recordings, case.comparison, mode, settings)
    target, flat = fitted.target, fitted.posterior.chain.flat()
    noise = case.comparison.noise
    truth = np.append(case.z[target.shared], (case.u[noise.scales] / noise.spread[noise.scales]))

    def likelihood(z: np.ndarray) -> float:
        point = target.at(z)
        return -np.inf if point is None else point.log_prob + 0.5 * float(z @ z) - float(target.tails(point.z))

    found: dict[str, Any] = {}
    for name, place in _places(case, f):
        mine = flat[:, int(np.flatnonzero(target.shared == place)[0])]
        rank = float(np.mean(mine < case.z[place]))
        found[name] = {"mean": float(mine.mean()), "sd": float(mine.std()), "rank": rank}
    drawn = np.array([likelihood(z) for z in flat[rng.choice(len(flat), DRAWS, replace=False)]])
    return found | {"log_likelihood": {"rank": _rank(likelihood(truth), drawn, rng)}}


def _rank(truth: float, drawn: np.ndarray, rng: np.random.Generator) -> float:
    """A truth's place among draws [-], 0 to 1, spread within its step."""
    return float((np.sum(drawn < truth) + rng.uniform()) / (drawn.size + 1))


def items_of(given: argparse.Namespace, code: str) -> list[Item]:
    """Every case of a campaign: of each stratum the seeds that begin with the first, then those that emcee samples."""
    first, strata = given.first_seed, list(dict.fromkeys(given.stratum))
    counts = {name: given.with_runs if STRATA[name].runs else given.sweeps for name in strata}
    cases = [(name, first + k, False) for name, count in counts.items() for k in range(count)]
    of_emcee = [name for name in EMCEE_STRATA if name in strata]
    if of_emcee:
        cases += [(of_emcee[k % len(of_emcee)], first + EMCEE_SEEDS + k, True) for k in range(given.emcee)]
    mark = sha256(f"{code} {SETTINGS} {DRAWS} {POOL}".encode()).hexdigest()
    return [
        Item(f"{name}-{seed}", {"stratum": name, "seed": seed, "emcee": emcee}, mark) for name, seed, emcee in cases
    ]


STUDY = Study(
    name="strata",
    words=__doc__,
    roots=("calibration.studies.strata_draw", DIAGNOSIS, "calibration.fit.whole"),
    task=calibrate,
    items=items_of,
    first_seed=600_000,
    options={
        "--sweeps": {"type": whole_number, "default": SWEEPS, "help": "cases of each stratum of sweeps (%(default)s)"},
        "--with-runs": {"type": whole_number, "default": WITH_RUNS, "help": "the same with runs in time (%(default)s)"},
        "--emcee": {"type": whole_number, "default": EMCEE, "help": "further cases, sampled too (%(default)s)"},
        "--stratum": {"nargs": "+", "choices": list(STRATA), "default": list(STRATA), "help": "all if left out"},
    },
    summary=strata_table.summary,
    documents=strata_table.documents,
    told=strata_table.table,
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
