"""What a bench yields: single readings, each with its quality and its times, and the exchanges of bytes behind them.

A reading that failed is still a reading: it has no value, and a quality that says why. A gap stays a gap.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from enum import StrEnum

NS = 1_000_000_000  # nanoseconds in a second


class Quality(StrEnum):
    """How far a reading may be trusted, and if not, why."""

    OK = "ok"  # checked on the way (checksum, or two polls that agree)
    UNVERIFIED = "unverified"  # no checksum on the wire, and no second poll that agreed
    OVER_RANGE = "over-range"
    STALE = "stale"  # the instrument repeats an old value
    TIMEOUT = "timeout"
    CRC = "crc"  # bytes came, but damaged or not the answer to the question
    EXCEPTION = "exception"  # the instrument says that it cannot answer, or flags the channel as faulty
    MANUAL = "manual"  # read and entered by a person
    SIMULATED = "simulated"  # as good as ok, from a virtual bench


GOOD = frozenset({Quality.OK, Quality.MANUAL, Quality.SIMULATED})
USABLE = GOOD | {Quality.UNVERIFIED}  # what plateaus are made of; the run's record counts how many were unverified


def scpi_number(number: float) -> float:
    """A number of an instrument that speaks SCPI-99: there 9.91e37 is not a number, and +-9.9e37 beyond the range."""
    if not abs(number) >= 9e36:
        return number
    return math.nan if math.isclose(number, 9.91e37, rel_tol=5e-4) else math.copysign(math.inf, number)


@dataclass(frozen=True, slots=True)
class Reading:
    """One value of one channel of one instrument, or the reason why there is none.

    `value`: in ``unit``; None where there is none. An off-scale reading holds the limit it is beyond.
    `time_ns`: when the quantity was sampled, as well as that is known, on the bench's monotonic clock [ns].
    `request_ns`, `reply_ns`: when the request was sent and the reply was whole [ns]; the same for what comes unasked.
    `raw`: the value as it came, in the instrument's own words or counts.
    `detail`: flags, exception code, reference state, or the reason of a failure.
    `censored`: -1 when the true value is below ``value``, 1 when it is above [-].
    """

    device: str
    channel: str
    value: float | None
    unit: str
    quality: Quality
    time_ns: int
    request_ns: int
    reply_ns: int
    retries: int = 0
    raw: str = ""
    detail: str = ""
    censored: int = 0

    @property
    def name(self) -> str:
        """``device.channel``, as the bench file names it."""
        return f"{self.device}.{self.channel}"

    @property
    def good(self) -> bool:
        """Whether there is a value that was checked."""
        return self.value is not None and self.quality in GOOD

    @property
    def usable(self) -> bool:
        """Whether there is a value without a fault, checked or not."""
        return self.value is not None and self.quality in USABLE


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened on a line's wire.

    `kind`: ``tx``: bytes sent; ``rx``: bytes received; ``silence``: a wait that ended without bytes; ``lost``: the port
        failed.
    `data`: the bytes, or for ``lost`` what the system said, as UTF-8.
    """

    kind: str
    time_ns: int
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class Exchange:
    """Everything that went over one line for one action on one device, and what it gave: the unit of the run log.

    `action`: what the driver was asked: ``open``, ``identify``, ``poll``, ``write``, ``failsafe`` or ``capture``.
    `events`: the wire, in order; a replay plays them back.
    `outcome`: empty, or why the action failed, or for ``identify`` the identity found.
    """

    line: str
    device: str
    action: str
    argument: float | None = None
    events: tuple[Event, ...] = ()
    readings: tuple[Reading, ...] = ()
    outcome: str = ""

    def with_readings(self, readings: tuple[Reading, ...]) -> Exchange:
        """The same exchange with other readings."""
        return dataclasses.replace(self, readings=readings)


def with_error(mean: float, error: float | None) -> str:
    """A mean for a person, no finer than two digits of its standard error, nor than five digits of its own."""
    if not error:
        return f"{mean:.5g}"
    own = 4 - math.floor(math.log10(abs(mean))) if mean else 4
    decimals = max(0, min(own, 1 - math.floor(math.log10(error))))
    return f"{round(mean, decimals):.7g} +- {max(error, 10.0**-decimals):.{decimals}f}"
