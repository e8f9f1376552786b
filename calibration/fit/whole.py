"""The fit of everything that was measured: plateaus, runs in time, one recording or several of one motor."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from calibration.fit import moves, posterior, sampling, store, surrogate
from calibration.fit.fit import NotConvergedError, why_not
from calibration.fit.integrated import Integrated, log_prob_of
from calibration.fit.peak import NoPeakError
from calibration.fit.posterior import FitQuality, Posterior, SuspectRow
from calibration.fit.sampling import Begun, Progress, Settings
from calibration.fit.surrogate import Surrogate
from calibration.fit.transport import REACH
from calibration.likelihood.compared import Compared
from calibration.likelihood.mode import Mode
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.several.comparison import Several
from calibration.work.side_by_side import SideBySide
from calibration.work.sources import imported_sha256
from calibration.work.threads import each, threads
from model.motor import Motor
from rig.recording import Recording
from rig.recording.columns import OF_CHANNEL

LEVELS = (0.05, 0.16, 0.50, 0.84, 0.95)  # quantiles of the 90 % and 68 % bands, and the median
BANDS_DRAWS = 200  # of the posterior
NOISE_DRAWS = 5  # about each
STAND_IN = Settings(effective_samples=2000, most_steps=2000, walkers=144, times_tau=10.0, warm_up_blocks=4, block=10)
WALKERS, BLOCK, TIMES_TAU = 16, 5, 10.0  # independent proposals forget at once: short chains tell how long is enough


@dataclass(frozen=True)
class WholeFit:
    """Recordings, and what came out.

    `bands`, shape (5, m): what new readings would be at the places of the old ones, at `LEVELS` [SI].
    """

    recordings: tuple[Recording, ...]
    comparison: Comparison | Several
    mode: Mode
    target: Integrated
    posterior: Posterior
    settings: Settings
    effects: tuple[str, ...]
    bands: np.ndarray
    quality: FitQuality | None = None

    @property
    def recording(self) -> Recording:
        """The first recording."""
        return self.recordings[0]

    @property
    def motor(self) -> Motor:
        """The motor, at the first recording's ambient."""
        return next(part for _, part, _ in parts_of(self.comparison)).problem.motor

    @property
    def rows(self) -> int:
        """Plateaus that were fitted [-]."""
        return sum(part.n for _, part, _ in parts_of(self.comparison))

    @property
    def in_time(self) -> bool:
        """Whether runs in time were."""
        return self.comparison.in_time


def parts_of(comparison: Comparison | Several) -> Iterator[tuple[str, Comparison, np.ndarray]]:
    """Each recording with its name, empty where it is the only one, and the places of its readings among all."""
    if isinstance(comparison, Several):
        yield from zip(comparison.names, comparison.parts, comparison.at, strict=True)
    else:
        yield "", comparison, np.arange(comparison.read.size)


def fit(
    recordings: Sequence[Recording],
    comparison: Compared,
    mode: Mode,
    settings: Settings,
    chain_folder: Path | None = None,
    progress: Progress | None = None,
    workers: int = 1,
) -> WholeFit:
    """Sample the posterior about its most probable point.

    `mode`: the most probable point, with the effects that the model holds.
    `chain_folder`: where the chain is kept as it grows, and continued from.
    `workers`: processes; the result is the same [-].
    Raises NotConvergedError when the budget is spent; NoPeakError when the most probable point lies where nothing is
    ever proposed.
    """
    begun = time.monotonic()
    # Who judged it has refused every other machine.
    target = Integrated(cast("Comparison | Several", comparison), mode)
    _refuse_far_out(target, len(recordings) > 1)
    mark = _fingerprint(recordings, target, settings)
    if chain_folder is not None:
        store.refuse_another(chain_folder, mark)
    rng = np.random.default_rng(settings.seed)
    tell = progress or (lambda done, wanted, words: None)
    with SideBySide(workers) as side_by_side:
        side_by_side.begin(["calibration.fit.integrated"])
        with threads(workers):
            stand_in, drawn = stand_in_for(target, rng, settings, tell)

        def log_prob(z: np.ndarray) -> np.ndarray:
            chunks = np.array_split(z, min(workers, max(len(z), 1)))
            return np.concatenate(side_by_side(log_prob_of, [(target, chunk) for chunk in chunks]))

        begin = _begun(target, stand_in, drawn, rng)
        chosen = dataclasses.replace(
            settings, walkers=WALKERS, block=BLOCK, times_tau=min(settings.times_tau, TIMES_TAU)
        )
        chain = sampling.sample(
            log_prob, len(target.unknowns), target.factors, chosen, chain_folder, mark, progress, begin
        )
    if not chain.converged:
        raise NotConvergedError(why_not(chain, target.unknowns, chosen, chain_folder))
    with threads(workers):
        bands, suspects, draws = _expected(target, posterior.thinned(chain.flat(), BANDS_DRAWS), rng)
    result = posterior.summarise(
        chain, target.unknowns, suspects, time.monotonic() - begun, target.of_recordings, draws
    )
    return WholeFit(tuple(recordings), target.comparison, mode, target, result, chosen, mode.names, bands)


def _begun(target: Integrated, stand_in: Surrogate, drawn: sampling.Chain, rng: np.random.Generator) -> Begun:
    """Draws of the stand-in to begin at, and the moves by which it proposes."""
    flat, shape = drawn.flat(), sampling.mapped(drawn, target.factors)
    count = 2 * sampling.ENSEMBLES * max(WALKERS, 2 * len(target.unknowns) + 2)
    begin = flat[rng.choice(len(flat), count, replace=False)]
    made = moves.delayed(stand_in.log_prob, shape, flat[:: -(-len(flat) // sampling.MAP_SAMPLES)])
    return Begun(begin, lambda: made)


def stand_in_for(
    target: Integrated, rng: np.random.Generator, settings: Settings, tell: Progress
) -> tuple[Surrogate, sampling.Chain]:
    """The stand-in that proposes, and draws of it: fitted about the mode first, then where it has its mass."""
    chosen = dataclasses.replace(STAND_IN, seed=settings.seed)
    rounds: list[tuple[np.ndarray, np.ndarray]] = []
    begin = surrogate.scattered(target, rng, surrogate.START)
    for number in range(surrogate.ROUNDS):
        tell(0, settings.effective_samples, f"simulating about the peak, {number + 1} of {surrogate.ROUNDS}")
        there = begin[rng.choice(len(begin), surrogate.wanted(target), replace=False)]
        rounds = [*rounds, surrogate.simulated(target, there)][-surrogate.KEPT :]
        stand_in = Surrogate(target, *(np.vstack(one) for one in zip(*rounds, strict=True)))
        drawn = sampling.sample(stand_in.log_prob, len(target.unknowns), target.factors, chosen, begun=Begun(begin))
        begin = drawn.flat()
    return stand_in, drawn


def _expected(
    target: Integrated, draws: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, list[SuspectRow], np.ndarray | None]:
    """Bands of new readings at the places of the old ones, shape (5, m) [SI]; readings that are probably bad; and draws
    of what was sampled with what is the recordings' own, where that was integrated out."""
    comparison = target.comparison
    points, readings, with_own = [], [], []
    for z, point in zip(draws, each(target.at, draws), strict=True):
        if point is None:
            continue
        points.append(point)
        for _ in range(NOISE_DRAWS):
            moved = point.root @ rng.standard_normal(target.own.size)
            readings.append(point.raw + target.D @ moved + comparison.drawn_noise(point.prediction, point.u, rng))
            with_own.append(np.append(z, (point.z[target.own] + moved)[target.told]))
    bands = np.quantile(np.array(readings), LEVELS, axis=0)
    bad = np.mean([point.bad for point in points], axis=0)
    suspects = [
        SuspectRow(row.file, row.row, OF_CHANNEL[row.channel].column, float(bad[i]))
        for i, row in enumerate(comparison.rows)
        if bad[i] > posterior.SUSPECT
    ]
    return bands, suspects, np.array(with_own) if target.told.size else None


def _refuse_far_out(target: Integrated, are_several: bool) -> None:
    """Refuse a most probable point with noise far from what is declared, or with anything where the maps end."""
    centre, farthest = target.centre(), np.full(len(target.unknowns), 2.0 * REACH)
    farthest[target.shared.size :] = REACH
    far = [
        f"{unknown.name} {value:.3g}{'' if unknown.unit == '1' else f' {unknown.unit}'} ({z:+.1f} prior sds, at most "
        f"{most:g})"
        for unknown, value, z, most in zip(
            target.unknowns, target.values(centre[None])[0], centre, farthest, strict=True
        )
        if abs(z) > most
    ]
    if far:
        compare = "see by `spinbench compare` whether the motor changed from one to the other, or "
        changed = compare if are_several else ""
        raise NoPeakError(
            f"the most probable point is too far out for a fit: {', '.join(far)}; {changed}leave out the readings that "
            "ask for it by --without FILE"
        )


def _fingerprint(recordings: Sequence[Recording], target: Integrated, settings: Settings) -> str:
    """What a chain on disk has to share with a fit that goes on from it: all, the code too, but budget and target."""
    compared = target.comparison.parts if isinstance(target.comparison, Several) else [target.comparison]
    parts = [
        [store.of_readings(one) for one in recordings],
        [one.problem.motor.model_dump() for one in compared],
        [(one.name, one.unit, one.kind, one.a, one.b) for one in target.unknowns],
        list(target.mode.names),
        target.comparison.read.size,
        settings.seed,
        imported_sha256(__name__),
    ]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
