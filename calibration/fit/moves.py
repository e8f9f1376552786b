"""Proposals for the ensemble sampler. Every move that a fit uses is held against a known distribution in the tests.

They work in the straightened coordinates of `calibration.fit.transport`, where the posterior is nearly N(0, I). emcee's
released ``DESnookerMove`` samples too narrow a posterior and is never used; docs/sampling.md has the measurements by
which these were chosen.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import gammaln

from calibration.fit.peak import BatchLogProb
from calibration.fit.transport import TransportMap

if TYPE_CHECKING:
    from emcee.moves import Move

STEPS = 24  # that a stand-in walks, where the true posterior takes a thousand times as long
LOCAL, TURNS = 0.4, (0.1, 0.8)  # share of a stand-in's steps that are turns, and how far these go: sine of the angle
SELDOM, OFTEN = 0.03, 0.2  # shares of proposals other than the stand-in's own
OFF, ENOUGH = 5.0, 3  # sds off the ridge that make a branch, and points for each of its coordinates
SIDE, BLURRED = 0.1, 0.1  # share of proposals in a branch, and what its variances are widened by
FLATTER = 1.5  # by which a stand-in's log density is divided, for proposals farther out


class Branch:
    """A normal law about points that lie off the ridge: a second one, where a reading is taken for bad, say.

    `points`, shape (n_points, n): in straightened coordinates [-].
    """

    def __init__(self, points: np.ndarray) -> None:
        self.mean = points.mean(axis=0)
        self.root = np.linalg.cholesky(np.atleast_2d(np.cov(points.T)) + BLURRED * np.eye(points.shape[1]))

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density, shape (n_walkers,) [-]. `x`, shape (n_walkers, n): points [-]."""
        z = np.linalg.solve(self.root, (x - self.mean).T)
        volume = np.log(np.diag(self.root)).sum() + 0.5 * x.shape[1] * np.log(2.0 * np.pi)
        found: np.ndarray = -0.5 * np.sum(z * z, axis=0) - volume
        return found


class IndependenceMove:
    """Propose from a fixed distribution about the origin, wherever the walker stands (independence Metropolis).

    Successive samples then hardly depend on each other. Most proposals come from a Student t; one in seven is stretched
    `LONG` times along a single coordinate, for a posterior that has a little of its mass far out on one side of the
    ridge (a recording of a row or two, one reading of which may be bad) and would hold a walker there.
    """

    LONG = 15.0
    STRETCHED = 0.15

    def __init__(self, degrees: float = 20.0, spread: float = 1.05, branch: Branch | None = None) -> None:
        self.degrees = degrees
        self.spread = spread
        self.branch = branch

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density of the proposal up to a constant, shape (n_walkers,) [-].

        `x`, shape (n_walkers, n): points [-].
        """
        n = x.shape[1]
        squares = (x / self.spread) ** 2
        total = squares.sum(axis=1, keepdims=True)
        # One column for the t itself, one for each coordinate along which it may have been stretched.
        each = np.hstack([total, total - squares * (1.0 - self.LONG**-2)])
        log_t = -0.5 * (self.degrees + n) * np.log1p(each / self.degrees)
        weights = np.append(1.0 - self.STRETCHED, np.full(n, self.STRETCHED / (n * self.LONG)))
        most = log_t.max(axis=1)
        found: np.ndarray = most + np.log(np.exp(log_t - most[:, None]) @ weights)
        if self.branch is None:
            return found
        half = 0.5 * self.degrees
        whole = gammaln(half + 0.5 * n) - gammaln(half) - 0.5 * n * np.log(self.degrees * np.pi * self.spread**2)
        return np.logaddexp(found + whole + np.log1p(-SIDE), self.branch.log_density(x) + np.log(SIDE))

    def draw(self, random: Any, walkers: int, n: int) -> np.ndarray:
        """Draws of the proposal, shape (walkers, n) [-]."""
        widening = np.sqrt(self.degrees / random.chisquare(self.degrees, size=walkers))
        q = self.spread * widening[:, None] * random.randn(walkers, n)
        stretched = random.rand(walkers) < self.STRETCHED
        which = random.randint(n, size=walkers)
        q[np.arange(walkers)[stretched], which[stretched]] *= self.LONG
        if self.branch is not None:
            aside = random.rand(walkers) < SIDE
            q[aside] = (self.branch.mean + random.randn(walkers, n) @ self.branch.root.T)[aside]
        return q

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """One step of all walkers, as emcee calls it.

        `state`: the walkers; changed.
        Returns `state`: after the step; `accepted`: which walkers moved.
        """
        walkers, n = state.coords.shape
        q = self.draw(model.random, walkers, n)
        log_prob, _ = model.compute_log_prob_fn(q)
        ratio = log_prob - state.log_prob + self.log_density(state.coords) - self.log_density(q)
        accepted = np.log(model.random.rand(walkers)) < ratio
        state.coords = np.where(accepted[:, None], q, state.coords)
        state.log_prob = np.where(accepted, log_prob, state.log_prob)
        return state, accepted


class DelayedAcceptance:
    """Let a cheap stand-in walk some steps, and have the true posterior accept where it ends (Christen and Fox 2005).

    The stand-in's own steps are taken in straightened coordinates and accepted by the stand-in: independence proposals,
    or turns that keep a normal law as it is (preconditioned Crank-Nicolson; Cotter et al. 2013), which lead away from
    where the coordinates are badly straightened. This kernel leaves the stand-in's distribution as it is and can be
    walked backwards, so what is sampled is the true posterior, however wrong the stand-in. How wrong it is says the
    share that is accepted.

    `stand_in`: log density of points of shape (n, n_unknowns), returning shape (n,) [-].
    `shape`: whose independent numbers the stand-in is nearly normal in.
    `steps`: that the stand-in walks for one of the true posterior [-].
    `branch`: off the ridge, where it walks to as well.
    """

    def __init__(self, stand_in: BatchLogProb, shape: TransportMap, steps: int, branch: Branch | None = None) -> None:
        self.stand_in, self.shape, self.steps = stand_in, shape, steps
        self.within = IndependenceMove(10.0, 1.1, branch)

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """One step of all walkers, as emcee calls it.

        `state`: the walkers; changed.
        Returns `state`: after the step; `accepted`: which walkers moved.
        """
        walkers, n = state.coords.shape
        begin = self.stand_in(state.coords)
        here, value = state.coords.copy(), begin.copy()
        straight = self.shape.pull(here)
        weight = self.shape.push(straight)[1] + value
        for _ in range(self.steps):
            if model.random.rand() < LOCAL:
                turn = np.exp(model.random.uniform(*np.log(TURNS), size=(walkers, 1)))
                q = np.sqrt(1.0 - turn**2) * straight + turn * model.random.randn(walkers, n)
                of_moves = 0.5 * (np.sum(q**2, axis=1) - np.sum(straight**2, axis=1))
            else:
                q = self.within.draw(model.random, walkers, n)
                of_moves = self.within.log_density(straight) - self.within.log_density(q)
            z, log_volume = self.shape.push(q)
            there = self.stand_in(z)
            with np.errstate(invalid="ignore"):
                taken = np.log(model.random.rand(walkers)) < there + log_volume - weight + of_moves
            here[taken], straight[taken], value[taken] = z[taken], q[taken], there[taken]
            weight[taken] = (there + log_volume)[taken]
        # Where the stand-in has no mass it cannot walk from; the other move leads out of there.
        moved = np.isfinite(begin) & np.any(here != state.coords, axis=1)
        accepted = np.zeros(walkers, dtype=bool)
        draws = np.log(model.random.rand(walkers))
        if moved.any():
            log_prob, _ = model.compute_log_prob_fn(here[moved])
            ratio = log_prob - state.log_prob[moved] + begin[moved] - value[moved]
            accepted[np.flatnonzero(moved)] = draws[moved] < ratio
            taken = accepted[moved]
            state.log_prob[accepted] = log_prob[taken]
        state.coords = np.where(accepted[:, None], here, state.coords)
        return state, accepted


class DifferenceMove:
    """Step by a multiple of the difference of two points of a fixed set (ter Braak and Vrugt 2008).

    Differential evolution whose other walkers never move: each walker is then a chain of its own.

    `points`, shape (n_points, n_unknowns): that look like the posterior [-].
    """

    def __init__(self, points: np.ndarray) -> None:
        self.points = points

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """One step of all walkers, as emcee calls it; arguments and result as of `IndependenceMove.propose`."""
        walkers, n = state.coords.shape
        one, other = model.random.randint(len(self.points), size=(2, walkers))
        q = state.coords + 2.38 / np.sqrt(2.0 * n) * (self.points[one] - self.points[other])
        log_prob, _ = model.compute_log_prob_fn(q)
        accepted = np.log(model.random.rand(walkers)) < log_prob - state.log_prob
        state.coords = np.where(accepted[:, None], q, state.coords)
        state.log_prob = np.where(accepted, log_prob, state.log_prob)
        return state, accepted


def mixture() -> list[tuple[Move, float]]:
    """The moves of a fit: independent proposals, and differential evolution for what they do not reach."""
    from emcee.moves import DEMove  # with scipy.stats; a third of a second, which pages of diagnoses are spared

    return [(IndependenceMove(), 0.8), (DEMove(), 0.2)]


def delayed(
    stand_in: BatchLogProb, shape: TransportMap, points: np.ndarray, steps: int = STEPS, trusted: bool = False
) -> list[tuple[Move, float]]:
    """The moves where a stand-in proposes, none of which looks at other walkers.

    Some proposals are of a flatter one, one in five or, where the stand-in is ``trusted``, in thirty: where it has too
    little mass a walker would be held for long. Differences of ``points`` are for what neither reaches. Where enough of
    ``points`` lie off the ridge, the stand-in proposes there too.
    """
    e = shape.pull(points)
    off = e[np.abs(e).max(axis=1) > OFF]
    branch = Branch(off) if len(off) >= ENOUGH * e.shape[1] else None

    def flatter(z: np.ndarray) -> np.ndarray:
        return stand_in(z) / FLATTER

    own, flat = (DelayedAcceptance(law, shape, steps, branch) for law in (stand_in, flatter))
    share = SELDOM if trusted else OFTEN
    return [(own, 1.0 - share - SELDOM), (flat, share), (DifferenceMove(points), SELDOM)]
