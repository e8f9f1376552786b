"""What a chain says, in the words of posterior/1: parameters with their uncertainty, convergence, suspect rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calibration.fit.sampling import Chain
from calibration.systems.radial_piston.batch.likelihood import Likelihood
from calibration.unknowns.priors import Unknown

QUANTILES = {"q05": 0.05, "q50": 0.50, "q95": 0.95}
UNINFORMED = 0.5  # posterior sd over prior sd above which the recording says little of an unknown
SUSPECT = 0.5  # a reading that is more probably bad than good is named
DRAWS_FOR_ROWS = 400  # draws over which the rows' probabilities and predictions are averaged
COLUMNS = ("pressure", "flow", "speed")


@dataclass(frozen=True)
class Estimate:
    """One unknown's posterior.

    Attributes
    ----------
    sd_of_prior : float
        Posterior sd over prior sd, in the prior's standard normal number: 1 when the recording says nothing [-].
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

    Attributes
    ----------
    p_value : float
        How often chance alone leaves as much: uniform where the model is right [-].
    why : str
        What stands out, or that nothing does; in words.
    """

    p_value: float
    model_fits: bool
    why: str


@dataclass(frozen=True)
class Posterior:
    """A fit's result.

    Attributes
    ----------
    values : ndarray, shape (n_samples, n_unknowns)
        Samples in the unknowns' units.
    """

    estimates: tuple[Estimate, ...]
    chain: Chain
    values: np.ndarray
    suspect_rows: tuple[SuspectRow, ...]
    seconds: float

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name."""
        return next(estimate for estimate in self.estimates if estimate.unknown.name == name)

    def prior_dominates(self, name: str) -> bool:
        """Whether the recording narrows an unknown by less than half."""
        return self[name].sd_of_prior > UNINFORMED

    def share_from_priors(self, name: str) -> float:
        """Share of an unknown's variance that the unknowns which the recording hardly informs explain linearly [-]."""
        names = [estimate.unknown.name for estimate in self.estimates]
        loose = [i for i, e in enumerate(self.estimates) if e.sd_of_prior > UNINFORMED and e.unknown.name != name]
        if not loose:
            return 0.0
        flat = self.chain.flat()
        target = flat[:, names.index(name)] - flat[:, names.index(name)].mean()
        terms = flat[:, loose] - flat[:, loose].mean(axis=0)
        explained = terms @ np.linalg.lstsq(terms, target, rcond=None)[0]
        return float(explained.var() / target.var())


def summarise(chain: Chain, likelihood: Likelihood, columns: Sequence[str | None], seconds: float) -> Posterior:
    """Summarise a chain.

    Parameters
    ----------
    seconds : float
        Wall time of the fit [s].

    Returns
    -------
    Posterior
        The summary.
    """
    flat = chain.flat()
    values = likelihood.values(flat)
    estimates = tuple(_estimate(unknown, values[:, i], flat[:, i]) for i, unknown in enumerate(likelihood.unknowns))
    bad = likelihood.bad_probability(thinned(flat))
    rows = likelihood.measured.steady
    suspects = [
        SuspectRow(rows.file[r], int(rows.row[r]), str(columns[c]), float(bad[r, c]))
        for r, c in zip(*np.nonzero(bad > SUSPECT), strict=True)
    ]
    suspects.sort(key=lambda row: -row.probability)
    return Posterior(estimates, chain, values, tuple(suspects), seconds)


def thinned(flat: np.ndarray, most: int = DRAWS_FOR_ROWS) -> np.ndarray:
    """Evenly spaced draws of a flat chain, shape (<= most, n_unknowns) [-].

    Parameters
    ----------
    flat : ndarray, shape (n_samples, n_unknowns)
        All draws [-].
    """
    return flat[:: -(-len(flat) // most)]


def as_json(
    posterior: Posterior, quality: FitQuality | None = None, files: Sequence[dict[str, Any]] = ()
) -> dict[str, Any]:
    """As posterior/1.

    Parameters
    ----------
    quality : FitQuality or None
        Whether the model explains the readings; null where that was not asked.
    files : sequence of dict
        Rows of each file and how many of them were used, of `calibration.data.rows_used`.
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
