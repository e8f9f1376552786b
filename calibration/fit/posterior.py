"""What a chain says, in the words of posterior/1: parameters with their uncertainty, convergence, suspect rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calibration.data.rows_used import FileUse
from calibration.fit.sampling import Chain
from calibration.unknowns.priors import Unknown, values_of

QUANTILES = {"q05": 0.05, "q50": 0.50, "q95": 0.95}
UNINFORMED = 0.5  # posterior sd over prior sd above which the recording says little of an unknown
FAR_OFF = 4.0  # prior sds from its prior's middle at which an unknown contradicts it
SUSPECT = 0.5  # a reading that is more probably bad than good is named
DRAWS_FOR_ROWS = 400  # draws over which the rows' probabilities and predictions are averaged


@dataclass(frozen=True)
class Estimate:
    """One unknown's posterior.

    `sd_of_prior`: posterior sd over prior sd, in the prior's standard normal number: 1 when the recording says nothing
        [-].
    """

    unknown: Unknown
    mean: float
    sd: float
    quantiles: dict[str, float]
    sd_of_prior: float


@dataclass(frozen=True)
class SuspectRow:
    """A reading that is probably bad: file, row (1 is the first under the header), column and probability [-]."""

    file: str
    row: int
    channel: str
    probability: float


@dataclass(frozen=True)
class FitQuality:
    """Whether the model explains the readings that it was fitted to.

    `p_value`: how often chance alone leaves as much: uniform where the model is right [-].
    `why`: what stands out, or that nothing does; in words.
    """

    p_value: float
    model_fits: bool
    why: str


@dataclass(frozen=True)
class Posterior:
    """A fit's result.

    `estimates`: of what was sampled, then of what was integrated out.
    `z`, `values`, shape (n_draws, n_estimates): draws of all of them, as standard normal numbers and in the unknowns'
        units.
    """

    estimates: tuple[Estimate, ...]
    chain: Chain
    z: np.ndarray
    values: np.ndarray
    suspect_rows: tuple[SuspectRow, ...]
    seconds: float

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name."""
        return next(estimate for estimate in self.estimates if estimate.unknown.name == name)

    def prior_dominates(self, name: str) -> bool:
        """Whether the recording narrows an unknown by less than half."""
        return self[name].sd_of_prior > UNINFORMED

    def against_priors(self) -> list[tuple[Estimate, float]]:
        """Unknowns that contradict their priors, farthest first: by how many prior sds the mean is off [-]."""
        off = [(one, float(z)) for one, z in zip(self.estimates, self.z.mean(axis=0), strict=True) if abs(z) > FAR_OFF]
        return sorted(off, key=lambda one: -abs(one[1]))

    def share_from_priors(self, name: str) -> float:
        """Share of an unknown's variance that the unknowns which the recording hardly informs explain linearly [-]."""
        names = [estimate.unknown.name for estimate in self.estimates]
        loose = [i for i, e in enumerate(self.estimates) if e.sd_of_prior > UNINFORMED and e.unknown.name != name]
        if not loose:
            return 0.0
        target = self.z[:, names.index(name)] - self.z[:, names.index(name)].mean()
        terms = self.z[:, loose] - self.z[:, loose].mean(axis=0)
        explained = terms @ np.linalg.lstsq(terms, target, rcond=None)[0]
        return float(explained.var() / target.var())


def summarise(
    chain: Chain,
    unknowns: Sequence[Unknown],
    suspects: Sequence[SuspectRow],
    seconds: float,
    beside: Sequence[Unknown] = (),
    draws: np.ndarray | None = None,
) -> Posterior:
    """Summarise a chain.

    `unknowns`: that were sampled.
    `suspects`: readings that are probably bad, in any order.
    `seconds`: wall time of the fit [s].
    `beside`: that were integrated out.
    `draws`, shape (n_draws, n_unknowns): draws of what was sampled and of what was integrated out; left out where
        nothing was [-].
    Returns the summary.
    """
    flat = chain.flat()
    values = values_of(unknowns, flat)
    estimates = [_estimate(unknown, values[:, i], flat[:, i]) for i, unknown in enumerate(unknowns)]
    z = flat if draws is None else draws
    if draws is not None:
        values = values_of([*unknowns, *beside], z)
        of_them = range(len(unknowns), z.shape[1])
        estimates += [_estimate(unknown, values[:, i], z[:, i]) for i, unknown in zip(of_them, beside, strict=True)]
    worst_first = tuple(sorted(suspects, key=lambda row: -row.probability))
    return Posterior(tuple(estimates), chain, z, values, worst_first, seconds)


def thinned(flat: np.ndarray, most: int = DRAWS_FOR_ROWS) -> np.ndarray:
    """Evenly spaced draws of a flat chain, shape (<= most, n_unknowns) [-].

    `flat`, shape (n_samples, n_unknowns): all draws [-].
    """
    return flat[:: -(-len(flat) // most)]


def as_json(posterior: Posterior, quality: FitQuality | None = None, files: Sequence[FileUse] = ()) -> dict[str, Any]:
    """As posterior/1.

    `quality`: whether the model explains the readings; null where that was not asked.
    `files`: rows of each file and how many of them were used, of `calibration.data.rows_used`.
    """
    chain = posterior.chain
    return {
        "format": "posterior/1",
        "parameters": {
            estimate.unknown.name: {
                "unit": estimate.unknown.unit,
                "mean": estimate.mean,
                "sd": estimate.sd,
                **estimate.quantiles,
            }
            for estimate in posterior.estimates
        },
        "convergence": {
            "rhat_max": float(chain.rhat.max()),
            "ess_min": float(chain.effective.min()),
            "acceptance": chain.acceptance,
            "steps": chain.steps,
            "walkers": int(chain.samples.shape[2]),
            "ensembles": int(chain.samples.shape[0]),
        },
        "suspect_rows": [
            {"file": row.file, "row": row.row, "channel": row.channel, "probability": row.probability}
            for row in posterior.suspect_rows
        ],
        "fit_quality": None if quality is None else asdict(quality),
        "files": list(files),
        "seconds": posterior.seconds,
    }


def _estimate(unknown: Unknown, values: np.ndarray, z: np.ndarray) -> Estimate:
    quantiles = {name: float(np.quantile(values, q)) for name, q in QUANTILES.items()}
    return Estimate(unknown, float(values.mean()), float(values.std(ddof=1)), quantiles, float(z.std(ddof=1)))
