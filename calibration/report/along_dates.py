"""Figures of several recordings, each with its uncertainty, along the recordings' dates."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.report import style
from calibration.report.units import RAISED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 2
MOST_LABEL, MOST_WIDE = 24, 36  # characters under a point, and of a line along an axis
MOST_TICKS = 6
FEW = 4  # recordings whose names have two lines
MOST_ALONG, MOST_UPRIGHT, MOST_NAMES = 36, 16, 10  # characters along an axis and of an upright name; names at an axis
BAND = "#DCE9F3"


@dataclass(frozen=True)
class Point:
    """A figure of one recording, with its 5 and 95 % quantiles.

    `taken`: when it was recorded; points of a panel stand side by side where one has no date.
    """

    recording: str
    taken: datetime | None
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Panel:
    """Points of one quantity. `line`: a line's value at the points, and the sd of that."""

    title: str
    quantity: str
    unit: str
    points: Sequence[Point]
    line: tuple[np.ndarray, np.ndarray] | None = None


def picture(panels: Sequence[Panel]) -> bytes:
    """The panels as PNG."""
    return style.png(drawn(panels))


def drawn(panels: Sequence[Panel]) -> Figure:
    """The panels, two beside each other."""
    rows = max(-(-len(panels) // COLUMNS), 1)
    with style.drawing(rows, COLUMNS, height_in=2.7 * rows, squeeze=False) as (figure, axes):
        for axis, panel in zip(axes.flat, panels, strict=False):
            _draw(axis, panel)
        for axis in axes.flat[len(panels) :]:
            axis.set_axis_off()
    return figure


def _draw(axis: Axes, panel: Panel) -> None:
    import matplotlib.dates

    dates = [one.taken for one in panel.points]
    known = [taken for taken in dates if taken is not None]
    is_dated = len(known) == len(dates) and len(set(known)) > 2
    x: Any = known if is_dated else np.arange(len(dates))
    power = _power(max(abs(one.mean) for one in panel.points))
    factor = 10.0**-power
    mean, low, high = (
        factor * np.array([getattr(one, what) for one in panel.points]) for what in ("mean", "low", "high")
    )
    if panel.line is not None:
        order = np.argsort([taken.timestamp() for taken in known]) if is_dated else np.arange(len(dates))
        at, (value, sd) = [x[i] for i in order], (factor * one[order] for one in panel.line)
        axis.fill_between(at, value - sd, value + sd, color=BAND, linewidth=0.0)
        axis.plot(at, value, color=style.COLOURS[0], linewidth=1.0)
    spread = np.abs(np.array([mean - low, high - mean]))
    axis.errorbar(x, mean, spread, ecolor=style.INK, elinewidth=1.0, capsize=2.5, **style.MEASURED)
    if is_dated:
        locator = matplotlib.dates.AutoDateLocator(maxticks=MOST_TICKS)
        axis.xaxis.set_major_locator(locator)
        axis.xaxis.set_major_formatter(matplotlib.dates.ConciseDateFormatter(locator))
    else:
        _name_points(axis, panel.points)
    scaled = f"10{str(power).translate(RAISED)} {panel.unit}".strip() if power else panel.unit or "1"
    axis.set_ylabel(textwrap.fill(style.label(panel.quantity, scaled), MOST_WIDE), parse_math=False)
    axis.set_title(panel.title, fontsize=8.5, parse_math=False)


def _name_points(axis: Axes, points: Sequence[Point]) -> None:
    """Recordings that stand side by side: names with dates, upright where that is too wide; not all of many."""
    lines = 2 if len(points) <= FEW else 1
    named = [_under(one, MOST_LABEL, lines) for one in points]
    upright = len(points) * max(len(line) for text in named for line in text.split("\n")) > MOST_ALONG
    if upright:
        named = [_under(one, MOST_UPRIGHT, lines) for one in points]
    each = -(-len(points) // MOST_NAMES)
    axis.set_xticks(range(0, len(points), each), named[::each], fontsize=7.5, rotation=90 if upright else 0)
    axis.set_xlim(-0.6, len(points) - 0.4)


def _power(size: float) -> int:
    """The power of ten that a figure of that size is told in; 0 where it needs none."""
    power = math.floor(math.log10(size)) if size > 0.0 and math.isfinite(size) else 0
    return power if power < -3 or power > 3 else 0


def _under(one: Point, most: int, lines: int) -> str:
    parts = [style.plain(one.recording[start : start + most]) for start in range(0, len(one.recording), most)][:lines]
    return "\n".join(parts if one.taken is None else [*parts, one.taken.date().isoformat()])
