"""Noise of the readings of another rig: how large it is, and how alike neighbours are along a transient.

The scale on the declared noise is log-normal, 0.3 a channel; a correlation is as likely as any other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from calibration.systems.readings import Readings
from calibration.unknowns.priors import NOISE_FACTOR

NOISE_SD = math.log(NOISE_FACTOR)
CORRELATIONS = np.linspace(-0.6, 0.95, 32)


@dataclass
class Noise:
    """Scale and correlation of readings, by their labels; one without an entry is as declared."""

    u: dict[str, float] = field(default_factory=dict)
    rho: dict[str, float] = field(default_factory=dict)


def uncorrelated(white: np.ndarray, rho: float) -> np.ndarray:
    """Take the correlation of neighbours out of whitened residuals [-].

    Parameters
    ----------
    white : ndarray, shape (n,) or (n, k)
        Residuals in units of their noise [-].
    """
    if not rho:
        return white
    return np.concatenate([white[:1], (white[1:] - rho * white[:-1]) / math.sqrt(1.0 - rho * rho)])


def whitened(readings: Sequence[Readings], residuals: Sequence[np.ndarray], noise: Noise) -> list[np.ndarray]:
    """Residuals made independent and of deviation 1 [-].

    Parameters
    ----------
    residuals : sequence of ndarray
        Readings less predictions [SI].
    """
    return [
        uncorrelated(one.white(r) * math.exp(-noise.u.get(one.label, 0.0)), noise.rho.get(one.label, 0.0))
        for one, r in zip(readings, residuals, strict=True)
    ]


def log_scale(readings: Sequence[Readings], noise: Noise) -> float:
    """What scales and correlations add to minus the log posterior, their prior included [-]."""
    total = 0.0
    for one in readings:
        rho = noise.rho.get(one.label, 0.0)
        total += one.value.size * noise.u.get(one.label, 0.0)
        total += 0.5 * max(one.value.size - 1, 0) * math.log(1.0 - rho * rho)
    return total + 0.5 * sum((u / NOISE_SD) ** 2 for u in noise.u.values())


def noise_of(readings: Sequence[Readings], residuals: Sequence[np.ndarray]) -> Noise:
    """Noise scale and correlation that suit the residuals best, one array after the other.

    Parameters
    ----------
    residuals : sequence of ndarray
        Readings less predictions [SI].
    """
    found = Noise()
    for one, r in zip(readings, residuals, strict=True):
        white, best = one.white(r), math.inf
        n = white.size
        for rho in CORRELATIONS if one.serial else (0.0,):
            square = float(np.sum(uncorrelated(white, float(rho)) ** 2))
            u = 0.5 * math.log(max(square / max(n, 1), 1e-12))
            for _ in range(30):  # of n u + square exp(-2u) / 2 + (u / sd)^2 / 2, by Newton
                slope = n - square * math.exp(-2.0 * u) + u / NOISE_SD**2
                step = slope / (2.0 * square * math.exp(-2.0 * u) + NOISE_SD**-2)
                u -= min(max(step, -0.5), 0.5)
                if abs(step) < 1e-9:
                    break
            cost = 0.5 * square * math.exp(-2.0 * u) + n * u + 0.5 * (u / NOISE_SD) ** 2
            cost += 0.5 * max(n - 1, 0) * math.log(1.0 - rho * rho)
            if cost < best:
                best, found.u[one.label], found.rho[one.label] = cost, u, float(rho)
    return found
