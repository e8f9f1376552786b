"""What typed readings amount to: whether they agree, and the mean of a plateau made of them. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from rig.bench.bench import SafetyTable
from rig.bench.instrument import ChannelFile
from rig.instruments.codecs.values import Value
from rig.plateaus.plan import UP
from rig.plateaus.plateau import Mean, mean_of
from rig.readings import Reading

AGREE_NOISE = 3.0  # standard deviations of a difference
AGREE_RESOLUTION = 2.0
OVERSHOT_BAR = 0.02
FAR_BAR, FAR = 0.05, 0.03  # a reading so far from the level may be a slip of the pen
DOUBT_BAR = 0.25  # one so far from it is asked for again
GAUGE_SDS = 2.0  # by which a gauge may show less than the room's pressure while the rotor turns
DOUBT, DOUBT_RPM = 1.25, 10.0  # likewise a speed that is beyond what was expected by this factor and this much


def agree(first: Mapping[str, Reading], second: Mapping[str, Reading], channels: Mapping[str, ChannelFile]) -> bool:
    """Whether two entries agree within what the instruments scatter."""
    return all(_alike(first[name], second[name], channel) for name, channel in channels.items())


def _alike(first: Reading, second: Reading, channel: ChannelFile) -> bool:
    if first.value is None or second.value is None or first.censored != second.censored:
        return first.value is None and second.value is None
    noise = AGREE_NOISE * math.sqrt(2.0) * (channel.noise_sd or 0.0)
    within = max(noise, AGREE_RESOLUTION * (channel.resolution or 0.0))
    return abs(first.value - second.value) <= within * (1.0 + 1e-9)


def mean_of_entries(readings: Sequence[Reading]) -> Mean:
    """The mean of a channel's typed readings. `readings`: oldest first; those without a value do not count."""
    usable = [reading for reading in readings if reading.usable]
    return mean_of(
        np.array([reading.time_ns / 1e9 for reading in usable]),
        np.array([reading.value for reading in usable], dtype=np.float64),
        np.array([reading.censored for reading in usable], dtype=np.int64),
        [reading.quality for reading in usable],
    )


def with_drift(before: Mean, after: Reading | None) -> Mean:
    """The mean pressure of a plateau whose pressure was read again at its end.

    The other readings lie somewhere between; the pressure that belongs to them is anywhere between the two, so the
    middle is taken, with the error of a rectangular distribution, the drift over the root of 12.

    `after`: read at the end; None when it was not.
    """
    if after is None or not after.usable or after.value is None or before.mean is None:
        return before
    if before.censored or after.censored:
        return before
    drift = after.value - before.mean
    se = math.hypot(before.se or 0.0, drift / math.sqrt(12.0))
    qualities = before.qualities | {str(after.quality): before.qualities.get(str(after.quality), 0) + 1}
    return Mean(before.mean + 0.5 * drift, se, before.n + 1, before.n + 1.0, 0, drift, None, qualities, before.note)


def impossible(
    values: Mapping[str, Value], added_bar: float, ambient_bar: float, gauge_sd_bar: float, safety: SafetyTable
) -> dict[str, str]:
    """Why typed values cannot be what was read, by role; the arguments are those of `doubts`.

    `ambient_bar`: the room's pressure [bar].
    `gauge_sd_bar`: 1-sigma bias of the gauge [bar].
    """
    pressure, speed = values.get("pressure"), values.get("speed")
    why = {}
    if _is_beyond(pressure, safety.highest_pressure_bar_abs - added_bar):
        why["pressure"] = doubt_of_pressure(pressure, added_bar, 0.0, safety.highest_pressure_bar_abs)
    elif pressure is not None and _is_starved(pressure, speed, added_bar, ambient_bar - GAUGE_SDS * gauge_sd_bar):
        why["pressure"] = f"{_said(pressure)} bar is not above the room's {ambient_bar:.3f} bar, yet the rotor turns"
    if _is_beyond(speed, safety.highest_speed_rpm):
        why["speed"] = doubt_of_speed(speed, None, safety.highest_speed_rpm)
    return why


def doubts(
    values: Mapping[str, Value],
    added_bar: float,
    near_bar: float,
    safety: SafetyTable,
    expect: Callable[[float], tuple[float, float] | None],
) -> dict[str, str]:
    """Why typed values may be slips, by role: held against the limits, the level and the speeds to be believed.

    `values`: by role.
    `added_bar`: from the pressure channel's zero to absolute [bar].
    `near_bar`: where the pressure should be, absolute [bar].
    `expect`: the lowest and the highest speed to be believed at an absolute pressure [bar] -> [rpm].
    """
    pressure = values.get("pressure")
    why = doubt_of_pressure(pressure, added_bar, near_bar, safety.highest_pressure_bar_abs)
    there = near_bar
    if not why and pressure is not None and pressure.value is not None and not pressure.censored:
        there = pressure.value + added_bar
    speed = doubt_of_speed(values.get("speed"), expect(there), safety.highest_speed_rpm)
    return {role: text for role, text in (("pressure", why), ("speed", speed)) if text}


def _is_beyond(value: Value | None, limit: float) -> bool:
    return value is not None and value.value is not None and (value.censored > 0 or value.value > limit)


def _is_starved(pressure: Value, speed: Value | None, added_bar: float, least_bar: float) -> bool:
    if pressure.value is None or speed is None or speed.value is None:
        return False
    return not pressure.censored and pressure.value + added_bar <= least_bar and speed.value > 0.0 <= speed.censored


def doubt_of_pressure(value: Value | None, added_bar: float, near_bar: float, limit_bar: float) -> str:
    """Why a typed pressure may be a slip; empty when it is plausible.

    `added_bar`: from the channel's zero to absolute [bar].
    `near_bar`: where it should be, absolute [bar].
    `limit_bar`: of the bench, absolute [bar].
    """
    if value is None or value.value is None or value.censored < 0:
        return ""
    bar_abs = value.value + added_bar
    if value.censored > 0 or bar_abs > limit_bar:
        limit = f"the bench's limit of {limit_bar:g} bar abs"
        return f"a pressure of {_said(value)} bar is beyond {limit}; if it is so, close the valve"
    if abs(bar_abs - near_bar) > DOUBT_BAR:
        return f"that is {bar_abs:.3f} bar abs, where {near_bar:g} was expected"
    return ""


def doubt_of_speed(value: Value | None, expected: tuple[float, float] | None, limit_rpm: float) -> str:
    """Why a typed speed may be a slip; empty when it is plausible.

    `expected`: the lowest and the highest speed to be believed [rpm].
    """
    if value is None or value.value is None or value.censored < 0:
        return ""
    if value.censored > 0 or value.value > limit_rpm:
        limit = f"the bench's limit of {limit_rpm:g} rpm"
        return f"a speed of {_said(value)} rpm is beyond {limit}; if it is so, close the valve"
    if expected is None:
        return ""
    low, high = max(expected[0], 0.0), expected[1]
    if low / DOUBT - DOUBT_RPM <= value.value <= high * DOUBT + DOUBT_RPM:
        return ""
    return f"a speed of {_said(value)} rpm is far from what was expected, {low:.0f} to {high:.0f} rpm"


def _said(value: Value) -> str:
    """A typed value in its column's unit, which need not be what was typed."""
    return f"{({-1: '<', 1: '>'}).get(value.censored, '')}{value.value:g}"


def remarks(pressure_bar_abs: float | None, level_bar_abs: float, direction: str) -> list[str]:
    """What to tell the person of a pressure reading: overshot, or far from the level."""
    if pressure_bar_abs is None:
        return []
    off = pressure_bar_abs - level_bar_abs
    if abs(off) > max(FAR_BAR, FAR * level_bar_abs):
        return [f"{pressure_bar_abs:.3f} bar abs was typed where {level_bar_abs:g} was asked for"]
    if (off if direction == UP else -off) > OVERSHOT_BAR:
        side, back = ("below", "down") if direction == UP else ("above", "up")
        return [
            f"{pressure_bar_abs:.3f} bar abs is beyond {level_bar_abs:g}, which is approached from {side}: "
            f"go well {back} and come back, and type repeat"
        ]
    return []
