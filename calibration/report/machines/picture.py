"""A picture of a diagnosis of another rig: what the base model and the chosen set leave of the readings."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from calibration.diagnosis.result import Diagnosis
from calibration.likelihood.mode import Mode
from calibration.report import style
from calibration.report.sets_in_words import title
from calibration.systems.machines.comparison import Comparison
from rig.recording.columns import Known

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 8  # pieces of the speed, each way
FEWEST = 60  # readings from which on means over pieces of the speed are drawn


def picture(found: Diagnosis) -> Figure:
    """The residuals, a row a channel."""
    chosen = found.verdict.chosen
    parts = [("without any effect", found.base)]
    if chosen is not None:
        parts.append(("with " + "\nand ".join(title(name) for name in chosen.names), chosen.mode))
    channels = list(dict.fromkeys(one.channel for one in _compared(found).readings))
    with style.drawing(len(channels), len(parts), 2.9 * len(channels), sharey="row", sharex=True, squeeze=False) as (
        figure,
        grid,
    ):
        for row, channel in enumerate(channels):
            for column, (words, fit) in enumerate(parts):
                _panel(grid[row][column], found, channel, fit, style.COLOURS[column])
                if row == 0:
                    grid[row][column].set_title(words, fontsize=8.5)
            grid[row][0].set_ylabel(_label(found, channel))
        for axes in grid[-1]:
            axes.set_xlabel(_along(found)[1])
            axes.locator_params(axis="x", nbins=5)
        return figure


def _compared(found: Diagnosis) -> Comparison:
    return cast(Comparison, found.comparison)


def _label(found: Diagnosis, channel: str) -> str:
    known = _compared(found).problem.quantity(channel)
    return "reading less model: " + _with_unit(known.channel if channel == "drive" else channel, known)


def _along(found: Diagnosis) -> tuple[str, str, float]:
    """The coordinate that is drawn along, its label, and what a value in SI is multiplied by [-]."""
    problem = _compared(found).problem
    known = problem.system.coordinates()
    names = dict.fromkeys(("speed", "pressure", "time", *(name for one in known for name in one)))
    name = next((name for name in names if all(name in one for one in known)), "reading")
    quantity = problem.quantity(name)
    return name, _with_unit(name, quantity), 1.0 / quantity.to_si


def _with_unit(name: str, quantity: Known) -> str:
    return f"{name}, {quantity.unit}" if quantity.unit else name


def _panel(axes: Axes, found: Diagnosis, channel: str, fit: Mode, colour: str) -> None:
    factor = 1.0 / _compared(found).problem.quantity(channel).to_si
    of_speed = _along(found)[2]
    speed, rest = _of(found, channel, fit)
    axes.axhline(0.0, color=style.FAINT, linewidth=0.8)
    if rest.size < FEWEST:
        axes.plot(speed * of_speed, rest * factor, **(style.MEASURED | {"color": colour}))
        return
    axes.plot(speed * of_speed, rest * factor, ".", color=style.FAINT, markersize=2.0)
    for way in (speed < 0.0, speed > 0.0):
        if not way.any():
            continue
        v, r = speed[way], rest[way]
        edges = np.unique(np.quantile(v, np.linspace(0.0, 1.0, BINS + 1)))
        piece = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, max(edges.size - 2, 0))
        middle = [float(np.mean(v[piece == k])) * of_speed for k in np.unique(piece)]
        means = [float(np.mean(r[piece == k])) * factor for k in np.unique(piece)]
        axes.plot(middle, means, "o-", color=colour, markersize=4.0)


def _of(found: Diagnosis, channel: str, fit: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Coordinate and residual of a channel's readings [SI]."""
    comparison = _compared(found)
    known = comparison.problem.system.coordinates()
    left = comparison.noise.split(comparison.read - fit.prediction)
    mine = [i for i, one in enumerate(comparison.readings) if one.channel == channel]
    return (
        np.concatenate([known[i].get(_along(found)[0], np.arange(left[i].size)) for i in mine]),
        np.concatenate([left[i] for i in mine]),
    )
