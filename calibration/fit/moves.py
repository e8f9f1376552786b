"""Proposals for the ensemble sampler. Every move that a fit uses is held against a known Gaussian in the tests.

They work in the straightened coordinates of `calibration.fit.transport`, where the posterior is nearly N(0, I). emcee's
released ``DESnookerMove`` samples too narrow a posterior and is never used; docs/sampling.md has the measurements by
which these were chosen.
"""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np
from emcee.moves import Move
from scipy.special import logsumexp


class IndependenceMove(Move):
    """Propose from a fixed distribution about the origin, wherever the walker stands (independence Metropolis).

    Successive samples then hardly depend on each other. Most proposals come from a Student t; one in seven is stretched
    `LONG` times along a single coordinate, for a posterior that has a little of its mass far out on one side of the
    ridge (a recording of a row or two, one reading of which may be bad) and would hold a walker there.
    """

    LONG = 15.0
    STRETCHED = 0.15

    def __init__(self, degrees: float = 20.0, spread: float = 1.05) -> None:
        super().__init__()
        self.degrees = degrees
        self.spread = spread

    def log_density(self, x: np.ndarray) -> np.ndarray:
        """Log density of the proposal up to a constant, shape (n_walkers,) [-].

        Parameters
        ----------
        x : ndarray, shape (n_walkers, n)
            Points [-].
        """
        n = x.shape[1]
        squares = (x / self.spread) ** 2
        total = squares.sum(axis=1, keepdims=True)
        # One column for the t itself, one for each coordinate along which it may have been stretched.
        each = np.hstack([total, total - squares * (1.0 - self.LONG**-2)])
        log_t = -0.5 * (self.degrees + n) * np.log1p(each / self.degrees)
        weights = np.append(1.0 - self.STRETCHED, np.full(n, self.STRETCHED / (n * self.LONG)))
        found: np.ndarray = logsumexp(log_t, b=weights, axis=1)
        return found

    def draw(self, random: Any, walkers: int, n: int) -> np.ndarray:
        """Draws of the proposal, shape (walkers, n) [-]."""
        widening = np.sqrt(self.degrees / random.chisquare(self.degrees, size=walkers))
        q = self.spread * widening[:, None] * random.randn(walkers, n)
        stretched = random.rand(walkers) < self.STRETCHED
        which = random.randint(n, size=walkers)
        q[np.arange(walkers)[stretched], which[stretched]] *= self.LONG
        found: np.ndarray = q
        return found

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """One step of all walkers, as emcee calls it.

        Parameters
        ----------
        state : emcee.State
            The walkers; changed.

        Returns
        -------
        state : emcee.State
            After the step.
        accepted : ndarray of bool, shape (n_walkers,)
            Which walkers moved.
        """
        walkers, n = state.coords.shape
        q = self.draw(model.random, walkers, n)
        log_prob, _ = model.compute_log_prob_fn(q)
        ratio = log_prob - state.log_prob + self.log_density(state.coords) - self.log_density(q)
        accepted = np.log(model.random.rand(walkers)) < ratio
        state.coords = np.where(accepted[:, None], q, state.coords)
        state.log_prob = np.where(accepted, log_prob, state.log_prob)
        return state, accepted


def mixture() -> list[tuple[Move, float]]:
    """The moves of a fit: independent proposals, and differential evolution for what they do not reach."""
    return [(IndependenceMove(), 0.8), (emcee.moves.DEMove(), 0.2)]
