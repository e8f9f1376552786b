"""Proposals for the ensemble sampler. Every move that a fit uses is held against a known Gaussian in the tests.

They work in the straightened coordinates of `calibration.transport`, where the posterior is nearly N(0, I). emcee's
released ``DESnookerMove`` samples too narrow a posterior and is never used; docs/sampling.md has the measurements by
which these were chosen.
"""

from __future__ import annotations

from typing import Any

import emcee
import numpy as np
from emcee.moves import Move


class IndependenceMove(Move):
    """Propose from a fixed Student t about the origin, wherever the walker stands (independence Metropolis).

    Successive samples then hardly depend on each other. The tails are heavier than a normal's, and what lies in the
    posterior's own heavier tails is moved by the other move of the mixture.

    Parameters
    ----------
    degrees : float
        Degrees of freedom of the t [-].
    spread : float
        Its scale [-].
    """

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
        square = np.sum((x / self.spread) ** 2, axis=1)
        found: np.ndarray = -0.5 * (self.degrees + x.shape[1]) * np.log1p(square / self.degrees)
        return found

    def propose(self, model: Any, state: Any) -> tuple[Any, np.ndarray]:
        """One step of all walkers, as emcee calls it.

        Parameters
        ----------
        model : emcee.model.Model
            Log probability, mapping and randomness.
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
        widening = np.sqrt(self.degrees / model.random.chisquare(self.degrees, size=walkers))
        q = self.spread * widening[:, None] * model.random.randn(walkers, n)
        log_prob, _ = model.compute_log_prob_fn(q)
        ratio = log_prob - state.log_prob + self.log_density(state.coords) - self.log_density(q)
        accepted = np.log(model.random.rand(walkers)) < ratio
        state.coords = np.where(accepted[:, None], q, state.coords)
        state.log_prob = np.where(accepted, log_prob, state.log_prob)
        return state, accepted


def mixture() -> list[tuple[Move, float]]:
    """The moves of a fit: independent proposals, and differential evolution for what they do not reach."""
    return [(IndependenceMove(), 0.8), (emcee.moves.DEMove(), 0.2)]
