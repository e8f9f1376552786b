"""Lutron's 16-byte frames, which many makers sell under their own names: tachometers, anemometers, thermometers.

``02 '4' D13 D12 D11 D10 D9 D8..D1 0D``: D13 the display, D12 D11 the unit's code, D10 the sign (0 plus, 1 minus), D9
the decimals (0 to 3), D8..D1 the digits, highest first. There is no checksum, and most of them send unasked. The codes
of the units are not the same for all models, so they are in the file, and what came is logged.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from rig.bench.instrument import InstrumentFile, Scale
from rig.instruments.codecs.streaming import Stream
from rig.instruments.codecs.values import Value
from rig.instruments.placing import refuse_keyboard
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, UncheckedChannel, repeated, timing_of
from rig.lines import BadReplyError, Line
from rig.readings import Quality

if TYPE_CHECKING:
    from rig.bench.bench import Place

FIRST_BYTE, LAST_BYTE = 0x02, 0x0D
FRAME_BYTES = 16
MOST_DECIMALS = 3

UnitCode = Annotated[str, pydantic.StringConstraints(pattern=r"^[0-9A-Z]{2}$")]


class DisplayChannel(UncheckedChannel):
    """What one of the meter's displays shows: value = scale * number."""

    display: Annotated[str, pydantic.StringConstraints(pattern=r"^[0-9]$")] = "1"
    unit_codes: list[UnitCode] = pydantic.Field(default_factory=list)  # another one is a fault; any, when left out
    scale: Scale = 1.0


class Settings(PolledFile):
    """The keys of a meter with Lutron's frames."""

    query: Annotated[str, pydantic.StringConstraints(max_length=16, pattern=r"^[\x00-\x7f]*$")] = ""  # sends unasked
    channels: Annotated[dict[ChannelName, DisplayChannel], pydantic.Field(min_length=1, max_length=4)]

    @pydantic.model_validator(mode="after")
    def displays_differ(self) -> Settings:
        """Refuse two channels of one display."""
        displays = [channel.display for channel in self.channels.values()]
        if len(set(displays)) < len(displays):
            raise ValueError("channels: two of them name the same display")
        return self


@dataclass(frozen=True, slots=True)
class Frame:
    """A frame's content."""

    display: str
    unit_code: str
    value: float


def decode(frame: bytes) -> Frame:
    """The content of a frame. Raises BadReplyError when it is none."""
    if len(frame) != FRAME_BYTES or frame[0] != FIRST_BYTE or frame[1:2] != b"4" or frame[-1] != LAST_BYTE:
        raise BadReplyError(f"not a Lutron frame: {frame[:FRAME_BYTES].hex(' ')}")
    body = frame[2:15]
    display, unit_code, sign, decimals, digits = body[:1], body[1:3], body[3:4], body[4:5], body[5:]
    known = display.isdigit() and unit_code.isalnum() and sign in (b"0", b"1") and digits.isdigit()
    if not known or not decimals.isdigit() or int(decimals) > MOST_DECIMALS:
        raise BadReplyError(f"not a Lutron frame: {frame.hex(' ')}")
    number = int(digits) / 10 ** int(decimals)
    return Frame(display.decode(), unit_code.decode(), -number if sign == b"1" else number)


def cut(buffer: bytes) -> tuple[list[bytes], bytes]:
    """The whole frames of a buffer; bytes that belong to none are skipped up to the next start.

    Returns `frames`: 16 bytes each, oldest first; `rest`: what may become a frame.
    """
    frames: list[bytes] = []
    while (start := buffer.find(FIRST_BYTE)) >= 0:
        buffer = buffer[start:]
        if len(buffer) < FRAME_BYTES:
            return frames, buffer
        try:
            decode(buffer[:FRAME_BYTES])
        except BadReplyError:
            buffer = buffer[1:]
        else:
            frames.append(buffer[:FRAME_BYTES])
            buffer = buffer[FRAME_BYTES:]
    return frames, b""


class LutronMeter(Polled):
    """A meter with Lutron's frames."""

    checked = False

    def __init__(self, device: str, settings: Settings) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings = settings
        self._stream = Stream(cut)

    def open(self, line: Line) -> None:
        """Forget what was known."""
        super().open(line)
        self._stream.forget()

    def ask(self, line: Line) -> Answer:
        """The newest frame of each display."""
        request_ns = line.tell(self.settings.query.encode("ascii")) if self.settings.query else None
        time_ns, frames = self._stream.frames(line, timing_of(self.settings, line).timeout_s)
        newest = {frame.display: (frame, data) for data in frames for frame in (decode(data),)}
        if not any(channel.display in newest for channel in self.settings.channels.values()):
            raise BadReplyError(f"{self.device} sends of the displays {sorted(newest)}, none of which the file names")
        found = {name: _value(channel, newest.get(channel.display)) for name, channel in self.settings.channels.items()}
        block = b"".join(data for _, data in newest.values())
        return Answer(found, block, time_ns if request_ns is None else request_ns, time_ns, time_ns)

    def identify(self, line: Line) -> str:
        """See that frames come; the meter does not tell who it is."""
        answer = repeated(lambda: self.ask(line), 1)
        shown = "; ".join(value.detail for value in answer.found.values())
        return f"{self.settings.title} (its frames come; {shown})"


def _value(channel: DisplayChannel, newest: tuple[Frame, bytes] | None) -> Value:
    if newest is None:
        return Value(None, Quality.TIMEOUT, detail=f"no frame of display {channel.display}")
    frame, data = newest
    raw = data[1:-1].decode("ascii")
    if channel.unit_codes and frame.unit_code not in channel.unit_codes:
        wanted = " or ".join(channel.unit_codes)
        return Value(
            None, Quality.EXCEPTION, raw, f"unit code {frame.unit_code}, not {wanted}: is the meter set otherwise?"
        )
    checked = "" if channel.unit_codes else " (not checked: the file names none)"
    return Value(channel.scale * frame.value, raw=raw, detail=f"unit code {frame.unit_code}{checked}")


def build(device: str, settings: InstrumentFile, place: Place) -> LutronMeter:
    """The driver of a meter with Lutron's frames."""
    chosen = cast(Settings, settings)
    refuse_keyboard(device, place)
    return LutronMeter(device, chosen)
