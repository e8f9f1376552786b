"""Advantech ADAM-4024, four analogue outputs over Modbus, one of them driving an analogue pressure regulator.

The module knows counts. Which pressure they mean is the regulator's span, in the bench file; which current or voltage,
the output's type code. Register numbers are those of the manual's table, less one on the wire.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, cast

import pydantic

from configs import ConfigError, Strict
from rig.bench.instrument import ChannelFile, IdentityError, InstrumentError, InstrumentFile
from rig.instruments.codecs.values import Value
from rig.instruments.placing import modbus_unit
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, repeated, timing_of
from rig.instruments.setting import set_and_read_back
from rig.lines import Line, LineError, LostError
from rig.lines.modbus import WRITE_ONE, RefusedError, registers_of
from rig.readings import Quality

if TYPE_CHECKING:
    from rig.bench.bench import Place

OUTPUTS, OUTPUT_COUNT = 0, 4  # 40001-40004
TYPE_CODES = 200  # 40201-40204
NAME, NAME_COUNT = 210, 4  # 40211-40214: name 1, name 2, version 1, version 2
SAFETY, SAFETY_COUNT = 214, 2  # 40215 communications safety enabled, 40216 occurred
MODEL = 0x4024
MOST_COUNTS = 0xFFFF


class Range(Strict):
    """An output range: its type code, and the counts at the ends that the regulator's span refers to."""

    code: Annotated[int, pydantic.Field(ge=0, le=0xFFFF)]
    name: str
    low_counts: Annotated[int, pydantic.Field(ge=0, le=MOST_COUNTS)]
    high_counts: Annotated[int, pydantic.Field(ge=1, le=MOST_COUNTS)]


class Settings(PolledFile):
    """The keys of an ADAM-4024."""

    unit: str = "bar gauge"  # of the set-point
    channels: Annotated[dict[ChannelName, ChannelFile], pydantic.Field(min_length=1, max_length=1)]
    ranges: Annotated[list[Range], pydantic.Field(min_length=1, max_length=16)]

    @pydantic.model_validator(mode="after")
    def ranges_rise(self) -> Settings:
        """Refuse a range of no extent, and a code that stands twice."""
        if any(entry.low_counts >= entry.high_counts for entry in self.ranges):
            raise ValueError("ranges: low_counts lies below high_counts")
        if len({entry.code for entry in self.ranges}) < len(self.ranges):
            raise ValueError("ranges: the same code stands twice")
        return self


def counts_of(value: float, span: tuple[float, float], output: Range) -> int:
    """Counts of a set-point. `span`: set-point at the range's low and high end [own unit]."""
    share = (value - span[0]) / (span[1] - span[0])
    return round(output.low_counts + share * (output.high_counts - output.low_counts))


def value_of(counts: int, span: tuple[float, float], output: Range) -> float:
    """The set-point that counts stand for [own unit]. `span`: set-point at the range's low and high end [own unit]."""
    share = (counts - output.low_counts) / (output.high_counts - output.low_counts)
    return span[0] + share * (span[1] - span[0])


class Adam4024(Polled):
    """One output of an ADAM-4024 with an analogue regulator behind it."""

    def __init__(self, device: str, settings: Settings, place: Place) -> None:
        super().__init__(device, settings.channels, settings)
        if place.table.channel is None or not 0 <= place.table.channel < OUTPUT_COUNT:
            raise ConfigError(f"devices.{device}.channel: say which output drives the regulator, 0 to 3")
        span = place.table.span
        if span is None or not span[0] < span[1]:
            raise ConfigError(
                f"devices.{device}.span: say the regulator's set-point at the output's low and high end, such as "
                f"[0.0, 5.0], in {settings.unit}"
            )
        self.settings = settings
        self.unit, (self.lowest, self.highest) = settings.unit, span
        self.output: int = place.table.channel
        self._span = (self.lowest, self.highest)
        self._unit = modbus_unit(device, place)
        self._range: Range | None = None

    def open(self, line: Line) -> None:
        """Forget what was known, the output's range included."""
        super().open(line)
        self._range = None

    def ask(self, line: Line) -> Answer:
        """Read the outputs and the safety flags; the two answers differ in length, so neither passes for the other."""
        timing, output = timing_of(self.settings, line), self._known_range(line)
        safety, first = self._unit.read(line, SAFETY, SAFETY_COUNT, timing)
        counts, reply = self._unit.read(line, OUTPUTS, OUTPUT_COUNT, timing)
        held = counts[self.output]
        state = f"{output.name}, communications safety {'on' if safety[0] else 'off'}"
        if safety[1]:
            detail = f"communications safety has occurred: the module went to its safe values; {state}"
            value = Value(None, Quality.EXCEPTION, f"{held} counts", detail)
        else:
            value = Value(value_of(held, self._span, output), raw=f"{held} counts", detail=state)
        found = dict.fromkeys(self.channels, value)
        return Answer(found, registers_of(counts + safety), first.request_ns, reply.reply_ns, reply.reply_ns)

    def identify(self, line: Line) -> str:
        """Check the model's name, where the module tells it, and the output's range."""
        timing = timing_of(self.settings, line)
        try:
            words, _ = repeated(lambda: self._unit.read(line, NAME, NAME_COUNT, timing), 1)
        except RefusedError as error:
            if error.is_busy:
                raise
            version = "it does not tell its name"
        else:
            if words[0] != MODEL:
                raise IdentityError(
                    f"{self.device}: unit {self._unit.unit} calls itself {words[0]:04X}, not {MODEL:04X}: this is "
                    f"not a {self.settings.title}"
                )
            version = f"version {words[2]:04X} {words[3]:04X}"
        self._range = None
        output = repeated(lambda: self._known_range(line), 1)
        return f"{self.settings.title} at unit {self._unit.unit} ({version}; output {self.output}: {output.name})"

    def write(self, line: Line, value: float) -> float:
        """Order a set-point and return what the module reads back."""
        timing, output = timing_of(self.settings, line), repeated(lambda: self._known_range(line), 1)

        def order() -> None:
            self._unit.write(line, OUTPUTS + self.output, (counts_of(value, self._span, output),), WRITE_ONE, timing)

        def read_back() -> float:
            counts, _ = self._unit.read(line, OUTPUTS, OUTPUT_COUNT, timing)
            return value_of(counts[self.output], self._span, output)

        half_a_count = 0.5001 * (self.highest - self.lowest) / (output.high_counts - output.low_counts)
        return set_and_read_back(self, value, order, read_back, half_a_count)

    def set_failsafe(self, line: Line) -> str:
        """Switch the communications safety on, where it is not, and read it back."""
        timing = timing_of(self.settings, line)

        def enabled() -> bool:
            words, _ = self._unit.read(line, SAFETY, SAFETY_COUNT, timing)
            return words[0] == 1

        refused = ""
        if not repeated(enabled, 1):
            try:
                self._unit.write(line, SAFETY, (1,), WRITE_ONE, timing)
            except LostError:
                raise
            except LineError as error:
                refused = f" ({error})"
            if not repeated(enabled, 1):
                raise InstrumentError(
                    f"{self.device}: the communications safety (40215) is off and cannot be switched on over "
                    f"Modbus{refused}; switch it on, with zero as safe value, by the maker's utility"
                )
        return (
            "communications safety is on (40215 read back as 1); its time and the outputs' safe values are kept in the "
            "module and cannot be read over Modbus"
        )

    def _known_range(self, line: Line) -> Range:
        """The output's range, read once after each opening: it decides what counts mean."""
        if self._range is None:
            words, _ = self._unit.read(line, TYPE_CODES, OUTPUT_COUNT, timing_of(self.settings, line))
            code = words[self.output]
            chosen = next((entry for entry in self.settings.ranges if entry.code == code), None)
            if chosen is None:
                known = ", ".join(f"0x{entry.code:02X} {entry.name}" for entry in self.settings.ranges)
                raise IdentityError(
                    f"{self.device}: output {self.output} has the type code 0x{code:02X}, which the instrument's file "
                    f"does not know ({known})"
                )
            self._range = chosen
        return self._range


def build(device: str, settings: InstrumentFile, place: Place) -> Adam4024:
    """The driver of one output of an ADAM-4024."""
    chosen = cast(Settings, settings)
    return Adam4024(device, chosen, place)
