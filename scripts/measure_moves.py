"""Measure how well sets of moves sample the posterior of the published sweep; docs/sampling.md holds the output.

    python scripts/measure_moves.py              print the table; it took five minutes of CPU time

Every set starts from the same draws of a converged fit, so the table shows the moves and not the way to the posterior.
tau is the fit's own estimate, the largest over the unknowns. A set with a tau of t needs t evaluations for an
effective sample. The last two lines are whole fits that differ in their warm-up alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import emcee
import numpy as np
from emcee.moves import DEMove, Move, StretchMove

from calibration.fit import fit, sampling
from calibration.fit.moves import IndependenceMove
from calibration.fit.transport import REACH, TransportMap
from calibration.systems.radial_piston.batch.likelihood import Likelihood
from rig.recording import read_recording

PUBLISHED_SWEEP = Path(__file__).resolve().parent.parent / "logs" / "published_sweep"
WALKERS = sampling.WALKERS
NORMAL = 1e6  # degrees of freedom at which a t is a normal distribution
WARM_UPS = (7, 4)

Push = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
Map = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class MoveSet:
    """Moves, the coordinates they walk in, and how many steps show their tau."""

    words: str
    push: Push
    pull: Map
    moves: list[tuple[Move, float]]
    steps: int


@dataclass(frozen=True)
class Quality:
    """Share of proposals taken [-], largest autocorrelation time in steps [-], CPU time of 1000 evaluations [s]."""

    acceptance: float
    tau: float
    seconds: float


def affine(mean: np.ndarray, covariance: np.ndarray) -> tuple[Push, Map]:
    """Push and pull between independent normal numbers and a normal distribution."""
    root = np.linalg.cholesky(covariance)
    return lambda e: (mean + e @ root.T, np.zeros(len(e))), lambda z: np.linalg.solve(root, (z - mean).T).T


def move_sets(draws: np.ndarray, factors: np.ndarray) -> list[MoveSet]:
    """What is compared; maps are fitted to the draws."""
    n = draws.shape[1]
    plain = affine(np.zeros(n), np.eye(n))
    normal = affine(draws.mean(axis=0), np.cov(draws.T))
    logarithms = TransportMap(draws, np.ones(n))
    values = TransportMap(draws, factors)
    quadratic = (logarithms.push, logarithms.pull)
    warped = (values.push, values.pull)
    chosen = IndependenceMove()

    def mixed(move: Move, share: float) -> list[tuple[Move, float]]:
        return [(move, share), (DEMove(), 1.0 - share)]

    return [
        MoveSet("plain coordinates: 0.5 stretch + 0.5 DE", *plain, mixed(StretchMove(), 0.5), 1500),
        MoveSet("plain coordinates: DE", *plain, [(DEMove(), 1.0)], 1500),
        MoveSet("normal of the posterior's covariance", *normal, [(IndependenceMove(NORMAL, 1.0), 1.0)], 800),
        MoveSet("map, unknowns as logarithms: normal", *quadratic, [(IndependenceMove(NORMAL, 1.0), 1.0)], 400),
        MoveSet("map, unknowns as values: normal", *warped, [(IndependenceMove(NORMAL, 1.0), 1.0)], 400),
        MoveSet("map, values: DE", *warped, [(DEMove(), 1.0)], 800),
        MoveSet("map, values: 0.8 t(50, 1.0) + 0.2 DE", *warped, mixed(IndependenceMove(50.0, 1.0), 0.8), 400),
        MoveSet("map, values: 0.6 t(20, 1.05) + 0.4 DE", *warped, mixed(chosen, 0.6), 400),
        MoveSet("map, values: 0.8 t(20, 1.05) + 0.2 DE (chosen)", *warped, mixed(chosen, 0.8), 400),
    ]


def measure(likelihood: Likelihood, tried: MoveSet, start: np.ndarray, seed: int) -> Quality:
    """Run one set of moves from the start."""

    def log_prob(e: np.ndarray) -> np.ndarray:
        z, log_volume = tried.push(e)
        inside = np.all(np.abs(z) < REACH, axis=1)
        found = np.full(len(z), -np.inf)
        found[inside] = likelihood.log_prob(z[inside]) + log_volume[inside]
        return found

    walkers, n = start.shape
    np.random.seed(seed)  # emcee takes its first state from here  # noqa: NPY002
    sampler = emcee.EnsembleSampler(walkers, n, log_prob, vectorize=True, moves=tried.moves)
    begun = time.process_time()
    sampler.run_mcmc(tried.pull(start), tried.steps, skip_initial_state_check=True)
    seconds = time.process_time() - begun
    chain = tried.push(sampler.get_chain(flat=True))[0].reshape(1, tried.steps, walkers, n)
    tau = sampling._tau(chain).max()  # the fit's estimate, in which a walker that sticks counts
    return Quality(float(np.mean(sampler.acceptance_fraction)), float(tau), seconds / (walkers * tried.steps) * 1e3)


def whole_fit(likelihood: Likelihood, seed: int, warm_up_blocks: int) -> tuple[sampling.Chain, Quality]:
    """The fit's own sampling, with a warm-up of so many blocks."""
    sampling.WARM_UP_BLOCKS = warm_up_blocks
    begun = time.process_time()
    chain = sampling.sample(
        likelihood.log_prob, len(likelihood.unknowns), likelihood.factors, sampling.Settings(seed=seed)
    )
    seconds = time.process_time() - begun
    evaluations = chain.steps * chain.samples.shape[0] * chain.samples.shape[2]
    return chain, Quality(chain.acceptance, float(chain.tau.max()), seconds / evaluations * 1e3)


def row(words: str, quality: Quality) -> str:
    """A line of the table."""
    return f"| {words} | {quality.acceptance:.2f} | {quality.tau:.1f} | {quality.seconds:.3f} |"


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--seed", type=int, default=1)
    seed = arguments.parse_args().seed
    _, _, likelihood = fit.prepare(read_recording(PUBLISHED_SWEEP))
    fits = {blocks: whole_fit(likelihood, seed, blocks) for blocks in WARM_UPS}
    flat = fits[WARM_UPS[0]][0].flat()
    draws = np.random.default_rng(seed).choice(flat, size=min(len(flat), 16_000), replace=False)
    print("| moves | acceptance | tau, steps | CPU s per 1000 evaluations |")
    print("|---|---|---|---|")
    for tried in move_sets(draws, likelihood.factors(draws.mean(axis=0))):
        print(row(tried.words, measure(likelihood, tried, draws[:WALKERS], seed)), flush=True)
    for blocks, (_, quality) in fits.items():
        print(row(f"a whole fit, warm-up of {blocks} blocks", quality))


if __name__ == "__main__":
    main()
