"""Sweeps of one motor on top of each other: speed and flow against pressure, the older the paler."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calibration.data.measurement import OBSERVED, Rows, gather
from calibration.report import style
from configs.units import STANDARD_BAR
from rig.recording import Recording, RecordingError

CHANNELS = (("speed", "rpm"), ("flow", "L/min"))
PALEST = 0.75  # of the oldest, between ink and white
MOST_NAMED, MOST_LABEL = 8, 30


def picture(recordings: Sequence[Recording]) -> bytes | None:
    """The plateaus, and beneath them what is more than a parabola through all of them; as PNG.

    `recordings`: oldest first.
    None where fewer than two have plateaus.
    """
    swept = [(one, rows) for one in recordings if (rows := _plateaus(one)) is not None]
    if len(swept) < 2:
        return None
    with style.drawing(2, 2, height_in=5.0, sharex=True, squeeze=False, height_ratios=(3, 2)) as (figure, axes):
        for column, (channel, unit) in enumerate(CHANNELS):
            read = [_readings(one, rows, channel) for one, rows in swept]
            through = _parabola(read)
            for k, ((one, _), (x, y)) in enumerate(zip(swept, read, strict=True)):
                look = style.MEASURED | {"markersize": 4.0, "color": _ink(k, len(swept))}
                named = k < MOST_NAMED // 2 or k >= len(swept) - MOST_NAMED // 2
                label = style.plain(one.folder.resolve().name[:MOST_LABEL]) if named else None
                axes[0, column].plot(x, y, **look, label=label)
                axes[1, column].plot(x, y - np.polyval(through, x), **look)
            axes[1, column].axhline(0.0, color=style.FAINT, linewidth=0.8)
            style.name_axes(axes[0, column], ("", "1"), (channel, unit))
            style.name_axes(axes[1, column], ("pressure reading, absolute", "bar"), ("less a parabola", unit))
        axes[0, 0].legend(loc="upper left", fontsize=6.5)
        return style.png(figure)


def _plateaus(recording: Recording) -> Rows | None:
    """The rows that are read; None where there are none."""
    try:
        return gather(recording).steady
    except RecordingError:
        return None


def _readings(recording: Recording, rows: Rows, channel: str) -> tuple[np.ndarray, np.ndarray]:
    """Pressure [bar abs] and the channel's readings on its scale, in its unit."""
    room = recording.ambient.pressure_bar_abs or STANDARD_BAR
    seen = getattr(rows, f"{channel}_state") == OBSERVED
    return (rows.pressure + np.where(rows.is_gauge, room, 0.0))[seen], getattr(rows, channel)[seen]


def _parabola(read: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Of all readings together; of lower order where there are too few."""
    x, y = (np.concatenate(arrays) for arrays in zip(*read, strict=True))
    order = min(2, np.unique(np.round(x, 2)).size - 1)
    found: np.ndarray = np.polyfit(x, y, order) if order >= 0 else np.zeros(1)
    return found


def _ink(k: int, count: int) -> Any:
    """The colour of the k-th of so many: the older the paler."""
    from matplotlib.colors import to_rgb

    share = PALEST * (1.0 - k / max(count - 1, 1))
    return tuple(share + (1.0 - share) * one for one in to_rgb(style.COLOURS[0]))
