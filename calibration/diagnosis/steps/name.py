"""Which set of effects explains the recording: the screen in the linear model, and how sets are weighed.

Evidence is Laplace's. The prior of a set falls tenfold with each further member and is even over the sets of a
size, so that many candidates cost what they should. An effect that has the form of an instrument's error counts
only where the whole error is beyond three of its declared standard deviations: its evidence is conditional on
that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import gammaln, log_ndtr, logsumexp

from calibration.diagnosis.steps.candidate import Candidate, Reason, Refusal, at_bound, no_larger, vanishes
from calibration.likelihood.compared import Compared, Problem
from calibration.likelihood.linearized import GOOD
from calibration.likelihood.mode import Mode
from calibration.likelihood.signatures import Signature, log_gain, project
from calibration.unknowns.effects import is_size

WORTH = 1.0  # nats in the linear model below which nothing is refitted; far from it that model orders poorly
BEYOND_SD = 3.0  # of the declared size of a nuisance
AT_BOUND = 1e-3
DOUBT = 2.0  # nats by which the evidence may be wrong with runs in time: the less probable sets get their benefit
FURTHER = 10.0  # how much rarer each further effect is: rigs seldom have two faults at once


def evidence_p(comparison: Compared, modes: dict[tuple[str, ...], Mode]) -> float:
    """Bound on how often chance alone favours some effect as much: 1 over the mean Bayes factor (Markov) [-].

    `modes`: by set; effects that were not refitted count as worth nothing.
    """
    base = modes[()].log_evidence
    gains = [mode.log_evidence - base for key, mode in modes.items() if key and not refusal(comparison, mode)]
    if not gains:
        return 1.0
    return float(min(1.0, math.exp(math.log(len(comparison.problem.effects_that_could())) - logsumexp(gains))))


def screen(
    comparison: Compared,
    mode: Mode,
    found: Sequence[Signature],
    u: np.ndarray,
    worth: float = WORTH,
    without: str = "",
) -> list[tuple[str, float, dict[tuple[str, str], float]]]:
    """Effects by what they would add in the linear model, with values to start a refit from.

    `u`, shape (k,): the noise [-].
    `worth`: log evidence below which an effect is left out [-].
    `without`: a member of the mode's set in whose place they are to stand; what they add is over the set without it.
    Returns effect, log evidence that it adds [-], and its unknowns to start from [-]; the most promising first.
    """
    white = comparison.whitener(mode.prediction, u)
    good = (mode.bad < GOOD).astype(float)
    J = white(mode.D) * good[:, None]
    z, members = mode.z.copy(), comparison.problem.effect_unknowns(mode.names)
    for place, (name, unknown) in enumerate(members, mode.z.size - len(members)):
        if name == without:  # all that it does is put back, its amplitude from 0 on: not the middle of every prior
            J[:, place] = 0.0
            shape = comparison.problem.parameter(name, unknown.name).shape
            z[place] = 0.0 if shape else mode.z[place] + unknown.a / unknown.b
    r = project(J, good * white(np.nan_to_num(comparison.read - comparison.raw(mode.prediction)) + mode.D @ z))
    best: dict[str, tuple[float, dict[tuple[str, str], float]]] = {}
    for one in found:
        g = white(one.column) * good
        gain, at_z = log_gain(one, g, project(J, g), r)
        first = dict(one.unknowns)
        amplitude = next(iter(first))
        first[amplitude] = float(np.clip((at_z - one.mean) / one.sd, -5.0, 5.0))
        if one.effect not in best or gain > best[one.effect][0]:
            best[one.effect] = (gain, first)
    order = sorted(best, key=lambda name: -best[name][0])
    return [(name, *best[name]) for name in order if best[name][0] > worth]


def weigh(comparison: Compared, modes: dict[tuple[str, ...], Mode]) -> list[Candidate]:
    """Probabilities of sets."""
    K = len(comparison.problem.effects_that_could())
    out = []
    for names, mode in modes.items():
        log_evidence = mode.log_evidence + sum(beyond(comparison.problem, mode, name) for name in names)
        out.append((names, mode, log_evidence, log_evidence + log_prior(len(names), K), refusal(comparison, mode)))
    best = max(o[3] for o in out)
    doubt = DOUBT if comparison.in_time else 0.0
    weight = [min(o[3] + doubt, best) for o in out]
    total = logsumexp(weight)
    order = sorted(range(len(out)), key=lambda i: (-out[i][3], out[i][0]))
    return [Candidate(*out[i][:3], float(weight[i] - total), out[i][4]) for i in order]


def log_prior(k: int, K: int) -> float:
    """Logarithm of a set's prior: nothing missing as likely as something, and each further member ten times rarer."""
    return float(-math.log(FURTHER) * max(k - 1, 0) - (gammaln(K + 1) - gammaln(k + 1) - gammaln(K - k + 1)))


def beyond(problem: Problem, mode: Mode, name: str) -> float:
    """What it does to the log evidence that a nuisance-like effect is to be beyond three declared sds; 0 for others."""
    found = total_size(problem, mode, name)
    if found is None:
        return 0.0
    mean, sd, prior_sd, one_sided = found
    after = [float(log_ndtr((mean - BEYOND_SD) / sd))]
    if not one_sided:
        after.append(float(log_ndtr((-BEYOND_SD - mean) / sd)))
    before = [float(log_ndtr(-BEYOND_SD / prior_sd))] * 2  # of one that cannot be negative: of both halves in one
    return float(logsumexp(after) - logsumexp(before))


def total_size(problem: Problem, mode: Mode, name: str) -> tuple[float, float, float, bool] | None:
    """Mean, sd and prior sd of a nuisance and the effect together, in declared sds; None where the effect has none.

    Of several recordings those where they are largest.
    """
    k, amplitude = len(problem.nuisances), problem.amplitude(name)
    found = [
        _size_at(problem, mode, name, i, *declared)
        for i, (effect, unknown) in enumerate(problem.effect_unknowns(mode.names), start=k)
        if effect == name and is_size(unknown.name, amplitude)
        for declared in declared_sizes(problem, name, unknown.name)
    ]
    return max(found, key=lambda size: abs(size[0]), default=None)


def _size_at(
    problem: Problem, mode: Mode, name: str, place: int, ratio: float, nuisance: int | None
) -> tuple[float, float, float, bool]:
    weights = {place: ratio} if nuisance is None else {place: ratio, nuisance: 1.0}
    index = np.array(list(weights))
    w = np.array(list(weights.values()))
    mean = float(w @ mode.z[index])
    sd = math.sqrt(max(float(w @ mode.covariance[np.ix_(index, index)] @ w), 1e-12))
    return mean, sd, math.sqrt(float(w @ w)), problem.amplitude(name).low >= 0.0


def declared_sizes(problem: Problem, name: str, parameter: str) -> list[tuple[float, int | None]]:
    """An effect's ordinary size in declared sds of the nuisance that it has the form of [-], and that one's place.

    Without a place where the nuisance is no unknown; none where the effect has the form of none. Of several recordings
    each has such a nuisance, or instruments that have a serial number.
    """
    effect, declared = problem.effect(name), problem.nuisance_of(name, parameter)
    scale = problem.amplitude(name).scale
    if effect.usual_sd is not None:
        return [(scale / effect.usual_sd, None)]
    found: list[tuple[float, int | None]] = []
    for place, unknown in enumerate(problem.nuisances):
        if not declared or declared not in (unknown.name, unknown.own):
            continue
        unit = unknown.b * problem.in_si(unknown.name)
        if unknown.kind == "lognormal":  # which the effect multiplies, or adds to
            unit = math.log(unknown.b) if effect.factors else unknown.a * (unknown.b - 1.0)
        found.append((scale / unit, place))
    return found


def refusal(comparison: Compared, mode: Mode) -> Refusal | None:
    """Why a set cannot be named: an amplitude at a bound, or a size that is its nuisance's own.

    Of an effect whose size has two components, such as a sine and a cosine, both are amplitudes.
    """
    problem = comparison.problem
    k = len(problem.nuisances)
    members = problem.effect_unknowns(mode.names)
    for i, (name, unknown) in enumerate(members):
        parameter, amplitude = problem.parameter(name, unknown.name), problem.amplitude(name)
        value = float(unknown.value(mode.z[k + i]))
        span = parameter.high - parameter.low
        component = parameter.low == -parameter.high
        if (is_size(unknown.name, amplitude) or component) and (
            value >= parameter.high - AT_BOUND * span
            or (parameter.low != 0.0 and value <= parameter.low + AT_BOUND * span)
        ):
            return at_bound(name, unknown.name)
        mine = [
            z
            for z, (one, other) in zip(mode.z[k:], members, strict=True)
            if one == name and is_size(other.name, amplitude)
        ]
        if amplitude.low == 0.0 and max(mine, default=1.0) <= 1e-6:
            return vanishes(name)
    if mode.names and (loud := comparison.noise.too_loud(mode.u)):
        return Refusal(Reason.TOO_LOUD, f"the noise would be {loud[1]:.1f} times as large as declared")
    for name in mode.names:
        found = total_size(problem, mode, name)
        if found is not None and abs(found[0]) < BEYOND_SD:
            return no_larger(name)
    return None
