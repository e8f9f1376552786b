"""Sampling the posterior of plateaus: polynomials propose, the true model accepts.

Points are moved to where the polynomials have their mass, which costs little. Where the polynomials are good enough to
propose, a chain of the true posterior begins at these points and forgets at once. Where they are not, as with a rotor
that stands still, the true posterior is sampled alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from calibration.fit import moves, peak, sampling
from calibration.fit.moves import IndependenceMove
from calibration.fit.peak import BatchLogProb
from calibration.fit.sampling import Begun, Chain, Progress, Settings
from calibration.fit.transport import TransportMap
from calibration.systems.radial_piston.batch.likelihood import Likelihood

POINTS = 10_000  # in a generation of proposals
GENERATIONS = 24
LIKE = 0.125  # share of the points that a generation's weights, tempered, are worth
GOOD = 0.4  # the same without tempering: where the map is like the polynomials' own distribution
PATIENCE = 4  # generations with none better, after which the best is taken
ROUNDS = 4  # of fitting polynomials: about the peak, then where those before have their mass
WIDER = 1.5  # than that: where they are fitted
LEAST = 1e4  # of minus a log weight: what is impossible
LOOKED_AT = 1000  # draws of the polynomials at which the true posterior is asked for
HEAVIEST = 0.7  # Pareto's k of the weights there, above which polynomials are not trusted
TIMES_TAU, BLOCK = 10.0, 5  # proposals that forget at once: short chains tell how long is enough
STEPS, STEPS_WITH_EFFECTS = 12, 24  # that the polynomials walk for one of the true posterior: effects make that dear
WARM_UP_WITH_EFFECTS = 24  # blocks, without polynomials: the ridge is thinner, its map needs more draws


def draw(
    likelihood: Likelihood,
    settings: Settings,
    folder: Path | None = None,
    fingerprint: str = "",
    progress: Progress | None = None,
) -> Chain:
    """Sample the posterior of plateaus; arguments, result and errors as of `calibration.fit.sampling.sample`."""
    tell = progress or (lambda done, wanted, words: None)
    tell(0, settings.effective_samples, "finding the peak")
    begun = _begun(likelihood, settings)
    if begun:
        settings = replace(settings, times_tau=min(settings.times_tau, TIMES_TAU), block=BLOCK)
    elif likelihood.effects:
        settings = replace(settings, warm_up_blocks=WARM_UP_WITH_EFFECTS)
    n, mark = len(likelihood.unknowns), f"{fingerprint} {'proposed' if begun else 'alone'}"
    return sampling.sample(likelihood.log_prob, n, likelihood.factors, settings, folder, mark, progress, begun)


@dataclass(frozen=True)
class _Generation:
    """Points that were drawn from a known density.

    `log_density`, shape (n,): of each point where it was drawn from, up to a constant [-].
    `shape`: what they were drawn with; None for a normal law.
    """

    points: np.ndarray
    log_density: np.ndarray
    shape: TransportMap | None = None


def _begun(likelihood: Likelihood, settings: Settings) -> Begun | None:
    """Draws of polynomials that are good enough to propose, and the moves that do; None where none are."""
    n, random = len(likelihood.unknowns), np.random.RandomState(settings.seed)
    top = peak.find_peak(likelihood.log_prob, random.randn(sampling.CANDIDATES, n))
    e = random.randn(POINTS, n)
    drawn = top + e @ np.linalg.cholesky(peak.spread_at(likelihood.log_prob, top)).T
    generation = _Generation(drawn, -0.5 * np.sum(e * e, axis=1))
    where = top + WIDER * drawn.std(axis=0) * random.randn(likelihood.points_wanted, n)
    for number in range(ROUNDS):
        polynomials = likelihood.polynomials(where)
        if polynomials is None:
            return None
        stand_in = partial(likelihood.log_prob_by, polynomials)
        drawn, generation, worth = _moved(stand_in, likelihood.factors, generation, random)
        shape = generation.shape
        if shape is None:
            return None
        where, _ = shape.push(WIDER * random.randn(likelihood.points_wanted, n))
        looked_at = drawn[random.permutation(POINTS)[:LOOKED_AT]]
        if number > 0 and worth >= LIKE and heaviness(likelihood.log_prob(looked_at) - stand_in(looked_at)) < HEAVIEST:
            walkers = sampling.ENSEMBLES * max(settings.walkers, 2 * n + 2)
            steps = STEPS_WITH_EFFECTS if likelihood.effects else STEPS
            begin = drawn[random.permutation(POINTS)[: 2 * walkers]]
            again = partial(_moves, stand_in, shape, steps)
            return Begun(begin, again(drawn), again)
    return None


def _moves(stand_in: BatchLogProb, shape: TransportMap, steps: int, points: np.ndarray) -> sampling.Moves:
    made = moves.delayed(stand_in, shape, points, steps, trusted=True)
    return lambda: made


def _moved(
    stand_in: BatchLogProb, factors: sampling.Factors, generation: _Generation, random: np.random.RandomState
) -> tuple[np.ndarray, _Generation, float]:
    """Draws of a stand-in, shape (POINTS, n) [-], the generation that they were chosen from, and the share of it that
    they are worth [-]: below `LIKE` the weights were tempered, and the draws are on the way to its mass.

    Each generation is drawn from a map that was fitted to the one before, whose weights are tempered so that enough
    points count (population Monte Carlo, Cappe et al. 2004).
    """
    proposal = IndependenceMove()
    best, best_drawn, most, since = generation, generation.points, 0.0, 0
    for _ in range(GENERATIONS):
        log_weights = stand_in(generation.points) - generation.log_density
        if not np.isfinite(log_weights.max()):
            break
        log_weights -= log_weights.max()
        power = _power(log_weights)
        shares = np.cumsum(np.exp(np.maximum(power * log_weights, -LEAST)))
        at = np.searchsorted(shares, (np.arange(POINTS) + random.rand()) / POINTS * shares[-1])
        drawn = generation.points[np.minimum(at, POINTS - 1)]
        since += 1
        worth = _worth(log_weights) if generation.shape else 0.0
        if worth > most:
            best, best_drawn, most, since = generation, drawn, worth, 0
        if most > GOOD or (most >= LIKE and since == PATIENCE):
            break
        shape = TransportMap(drawn, factors(drawn.mean(axis=0)))
        e = proposal.draw(random, POINTS, drawn.shape[1])
        points, log_volume = shape.push(e)
        generation = _Generation(points, proposal.log_density(e) - log_volume, shape)
    return best_drawn, best, most


def _worth(log_weights: np.ndarray) -> float:
    """Share of points that weighted ones are worth [-]; the largest weight's logarithm is 0."""
    weights = np.exp(log_weights)
    return float(weights.sum() ** 2 / np.sum(weights**2) / weights.size)


def _power(log_weights: np.ndarray) -> float:
    """The largest power, at most 1, of weights that leaves `LIKE` of the points their worth [-]."""
    possible = np.maximum(log_weights, -LEAST)
    if _worth(possible) >= LIKE:
        return 1.0
    return float(brentq(lambda power: _worth(power * possible) - LIKE, 0.0, 1.0, xtol=1e-4))


def heaviness(log_weights: Sequence[float] | np.ndarray) -> float:
    """Pareto's k of the largest importance weights [-], as Zhang and Stephens (2009) estimate it.

    Above 0.7 a mean under these weights cannot be trusted (Vehtari et al. 2024, arXiv:1507.02646); infinite where a
    weight is not a number or all are 0.

    `log_weights`, shape (n,): logarithms of true density over proposed [-].
    """
    logs = np.sort(np.asarray(log_weights, dtype=float))
    if np.isnan(logs).any() or not np.isfinite(logs[-1]):
        return float("inf")
    weights = np.exp(logs - logs[-1])
    tail = int(min(0.2 * weights.size, 3.0 * weights.size**0.5))
    beyond = weights[-tail:] - weights[-tail - 1]
    beyond = beyond[beyond > 0.0]
    if beyond.size < 5:  # hardly any differ: there is no tail
        return -float("inf")
    m = 30 + int(beyond.size**0.5)
    grid = 1.0 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))
    b = grid / (3.0 * beyond[int(beyond.size / 4 + 0.5) - 1]) + 1.0 / beyond[-1]
    k = np.log1p(-b[:, None] * beyond).mean(axis=1)
    fit = beyond.size * (np.log(-b / k) - k - 1.0)
    share = 1.0 / np.exp(fit - fit[:, None]).sum(axis=1)
    shape = np.log1p(-(b @ share) * beyond).mean()
    return float((beyond.size * shape + 5.0) / (beyond.size + 10.0))  # a weak prior at 0.5
