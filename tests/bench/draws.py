"""Effective samples a second of the published sweep's posterior: our sampler against emcee's default and dynesty.

All see the same compiled likelihood. The stretch move is given our posterior's draws to start from, so that it pays for
no burn-in while ours pays for the whole run; its autocorrelation time is emcee's own estimate, which is too short for
short chains, while ours is the stricter one by which a fit ends. Both errors favour the peer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from unittest.mock import patch

import dynesty
import emcee
import numba
import numpy as np
from emcee.autocorr import integrated_time
from results import Row
from scipy.special import ndtri
from timing import one_core

from calibration.fit import fit, proposed, sampling, whole
from calibration.fit.sampling import Chain, Settings
from calibration.studies import nulls_draw
from calibration.systems.look_up import compared
from rig.recording import Recording

LogProb = Callable[[np.ndarray], np.ndarray]
WALKERS = 64
LIVE_POINTS = 250
WANTED = 10_000  # effective samples
TOPIC = "The posterior of Table 3: effective samples"
LARGER = "Larger posteriors: effective samples"
DESIGN_SEED = 5  # of a motor that turns at all 26 plateaus and all along both runs
GOOD = {"pressure_bar_abs": 0.001, "flow_l_min": 0.1, "speed_rpm": 0.05}  # noise of very good instruments


@dataclass(frozen=True)
class Target:
    """A posterior to sample: in standard normal numbers, as the fit's likelihood has it.

    Attributes
    ----------
    log_prob, log_likelihood : callable
        Of points of shape (n, n_unknowns), returning shape (n,) [-].
    draw : callable
        Our whole run with given settings.
    n_unknowns : int
        Dimensions [-].
    """

    log_prob: LogProb
    log_likelihood: LogProb
    draw: Callable[[Settings], Chain]
    n_unknowns: int


@dataclass(frozen=True)
class Effort:
    """How long each sampler is run.

    Attributes
    ----------
    settings : Settings
        Of our sampler.
    alone_steps, vectorised_steps : int
        Of the stretch move, one point at a time and vectorised [-].
    nested_s : float
        Most wall time of the nested sampler [s].
    """

    settings: Settings
    alone_steps: int
    vectorised_steps: int
    nested_s: float


@dataclass(frozen=True)
class Peer:
    """What a peer drew: effective samples of the worst unknown [-], wall time [s], and conditions in words."""

    effective: float
    seconds: float
    note: str


def gaussian(n: int) -> Target:
    """A unit normal prior and a likelihood twice as narrow: a target for trying the pieces out.

    Parameters
    ----------
    n : int
        Number of unknowns [-].
    """

    def log_prob(z: np.ndarray) -> np.ndarray:
        return -2.5 * np.sum(z * z, axis=1)

    draw = partial(sampling.sample, log_prob, n, np.ones_like)
    return Target(log_prob, lambda z: -2.0 * np.sum(z * z, axis=1), draw, n)


def of_recording(recording: Recording) -> Target:
    """The posterior of a recording's plateaus, all channels seen.

    Parameters
    ----------
    recording : Recording
        With at least one plateau.
    """
    _, _, likelihood = fit.prepare(recording)
    draw = partial(proposed.draw, likelihood)
    return Target(likelihood.log_prob, likelihood.log_likelihood, draw, len(likelihood.unknowns))


def rows(target: Target, effort: Effort, tell: Callable[[str], None]) -> list[Row]:
    """Effective samples a second of all samplers, and our time to 10 000.

    Parameters
    ----------
    target : Target
        The posterior.
    effort : Effort
        Length of the runs.
    tell : callable
        Told what comes next.
    """
    target.log_prob(np.zeros((2, target.n_unknowns)))  # compile or load first
    tell("posterior: our sampler")
    chain, seconds = ours(target, effort.settings)
    rate = float(chain.effective.min()) / seconds
    start = chain.flat()[np.random.default_rng(1).choice(len(chain.flat()), WALKERS, replace=False)]
    tell("posterior: emcee's stretch move, vectorised")
    vectorised, tau = stretch(target, start, effort.vectorised_steps)
    tell("posterior: emcee's stretch move, a point at a time")
    alone = stretch_alone(target, start, effort.alone_steps, tau)
    tell("posterior: dynesty")
    nested_peer = nested(target, effort.nested_s)
    what = "per second, against "
    return [
        _to_wanted(chain, seconds, TOPIC, f"time to {effort.settings.effective_samples}", effort.settings, 3.0),
        Row(TOPIC, what + "emcee as it comes", rate, _rate(alone), "1/s", True, 10.0, note=alone.note),
        Row(TOPIC, what + "emcee vectorised", rate, _rate(vectorised), "1/s", True, note=vectorised.note),
        Row(TOPIC, what + "dynesty", rate, _rate(nested_peer), "1/s", True, note=nested_peer.note),
    ]


def ours(target: Target, settings: Settings) -> tuple[Chain, float]:
    """The whole run of our sampler, search for the peak and warm-up included, and its wall time [s].

    Parameters
    ----------
    target : Target
        The posterior.
    settings : Settings
        Seed, target and budget.
    """
    begun = time.perf_counter()
    chain = target.draw(settings)
    return chain, time.perf_counter() - begun


def stretch(target: Target, start: np.ndarray, steps: int) -> tuple[Peer, float]:
    """emcee's default move with the batched likelihood; also its autocorrelation time in steps.

    Parameters
    ----------
    target : Target
        The posterior.
    start : ndarray, shape (n_walkers, n_unknowns)
        Draws from the posterior [-].
    steps : int
        Length of the run [-].
    """
    sampler = emcee.EnsembleSampler(*start.shape, target.log_prob, vectorize=True)
    begun = time.perf_counter()
    sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    seconds = time.perf_counter() - begun
    tau = float(np.max(integrated_time(sampler.get_chain(), tol=0)))
    note = f"{len(start)} walkers, {steps} steps from our draws, autocorrelation time {tau:.0f} steps"
    short = "" if steps >= 50 * tau else f" (the chain is {steps / tau:.0f} of them: the true time may be longer)"
    return Peer(steps * len(start) / tau, seconds, note + short), tau


def stretch_alone(target: Target, start: np.ndarray, steps: int, tau: float) -> Peer:
    """The same chain with the likelihood called for one walker at a time, as emcee does by default.

    Parameters
    ----------
    target : Target
        The posterior.
    start : ndarray, shape (n_walkers, n_unknowns)
        Draws from the posterior [-].
    steps : int
        Length of the run; its time a step is what counts [-].
    tau : float
        Autocorrelation time of the same chain, from the longer vectorised run [steps].
    """
    sampler = emcee.EnsembleSampler(*start.shape, lambda z: float(target.log_prob(z[None])[0]))
    with one_core():
        begun = time.perf_counter()
        sampler.run_mcmc(start, steps, skip_initial_state_check=True)
        seconds = time.perf_counter() - begun
    note = f"default move, vectorize=False, {len(start)} walkers, time of {steps} steps, mixing as vectorised"
    return Peer(steps * len(start) / tau, seconds, note)


def nested(target: Target, most_s: float) -> Peer:
    """dynesty's nested sampling with the likelihood called one by one, stopped when the time is up.

    Parameters
    ----------
    target : Target
        The posterior.
    most_s : float
        Most wall time [s].
    """
    n = target.n_unknowns

    def log_likelihood(z: np.ndarray) -> float:
        return max(float(target.log_likelihood(z[None])[0]), -1e300)

    with one_core():
        begun = time.perf_counter()
        sampler = dynesty.NestedSampler(log_likelihood, ndtri, n, nlive=LIVE_POINTS, rstate=np.random.default_rng(1))
        finished = True
        for _ in sampler.sample(dlogz=0.1):
            if time.perf_counter() - begun > most_s:
                finished = False
                break
        for _ in sampler.add_live_points():
            pass
        seconds = time.perf_counter() - begun
    results = sampler.results
    weights = np.exp(results.logwt - results.logz[-1])
    kish = float(weights.sum() ** 2 / np.sum(weights**2))
    note = f"{LIVE_POINTS} live points, {np.sum(results.ncall)} calls, Kish's effective samples {kish:.0f}"
    return Peer(kish, seconds, note + ("" if finished else f"; stopped after {most_s:g} s, before it was done"))


def larger(settings: Settings, tell: Callable[[str], None]) -> list[Row]:
    """Times to as many effective samples of 26 plateaus, the same by very good instruments, and with two runs in time.

    Parameters
    ----------
    settings : Settings
        Seed, target and budget.
    tell : callable
        Told what comes next.
    """
    by_good = {name: replace(nulls_draw.INSTRUMENTS[name], noise_sd=sd, resolution=sd) for name, sd in GOOD.items()}
    found = []
    for what, instruments in (("26 plateaus", nulls_draw.INSTRUMENTS), ("26 plateaus, very good instruments", by_good)):
        tell(f"posterior: {what}")
        with patch.dict(nulls_draw.INSTRUMENTS, instruments):
            target = of_recording(_drawn(with_runs=False))
        target.log_prob(np.zeros((2, target.n_unknowns)))
        chain, seconds = ours(target, settings)
        found.append(_to_wanted(chain, seconds, LARGER, what, settings, 10.0))
    recording = _drawn(with_runs=True)
    for wanted, most in ((settings.effective_samples // 5, 45.0), (settings.effective_samples, 180.0)):
        what = f"26 plateaus, a spin-up and a coast-down, {wanted} samples"
        tell(f"posterior: {what}")
        begun = time.perf_counter()
        comparison = compared(recording)
        given = replace(settings, effective_samples=wanted)
        chain = whole.fit([recording], comparison, comparison.base(), given, workers=numba.config.NUMBA_NUM_THREADS)
        found.append(_to_wanted(chain.posterior.chain, time.perf_counter() - begun, LARGER, what, given, most))
    return found


def _drawn(with_runs: bool) -> Recording:
    return nulls_draw.null_recording("declared", with_runs, np.random.default_rng(DESIGN_SEED))[0]


def _rate(peer: Peer) -> float:
    return peer.effective / peer.seconds


def _to_wanted(chain: Chain, seconds: float, topic: str, what: str, settings: Settings, most: float) -> Row:
    effective = float(chain.effective.min())
    ensembles, _, walkers, _ = chain.samples.shape
    note = (
        f"whole run, warm-up included: {effective:.0f} of the worst unknown after {chain.steps} steps, "
        f"{chain.steps * ensembles * walkers / effective:.1f} evaluations for each, R-hat {chain.rhat.max():.4f}"
        f"{'' if chain.converged else ' (not converged)'}"
    )
    goal = most if chain.converged and effective >= settings.effective_samples else None
    return Row(topic, what, seconds, None, "s", most=goal, note=note)
