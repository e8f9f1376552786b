"""What the readings of a moment say to the sweep: at rest, vented, settled, off the level."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from rig.bench.bench import SweepTable
from rig.bench.checks import LEAST_READINGS
from rig.plateaus.plateau import Mean, Plateau, mean_of
from rig.plateaus.settle import settled
from rig.readings import NS, Reading
from rig.sweep.orders import View

VENTED_WITHIN_BAR = 0.05  # a gauge's own offset is less, and the motor does not turn
NEAR_AMBIENT_BAR = 0.2  # a sweep is not begun with more in a line that should be vented
AT_REST_RPM = 1.0
OFF_LEVEL_BAR = 0.05
OFF_LEVEL = 0.03  # of the level


def pressure_abs(view: View, ambient_bar: float) -> float | None:
    """The line's pressure by the newest reading [bar abs]; None where there is none.

    `ambient_bar`: added to a gauge pressure [bar].
    """
    reading = view.last("pressure")
    if reading is None or not reading.usable or reading.value is None:
        return None
    return reading.value + (ambient_bar if reading.channel.endswith("_gauge") else 0.0)


def is_vented(view: View, ambient_bar: float) -> bool:
    """Whether the gauge says that the line is vented."""
    return _is_within(view, ambient_bar, VENTED_WITHIN_BAR)


def is_near_ambient(view: View, ambient_bar: float) -> bool:
    """Whether the gauge shows no more than an offset could."""
    return _is_within(view, ambient_bar, NEAR_AMBIENT_BAR)


def not_at_rest(view: View, ambient_bar: float) -> str:
    """Why this is no zero: pressure in the line, or a rotor that turns; empty when it is one."""
    missing = not_reading(view)
    if missing:
        return missing
    if not is_vented(view, ambient_bar):
        shown = pressure_abs(view, ambient_bar)
        return f"the gauge shows {shown:.3f} bar abs, the room has {ambient_bar:.3f}"
    speed = view.last("speed")
    if speed is not None and speed.usable and not _stands(speed):
        return f"the rotor still turns, at {speed.value:g} rpm"
    return ""


def not_reading(view: View) -> str:
    """Which of pressure and speed gives no reading, and why; empty when both do."""
    for role in ("pressure", "speed"):
        reading = view.last(role)
        if reading is None:
            return f"there is no reading of the {role} yet"
        if not reading.usable:
            why = f": {reading.detail}" if reading.detail else ""
            return f"the {role} ({reading.name}) cannot be read: {reading.quality}{why}"
    return ""


def not_read(view: View, start_ns: int, end_ns: int) -> str:
    """Which of pressure and speed has no usable reading between two times, and why; empty when both have."""
    for role in ("pressure", "speed"):
        if view.window(role, start_ns, end_ns).time_s.size:
            continue
        reading = view.last(role)
        if reading is not None and reading.usable:
            span = f"in these {(end_ns - start_ns) / NS:.3g} s"
            return f"there is no reading of the {role} ({reading.name}) {span}, though it is read at other times"
        last = "" if reading is None else f" ({reading.name}; its last reading: {reading.quality})"
        return f"there is no reading of the {role}{last}"
    return ""


def not_turning(view: View, start_ns: int, end_ns: int) -> str:
    """That no reading of the speed between two times shows the rotor turning; empty when one does."""
    read = view.window("speed", start_ns, end_ns)
    if np.any((np.abs(read.value) >= AT_REST_RPM) & (read.censored * read.value >= 0.0)):
        return ""
    reading = view.last("speed")
    name = "" if reading is None else f" ({reading.name})"
    return f"the speed{name} shows no turning rotor; look whether it turns, and whether the tachometer sees it"


def none_turns(plateaus: Sequence[Plateau]) -> str:
    """That the rotor turns at no plateau; empty when it does, or where its speed was not read."""
    speeds = [mean.mean for plateau in plateaus if (mean := plateau.means.get("speed")) and mean.mean is not None]
    if not speeds or max(map(abs, speeds)) >= AT_REST_RPM:
        return ""
    return "no plateau shows the rotor turning; look whether it turns, and whether the tachometer sees it"


def unusable(plateaus: Sequence[Plateau]) -> list[Plateau]:
    """Plateaus that had not settled, or without a reading of pressure or speed."""
    means = [[plateau.means[role] for role in ("pressure", "speed") if role in plateau.means] for plateau in plateaus]
    return [one for one, its in zip(plateaus, means, strict=True) if not (one.settled and all(mean.n for mean in its))]


def lost(plateaus: Sequence[Plateau]) -> str:
    """How many plateaus cannot be used; empty when all can."""
    count = len(unusable(plateaus))
    why = "it had" if count == 1 else "they had"
    told = f"{count} of {len(plateaus)} plateaus cannot be used: {why} not settled, or pressure or speed was not read"
    return told if count else ""


def hanging(view: View, start_ns: int, end_ns: int) -> str:
    """That the speed is one number between two times in which the rotor came to rest; empty when it is not."""
    read = view.window("speed", start_ns, end_ns)
    if read.size < LEAST_READINGS or np.ptp(read.value) > 0.0:
        return ""
    return f"the tachometer shows {read.value[0]:g} rpm all the time, though the line is vented; its display hangs"


def not_settled(view: View, table: SweepTable, since_ns: int, now_ns: int) -> str:
    """Why pressure or speed has not settled; empty when both have.

    `since_ns`, `now_ns`: only readings between these count [ns].
    """
    start_ns = max(since_ns, now_ns - int(table.window_s * NS))
    limits = {
        "pressure": (table.pressure_slope_bar_s, None),
        "speed": (table.speed_slope_rpm_s, table.speed_scatter_rpm),
    }
    for role, (slope, scatter) in limits.items():
        window = view.window(role, start_ns, now_ns)
        verdict = settled(window.time_s, window.value, table.window_s, slope, scatter)
        if not verdict.settled:
            return f"{role}: {verdict.why}"
    return ""


def mean(view: View, channel: str, start_ns: int, end_ns: int) -> Mean:
    """What a channel read between two times."""
    window = view.window(channel, start_ns, end_ns)
    return mean_of(window.time_s, window.value, window.censored, window.quality)


def all_in(view: View, channels: Iterable[str], end_ns: int) -> bool:
    """Whether every reading of channels before a time is in: each has a newer one, a failed one too."""
    newest = [view.last(channel) for channel in channels]
    return all(reading is not None and reading.time_ns > end_ns for reading in newest)


def remarks(means: dict[str, Mean], level_bar_abs: float, view: View, ambient_bar: float) -> list[str]:
    """What a person should know of a plateau. `level_bar_abs`: what was asked for [bar]."""
    notes = [f"{role}: {mean.note}" for role, mean in means.items() if mean.note]
    shown = pressure_abs(view, ambient_bar)
    if shown is not None and abs(shown - level_bar_abs) > max(OFF_LEVEL_BAR, OFF_LEVEL * level_bar_abs):
        notes.append(f"the gauge shows {shown:.3f} bar abs where {level_bar_abs:g} was asked for")
    return notes


def _is_within(view: View, ambient_bar: float, most_bar: float) -> bool:
    shown = pressure_abs(view, ambient_bar)
    return shown is not None and shown - ambient_bar <= most_bar


def _stands(speed: Reading) -> bool:
    return speed.value is not None and (abs(speed.value) < AT_REST_RPM or speed.censored < 0.0 <= speed.value)
