"""What a codec makes of a channel, and the reading that becomes of it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

from rig.bench.instrument import ChannelFile
from rig.lines import LineError
from rig.readings import Quality, Reading
from rig.recording.units import unit_called

MOST_TEXT = 80  # characters of a device's own words that go into a reading
MOST_REASON = 300
OTHER_WAY = "the rotor turns the other way for this tachometer; turn its sign, with scale = -1 in the instrument file"


@dataclass(frozen=True, slots=True)
class Value:
    """What a codec makes of one channel; the fields are those of `rig.readings.Reading`."""

    value: float | None
    quality: Quality = Quality.OK
    raw: str = ""
    detail: str = ""
    censored: int = 0


@dataclass(frozen=True, slots=True)
class Times:
    """When a reading was sampled, asked for and answered [ns], and after how many failed questions."""

    time_ns: int
    request_ns: int
    reply_ns: int
    retries: int = 0


def bounded(value: Value, channel: ChannelFile) -> Value:
    """A value held against the channel's limits: NaN is a fault, beyond the scale is over-range.

    `value`: as decoded; infinities allowed.
    Returns the same, or one that says what is wrong; off the scale it holds the limit, where the file gives one.
    """
    number = value.value
    if number is None or value.quality is Quality.OVER_RANGE:
        return value
    if math.isnan(number):
        return dataclasses.replace(
            value,
            value=None,
            quality=Quality.EXCEPTION,
            detail=joined("the device reports a fault: not a number", value.detail),
        )
    above = channel.highest is not None and number > channel.highest
    below = channel.lowest is not None and number < channel.lowest
    if math.isfinite(number) and not above and not below:
        return value
    limit, word, censored = (channel.highest, "above", 1) if number > 0 and not below else (channel.lowest, "below", -1)
    shown = f"{number:g} {channel.unit} is {word} the scale" + ("" if limit is None else f", which ends at {limit:g}")
    if number < 0.0 and unit_called(channel.unit) == "rpm":
        shown += f"; {OTHER_WAY}"
    return Value(limit, Quality.OVER_RANGE, value.raw, joined(shown, value.detail), censored)


def reading_of(device: str, name: str, channel: ChannelFile, value: Value, times: Times) -> Reading:
    """The reading that a decoded value is."""
    return Reading(
        device,
        name,
        value.value,
        channel.unit,
        value.quality,
        times.time_ns,
        times.request_ns,
        times.reply_ns,
        times.retries,
        printable(value.raw),
        value.detail,
        value.censored,
    )


def failures(device: str, channels: Mapping[str, ChannelFile], error: LineError, times: Times) -> list[Reading]:
    """A reading without a value for each channel."""
    value = Value(None, error.quality, detail=printable(str(error), MOST_REASON))
    return [reading_of(device, name, channel, value, times) for name, channel in channels.items()]


def joined(first: str, second: str) -> str:
    """Two remarks as one. `first`, `second`: either may be empty."""
    return f"{first}; {second}" if first and second else first or second


def printable(text: str, most: int = MOST_TEXT) -> str:
    """A device's words, cut to a length, with everything that is not plain ASCII escaped."""
    shown = text if text.isascii() and text.isprintable() else ascii(text)[1:-1]
    return shown if len(shown) <= most else shown[: most - 3] + "..."
