"""Alicat meters and controllers over their text protocol: ``A`` asks unit A for one frame, ``AS6.0`` sets a set-point.

A frame is the unit's letter, then numbers in an order and in units that each device has of its own (``A??D*`` tells
them), then the flags. No flag is ever dropped: over-range flags mark the quantity they speak of, faults mark all, and
with a word that is not known here every reading counts as unverified.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from configs import ConfigError, Strict
from rig.bench.instrument import InstrumentError, InstrumentFile, Positive, Scale
from rig.instruments.ascii import NO_NUMBER, NUMBER, ask_text, ends_with
from rig.instruments.codecs.values import Value, joined, printable
from rig.instruments.placing import refuse_keyboard
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, UncheckedChannel, repeated, timing_of
from rig.instruments.setting import set_and_read_back
from rig.lines import BadReplyError, Line
from rig.lines.line import Reply
from rig.readings import Quality

if TYPE_CHECKING:
    from rig.bench.bench import Place

OVER_RANGE_WORDS = ("MOV", "VOV", "POV", "TOV", "OVR")  # mass, volume, pressure, temperature, totalizer
FAULT_WORDS = ("ADC", "EXH")  # converter error; exhausting instead of controlling
# Display held, locked; total lost, pressure limited, second pressure beyond.
NOTE_WORDS = ("HLD", "LCK", "TMF", "OPL", "P2O")
WORD = re.compile(r"(?=.?[A-Z])[A-Z0-9]{2,12}")  # a flag, known or not
# Which quantity an over-range flag speaks of, by the beginning of the channel's name.
OUT_OF_RANGE_OF = {"MOV": "flow_sl", "VOV": "flow_l", "POV": "pressure", "TOV": "temperature", "OVR": "total"}
SETPOINT, GAS, UNUSED = "setpoint", "gas", "-"
MOST_BYTES = 128
END_OF_LINE = b"\r"
GAS_NAME = re.compile(r"(?=.*[A-Za-z])[!-~]{1,20}")  # mixtures have names that people gave them


class Scaled(Strict):
    """A number of the device in the file's unit: value = scale * number + offset."""

    scale: Scale = 1.0
    offset: float = 0.0


class DeviceChannel(UncheckedChannel, Scaled):
    """A number of the frame."""


class Setpoint(Scaled):
    """The set-point, in the actuator's unit."""

    unit: str
    lowest: float
    highest: float
    tolerance: Positive

    @pydantic.model_validator(mode="after")
    def _has_room(self) -> Setpoint:
        if self.lowest >= self.highest:
            raise ValueError("lowest lies below highest")
        return self


class TextSetpoint(Setpoint):
    """A set-point that is sent as text."""

    decimals: Annotated[int, pydantic.Field(ge=0, le=6)] = 3


class Settings(PolledFile):
    """The keys of an Alicat device that speaks text."""

    layout: Annotated[list[str], pydantic.Field(min_length=1, max_length=16)]  # channels, setpoint, gas or -
    channels: Annotated[dict[ChannelName, DeviceChannel], pydantic.Field(min_length=1, max_length=16)]
    setpoint: TextSetpoint | None = None

    @pydantic.model_validator(mode="after")
    def layout_fits(self) -> Settings:
        """Refuse a layout that does not hold each channel once."""
        named = [entry for entry in self.layout if entry not in (GAS, UNUSED)]
        wanted = [*self.channels, *([SETPOINT] if self.setpoint is not None or SETPOINT in named else [])]
        if sorted(named) != sorted(wanted):
            raise ValueError(
                f"layout: it holds {', '.join(named)} where the file has {', '.join(wanted)}; each stands once, others "
                f"are '{GAS}' or '{UNUSED}'"
            )
        return self


def decode(text: str, address: str, layout: Sequence[str]) -> tuple[dict[str, str], tuple[str, ...]]:
    """The fields of a frame as they came, and its flags.

    Returns `fields`: numbers, by the layout's names; the gas under ``gas``; `flags`: in the frame's order. Raises
    BadReplyError when the line is no frame of this unit and layout, or the unit refuses.
    """
    words = text.split()
    if words[:1] != [address]:
        raise BadReplyError(f"'{printable(text)}' is not from unit {address}")
    if "?" in words:
        raise BadReplyError(f"unit {address} refuses: '{printable(text)}'", Quality.EXCEPTION)
    values, flags = words[1 : 1 + len(layout)], tuple(words[1 + len(layout) :])
    if len(values) < len(layout):
        raise BadReplyError(f"'{printable(text)}' has {len(values)} fields, the file's layout {len(layout)}")
    strange = [flag for flag in flags if not WORD.fullmatch(flag)]
    if strange:
        raise BadReplyError(
            f"'{printable(text)}': '{printable(strange[0])}' is no flag; is the layout the device's own?"
        )
    for entry, word in zip(layout, values, strict=True):
        if not (GAS_NAME if entry == GAS else NUMBER).fullmatch(word) and (
            entry in (GAS, SETPOINT) or not NO_NUMBER.fullmatch(word)
        ):
            raise BadReplyError(f"'{printable(text)}': '{printable(word)}' stands where the layout has {entry}")
    return dict(zip(layout, values, strict=True)), flags


def judge(
    numbers: Mapping[str, float], raw: Mapping[str, str], flags: Sequence[str], note: str = ""
) -> dict[str, Value]:
    """The values of numbers and flags: what Alicat's text and Modbus protocols have in common.

    `numbers`: channel to its number [own unit].
    `flags`: all that were set; each goes into the detail of every channel.
    By channel, limits not yet looked at.
    """
    detail = joined(" ".join(flags), note)
    faulty = any(flag in FAULT_WORDS or not WORD.fullmatch(flag) for flag in flags)  # a status bit is no word
    unknown = any(flag not in (*OVER_RANGE_WORDS, *NOTE_WORDS) for flag in flags)
    found = {}
    for name, number in numbers.items():
        if faulty:
            found[name] = Value(None, Quality.EXCEPTION, raw[name], detail)
        elif math.isnan(number):
            found[name] = Value(None, Quality.EXCEPTION, raw[name], joined("the device shows no number", detail))
        elif math.isfinite(number) and any(name.startswith(OUT_OF_RANGE_OF.get(flag, "?")) for flag in flags):
            found[name] = Value(number, Quality.OVER_RANGE, raw[name], detail, -1 if number < 0.0 else 1)
        else:
            quality = Quality.UNVERIFIED if unknown else Quality.OK
            found[name] = Value(number, quality, raw[name], detail)
    return found


def _number(word: str) -> float:
    return math.nan if NO_NUMBER.fullmatch(word) else float(word)


class Alicat(Polled):
    """An Alicat device at a letter of a line."""

    checked = False

    def __init__(self, device: str, settings: Settings, address: str, echo: bool) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings, self._echo = settings, echo
        self.address = address
        # Dashes in the set-point's place cost no channel its value.
        self._read = [UNUSED if entry == SETPOINT else entry for entry in settings.layout]

    def ask(self, line: Line) -> Answer:
        """Ask for one frame."""
        fields, flags, reply = self._frame(line, self.address, self._read)
        channels = self.settings.channels
        numbers = {name: channel.scale * _number(fields[name]) + channel.offset for name, channel in channels.items()}
        note = f"gas {fields[GAS]}" if GAS in fields else ""
        return Answer(judge(numbers, fields, flags, note), reply.data, reply.request_ns, reply.reply_ns)

    def identify(self, line: Line) -> str:
        """See that the unit answers with a frame of the file's layout."""
        _, flags, _ = repeated(lambda: self._frame(line, self.address, self._read), 1)
        raised = f"; flags {' '.join(flags)}" if flags else ""
        return (
            f"{self.settings.title}, unit {self.address} (its frame has the layout; it is not asked who it is{raised})"
        )

    def _frame(self, line: Line, question: str, layout: Sequence[str]) -> tuple[dict[str, str], tuple[str, ...], Reply]:
        """One question, and the frame that answers it."""
        request = question.encode("ascii") + END_OF_LINE
        reply = ask_text(line, request, ends_with(END_OF_LINE, MOST_BYTES), timing_of(self.settings, line), self._echo)
        try:
            text = reply.data.removesuffix(END_OF_LINE).decode("ascii", errors="replace").strip("\n\0 ")
            return *decode(text, self.address, layout), reply
        except BadReplyError:
            line.drop()
            raise


class AlicatController(Alicat):
    """An Alicat controller: a device with a set-point. `settings`: its file, with a ``[setpoint]``."""

    def __init__(self, device: str, settings: Settings, address: str, echo: bool) -> None:
        super().__init__(device, settings, address, echo)
        self.setpoint = cast(TextSetpoint, settings.setpoint)
        self.unit, self.lowest, self.highest = self.setpoint.unit, self.setpoint.lowest, self.setpoint.highest

    def write(self, line: Line, value: float) -> float:
        """Order a set-point and return the one that the next frame shows."""
        table = self.setpoint

        def order() -> None:
            number = f"{(value - table.offset) / table.scale:.{table.decimals}f}"
            self._frame(line, f"{self.address}S{number}", self.settings.layout)

        def read_back() -> float:
            fields, _, _ = self._frame(line, self.address, self.settings.layout)
            return table.scale * float(fields[SETPOINT]) + table.offset

        return set_and_read_back(self, value, order, read_back, table.tolerance)

    def set_failsafe(self, line: Line) -> str:
        """There is none in the documents."""
        raise InstrumentError(NO_FAILSAFE.format(device=self.device))


NO_FAILSAFE = (
    "{device}: no communications failsafe of Alicat's controllers is documented: when this program dies, the last "
    "set-point stays. Put a valve before it that closes without power, and waive the failsafe by name in the bench "
    "file ([safety] waive_failsafe)"
)


def build(device: str, settings: InstrumentFile, place: Place) -> Alicat:
    """The driver of an Alicat device that speaks text."""
    chosen = cast(Settings, settings)
    refuse_keyboard(device, place)
    address = place.table.address
    if not re.fullmatch("[A-Z]", address):
        raise ConfigError(f"devices.{device}.address: '{printable(address)}' is no unit; it is one letter, A to Z")
    kind = Alicat if chosen.setpoint is None else AlicatController
    return kind(device, chosen, address, place.line.echo)
