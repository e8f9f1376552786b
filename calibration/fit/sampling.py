"""Sampling with emcee: length decided by the autocorrelation time, a chain that survives a kill.

Walkers of one ensemble move by each other's positions, so there are four ensembles, and R-hat is taken between them.
Walkers that move each by itself are one ensemble, and R-hat is taken between four groups of them. The effective sample
size is the number of samples over the autocorrelation time. Blocks of the chain go to disk as they are made (temporary
file and rename), each with the state of the random numbers: a fit that is killed goes on from the last block, to the
same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.fit import moves, peak
from calibration.fit.peak import BatchLogProb
from calibration.fit.store import Store
from calibration.fit.transport import REACH, Plain, TransportMap

if TYPE_CHECKING:
    import emcee
    from emcee.moves import Move

ENSEMBLES = 4
WALKERS = 48
BLOCK = 25  # steps between looks at convergence
WARM_UP_BLOCKS = 7
LONGEST_WARM_UP = 8  # times the first: a warm-up that proves too short is doubled up to here
MAP_SAMPLES = 40_000  # as many draws as a map is fitted to, at most
SCATTERED = 1024  # points that the first map is fitted to
MOST_SCATTERED = 100 * SCATTERED  # before it is given up
TIMES_TAU = 50  # a chain is long enough at this many autocorrelation times: tau is a mean over all walkers
LOOKS = 10  # a long chain is assessed when it has grown by a tenth
DISCARD_TAU = 5  # autocorrelation times left out at the start of what the fixed moves drew
RHAT = 1.01
HELD = 2.5  # autocorrelation time above which proposals that forget at once do not reach some of the mass
CANDIDATES = 512

Factors = Callable[[np.ndarray], np.ndarray]
Moves = Callable[[], "list[tuple[Move, float]]"]
Shape = TransportMap | Plain
Progress = Callable[[int, float, str], None]  # effective samples so far, those wanted, in words


STEADY, WHOLE = (10_000, 12_000), (2000, 400)  # effective samples and steps that are usual: of plateaus, with runs


@dataclass(frozen=True)
class Settings:
    """How long to sample.

    `effective_samples`, `most_steps`: of every unknown, and of each ensemble; 0 for what is usual, which `within` puts
        in.
    `warm_up_blocks`: blocks that the map is fitted to, not kept. `sample` doubles them where the chain drawn after them
        forgets too slowly.
    `block`: steps between looks at convergence.
    """

    seed: int = 1
    effective_samples: int = 4000
    most_steps: int = 12_000
    walkers: int = WALKERS
    times_tau: float = TIMES_TAU
    warm_up_blocks: int = WARM_UP_BLOCKS
    block: int = BLOCK

    def __post_init__(self) -> None:
        """Raises TypeError for what is no whole number, ValueError for a negative one."""
        for name in ("seed", "effective_samples", "most_steps"):
            given = getattr(self, name)
            if not isinstance(given, Integral) or isinstance(given, bool):
                raise TypeError(f"{name}: expected a whole number; given {given!r:.60}")
            if given < 0:
                raise ValueError(f"{name}: expected 0 or more; given {given}")

    def within(self, usual: tuple[int, int]) -> Settings:
        """With what is usual, effective samples and steps, where nothing is asked for."""
        samples, steps = usual
        return replace(self, effective_samples=self.effective_samples or samples, most_steps=self.most_steps or steps)


@dataclass(frozen=True)
class Chain:
    """Samples and what is known of their quality.

    `samples`, shape (4, n_steps, n_walkers, n_unknowns): standard normal numbers, by ensembles or groups of walkers;
        burn-in left out.
    `tau`, shape (n_unknowns,): integrated autocorrelation time in steps.
    `rhat`, `effective`, shape (n_unknowns,): R-hat between the four, and effective sample size.
    """

    samples: np.ndarray
    tau: np.ndarray
    rhat: np.ndarray
    effective: np.ndarray
    acceptance: float
    steps: int
    drawn: int
    converged: bool
    seconds: float

    def flat(self) -> np.ndarray:
        """All samples, shape (n_samples, n_unknowns) [-]."""
        return self.samples.reshape(-1, self.samples.shape[-1])


@dataclass(frozen=True)
class Begun:
    """Where a chain begins that need not find its peak, and how it goes on.

    `points`, shape (n, n_unknowns): that look like the posterior; as many as there are walkers at least [-].
    `moves`: moves that need no straightened coordinates, and so no warm-up, and that move each walker by itself.
    `again`: such moves made anew from draws, shape (n, n_unknowns) [-], where a walker is held for long.
    """

    points: np.ndarray
    moves: Moves | None = None
    again: Callable[[np.ndarray], Moves] | None = None


def sample(
    log_prob: BatchLogProb,
    n_unknowns: int,
    factors: Factors,
    settings: Settings,
    folder: Path | None = None,
    fingerprint: str = "",
    progress: Progress | None = None,
    begun: Begun | None = None,
) -> Chain:
    """Draw from a posterior until every unknown has enough effective samples, or the budget is spent.

    `log_prob`: log posterior of points of shape (n, n_unknowns), returning shape (n,) [-].
    `factors`: at a point of shape (n_unknowns,), what one unit of each coordinate multiplies its unknown by, same
        shape; 1 where it adds [-].
    `folder`: where the chain is kept as it grows; a chain that is there already is continued.
    `fingerprint`: of recording, motor and settings: a chain with another is refused.
    `begun`: where to begin; the posterior's peak when left out.
    Look at ``converged`` before use. Raises ChainError when the folder holds another fit's chain; ArithmeticError when
    no point of the prior explains the data, or hardly one about the peak is possible; ValueError when the settings
    leave no step to keep.
    """
    started = time.monotonic()
    store = Store(folder, fingerprint)
    blocks = store.blocks()
    tell = progress or (lambda done, wanted, words: None)
    if not blocks:
        tell(0, settings.effective_samples, "finding the peak")
        blocks = [_start(log_prob, n_unknowns, settings, begun)]
        store.write(0, blocks[0])
    way = _Way(begun, factors, settings, blocks[0]["population"])
    most_blocks = way.warm_up + -(-settings.most_steps // settings.block)
    chain = None
    for number in range(1, most_blocks + 1):
        way.straighten(blocks[:number])
        if number == len(blocks):
            blocks.append(_advance(log_prob, blocks[-1], way.shape, way.moves, settings.block))
            store.write(number, blocks[-1])
        kept = number - way.warm_up
        if kept <= 0:
            tell(0, settings.effective_samples, "warm-up")
            continue
        if kept % max(1, kept // LOOKS) and kept != way.warm_up and number < most_blocks:
            continue
        chain = _assess(blocks[way.warm_up + 1 : number + 1], settings, number, time.monotonic() - started)
        if chain.converged:
            break
        tell(*way.goes_on(chain, number))
    if chain is None:
        raise ValueError(f"a budget of {settings.most_steps} steps after the warm-up keeps nothing")
    return chain


class _Way:
    """How a chain is drawn: its moves, the coordinates that they are taken in, and how many blocks are warm-up.

    What it decides hangs on the chain alone, never on the budget, so that a chain goes on the same with a larger one.

    `population`, shape (n, n_unknowns): points that the first coordinates are fitted to [-].
    """

    def __init__(self, begun: Begun | None, factors: Factors, settings: Settings, population: np.ndarray) -> None:
        fixed = begun.moves if begun else None
        self.factors, self.settings = factors, settings
        self.again = begun.again if begun else None
        self.is_fixed = fixed is not None
        self.moves: Moves = fixed or moves.mixture
        self.shape: Shape = Plain() if fixed else _mapped(population, factors)
        self.warm_up = 0 if fixed else settings.warm_up_blocks

    def straighten(self, blocks: list[dict[str, np.ndarray]]) -> None:
        """Fit the coordinates to the blocks so far, while they are warm-up."""
        number = len(blocks)
        if not self.is_fixed and (1 < number <= self.settings.warm_up_blocks + 1 or number == self.warm_up + 1):
            self.shape = _adapted(blocks, self.factors)

    def goes_on(self, chain: Chain, number: int) -> tuple[int, int, str]:
        """What to tell of a chain that is not long enough after ``number`` blocks; it may all become warm-up."""
        wanted = self.settings.effective_samples
        tells = chain.drawn >= self.settings.times_tau * HELD
        if self.again and not self.warm_up and tells and chain.tau.max() > HELD:
            self.warm_up, self.moves = number, self.again(chain.flat())
            return 0, wanted, "a walker is held: proposals made anew"
        longer = 2 * self.warm_up <= LONGEST_WARM_UP * self.settings.warm_up_blocks
        if not self.is_fixed and number == 2 * self.warm_up and longer and self._is_too_slow(chain):
            self.warm_up = number
            return 0, wanted, "warm-up, longer"
        return int(chain.effective.min()), wanted, f"R-hat {chain.rhat.max():.3f}"

    def _is_too_slow(self, chain: Chain) -> bool:
        """Whether a chain as long as its warm-up needs more than as much again: its map misses some of the mass."""
        return bool((self.settings.times_tau + DISCARD_TAU) * chain.tau.max() > 2 * chain.drawn)


def _start(log_prob: BatchLogProb, n_unknowns: int, settings: Settings, begun: Begun | None) -> dict[str, np.ndarray]:
    """Block 0: the ensembles at their start, and the scattered points that the first map is fitted to.

    Walkers that do not look at each other move as one ensemble, which takes less time.
    """
    import emcee  # as in `calibration.fit.moves`

    walkers = max(settings.walkers, 2 * n_unknowns + 2)
    rng, wanted = np.random.default_rng(settings.seed), ENSEMBLES * walkers
    together = ENSEMBLES if begun and begun.moves else 1
    if begun is None:
        points, values = _about_the_peak(log_prob, n_unknowns, wanted, rng)
    else:
        points, values = begun.points, log_prob(begun.points)
    likely = np.argsort(values)[::-1][: np.isfinite(values).sum()]
    if likely.size < wanted:
        raise peak.NoPeakError("hardly a point about the posterior's peak is possible; check the effects' bounds")
    chosen = likely[: max(wanted, len(points) // 2)]
    picked = rng.permutation(chosen)[:wanted].reshape(-1, together * walkers)
    states = []
    for there in picked:
        generator = np.random.RandomState(rng.integers(2**32))
        states.append(emcee.State(points[there], log_prob=values[there], random_state=generator.get_state()))
    block = _packed(states, np.empty((len(picked), 0, picked.shape[1], n_unknowns)), np.zeros(len(picked)))
    return block | {"population": points[chosen]}


def _about_the_peak(
    log_prob: BatchLogProb, n_unknowns: int, wanted: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points scattered about the posterior's peak and their log posterior, so many of them possible at least."""
    top = peak.find_peak(log_prob, rng.standard_normal((CANDIDATES, n_unknowns)))
    spread = peak.spread_at(log_prob, top)
    points, values = np.empty((0, n_unknowns)), np.empty(0)
    while np.isfinite(values).sum() < wanted:  # near a bound most are impossible, and no walker may stand there
        if len(points) >= MOST_SCATTERED:
            raise peak.NoPeakError("hardly a point about the posterior's peak is possible; check the effects' bounds")
        more = peak.scatter(log_prob, top, spread, rng, max(SCATTERED, wanted))
        points, values = np.concatenate([points, more]), np.concatenate([values, log_prob(more)])
    return points, values


def _advance(
    log_prob: BatchLogProb, before: dict[str, np.ndarray], shape: Shape, chosen: Moves, steps: int
) -> dict[str, np.ndarray]:
    """The next block: steps of every ensemble from where the block before ends, in the straightened coordinates."""
    import emcee

    interrupted = False

    def straightened(e: np.ndarray) -> np.ndarray:
        """Ctrl-C in here is kept for later: emcee would print every point and a traceback."""
        nonlocal interrupted
        z, log_volume = shape.push(e)
        inside = np.all(np.abs(z) < REACH, axis=1)
        found = np.full(len(z), -np.inf)
        if inside.any() and not interrupted:
            try:
                found[inside] = log_prob(z[inside]) + log_volume[inside]
            except KeyboardInterrupt:
                interrupted = True
        return found

    after, chains, accepted = [], [], []
    for state in _ends_of(before):
        walkers, n = state.coords.shape
        sampler = emcee.EnsembleSampler(walkers, n, straightened, vectorize=True, moves=chosen())
        coords = shape.pull(state.coords)
        log_prob_there = state.log_prob + shape.push(coords)[1]
        begin = emcee.State(coords, log_prob=log_prob_there, random_state=state.random_state)
        end = sampler.run_mcmc(begin, steps, skip_initial_state_check=True)
        if interrupted:
            raise KeyboardInterrupt
        coords, log_volume = shape.push(end.coords)
        after.append(emcee.State(coords, log_prob=end.log_prob - log_volume, random_state=end.random_state))
        chains.append(shape.push(sampler.get_chain(flat=True))[0].reshape(steps, walkers, n))
        accepted.append(np.mean(sampler.acceptance_fraction))
    return _packed(after, np.array(chains), np.array(accepted))


def _adapted(blocks: list[dict[str, np.ndarray]], factors: Factors) -> TransportMap:
    """The map fitted to what the warm-up has drawn so far: its later half, of all ensembles."""
    drawn = np.concatenate([block["chain"] for block in blocks[1:]], axis=1)
    kept = drawn[:, drawn.shape[1] // 2 :].reshape(-1, drawn.shape[-1])
    return _mapped(kept[:: -(-len(kept) // MAP_SAMPLES)], factors)


def mapped(chain: Chain, factors: Factors) -> TransportMap:
    """The map fitted to a chain."""
    flat = chain.flat()
    return _mapped(flat[:: -(-len(flat) // MAP_SAMPLES)], factors)


def _mapped(samples: np.ndarray, factors: Factors) -> TransportMap:
    return TransportMap(samples, factors(samples.mean(axis=0)))


def _assess(blocks: list[dict[str, np.ndarray]], settings: Settings, number: int, seconds: float) -> Chain:
    """The samples that the fixed moves drew, less their own beginning, and their quality; block ``number`` is last."""
    samples = np.concatenate([block["chain"] for block in blocks], axis=1)
    steps = samples.shape[1]
    samples = np.concatenate(np.split(samples, ENSEMBLES // len(samples), axis=2))
    tau = _tau(samples)
    first = min(int(np.ceil(DISCARD_TAU * tau.max())), steps // 2)
    samples = samples[:, first:]
    means = samples.mean(axis=(1, 2))
    within = samples.var(axis=(1, 2)).mean(axis=0)
    rhat = np.sqrt(1.0 + means.var(axis=0, ddof=1) / within)
    effective = samples.shape[0] * samples.shape[1] * samples.shape[2] / tau
    converged = (
        steps - first >= settings.times_tau * tau.max()
        and rhat.max() <= RHAT
        and effective.min() >= settings.effective_samples
    )
    acceptance = float(np.mean([block["acceptance"].mean() for block in blocks]))
    return Chain(samples, tau, rhat, effective, acceptance, number * settings.block, steps, bool(converged), seconds)


def _tau(samples: np.ndarray) -> np.ndarray:
    """Integrated autocorrelation time of each unknown in steps, at least 1: the mean over ensembles.

    The autocovariance of an ensemble is the mean over its walkers about the ensemble's own mean, so that a walker that
    hardly moves counts as what it is; the window is Sokal's, as emcee cuts it.
    """
    from emcee.autocorr import auto_window

    ensembles, steps, _, n = samples.shape
    centred = samples - samples.mean(axis=(1, 2), keepdims=True)
    size = 2 * steps
    spectrum = np.fft.rfft(centred, n=size, axis=1)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2, n=size, axis=1)[:, :steps].mean(axis=2)
    covariance /= (steps - np.arange(steps))[None, :, None]
    found = np.empty((ensembles, n))
    for e in range(ensembles):
        for k in range(n):
            taus = 2.0 * np.cumsum(covariance[e, :, k] / covariance[e, 0, k]) - 1.0
            found[e, k] = taus[auto_window(taus, 5.0) or -1]  # 0: the chain is shorter than any window
    return np.maximum(found.mean(axis=0), 1.0)


def _packed(states: list[emcee.State], chain: np.ndarray, acceptance: np.ndarray) -> dict[str, np.ndarray]:
    """A block as it is written: samples, and everything that the next block starts from."""
    keys = [state.random_state for state in states]
    return {
        "chain": chain,
        "acceptance": acceptance,
        "coords": np.array([state.coords for state in states]),
        "log_prob": np.array([state.log_prob for state in states]),
        "key": np.array([key[1] for key in keys]),
        "position": np.array([[key[2], key[3]] for key in keys]),
        "gauss": np.array([key[4] for key in keys]),
    }


def _ends_of(block: dict[str, np.ndarray]) -> Iterator[emcee.State]:
    """Where each ensemble stands at the end of a block."""
    import emcee

    for coords, log_prob, key, (position, has_gauss), gauss in zip(
        *(block[name] for name in ("coords", "log_prob", "key", "position", "gauss")), strict=True
    ):
        random_state = ("MT19937", key, int(position), int(has_gauss), float(gauss))
        yield emcee.State(coords, log_prob=log_prob, random_state=random_state)
