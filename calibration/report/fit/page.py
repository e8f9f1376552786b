"""The report of `spinbench fit`: one self-contained HTML page, one picture, a table and remarks for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from calibration.data.joined import names_of
from calibration.data.rows_used import by_fit, in_words_of
from calibration.fit.fit import Fit
from calibration.fit.posterior import Estimate, Posterior
from calibration.report import style
from calibration.report.fit import figures as fit_figures
from calibration.report.fit import numbers
from calibration.report.fit import words as fit_words
from calibration.report.fit.numbers import TARGET
from calibration.report.fit.words import AnyFit, figure, probability, rounded, uncertainty, with_unit
from calibration.report.origin import name_of, origins
from calibration.report.render import HTML, PNG, Grid, inline, render, versions
from calibration.report.units import in_a_table
from model.motor import Motor
from rig.recording import Recording
from rig.recording.columns import NUMERIC, OF_CHANNEL

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.table import Table

TITLE_WIDTH = 68  # letters that fit over the picture
Variants = list[tuple[str, Posterior]]


def report(found: Fit, variants: Variants) -> dict[str, bytes]:
    """Files of the report by name: ``report.html``, ``report.png``.

    `variants`: name and result of each fit that it is compared with.
    """
    shown, suspects = numbers.channels(found), numbers.suspects(found)
    posterior, sentence = found.posterior, on_the_picture(found)
    figures = {
        "fit": fit_figures.measured_against_model(found, shown, suspects),
        "density": fit_figures.density(posterior),
        "ridge": fit_figures.ridge(posterior),
    }
    if variants:
        figures["forest"] = fit_figures.forest(posterior, variants)
    return {
        HTML: page(context(found, variants, suspects) | {"figures": {k: inline(v) for k, v in figures.items()}}),
        PNG: style.png(fit_figures.essentials(found, shown, suspects, variants, sentence)),
    }


def picture(found: Fit) -> Figure:
    """The one picture of a fit that is compared with no other."""
    shown, suspects = numbers.channels(found), numbers.suspects(found)
    return fit_figures.essentials(found, shown, suspects, [], on_the_picture(found))


def on_the_picture(found: AnyFit) -> str:
    """What stands over the first picture: f_overall, or that it is not to be relied on."""
    wrong = fit_words.contradicted(found)
    words = f"{wrong} {fit_words.not_to_be_relied_on(found.posterior)}" if wrong else fit_words.verdict(found.posterior)
    return textwrap.fill(words, TITLE_WIDTH)


def table(found: AnyFit) -> Table:
    """The unknowns, for the terminal."""
    from rich.markup import escape
    from rich.table import Table

    wrong = bool(fit_words.contradicted(found))
    caption = "The model does not explain the readings: none of these figures is to be relied on." if wrong else None
    shown = Table("parameter", "unit", "mean", "sd", "5 %", "50 %", "95 %", "sd/prior", caption=caption)
    for e in found.posterior.estimates:
        mean, sd, low, high = _spread(e)
        name = f"{TARGET} (do not rely on it)" if wrong and e.unknown.name == TARGET else e.unknown.name
        middle = rounded(e.quantiles["q50"], e.sd)
        shown.add_row(escape(name), in_a_table(e.unknown.unit), mean, sd, low, middle, high, f"{e.sd_of_prior:.2f}")
    return shown


def remarks(found: Fit) -> list[str]:
    """What a person should know beside the table, in sentences; without the recording's own warnings."""
    return fit_words.remarks(found, numbers.suspects(found))


def page(filled: dict[str, Any]) -> bytes:
    """The page, every text in it escaped; ``filled`` is `context` with the figures."""
    return render("fit.html.j2", filled)


def context(found: Fit, variants: Variants, suspects: list[numbers.Suspect]) -> dict[str, Any]:
    """The texts and tables of the page."""
    used = in_words_of(found.recordings, by_fit(found.recording, found.measured))
    return common(found) | {
        "used": f"{used}; channels {', '.join(found.measured.channels)}",
        "remarks": fit_words.remarks(found, suspects),
        "suspects": _suspect_table(suspects),
        "variants": variant_table(found, variants),
        "notes": found.notes,
        "convergence": convergence(
            found, [("parameter sets that the solver gave up on", str(found.likelihood.not_converged))]
        ),
    }


def common(found: AnyFit) -> dict[str, Any]:
    """The texts and tables of the page of any fit."""
    pairs = numbers.trade_offs(found.posterior)
    return {
        "name": name_of(found.recordings),
        "origins": origins(found.recordings),
        "motor": found.motor.name,
        "description": found.motor.description,
        "verdict": fit_words.verdict(found.posterior),
        "explained": fit_words.explained(found),
        "contradicted": fit_words.contradicted(found),
        "stands_out": found.quality.why if found.quality else "",
        "not_to_be_relied_on": fit_words.not_to_be_relied_on(found.posterior),
        "next_command": fit_words.next_command(found),
        "hangs_on": fit_words.hangs_on(pairs),
        "prior_says": fit_words.prior_says(found),
        "prior_dominates": fit_words.prior_dominates(found),
        "effects": fit_words.held_effects(found),
        "trade_offs": _trade_off_table(found.posterior, pairs),
        "unknowns": _unknown_table(found.posterior),
        "instruments": _instrument_table(found.recordings),
        "readings": _reading_table(found.motor),
        "held": _held_table(found.posterior, found.motor),
        "sha256": " and ".join(one.sha256 for one in found.recordings if one.sha256),
    }


def _suspect_table(suspects: list[numbers.Suspect]) -> Grid:
    header = ("file", "column", "row", "reading", "the fit expects", "probability of being bad")
    rows = tuple(
        (
            one.row.file,
            one.row.channel,
            str(one.row.row),
            f"{figure(one.reading)} {OF_CHANNEL[one.channel].unit}",
            f"{rounded(one.expected, one.sd)} ± {uncertainty(one.sd)} {OF_CHANNEL[one.channel].unit}",
            probability(one.row.probability),
        )
        for one in suspects
    )
    return Grid(header, rows, 2)


def _trade_off_table(posterior: Posterior, pairs: list[Any]) -> Grid:
    target = posterior[TARGET]
    unit = target.unknown.unit
    rows = tuple(
        (unknown.name, f"{r:+.2f}".replace("-", "−"), uncertainty(target.sd * (1.0 - r * r) ** 0.5))
        for unknown, r in pairs[:6]
    )
    return Grid(("unknown", f"correlation with {TARGET}", f"sd of {TARGET} if it were known, {unit}"), rows)


def variant_table(found: AnyFit, variants: Variants) -> Grid:
    """f_overall of the fit and of its variants."""
    unit = found.posterior[TARGET].unknown.unit
    header = ("fit", *(f"{word}, {unit}" for word in ("mean", "sd", "5 %", "95 %")), "suspect readings")
    name = "this fit, not to be relied on" if fit_words.contradicted(found) else "this fit"
    entries = [(name, found.posterior), *variants]
    return Grid(header, tuple((name, *_spread(one[TARGET]), str(len(one.suspect_rows))) for name, one in entries))


def _spread(e: Estimate) -> tuple[str, ...]:
    return (
        rounded(e.mean, e.sd),
        uncertainty(e.sd),
        rounded(e.quantiles["q05"], e.sd),
        rounded(e.quantiles["q95"], e.sd),
    )


def _unknown_table(posterior: Posterior) -> Grid:
    header = ("unknown", "unit", "prior", "mean", "sd", "5 %", "50 %", "95 %", "sd / prior's", "R-hat", "ESS")
    rows = []
    for i, e in enumerate(posterior.estimates):
        mean, sd, low, high = _spread(e)
        rows.append(
            (
                e.unknown.name,
                in_a_table(e.unknown.unit),
                fit_words.prior_in_words(e.unknown),
                *(mean, sd, low, rounded(e.quantiles["q50"], e.sd), high),
                f"{e.sd_of_prior:.2f}",
                f"{posterior.chain.rhat[i]:.4f}" if i < posterior.chain.rhat.size else "",
                f"{posterior.chain.effective[i]:.0f}" if i < posterior.chain.rhat.size else "",
            )
        )
    return Grid(header, tuple(rows), 3)


def convergence(found: AnyFit, further: list[tuple[str, str]]) -> Grid:
    """How long the chain is and how good; ``further`` pairs of what and figure are added."""
    chain = found.posterior.chain
    entries = [
        ("ensembles x walkers", f"{chain.samples.shape[0]} x {chain.samples.shape[2]}"),
        ("steps of each, of these kept", f"{chain.steps}, {chain.samples.shape[1]}"),
        ("largest R-hat", f"{chain.rhat.max():.4f}"),
        ("least effective sample size", f"{chain.effective.min():.0f}, of {found.settings.effective_samples} wanted"),
        ("proposals taken", f"{100 * chain.acceptance:.0f} %"),
        ("longest autocorrelation time", f"{chain.tau.max():.1f} steps"),
        *further,
        ("wall time", f"{found.posterior.seconds:.1f} s"),
        ("seed", str(found.settings.seed)),
        ("versions", versions()),
    ]
    return Grid((), tuple(entries))


def _instrument_table(recordings: Sequence[Recording]) -> Grid:
    """The instruments' figures; of several recordings with the name of each ahead."""
    header = ("column", "unit", "noise, 1 sd", "offset, 1 sd", "scale, 1 sd", "resolution", "taken by default")
    rows = []
    for name, recording in zip(names_of(recordings), recordings, strict=True):
        for column, channel in recording.channels.items():
            figures = (channel.noise_sd, channel.bias_sd, channel.scale_sd, channel.resolution)
            texts = [figure(value) for value in figures]
            texts[2] = f"{figure(100 * channel.scale_sd)} %"
            rows.append((name, column, NUMERIC[column].unit, *texts, ", ".join(channel.defaulted) or "nothing"))
    if len(recordings) == 1:
        return Grid(header, tuple(row[1:] for row in rows), 2)
    return Grid(("recording", *header), tuple(rows), 3)


def _reading_table(motor: Motor) -> Grid:
    words = {True: "yes", False: "no"}
    entries = motor.readings.model_dump().items()
    rows = tuple((name, words.get(value, str(value).replace("_", " "))) for name, value in entries)
    return Grid(("where the article can be read in two ways", "read as"), rows, 2)


def _held_table(posterior: Posterior, motor: Motor) -> Grid:
    fitted = {estimate.unknown.own for estimate in posterior.estimates}
    rows = tuple(
        (name, with_unit(figure(motor[name].value), motor[name].unit), motor[name].source)
        for name in type(motor.parameters).model_fields
        if name not in fitted
    )
    return Grid(("held fixed", "value", "source"), rows, 3)
