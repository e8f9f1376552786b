"""A fit: how it is made of what is asked for, for the command line too, and a result that shows itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from arviz import InferenceData
    from matplotlib.figure import Figure

    from calibration.fit.fit import Fit
    from calibration.fit.posterior import FitQuality, Posterior
    from calibration.fit.sampling import Settings
    from calibration.fit.whole import WholeFit
    from calibration.systems.several.sharing import Sharing
    from model.motor import Motor
    from rig.recording import Recording
    from spinbench.api.opened import Data
    from spinbench.api.simulating import Values

LEAST_EFFECTIVE = 200  # samples, from which quantiles can be told


@dataclass(frozen=True)
class Asked:
    """What is to be fitted, and how.

    Attributes
    ----------
    workers : int
        Processes; the result is the same with any [-].
    """

    settings: Settings
    assignments: Sequence[str]
    channels: tuple[str, ...]
    effects: Sequence[str]
    steady_only: bool
    sharing: Sharing
    workers: int = 1

    def is_whole(self, parts: Sequence[Recording]) -> bool:
        """Whether there is more to fit than the plateaus of one recording."""
        return len(parts) > 1 or (not self.steady_only and any(file.kind == "transient" for file in parts[0].files))


def prepared(
    recordings: Sequence[Recording],
    settings: Settings,
    assignments: Sequence[str] = (),
    channels: tuple[str, ...] | None = None,
    effects: Sequence[str] = (),
    steady_only: bool = False,
    per_recording: Sequence[str] = (),
    workers: int = 1,
) -> tuple[list[Recording], Asked]:
    """The recordings as they are fitted, one wherever they can be one, and what is asked of them."""
    from calibration.data.joined import as_given, without_runs
    from calibration.systems.several.sharing import own_of_each
    from calibration.unknowns.priors import CHANNELS

    parts = list(recordings)
    if steady_only and len(parts) > 1:
        steady = [one for one in parts if any(file.kind == "steady" for file in one.files)] or parts[:1]
        passed_over = [f"{one.folder}: passed over: it has no plateaus" for one in parts if one not in steady]
        parts = [without_runs(one) for one in steady]
        parts[0] = replace(parts[0], warnings=(*parts[0].warnings, *passed_over))
    held = [name.strip() for name in effects]
    sharing = own_of_each(per_recording, len(parts), held)
    read = parts if steady_only and len(parts) == 1 else as_given(parts, apart=bool(sharing.own))
    return read, Asked(settings, assignments, channels or CHANNELS, held, steady_only, sharing, workers)


def fitted(parts: Sequence[Recording], asked: Asked, chain: Path | None = None) -> Fit | WholeFit:
    """The fit, with whether its model explains the readings."""
    return _fitted_whole(parts, asked, chain) if asked.is_whole(parts) else _fitted_steady(parts[0], asked, chain)


def _fitted_steady(read: Recording, asked: Asked, chain: Path | None) -> Fit:
    from calibration import fit_quality
    from calibration.fit import fit as fits
    from calibration.fit.sampling import STEADY
    from spinbench.progress import sampling, waiting

    settings = asked.settings.within(STEADY)
    with waiting("does the model explain the readings?") as tell:
        quality = fit_quality.judge(read, settings.seed, asked.assignments, asked.channels, asked.effects, tell)
    try:
        with sampling("fit") as progress:
            found = fits.fit(read, settings, asked.assignments, asked.channels, chain, progress, asked.effects)
    except fits.NotConvergedError as error:
        _add_why(error, quality)
        raise
    return replace(found, quality=quality)


def _fitted_whole(parts: Sequence[Recording], asked: Asked, chain: Path | None) -> WholeFit:
    from calibration import fit_quality
    from calibration.fit import whole
    from calibration.fit.fit import NotConvergedError
    from calibration.fit.peak import NoPeakError
    from calibration.fit.sampling import WHOLE
    from spinbench.progress import sampling, waiting

    settings, workers = asked.settings.within(WHOLE), asked.workers
    with waiting("does the model explain the readings?") as tell:
        used, start, quality = fit_quality.judge_whole(
            parts, settings.seed, asked.assignments, asked.channels, asked.effects, tell, workers, asked.sharing
        )
    try:
        with sampling("fit") as progress:
            found = whole.fit(used, start.comparison, start.base, settings, chain, progress, workers)
    except (NotConvergedError, NoPeakError) as error:
        _add_why(error, quality)
        raise
    return replace(found, quality=quality)


def _add_why(error: Exception, quality: FitQuality) -> None:
    if not quality.model_fits:
        error.add_note(f"nor does the model explain the readings: {quality.why}")


@dataclass(frozen=True, eq=False, repr=False)
class FitResult:
    """What `fit` found; a notebook shows the sentence, the notes and the table.

    Attributes
    ----------
    found : Fit or WholeFit
        The fit itself.
    notes : tuple of str
        What was left out or assumed of the recordings, a sentence each.
    """

    found: Fit | WholeFit
    notes: tuple[str, ...] = ()

    @property
    def posterior(self) -> Posterior:
        """Estimates, chain and suspect rows."""
        return self.found.posterior

    @property
    def quality(self) -> FitQuality | None:
        """Whether the model explains the readings: ``p_value``, ``model_fits`` and ``why``."""
        return self.found.quality

    @property
    def recording(self) -> Recording:
        """The first recording."""
        return self.found.recording

    @property
    def recordings(self) -> tuple[Recording, ...]:
        """What was fitted."""
        return self.found.recordings

    @property
    def motor(self) -> Motor:
        """The motor, at the first recording's ambient."""
        return self.found.motor

    @property
    def settings(self) -> Settings:
        """How long was sampled."""
        return self.found.settings

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that the model holds."""
        return self.found.effects

    @property
    def sentence(self) -> str:
        """What comes first: f_overall, or that the model does not explain the readings."""
        from calibration.report.fit import words

        return " ".join(words.headline(self.found))

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for each unknown: unit, mean, sd, quantiles, and its sd over that of its prior."""
        import pandas as pd

        rows = {
            one.unknown.name: {"unit": one.unknown.unit, "mean": one.mean, "sd": one.sd}
            | one.quantiles
            | {"sd_of_prior": one.sd_of_prior}
            for one in self.posterior.estimates
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")

    @cached_property
    def samples(self) -> pd.DataFrame:
        """Draws of all unknowns together, a column each, in their units."""
        import pandas as pd

        from spinbench.api.frames import with_units

        unknowns = [one.unknown for one in self.posterior.estimates]
        frame = pd.DataFrame(self.posterior.values, columns=[one.name for one in unknowns])
        return with_units(frame, {one.name: one.unit for one in unknowns})

    @property
    def draws(self) -> xarray.Dataset:
        """The chain, a variable for each unknown that was sampled, with its unit; MissingPackageError without xarray.

        Each ensemble is a chain; its walkers follow each other along ``draw``.
        """
        from spinbench.api.arviz_data import draws

        return draws(self.found)

    def to_arviz(self) -> InferenceData:
        """Posterior and prior as ArviZ takes them; MissingPackageError where it is not installed."""
        from spinbench.api.arviz_data import inference_data

        return inference_data(self.found)

    def to_netcdf(self, path: str | Path) -> Path:
        """Write `to_arviz` as a file that ``arviz.from_netcdf`` opens, whole or not at all."""
        from spinbench.api.arviz_data import write_netcdf

        return write_netcdf(self.found, Path(path))

    def as_json(self) -> dict[str, Any]:
        """As posterior/1, what `spinbench fit --json` writes."""
        from calibration.fit.document import as_json

        return as_json(self.found)

    def plot(self) -> Figure:
        """Readings and model, and the residuals."""
        from calibration.fit.fit import Fit
        from calibration.report.fit import page, whole

        return page.picture(self.found) if isinstance(self.found, Fit) else whole.plateaus(self.found)

    def __repr__(self) -> str:
        from calibration.report.origin import name_of

        return f"<fit of {name_of(self.recordings)}: {self.sentence}>"

    def _repr_html_(self) -> str:
        from spinbench.api.frames import as_html

        return as_html(self.sentence, self.notes, self.table)


def fit(
    data: Data | Recording | Sequence[Data | Recording],
    settings: Settings | None = None,
    *,
    values: Values | None = None,
    effects: str | Sequence[str] = (),
    per_recording: str | Sequence[str] = (),
    steady_only: bool = False,
    channels: tuple[str, ...] | None = None,
    chain_folder: str | Path | None = None,
) -> FitResult:
    """Fit f_overall, and what it depends on, to one recording or to several of one motor, as `spinbench fit` does.

    Parameters
    ----------
    data : Opened, Recording, str, Path, or a list of these
        A path is opened as `open` does.
    settings : Settings, optional
        Seed and length; what is usual if left out.
    values : mapping, optional
        Parameters and readings of the motor that are changed.
    effects : str or sequence of str
        Ids of effects that the model holds; their sizes become unknowns.
    per_recording : str or sequence of str
        Those of them whose sizes are each recording's own.
    channels : tuple of str, optional
        ``("pressure", "speed")`` leaves the flow out.
    chain_folder : str or Path, optional
        Where the chain is kept as it grows; a fit that was interrupted goes on from it.

    Raises
    ------
    RecordingError
        When a recording cannot be used.
    ConfigError, EffectsError
        For a value or an effect that there is not.
    NotConvergedError
        When the budget of steps is spent.
    NoPeakError
        When nothing in the prior explains the readings.
    TypeError
        For an argument of another kind.
    ValueError
        For settings that ask for fewer than 200 effective samples, and for other channels.
    """
    from calibration.fit.sampling import Settings
    from calibration.unknowns.priors import CHANNELS
    from spinbench.api.opened import argument, at_least, listed, opened_all, said_of
    from spinbench.api.simulating import assignments_of

    if not isinstance(settings, Settings | None):
        raise TypeError(f"settings: expected Settings, such as Settings(seed=1); given {settings!r:.60}")
    chosen = settings or Settings(effective_samples=0, most_steps=0)
    if chosen.effective_samples:  # 0 stands for what is usual
        at_least("settings: effective_samples", chosen.effective_samples, LEAST_EFFECTIVE)
    if channels is not None and not {"pressure"} < set(channels) <= set(CHANNELS):
        raise ValueError(f"channels: expected pressure with flow, speed or both; given {channels!r:.60}")
    recordings, notes = opened_all(data)
    effects, per_recording = listed("effects", effects), listed("per_recording", per_recording)
    parts, asked = prepared(recordings, chosen, assignments_of(values), channels, effects, steady_only, per_recording)
    with argument("values", "--set"):
        found = fitted(parts, asked, None if chain_folder is None else Path(chain_folder))
    return FitResult(found, tuple(said_of(parts, notes)))
