"""The report of a fit to everything that was measured: its pictures and what its page has beside that of any fit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.data.rows_used import in_words_of
from calibration.fit.whole import WholeFit, parts_of
from calibration.report import along_dates, style
from calibration.report.fit import figures as fit_figures
from calibration.report.fit import page
from calibration.report.fit import words as fit_words
from calibration.report.fit.figures import BANDS
from calibration.report.fit.words import rounded, uncertainty
from calibration.report.render import HTML, PNG, Grid, inline
from calibration.report.units import in_a_table, on_an_axis
from calibration.systems.radial_piston.comparison import Comparison
from calibration.systems.radial_piston.predict import gauge
from calibration.systems.radial_piston.predict.kinds import FLOW, RUN, SPEED
from calibration.systems.several.problem import SeveralProblem
from configs.units import BAR
from model.effects import effects
from model.layout import L_MIN, RPM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHANNELS = (("speed", SPEED, RPM, "rpm"), ("flow", FLOW, L_MIN, "L/min"))
MARKS = ("o", "s", "^", "D", "v", "P")
MEAN_APART, SD_APART = 0.2, 0.1  # of a posterior's sd, from which Laplace's approximation is said to be off
NORMAL = 20_000  # draws of Laplace's normal law, for an unknown that is no straight function of its number


def report(found: WholeFit, variants: page.Variants) -> dict[str, bytes]:
    """Files of the report by name: ``report.html``, ``report.png``."""
    pictures = {
        "fit": style.png(plateaus(found)),
        "density": fit_figures.density(found.posterior),
        "ridge": fit_figures.ridge(found.posterior),
    }
    if panels := _panels(found):
        pictures["along"] = along_dates.picture(panels)
    if variants:
        pictures["forest"] = fit_figures.forest(found.posterior, variants)
    filled = _context(found, variants) | {"figures": {name: inline(png) for name, png in pictures.items()}}
    return {HTML: page.page(filled), PNG: pictures["fit"]}


def plateaus(found: WholeFit) -> Figure:
    """Speed and flow of the plateaus against pressure, with what new readings would be, and the residuals.

    Of the channels that a plateau was read of; of both where there is none.
    """
    parts = list(parts_of(found.comparison))
    read_of = [one for one in CHANNELS if any(part.known[part.kind == one[1]].any() for _, part, _ in parts)]
    read_of = read_of or list(CHANNELS)
    columns = len(read_of)
    with style.drawing(2, columns, height_in=4.7, sharex=True, squeeze=False, height_ratios=(3, 2)) as (figure, axes):
        for column, (name, kind, factor, unit) in enumerate(read_of):
            for k, (recording, part, at) in enumerate(parts):
                mine, plateaus = np.flatnonzero((part.kind == kind) & part.known), part.problem.blocks.plateaus
                room = part.problem.motor.si("ambient_pressure")
                line = gauge.absolute(plateaus.pressure, plateaus.is_gauge, room)[part.index[mine]]
                pressure = line / BAR
                bands, read = found.bands[:, at[mine]] * factor, part.read[mine] * factor
                look = style.MEASURED | {"marker": MARKS[k % len(MARKS)], "markersize": 4.5}
                for panel, less in ((axes[0, column], 0.0), (axes[1, column], bands[2])):
                    for (low, high, colour, _), width in zip(BANDS, (1.5, 5.0), strict=True):
                        panel.vlines(pressure, bands[low] - less, bands[high] - less, color=colour, linewidth=width)
                    panel.plot(pressure, read - less, **look, label=style.plain(recording[:40]) or "measured")
            style.name_axes(axes[0, column], ("", "1"), (name, unit))
            style.name_axes(axes[1, column], ("pressure", "bar abs"), ("residual", unit))
            axes[1, column].axhline(0.0, color=style.COLOURS[0], linewidth=1.0)
        axes[0, 0].legend(loc="upper left", fontsize=7.5)
        figure.suptitle(page.on_the_picture(found), x=0.01, ha="left", fontsize=10, fontweight="bold", parse_math=False)
        return figure


def run_in_time(found: WholeFit, part: Comparison, at: np.ndarray, i: int) -> bytes:
    """A run: speed against time, with bands of new readings, and the residuals."""
    run, mine = part.problem.blocks.runs[i], np.flatnonzero((part.kind == RUN + i) & part.known)
    time, read, bands = run.time[part.index[mine]], part.read[mine] * RPM, found.bands[:, at[mine]] * RPM
    with style.drawing(2, 1, height_in=3.6, sharex=True, height_ratios=(3, 2)) as (figure, axes):
        for panel, less in ((axes[0], 0.0), (axes[1], bands[2])):
            for low, high, colour, name in BANDS:
                panel.fill_between(
                    time,
                    bands[low] - less,
                    bands[high] - less,
                    color=colour,
                    linewidth=0.0,
                    label=f"{name} of new readings",
                )
            panel.plot(time, read - less, **style.MEASURED | {"markersize": 2.5}, label="measured")
        axes[0].plot(time, bands[2], color=style.COLOURS[0], linewidth=1.0, label="model, median")
        axes[0].legend(loc="best", fontsize=7.5)
        style.name_axes(axes[0], ("", "1"), ("speed", "rpm"))
        style.name_axes(axes[1], ("time", "s"), ("residual", "rpm"))
        return style.png(figure)


def _panels(found: WholeFit) -> list[along_dates.Panel]:
    """The size of each effect that each recording has for itself, along the dates."""
    problem, made = found.comparison.problem, []
    if not isinstance(problem, SeveralProblem):
        return []
    for name in sorted(problem.sharing.own & set(found.effects)):
        size, points = effects()[name].amplitude, []
        factor, unit = on_an_axis(size.unit, size.name)
        estimates = {one.unknown.whose: one for one in found.posterior.estimates if one.unknown.of == (name, size.name)}
        for mine in problem.along_dates():
            one = estimates[mine]
            figures = (factor * value for value in (one.mean, one.quantiles["q05"], one.quantiles["q95"]))
            points.append(along_dates.Point(mine, problem.dates[mine], *figures))
        made.append(along_dates.Panel(effects()[name].title, size.text or size.name, unit, points))
    return made


def remarks(found: WholeFit) -> list[str]:
    """What a person should know beside the table, in sentences."""
    suspects, against = found.posterior.suspect_rows, fit_words.against_priors(found.posterior)
    if suspects and fit_words.contradicted(found):
        return [f"{len(suspects)} readings look bad by this model, which does not explain the rest either", *against]
    return against + [
        f"{one.file}: row {one.row}: {one.channel} is probably a bad reading (probability "
        f"{fit_words.probability(one.probability)}); the fit gives it little weight"
        for one in suspects
    ]


def _context(found: WholeFit, variants: page.Variants) -> dict[str, Any]:
    parts = list(parts_of(found.comparison))
    runs = [
        {"name": f"{name}: {run.file}" if name else run.file, "picture": inline(run_in_time(found, part, at, i))}
        for name, part, at in parts
        for i, run in enumerate(part.problem.blocks.runs)
    ]
    rows = tuple(
        (one.file, one.channel, str(one.row), fit_words.probability(one.probability))
        for one in found.posterior.suspect_rows
    )
    return page.common(found) | {
        "used": in_words_of(found.recordings, found.comparison.rows_used()),
        "remarks": remarks(found),
        "suspects": Grid(("file", "column", "row", "probability of being bad"), rows, 2),
        "variants": page.variant_table(found, variants),
        "notes": list(dict.fromkeys(words for one in found.recordings for words in one.warnings)),
        "convergence": page.convergence(
            found, [("what is a run's own", f"{found.target.own.size} unknowns, integrated out")]
        ),
        "runs": runs,
        "laplace": _laplace(found),
    }


def _laplace(found: WholeFit) -> Grid:
    """Each sampled unknown of motor and effects beside Laplace's approximation of it."""
    target, mode, rng = found.target, found.mode, np.random.default_rng(0)
    rows = []
    for place, e in zip(target.shared, found.posterior.estimates, strict=False):
        z = mode.z[place] + np.sqrt(mode.covariance[place, place]) * rng.standard_normal(NORMAL)
        values = e.unknown.value(np.clip(z, target.f.low[place], target.f.high[place]))
        mean, sd = float(values.mean()), float(values.std())
        apart, ratio = abs(mean - e.mean) / e.sd, sd / e.sd
        off = apart > MEAN_APART or abs(ratio - 1.0) > SD_APART
        rows.append(
            (
                e.unknown.name,
                in_a_table(e.unknown.unit),
                f"{rounded(e.mean, e.sd)} ± {uncertainty(e.sd)}",
                f"{rounded(mean, sd)} ± {uncertainty(sd)}",
                f"{apart:.2f}",
                f"{ratio:.2f}",
                "differs" if off else "",
            )
        )
    header = ("unknown", "unit", "sampled", "Laplace", "means apart, sd", "ratio of sds", "")
    return Grid(header, tuple(rows), 2)
