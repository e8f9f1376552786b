"""The figures of a fit's report. They draw what `numbers` computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.data.measurement import MISSING, OBSERVED
from calibration.fit.fit import Fit
from calibration.fit.posterior import Posterior, thinned
from calibration.report import style
from calibration.report.fit import numbers
from calibration.report.fit.numbers import Channel, Suspect

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_RIDGES = 2  # where no correlation is worth a word
LONG_DECADES = 1.7  # from which only powers of ten have a label
WIDE = 4.0  # from least to most, from which an axis is logarithmic
BANDS = ((0, 4, "#CFE3F1", "90 %"), (1, 3, "#8FBFDF", "68 %"))  # indices into numbers.LEVELS
ALARM = style.COLOURS[1]
RING: dict[str, Any] = {
    "marker": "o",
    "markersize": 11,
    "markerfacecolor": "none",
    "markeredgecolor": ALARM,
    "zorder": 6,
}
NAMED = 3  # suspect readings of a channel that a picture names; the names of more would hide it
DOTS = 1500
Variants = Sequence[tuple[str, Posterior]]


def measured_against_model(found: Fit, shown: list[Channel], suspects: list[Suspect]) -> bytes:
    """Speed and flow against pressure, with bands, and the residuals beneath."""
    with style.drawing(2, len(shown), height_in=4.7, sharex=True, squeeze=False, height_ratios=(3, 2)) as (
        figure,
        axes,
    ):
        _fit_panels(axes, found, shown, suspects)
        return style.png(figure)


def density(posterior: Posterior) -> bytes:
    """f_overall's density after the recording, and its prior."""
    with style.drawing(height_in=2.9) as (figure, axes):
        _density_panel(axes, posterior)
        return style.png(figure)


def ridge(posterior: Posterior) -> bytes:
    """f_overall against the unknowns that it is correlated with most, as `words.hangs_on` names them; two at least."""
    pairs = numbers.trade_offs(posterior)
    present = [unknown.name for unknown, _ in numbers.strongest(pairs) or pairs[:LEAST_RIDGES]]
    with style.drawing(-(-len(present) // 2), 2, height_in=2.5 * -(-len(present) // 2), squeeze=False) as (
        figure,
        axes,
    ):
        for panel, name in zip(axes.flat, present, strict=False):
            _ridge_panel(panel, posterior, name)
        for panel in axes.flat[len(present) :]:
            panel.set_axis_off()
        return style.png(figure)


def forest(posterior: Posterior, variants: Variants) -> bytes:
    """f_overall of the main fit and of each variant: mean, sd and 90 %."""
    with style.drawing(height_in=0.9 + 0.38 * (1 + len(variants))) as (figure, axes):
        _forest_panel(axes, posterior, variants)
        return style.png(figure)


def essentials(found: Fit, shown: list[Channel], suspects: list[Suspect], variants: Variants, sentence: str) -> Figure:
    """One picture of the whole: the fit, its residuals, f_overall, and what it hangs on.

    `variants`: other fits; without any, the trade-off that is strongest is drawn instead.
    """
    from matplotlib.gridspec import GridSpec

    with style.drawing(height_in=7.6) as (figure, first):
        first.remove()
        grid = GridSpec(3, 2, figure=figure, height_ratios=(3, 1.8, 3))
        axes = np.empty((2, len(shown)), dtype=object)
        for i in range(len(shown)):
            place = slice(None) if len(shown) == 1 else i
            axes[0, i] = figure.add_subplot(grid[0, place])
            axes[1, i] = figure.add_subplot(grid[1, place], sharex=axes[0, i])
            axes[0, i].tick_params(labelbottom=False)
        _fit_panels(axes, found, shown, suspects)
        _density_panel(figure.add_subplot(grid[2, 0]), found.posterior)
        last = figure.add_subplot(grid[2, 1])
        if variants:
            _forest_panel(last, found.posterior, variants)
        else:
            _ridge_panel(last, found.posterior, numbers.trade_offs(found.posterior)[0][0].name)
        figure.suptitle(sentence, x=0.01, ha="left", fontsize=10.5, fontweight="bold", parse_math=False)
        return figure


def _fit_panels(axes: Any, found: Fit, shown: list[Channel], suspects: list[Suspect]) -> None:
    """Two rows of panels: readings with bands, residuals."""
    files = set(found.measured.steady.file)
    pressure = "pressure reading, gauge" if found.measured.steady.is_gauge[0] else "pressure reading, absolute"
    error_bar = numbers.reading_sd(found, "pressure", found.measured.steady)
    for column, channel in enumerate(shown):
        upper, lower = axes[0, column], axes[1, column]
        ringed = [one for one in suspects if one.channel in (channel.name, "pressure")]
        _bands(upper, channel, 0.0)
        _bands(lower, channel, channel.curve.quantiles[2])
        _points(upper, channel, error_bar, 0.0)
        _points(lower, channel, error_bar, channel.at_rows.quantiles[2])
        for one in ringed:
            _ring(upper, lower, channel, one, len(files) > 1, len(ringed) <= NAMED)
        if len(ringed) > NAMED:
            upper.plot([], [], **RING, linestyle="none", label=f"suspect, {len(ringed)} readings")
            upper.legend(loc="lower right", fontsize=7.5)
        style.name_axes(upper, ("", "1"), (channel.name, channel.unit))
        style.name_axes(lower, (pressure, "bar"), ("residual", channel.unit))
        upper.set_title(channel.name)
        lower.axhline(0.0, color=style.COLOURS[0], linewidth=1.0)
    axes[0, 0].legend(loc="lower right", fontsize=7.5)


def _bands(panel: Axes, channel: Channel, less: np.ndarray | float) -> None:
    curve = channel.curve
    for low, high, colour, name in BANDS:
        panel.fill_between(
            curve.pressure_bar,
            curve.quantiles[low] - less,
            curve.quantiles[high] - less,
            color=colour,
            linewidth=0.0,
            label=f"{name} of new readings",
        )
    if np.ndim(less) == 0:
        panel.plot(curve.pressure_bar, curve.quantiles[2], color=style.COLOURS[0], linewidth=1.2, label="model, median")


def _points(panel: Axes, channel: Channel, pressure_error: np.ndarray, less: np.ndarray | float) -> None:
    """Readings with one standard deviation; those off the instrument's scale as crosses at its limit."""
    values, x = channel.reading - less, channel.at_rows.pressure_bar
    seen = channel.state == OBSERVED
    panel.errorbar(
        x[seen],
        values[seen],
        xerr=pressure_error[seen],
        yerr=channel.error[seen],
        **style.MEASURED | {"markersize": 4.5},
        elinewidth=0.9,
        label="measured, ± 1 sd",
    )
    off = ~seen & (channel.state != MISSING)
    if off.any():
        panel.plot(x[off], values[off], color=style.INK, marker="x", linestyle="none", label="off the scale")


def _ring(upper: Axes, lower: Axes, channel: Channel, one: Suspect, name_file: bool, named: bool) -> None:
    """A ring about a suspect reading in both panels and, where few are, its name in the upper one."""
    x, y = channel.at_rows.pressure_bar[one.index], channel.reading[one.index]
    upper.plot(x, y, **RING)
    lower.plot(x, y - channel.at_rows.quantiles[2][one.index], **RING)
    if not named:
        return
    place = f"{one.row.file[:40]}, row {one.row.row}" if name_file else f"row {one.row.row}"
    words = f"{place}: {one.channel} suspect"
    right_half, above = x > np.mean(channel.curve.pressure_bar), y > channel.at_rows.quantiles[2][one.index]
    upper.annotate(
        words,
        (x, y),
        xytext=(8 if right_half else -8, 9 if above else -9),
        textcoords="offset points",
        ha="right" if right_half else "left",
        va="bottom" if above else "top",
        color=ALARM,
        fontsize=8,
        parse_math=False,
    )


def _density_panel(panel: Axes, posterior: Posterior) -> None:
    unknown, values = posterior[numbers.TARGET].unknown, numbers.samples(posterior, numbers.TARGET)[0]
    estimate = posterior[numbers.TARGET]
    low, high = np.quantile(values, [0.0005, 0.9995])
    margin = 0.25 * (high - low)
    heights, _, _ = panel.hist(
        values, bins=30, range=(low, high), density=True, color=BANDS[1][2], label="after the recording"
    )
    top, q = 1.04 * float(np.max(heights)), estimate.quantiles
    panel.fill_between([q["q05"], q["q95"]], top, color=BANDS[0][2], alpha=0.5, linewidth=0.0, zorder=0)
    panel.vlines(estimate.mean, 0.0, top, color=style.COLOURS[0], label="mean, and 5 % to 95 %")
    x = np.linspace(low - margin, high + margin, 200)
    if unknown.kind != "normal":
        x = x[x > 0.0]
    panel.plot(x, numbers.prior_density(unknown, x), color=ALARM, linestyle="--", label="prior")
    panel.set_xlim(low - margin, high + margin)
    panel.set_ylim(0.0, 1.55 * top)
    panel.legend(loc="upper left")
    style.name_axes(panel, (numbers.TARGET, unknown.unit), ("density", f"1/({unknown.unit})"))


def _ridge_panel(panel: Axes, posterior: Posterior, name: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    other, target = posterior[name].unknown, posterior[numbers.TARGET].unknown
    x, y = numbers.samples(posterior, name, numbers.TARGET)
    dots = thinned(np.column_stack([x, y]), DOTS)
    by_factor = other.kind in ("lognormal", "loguniform") and np.ptp(np.log(dots[:, 0])) > math.log(WIDE)
    panel.plot(dots[:, 0], dots[:, 1], ".", color=style.FAINT, markersize=1.5, alpha=0.5)
    centre, height, found, levels = numbers.density_regions(np.log(x) if by_factor else x, y)
    panel.contour(
        np.exp(centre) if by_factor else centre,
        height,
        found,
        levels=levels,
        colors=[style.COLOURS[4], style.COLOURS[0]],
        linewidths=1.4,
    )
    if by_factor:
        panel.set_xscale("log")
        is_long = np.ptp(np.log10(dots[:, 0])) > LONG_DECADES
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0,) if is_long else (1.0, 3.0)))
        panel.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
    else:
        panel.locator_params(axis="x", nbins=4)  # six digits a tick must not run into each other
        panel.ticklabel_format(axis="x", style="sci", scilimits=(-4, 6))
    correlation = float(np.corrcoef(x, y)[0, 1])
    panel.set_title(f"correlation {correlation:+.2f}".replace("-", "−"), fontsize=8.5)
    style.name_axes(panel, (style.plain(name.replace(": ", ":\n")), other.unit), (target.name, target.unit))


def _forest_panel(panel: Axes, posterior: Posterior, variants: Variants) -> None:
    """A line each: 90 % thin, one sd thick, the mean a dot; the name above the line."""
    entries = [("this fit", posterior), *variants]
    for i, (name, one) in enumerate(entries):
        estimate, colour = one[numbers.TARGET], style.COLOURS[0] if i == 0 else style.INK
        panel.plot([estimate.quantiles["q05"], estimate.quantiles["q95"]], [i, i], color=colour, linewidth=1.2)
        panel.plot([estimate.mean - estimate.sd, estimate.mean + estimate.sd], [i, i], color=colour, linewidth=4)
        panel.plot(estimate.mean, i, marker="D", color="white", markeredgecolor=colour, markersize=5)
        panel.annotate(
            name, (0.0, i), xycoords=("axes fraction", "data"), xytext=(2, 5), textcoords="offset points", fontsize=8
        )
    reference = posterior[numbers.TARGET]
    panel.axvline(reference.mean, color=style.COLOURS[0], linewidth=0.8, linestyle=":")
    panel.set_ylim(len(entries) - 0.5, -0.8)
    panel.set_yticks([])
    style.name_axes(panel, (numbers.TARGET, reference.unknown.unit), ("", "1"))
