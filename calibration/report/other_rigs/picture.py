"""A picture of a diagnosis of another rig: what the base model and the chosen set leave of the readings, over speed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from calibration.diagnosis.other_rigs.diagnose import RigDiagnosis
from calibration.diagnosis.other_rigs.fit import RigFit
from calibration.diagnosis.sets_in_words import title
from calibration.report import style
from model.layout import L_MIN, RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = 8  # pieces of the speed, each way
FEWEST = 60  # readings from which on means over pieces of the speed are drawn


def picture(found: RigDiagnosis) -> bytes:
    """PNG of it."""
    chosen = found.chosen
    parts = [("without any effect", found.base)]
    if chosen is not None:
        parts.append(("with " + "\nand ".join(title(name) for name in chosen.names), chosen.mode))
    channels = list(dict.fromkeys(one.channel for one in found.problem.readings))
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
            axes.set_xlabel("speed, m/s" if found.problem.slides else "speed, rpm")
            axes.locator_params(axis="x", nbins=5)
        return style.png(figure)


def _label(found: RigDiagnosis, channel: str) -> str:
    drive = "force, N" if found.problem.slides else "torque, N m"
    return "reading less model: " + {"drive": drive, "speed": "speed, rpm", "flow": "flow, L/min"}[channel]


def _panel(axes: Axes, found: RigDiagnosis, channel: str, fit: RigFit, colour: str) -> None:
    factor = {"speed": RPM, "flow": L_MIN}.get(channel, 1.0)
    of_speed = 1.0 if found.problem.slides else RPM
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


def _of(found: RigDiagnosis, channel: str, fit: RigFit) -> tuple[np.ndarray, np.ndarray]:
    """Speed and residual of a channel's readings [SI]."""
    known: Sequence[dict[str, np.ndarray]] = found.problem.system.coordinates()
    mine = [i for i, one in enumerate(found.problem.readings) if one.channel == channel]
    return (
        np.concatenate([known[i]["speed"] for i in mine]),
        np.concatenate([fit.residuals[i] for i in mine]),
    )
