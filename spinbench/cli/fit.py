"""`fit`: f_overall and what it hangs on, from a recording."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench import readings
from spinbench.cli.errors import MODEL_DOES_NOT_FIT, kept_when_interrupted
from spinbench.cli.options import (
    LOGS,
    EffectiveSamplesOption,
    JsonOption,
    LogsOption,
    MaxStepsOption,
    SeedOption,
    SetOption,
)
from spinbench.cli.progress import sampling, waiting
from spinbench.cli.show import check_places, deliver, remark

if TYPE_CHECKING:
    from calibration.fit.fit import Fit
    from calibration.fit.posterior import Posterior
    from calibration.fit.sampling import Settings
    from rig.recording import Recording


@dataclass(frozen=True)
class Asked:
    """What is to be fitted, and how."""

    settings: Settings
    assignments: list[str]
    channels: tuple[str, ...]
    effects: list[str]


def _kept(out: Path | None) -> str:
    if out is None:
        return "nothing is kept; with -o DIR the chain is kept as it grows, and the same command goes on from it"
    if not any((out / "chain").glob("*")):
        return "nothing was drawn yet; the same command begins again"
    return f"what was drawn is kept in {out / 'chain'}; the same command goes on from there"


@kept_when_interrupted(_kept)
def fit(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording/1 folder, or a run as RUN elsewhere.")
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="Report, posterior and chain; a killed fit goes on."),
    ] = None,
    json_file: JsonOption = None,
    seed: SeedOption = 1,
    effective_samples: EffectiveSamplesOption = 10_000,
    max_steps: MaxStepsOption = 12_000,
    assignments: SetOption = None,
    speed_only: Annotated[bool, typer.Option("--speed-only", help="Leave the flow channel out.")] = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Fit again without the flow, to show what f_overall hangs on.")
    ] = False,
    gauge_span_bar: Annotated[
        float | None,
        typer.Option(metavar="BAR", help="Full scale of the gauge: fit again for accuracy classes 0.6, 1.0, 1.6, 2.5."),
    ] = None,
    effects: Annotated[
        str, typer.Option(metavar="ID,ID", help="Effects that the model holds too; their sizes become unknowns.")
    ] = "",
    logs: LogsOption = LOGS,
) -> None:
    """Fit f_overall and what it hangs on to a recording; exit code 3 if the sampler does not converge, 5 if the model
    does not explain the readings.
    """
    from calibration.fit import fit as fits
    from calibration.fit.sampling import Settings

    check_places(out, json_file)
    read = readings.read(readings.folder_named(recording, logs))
    remark(*read.warnings)
    settings = Settings(seed=seed, effective_samples=effective_samples, most_steps=max_steps)
    channels = ("pressure", "speed") if speed_only else fits.ALL_CHANNELS
    held = [name.strip() for name in effects.split(",") if name.strip()]
    asked = Asked(settings, assignments or [], channels, held)
    planned = fits.variants(read, channels, compare, gauge_span_bar)
    found = _fitted(read, asked, out)
    if out is not None and planned:  # one of them may not converge
        _keep_posterior(found, out)
    variants = [_variant(asked, *variant) for variant in planned]
    _show(found, variants, out, json_file)
    if found.quality is not None and not found.quality.model_fits:
        raise typer.Exit(MODEL_DOES_NOT_FIT)


def _fitted(read: Recording, asked: Asked, out: Path | None) -> Fit:
    """The fit, with whether its model explains the readings."""
    from calibration import fit_quality
    from calibration.fit import fit as fits

    with waiting("does the model explain the readings?") as tell:
        quality = fit_quality.judge(read, asked.settings.seed, asked.assignments, asked.channels, asked.effects, tell)
    chain = out / "chain" if out else None
    try:
        with sampling("fit") as progress:
            found = fits.fit(read, asked.settings, asked.assignments, asked.channels, chain, progress, asked.effects)
    except fits.NotConvergedError as error:
        if not quality.model_fits:
            error.add_note(f"nor does the model explain the readings: {quality.why}")
        raise
    return replace(found, quality=quality)


def _variant(asked: Asked, name: str, changed: Recording, channels: tuple[str, ...]) -> tuple[str, Posterior]:
    """A shorter fit, of the recording as changed."""
    from calibration.fit import fit as fits
    from calibration.systems.radial_piston.batch import effects as with_effects

    with sampling(name) as progress:
        still = with_effects.seen(asked.effects, channels)
        again = fits.fit(changed, fits.brief(asked.settings), asked.assignments, channels, None, progress, still)
    return name, again.posterior


def _keep_posterior(found: Fit, out: Path) -> None:
    from calibration import fit_quality
    from rig.recording import files

    files.write_files(out, {"posterior.json": files.json_bytes(fit_quality.as_json(found))})


def _show(found: Fit, variants: list[tuple[str, Posterior]], out: Path | None, json_file: Path | None) -> None:
    from calibration import fit_quality
    from calibration.report.fit import page as fit_page
    from calibration.report.fit import words as fit_words
    from rig.recording import files

    encoded = files.json_bytes(fit_quality.as_json(found))
    if out is not None:
        files.write_files(out, {"posterior.json": encoded} | fit_page.report(found, variants))
    for words in fit_words.headline(found):
        print(words, file=sys.stderr)
    deliver(encoded, [fit_page.table(found)], json_file)
    remark(*fit_page.remarks(found))
    if out is not None:
        remark(f"the report is {out / 'report.html'}")
