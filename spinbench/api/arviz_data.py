"""A fit's draws as xarray and ArviZ take them, and as a netCDF file."""

from __future__ import annotations

import contextlib
import importlib
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from calibration.fit.fit import Fit
from calibration.fit.whole import WholeFit
from calibration.unknowns.priors import Unknown, draw, values_of
from rig.recording.files import beside
from spinbench.extras import need

if TYPE_CHECKING:
    import xarray
    from arviz import InferenceData

PRIOR_DRAWS = 2000


def draws(found: Fit | WholeFit) -> xarray.Dataset:
    """The chain: ``chain`` is an ensemble, and along ``draw`` its walkers follow each other.

    So R-hat is between what is independent, and neighbours are correlated as the walkers' own steps are.
    """
    samples = found.posterior.chain.samples
    ensembles, steps, walkers, count = samples.shape
    by_walker = samples.transpose(0, 2, 1, 3).reshape(ensembles, walkers * steps, count)
    return _dataset(found, [one.unknown for one in found.posterior.estimates[:count]], by_walker)


def arviz_module() -> ModuleType:
    """ArviZ, which notes the day of its first import in a file: of two programs that do so at once, one fails."""
    need("arviz")
    with warnings.catch_warnings():  # of what a later version will have changed
        warnings.simplefilter("ignore", FutureWarning)
        with contextlib.suppress(FileNotFoundError):
            return importlib.import_module("arviz")
        return importlib.import_module("arviz")


def inference_data(found: Fit | WholeFit) -> InferenceData:
    """Posterior and prior. What is a recording's own and was integrated out is not in the chain, and so not here."""
    arviz = arviz_module()
    posterior = draws(found)
    unknowns = [one.unknown for one in found.posterior.estimates[: len(posterior.data_vars)]]
    prior = draw(unknowns, np.random.default_rng(found.settings.seed), PRIOR_DRAWS)
    return arviz.InferenceData(posterior=posterior, prior=_dataset(found, unknowns, prior[None]))


def write_netcdf(found: Fit | WholeFit, path: Path) -> Path:
    """Write both groups to a file; what stands there is replaced, once the new one is whole."""
    data = inference_data(found)
    path.parent.mkdir(parents=True, exist_ok=True)
    with beside(path.parent) as hidden:
        data.to_netcdf(str(hidden / path.name), engine="h5netcdf")
        (hidden / path.name).replace(path)
    return path


def _dataset(found: Fit | WholeFit, unknowns: Sequence[Unknown], z: np.ndarray) -> xarray.Dataset:
    """Standard normal numbers, shape (n_chains, n_draws, n_unknowns), as values with their units."""
    need("xarray")
    import xarray

    values = values_of(unknowns, z.reshape(-1, len(unknowns))).reshape(z.shape)
    quality = found.quality
    attrs = {
        "inference_library": "spinbench, emcee",
        "recordings": "; ".join(str(one.folder) for one in found.recordings),
        "sha256": "; ".join(one.sha256 for one in found.recordings),
        "motor": found.motor.name,
        "seed": found.settings.seed,
    }
    if quality is not None:
        attrs |= {"fit_quality_p_value": quality.p_value, "model_fits": str(quality.model_fits).lower()}
    variables = {
        one.name.replace("/", "_"): (("chain", "draw"), values[..., i], {"units": one.unit, "prior": one.why})
        for i, one in enumerate(unknowns)
    }
    coordinates = {"chain": np.arange(z.shape[0]), "draw": np.arange(z.shape[1])}
    return xarray.Dataset(variables, coordinates, attrs)
