"""`fit`: f_overall and what it depends on, from a recording."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from spinbench import readings
from spinbench.api.fitting import Asked, fitted, prepared
from spinbench.cli import options
from spinbench.cli.errors import MODEL_DOES_NOT_FIT, kept_when_interrupted
from spinbench.cli.show import check_places, deliver, remark, write_report
from spinbench.extras import has
from spinbench.progress import sampling

if TYPE_CHECKING:
    from calibration.fit.fit import Fit
    from calibration.fit.posterior import Posterior
    from calibration.fit.whole import WholeFit
    from rig.recording import Recording

NETCDF = "posterior.nc"
OutOption = Annotated[
    Path | None, options.out_folder("Folder for report, posterior and chain; a fit that was killed goes on there.")
]
SpeedOnlyOption = Annotated[bool, typer.Option("--speed-only", help="Leave the flow channel out.")]
CompareOption = Annotated[
    bool, typer.Option("--compare", help="Fit again without the flow, to show what f_overall depends on.")
]
GaugeSpanOption = Annotated[
    float | None,
    typer.Option(metavar="BAR", help="Full scale of the gauge: fit again for accuracy classes 0.6, 1.0, 1.6, 2.5."),
]
EffectsOption = Annotated[
    str | None, typer.Option(metavar="ID,ID", help="Effects to add to the model; their sizes become unknowns.")
]


def _kept(out: Path | None) -> str:
    if out is None:
        return "nothing is kept; with -o DIR the chain is kept as it grows, and the same command goes on from it"
    if not any((out / "chain").glob("*")):
        return "nothing was drawn yet; the same command begins again"
    return f"what was drawn is kept in {out / 'chain'}; the same command goes on from there"


@kept_when_interrupted(_kept)
def fit(
    recording: options.RecordingsArgument,
    out: OutOption = None,
    json_file: options.JsonOption = None,
    seed: options.SeedOption = 1,
    effective_samples: options.EffectiveSamplesOption = None,
    max_steps: options.MaxStepsOption = None,
    assignments: options.SetOption = None,
    steady_only: options.SteadyOnlyOption = False,
    speed_only: SpeedOnlyOption = False,
    compare: CompareOption = False,
    gauge_span_bar: GaugeSpanOption = None,
    effects: EffectsOption = None,
    left_out: options.WithoutOption = None,
    parents: options.WithParentsOption = False,
    per_recording: options.PerRecordingOption = None,
    logs: options.LogsOption = options.LOGS,
) -> None:
    """Fit f_overall, and what it depends on, to recordings of one motor; exit code 3 if the sampler does not converge,
    5 if the model does not explain the readings.
    """
    from calibration.data.left_out import without
    from calibration.fit import fit as fits
    from calibration.fit.sampling import Settings

    if compare and speed_only:
        raise typer.BadParameter(
            "--compare fits again without the flow, which --speed-only leaves out: give one of them"
        )
    check_places(out, json_file)
    parts = readings.all_named(recording, logs, parents)
    readings.refuse_twice(parts)
    parts = without(parts, left_out or [])
    settings = Settings(seed=seed, effective_samples=effective_samples or 0, most_steps=max_steps or 0)
    channels = ("pressure", "speed") if speed_only else None
    workers = min(2, os.cpu_count() or 1)
    read, asked = prepared(
        parts,
        settings,
        assignments or [],
        channels,
        options.ids_in(None if effects is None else [effects]),
        steady_only,
        options.ids_in(per_recording),
        workers,
    )
    remark(*readings.warnings_in(read))
    planned = fits.variants(read, asked.channels, compare, gauge_span_bar)
    found = fitted(read, asked, out / "chain" if out else None)
    if out is not None and planned:  # one of them may not converge
        _keep_posterior(found, out)
    variants = [_variant(asked, *variant) for variant in planned]
    _show(found, variants, out, json_file)
    if found.quality is not None and not found.quality.model_fits:
        raise typer.Exit(MODEL_DOES_NOT_FIT)


def _variant(asked: Asked, name: str, changed: Sequence[Recording], channels: tuple[str, ...]) -> tuple[str, Posterior]:
    """A shorter fit, of the recordings as changed; whether its model explains them is not told."""
    from calibration.fit import fit as fits
    from calibration.fit.sampling import STEADY
    from calibration.systems.radial_piston.batch import effects as with_effects

    held = with_effects.seen(asked.effects, channels)
    sharing = replace(asked.sharing, own=asked.sharing.own & set(held))
    again = replace(asked, channels=channels, effects=held, sharing=sharing)
    if asked.is_whole(changed):
        return name, fitted(changed, again).posterior
    settings = fits.brief(asked.settings.within(STEADY))
    with sampling(name) as progress:
        found = fits.fit(changed[0], settings, asked.assignments, channels, None, progress, again.effects)
    return name, found.posterior


def _keep_posterior(found: Fit | WholeFit, out: Path) -> None:
    from calibration.fit.document import as_json
    from rig.recording import files

    files.write_files(out, {"posterior.json": files.json_bytes(as_json(found))})


def _keep_draws(found: Fit | WholeFit, out: Path) -> None:
    """The draws as ArviZ opens them, where it is installed."""
    if has("arviz"):
        from spinbench.api.arviz_data import write_netcdf

        write_netcdf(found, out / NETCDF)


def _show(
    found: Fit | WholeFit, variants: list[tuple[str, Posterior]], out: Path | None, json_file: Path | None
) -> None:
    from calibration.fit.document import as_json
    from calibration.fit.fit import Fit
    from calibration.report.fit import page as fit_page
    from calibration.report.fit import whole as whole_page
    from calibration.report.fit import words as fit_words
    from rig.recording import files

    encoded = files.json_bytes(as_json(found))
    if out is not None:
        report = fit_page.report(found, variants) if isinstance(found, Fit) else whole_page.report(found, variants)
        write_report(out, {"posterior.json": encoded} | report, "posterior.json")
        _keep_draws(found, out)
    for words in fit_words.headline(found):
        print(words, file=sys.stderr)
    deliver(encoded, [fit_page.table(found)], json_file)
    remark(*(fit_page.remarks(found) if isinstance(found, Fit) else whole_page.remarks(found)))
    if out is not None:
        remark(f"the report is {out / 'report.html'}")
