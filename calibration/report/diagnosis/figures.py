"""The figures of a diagnosis's report. They draw what `numbers` and `sets` computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.diagnosis.document import Q95
from calibration.diagnosis.result import Diagnosis
from calibration.diagnosis.steps.verdict import RESIDUAL_P, VerdictKind
from calibration.report import style
from calibration.report.diagnosis import numbers, sets
from calibration.report.diagnosis.numbers import Coordinate, Curve, Model
from calibration.report.diagnosis.sets import Interval
from calibration.systems.radial_piston.predict import gauge
from calibration.systems.radial_piston.predict.kinds import RUN, STANDING
from configs.units import BAR
from model.layout import L_MIN, RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEFORE, AFTER = style.COLOURS[1], style.COLOURS[0]
MARKERS = ((1.0, "^", "▲", "up"), (-1.0, "v", "▼", "down"), (0.0, "s", "■", "direction not noted"))
BANDS = ((Q95, "#DCE9F3"), (1.0, "#9CC6E2"))
DECADES = 8.0  # odds beyond which a bar goes on no longer


def residuals(found: Diagnosis, models: Sequence[Model], whitened: bool) -> bytes:
    """Residuals of the plateaus: a row a channel, a column a coordinate, before and after in one panel.

    `models`: the base model, and the one that the verdict rests on.
    """
    along, channels = numbers.coordinates(found), numbers.channels(found)
    shape: dict[str, Any] = {"sharey": "row", "sharex": "col", "squeeze": False}
    with style.drawing(len(channels), len(along), height_in=0.9 + 1.75 * len(channels), **shape) as (figure, axes):
        for row, channel in enumerate(channels):
            for column, one in enumerate(along):
                _residual_panel(axes[row, column], found, models, channel, one, whitened)
                axes[row, column].label_outer()
        figure.legend(*_legend(axes[0, 0]), fontsize=7.5, loc="outside upper left", ncols=2)
        return style.png(figure)


def runs(found: Diagnosis, models: Sequence[Model]) -> bytes:
    """Runs in time with the models, a column each, and the residuals beneath."""
    count = len(numbers.of_motor(found).problem.blocks.runs)
    rows, columns = 2 * -(-count // 2), min(count, 2)
    ratios = [3, 2] * (rows // 2)
    with style.drawing(rows, columns, height_in=2.1 * rows, squeeze=False, height_ratios=ratios) as (figure, axes):
        for i in range(count):
            _run_panels(axes[2 * (i // 2), i % 2], axes[2 * (i // 2) + 1, i % 2], found, models, i)
        for i in range(count, columns * (rows // 2)):
            for panel in axes[2 * (i // 2) : 2 * (i // 2) + 2, i % 2]:
                panel.set_axis_off()
        axes[0, 0].legend(fontsize=7, loc="best")
        return style.png(figure)


def held_rotor(found: Diagnosis, models: Sequence[Model]) -> bytes:
    """Flow with the rotor held, against pressure: read, and what the models say.

    `models`: the base model, and the one that the verdict rests on.
    """
    standing = numbers.of_motor(found).problem.blocks.standing
    mine = np.flatnonzero(numbers.of_motor(found).kind == STANDING)
    rows = np.flatnonzero(np.isfinite(standing.pressure))
    rows = rows[np.argsort(standing.pressure[rows])]
    room = numbers.of_motor(found).problem.motor.si("ambient_pressure")
    pressure = gauge.absolute(standing.pressure, standing.is_gauge, room)[rows] / BAR
    flow = standing.flow[rows] * L_MIN
    with style.drawing(height_in=2.6) as (figure, panel):
        panel.errorbar(
            pressure, flow, Q95 * standing.sd[rows] * L_MIN, ecolor=style.INK, **style.MEASURED, label="read"
        )
        for model, colour, line in zip(models, _colours(found), ("--", "-"), strict=False):
            said = flow - model.difference[mine[rows]] * L_MIN
            panel.plot(pressure, said, color=colour, linestyle=line, marker="_", markersize=14, label=model.name)
        panel.axhline(0.0, color=style.INK, linewidth=0.8)
        panel.margins(x=0.1, y=0.15)
        panel.legend(fontsize=7.5)
        style.name_axes(panel, ("pressure", "bar abs"), ("flow, rotor held", "L/min"))
        return style.png(figure)


def forces(curves: Sequence[Curve]) -> bytes:
    """Smooth torque and flow with bands, a panel each."""
    rows = -(-len(curves) // 2)
    with style.drawing(rows, min(len(curves), 2), height_in=0.4 + 2.1 * rows, squeeze=False) as (figure, axes):
        for panel, curve in zip(axes.flat, curves, strict=False):
            _curve_panel(panel, curve)
        for panel in axes.flat[len(curves) :]:
            panel.set_axis_off()
        return style.png(figure)


def friction(found: Diagnosis, intervals: Sequence[Interval]) -> bytes:
    """f_overall before and after, and in the sets that are not far behind."""
    with style.drawing(height_in=0.9 + 0.4 * len(intervals)) as (figure, axes):
        _friction_panel(axes, intervals, _colours(found))
        return style.png(figure)


def ranked(found: Diagnosis) -> bytes:
    """The sets by their odds against the one that the verdict rests on."""
    with style.drawing(height_in=0.9 + 0.4 * len(sets.shortlist(found))) as (figure, axes):
        _odds_panel(axes, found)
        return style.png(figure)


def essentials(
    found: Diagnosis, models: Sequence[Model], curves: Sequence[Curve], intervals: Sequence[Interval], sentence: str
) -> Figure:
    """One picture of the whole: the verdict, the place, the sets, f_overall.

    `curves`: Free-form forces; the first two are drawn.
    """
    import textwrap

    from matplotlib.gridspec import GridSpec

    along, channels = numbers.coordinates(found), numbers.channels(found)
    place = found.places[0].coordinate if found.places else "pressure"
    chosen = next((one for one in along if one.name.startswith(place)), along[0] if along else None)
    rows: list[tuple[str, int]] = []
    rows += [("residuals", len(channels))] if chosen is not None and channels else []
    shown = min(len(numbers.of_motor(found).problem.blocks.runs), 2)
    rows += [("runs", shown)] if shown else []
    rows += [("curves", min(len(curves), 2))] if curves else []
    last = [name for name, there in (("odds", len(found.candidates) > 1), ("friction", bool(intervals))) if there]
    rows += [("last", len(last))] if last else []
    words = textwrap.wrap(sentence, 76)
    with style.drawing(height_in=2.3 * len(rows) + 0.25 + 0.2 * len(words)) as (figure, first):
        first.remove()
        grid = GridSpec(len(rows), 2, figure=figure)
        for row, (kind, count) in enumerate(rows):
            panels = [figure.add_subplot(grid[row, slice(None) if count == 1 else i]) for i in range(count)]
            for i, panel in enumerate(panels):
                if kind == "residuals" and chosen is not None:
                    _residual_panel(panel, found, models, channels[i], chosen, False)
                elif kind == "runs":
                    _run_panels(panel, None, found, models, i)
                elif kind == "curves":
                    _curve_panel(panel, curves[i])
                elif last[i] == "odds":
                    _odds_panel(panel, found)
                else:
                    _friction_panel(panel, intervals, _colours(found))
            if kind == "residuals":
                after = f"; open: {models[0].name}, filled: {models[1].name}" if len(models) > 1 else ""
                panels[0].set_title(f"{markers_in_words(found)}{after}"[:110], fontsize=8)
        figure.suptitle("\n".join(words), x=0.01, ha="left", fontsize=9.5, fontweight="bold", parse_math=False)
        return figure


def markers_in_words(found: Diagnosis) -> str:
    """What the markers of the residuals mean, of those that are drawn."""
    ways = set(numbers.of_motor(found).problem.blocks.plateaus.up)
    return ", ".join(f"{shown} {name}" for way, _, shown, name in MARKERS if way in ways)


def _residual_panel(
    panel: Axes, found: Diagnosis, models: Sequence[Model], channel: str, along: Coordinate, whitened: bool
) -> None:
    comparison = numbers.of_motor(found)
    plateaus = comparison.problem.blocks.plateaus
    unit, factor = numbers.UNITS[channel]
    mine = comparison.kind == numbers.KINDS[channel]
    bad = found.verdict.chosen.mode.bad if found.verdict.chosen is not None else found.base.bad
    for model, colour in zip(models, _colours(found), strict=False):
        y = model.white[mine] if whitened else model.difference[mine] * factor
        y = np.where(comparison.known[mine], y, np.nan)
        for way, marker, _, name in MARKERS:
            here = plateaus.up == way
            if here.any():
                panel.plot(
                    along.values[here],
                    y[here],
                    marker=marker,
                    linestyle="none",
                    markersize=4.5,
                    markerfacecolor="none" if colour == BEFORE else colour,
                    markeredgecolor=colour,
                    label=f"{model.name}, {name}",
                )
        out = bad[mine] > 0.5
        if out.any() and found.bad_rows:
            ring: dict[str, Any] = {"marker": "o", "markersize": 11, "markerfacecolor": "none", "linestyle": "none"}
            panel.plot(along.values[out], y[out], markeredgecolor=style.INK, **ring)
    sd = 1.0 if whitened else numbers.noise(found, channel)
    panel.axhspan(-sd, sd, color=style.SHADE, zorder=0)
    panel.axhline(0.0, color=style.INK, linewidth=0.8)
    panel.margins(y=0.12)
    style.name_axes(panel, (along.name, along.unit), (f"{channel} residual", "sd" if whitened else unit))


def _run_panels(upper: Axes, lower: Axes | None, found: Diagnosis, models: Sequence[Model], i: int) -> None:
    comparison = numbers.of_motor(found)
    run, mine = comparison.problem.blocks.runs[i], comparison.kind == RUN + i
    time, reading = run.time[comparison.index[mine]], comparison.read[mine] * RPM
    upper.plot(time, reading, **style.MEASURED | {"markersize": 3.0, "zorder": 2}, label="measured")
    for model, colour, line in zip(models, _colours(found), ("--", "-"), strict=False):
        difference = model.difference[mine] * RPM
        upper.plot(time, reading - difference, color=colour, linestyle=line, linewidth=1.2, label=model.name)
        if lower is not None:
            lower.plot(time, difference, color=colour, linestyle=line, linewidth=1.0)
    for place in found.places:
        if lower is not None and place.coordinate == "phase" and place.file == run.file:
            lower.axvspan(*place.where, color=style.SHADE, zorder=0)
    upper.set_title(run.file[:40], fontsize=8.5, parse_math=False)
    style.name_axes(upper, ("time" if lower is None else "", "s" if lower is None else "1"), ("speed", "rpm"))
    if lower is not None:
        lower.axhline(0.0, color=style.INK, linewidth=0.8)
        lower.sharex(upper)
        style.name_axes(lower, ("time", "s"), ("residual", "rpm"))


def _curve_panel(panel: Axes, curve: Curve) -> None:
    x = curve.along.values
    for times, colour in BANDS:
        panel.fill_between(x, curve.mean - times * curve.sd, curve.mean + times * curve.sd, color=colour, linewidth=0.0)
    panel.plot(x, curve.mean, color=style.COLOURS[0])
    panel.axhline(0.0, color=style.INK, linewidth=0.8)
    for low, high in curve.spans:
        panel.axvspan(low, high, color=BEFORE, alpha=0.12, zorder=0, linewidth=0.0)
    panel.set_xlim(min(x), max(x))
    panel.set_title(curve.title, fontsize=8.5)
    style.name_axes(panel, (curve.along.name, curve.along.unit), (curve.quantity, curve.unit))


def _friction_panel(panel: Axes, intervals: Sequence[Interval], colours: tuple[str, str]) -> None:
    """A line each, first before and after: 90 % thin, one sd thick, the mean a diamond; the name above the line."""
    for i, one in enumerate(intervals):
        colour = colours[i] if i < 2 else style.INK
        panel.plot([one.q05, one.q95], [i, i], color=colour, linewidth=1.2)
        panel.plot([one.mean - one.sd, one.mean + one.sd], [i, i], color=colour, linewidth=4)
        panel.plot(one.mean, i, marker="D", color="white", markeredgecolor=colour, markersize=5)
        _above(panel, one.name, i)
    panel.set_ylim(len(intervals) - 0.5, -0.8)
    panel.set_yticks([])
    panel.locator_params(axis="x", nbins=4)
    style.name_axes(panel, ("f_overall", "N m s"), ("", "1"))


def _odds_panel(panel: Axes, found: Diagnosis) -> None:
    """A bar each, by how many decades a set leads the verdict's or trails it; the base model is always among them."""
    shown, chosen = sets.shortlist(found), found.verdict.chosen
    leads = [_decades(sets.odds(found, one)) for one in shown]
    for i, (one, lead) in enumerate(zip(shown, leads, strict=True)):
        mine = chosen is not None and one.names == chosen.names
        out = bool(one.refused) or found.residual_p.get(one.names, 1.0) < RESIDUAL_P
        look: dict[str, Any] = {"color": AFTER if mine else style.FAINT}
        look = {"facecolor": "white", "edgecolor": style.FAINT, "hatch": "/////"} if out else look
        panel.barh(i, lead + DECADES, height=0.24, left=-DECADES, **look)
        _above(panel, " + ".join(one.names) or "base model", i)
    if max(leads) > 0.0:
        panel.axvline(0.0, color=style.INK, linewidth=0.8)
    panel.set_xlim(-DECADES, max(leads) + 0.3 * (max(leads) > 0.0))
    panel.set_ylim(len(shown) - 0.5, -0.8)
    panel.set_yticks([])
    ticks = {-8: "10⁻⁸", -6: "10⁻⁶", -4: "10⁻⁴", -2: "1 : 100", 0: "1 : 1", 2: "100 : 1", 4: "10⁴", 6: "10⁶", 8: "10⁸"}
    ticks = {at: words for at, words in ticks.items() if at <= max(leads)}
    panel.set_xticks(list(ticks), list(ticks.values()))
    rival = "the verdict's set" if chosen is not None else "the likeliest set"
    style.name_axes(panel, (f"odds against {rival}", "1"), ("", "1"))


def _decades(odds: float) -> float:
    """By how many decades a set leads the one that odds are of; negative where it trails."""
    return -math.log10(min(max(odds, 10.0**-DECADES), 10.0**DECADES))


def _colours(found: Diagnosis) -> tuple[str, str]:
    """Of the models: a base model that explains everything is not in the colour of what is wrong."""
    return (AFTER, AFTER) if found.verdict.kind == VerdictKind.CONSISTENT else (BEFORE, AFTER)


def _above(panel: Axes, name: str, i: int) -> None:
    text = panel.annotate(
        name[:60],
        (0.0, i),
        xycoords=("axes fraction", "data"),
        xytext=(2, 6),
        textcoords="offset points",
        fontsize=7,
        parse_math=False,
    )
    text.set_in_layout(False)  # a long name must not squeeze the panels


def _legend(panel: Axes) -> tuple[list[Any], list[str]]:
    """Each entry once."""
    handles, labels = panel.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    return list(once.values()), list(once)
