"""A device that answers in text, described by its file alone: a query, a pattern with a named group a channel, a unit.

Text has no checksum: a value counts as checked when two polls in a row agree. A device without a query is listened to.
"""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import pydantic

from rig.bench.instrument import IdentityError, InstrumentFile, Scale, refuse_doubles
from rig.instruments.codecs.streaming import Stream, cut_lines
from rig.instruments.codecs.values import Value, printable
from rig.instruments.placing import refuse_keyboard
from rig.instruments.polling import Answer, ChannelName, Polled, PolledFile, UncheckedChannel, repeated, timing_of
from rig.lines import BadReplyError, Line, Timing
from rig.lines.line import ECHOES, Complete, Reply
from rig.readings import Quality, scpi_number

if TYPE_CHECKING:
    from rig.bench.bench import Place

NUMBER = re.compile(r"[+-]?(\d{1,12}(\.\d{0,12})?|\.\d{1,12})([eE][+-]?\d{1,3})?")
NO_NUMBER = re.compile(r"[+-]?-+([.,]-+)?")  # dashes, as a display shows where it has no number
SIGN_APART = re.compile(r"^([+-])[ \t]{1,12}(?=[0-9.])")
WORD = re.compile(r"[A-Za-z][A-Za-z ._-]*")
DASHES = re.compile(r"-{2,}([.,]-+)?|-[.,]-+")
SWAPPED = str.maketrans(".,", ",.")
LINE_ENDS = b"\r\n"
# What may be left around a line. Not every control character: one bit makes 0x13 of a 3.
RIM = "\r\n\0\x02\x03"
MARKS = {".": "point", ",": "comma"}
SERIAL_GROUP = "serial"
_PARSER: Any = importlib.import_module("re._parser")  # the one way to look into a pattern
MOST_OPEN_REPEATS = 4  # of a pattern over so short a text as a reply
OPEN_SPAN = 16  # a repeat that may take so many characters more or less is open-ended

Words = Annotated[str, pydantic.StringConstraints(max_length=64, pattern=r"^[\x00-\x7f]*$")]
PatternText = Annotated[str, pydantic.StringConstraints(min_length=1, max_length=200, pattern=r"^[\x20-\x7e]*$")]


class TextChannel(UncheckedChannel):
    """A quantity in the reply: value = scale * number + offset."""

    scale: Scale = 1.0
    offset: float = 0.0
    over_range: list[str] = pydantic.Field(default_factory=list)  # texts in the number's place
    under_range: list[str] = pydantic.Field(default_factory=list)
    invalid: list[str] = pydantic.Field(default_factory=list)

    @pydantic.model_validator(mode="after")
    def states_differ(self) -> TextChannel:
        """Refuse a text that stands for two states."""
        refuse_doubles(self.over_range, self.under_range, self.invalid)
        return self


class DecimalMarkError(BadReplyError):
    """The numbers of a reply have the other decimal mark than the file says. `fix`: the key that would take it."""

    def __init__(self, text: str, decimal: str) -> None:
        other = "," if decimal == "." else "."
        self.fix = f'write decimal = "{other}" in the instrument file, and the {MARKS[other]} in its pattern'
        super().__init__(
            f"'{printable(text)}' has a {MARKS[other]} where the file has a decimal {MARKS[decimal]}: if that is the "
            f"decimal mark, {self.fix}"
        )


class Settings(PolledFile):
    """The keys of a generic ASCII device."""

    query: Words = ""  # without one, the device sends unasked
    terminator: Annotated[str, pydantic.StringConstraints(min_length=1, max_length=4, pattern=r"^[\x00-\x7f]+$")] = (
        "\r\n"
    )
    pattern: PatternText  # of the whole line without its end
    decimal: Literal[".", ","] = "."  # the decimal mark of all its numbers
    refusals: list[str] = pydantic.Field(default_factory=list)  # lines by which the device refuses
    most_bytes: Annotated[int, pydantic.Field(ge=1, le=256)] = 128
    channels: Annotated[dict[ChannelName, TextChannel], pydantic.Field(min_length=1, max_length=16)]
    identity_query: Words = ""
    identity_pattern: PatternText | None = None  # may have a group 'serial'

    @pydantic.model_validator(mode="after")
    def patterns_fit(self) -> Settings:
        """Refuse patterns that cannot be read, could take forever, or name other channels than the file."""
        groups = groups_of(self.pattern, "pattern")
        if groups != set(self.channels):
            raise ValueError(f"pattern: its named groups are {sorted(groups)}, the channels {sorted(self.channels)}")
        if bool(self.identity_query) != (self.identity_pattern is not None):
            raise ValueError("identity_query and identity_pattern come together")
        if self.identity_pattern is not None and not groups_of(self.identity_pattern, "identity_pattern") <= {
            SERIAL_GROUP
        }:
            raise ValueError("identity_pattern: the one named group it may have is 'serial'")
        return self


def decode(
    line: bytes, pattern: re.Pattern[str], channels: Mapping[str, TextChannel], decimal: str = "."
) -> dict[str, Value]:
    """The values of a line of text.

    `decimal`: the decimal mark; a number with the other one is refused.
    By channel, limits not yet looked at; one with dashes in the place of its number has no value, nor has one with a
    word, beside others that have. Raises BadReplyError when the line is not of the pattern, or a number is none.
    """
    text = line.decode("ascii", errors="replace")
    groups = _groups(pattern, text)
    if groups is None:
        if _groups(pattern, text.translate(SWAPPED)) is not None:
            raise DecimalMarkError(text, decimal)
        raise BadReplyError(f"the reply '{printable(text)}' is not of the pattern {pattern.pattern}")
    found = {name: _value(groups[name].strip(), channel, decimal) for name, channel in channels.items()}
    if not any(found.values()):
        raise BadReplyError(f"'{printable(text)}' has no number, nor a word that the file knows")
    return {name: value or _of_a_word(groups[name].strip()) for name, value in found.items()}


def _of_a_word(word: str) -> Value:
    return Value(None, Quality.EXCEPTION, word, f"the device shows '{printable(word)}' in place of a number")


def _groups(pattern: re.Pattern[str], text: str) -> dict[str, str] | None:
    """What stands where a pattern has its groups, dashes in a number's place too; None where the text is not of it."""
    for line in (text, text.strip(RIM)):
        matches = [pattern.fullmatch(shown) for shown in (line, *_with_digits(line))]
        match = next(filter(None, matches), None)
        if match is not None:
            spans = {name: match.span(name) for name in pattern.groupindex}
            return {name: line[begin:end] if begin >= 0 else "" for name, (begin, end) in spans.items()}
    return None


def _with_digits(line: str) -> list[str]:
    """A line with digits in place of dashes, the first of which may stand for a sign."""
    cut = [(dashes.span(), dashes[0][1:].replace("-", "0")) for dashes in DASHES.finditer(line)]
    found = []
    for sign in "0-":
        shown = line
        for (begin, end), digits in cut:
            shown = shown[:begin] + sign + digits + shown[end:]
        found.append(shown)
    return found


def _match(pattern: re.Pattern[str], text: str) -> re.Match[str] | None:
    """A line held against its pattern, without what may be left around it where it fits only so."""
    return pattern.fullmatch(text) or pattern.fullmatch(text.strip(RIM))


def _value(text: str, channel: TextChannel, decimal: str) -> Value | None:
    """The value of what stands in a number's place; None of a word that the file does not know."""
    rising = 1.0 if channel.scale > 0.0 else -1.0
    if text in channel.over_range:
        return Value(rising * float("inf"), raw=text, detail=f"'{text}' stands for over-range")
    if text in channel.under_range:
        return Value(-rising * float("inf"), raw=text, detail=f"'{text}' stands for under-range")
    if text in channel.invalid:
        return Value(None, Quality.EXCEPTION, text, f"the device reports a fault: '{text}'")
    if NO_NUMBER.fullmatch(text):
        return Value(None, Quality.EXCEPTION, text, "the device shows no number")
    number = SIGN_APART.sub(r"\1", text if decimal == "." else text.translate(SWAPPED))
    if not NUMBER.fullmatch(number):
        if NUMBER.fullmatch(number.translate(SWAPPED)):
            raise DecimalMarkError(text, decimal)
        if WORD.fullmatch(text):
            return None
        raise BadReplyError(f"'{printable(text)}' in the reply is not a number")
    return Value(channel.scale * scpi_number(float(number)) + channel.offset, raw=text)


def ends_with(terminator: bytes, most_bytes: int) -> Complete:
    """What tells where a reply in text ends. It has the form that `Line.ask` takes."""

    def complete(buffer: bytes) -> int | None:
        end = buffer.find(terminator)
        if end > most_bytes or (end < 0 and len(buffer) > most_bytes + len(terminator)):
            raise BadReplyError(f"{len(buffer)} bytes without the end of a reply, which has {most_bytes} at most")
        return None if end < 0 else end + len(terminator)

    return complete


def ask_text(
    line: Line, request: bytes, complete: Complete, timing: Timing, echo: bool, spoiled: Complete | None = None
) -> Reply:
    """Ask a question in text and return the answer, without the question's echo, which is told once.

    `complete`: tells where the answer ends. `echo`: whether the bench file expects the echo, so that it is not told.
    `spoiled`: as of `Line.ask`, which raises the same.
    """

    def after_echo(buffer: bytes) -> int | None:
        begin = _echo_in(request, buffer)
        if not begin and request.startswith(buffer):
            return None
        length = complete(buffer[begin:])
        return None if length is None else begin + length

    line.look(timing.byte_s)
    reply = line.ask(request, after_echo, timing, spoiled)
    begin = _echo_in(request, reply.data)
    if begin and not echo:
        line.remark(ECHOES)
    return dataclasses.replace(reply, data=reply.data[begin:]) if begin else reply


def _ends_otherwise(buffer: bytes) -> int | None:
    """What came in time, where it ends as a line does."""
    return len(buffer) if buffer.rstrip(LINE_ENDS) not in (b"", buffer) else None


def _other_end(came: bytes, terminator: str) -> BadReplyError:
    """A line that came whole, and does not end as the file says."""
    end = came[len(came.rstrip(LINE_ENDS)) :].decode("ascii")
    return BadReplyError(
        f"'{printable(came.decode('ascii', 'replace'))}' does not end with {json.dumps(terminator)}: if it is a whole "
        f"answer, write terminator = {json.dumps(end)} in the instrument file"
    )


def _echo_in(request: bytes, buffer: bytes) -> int:
    """Bytes of the question's echo at the start of a buffer; a terminal's has a line feed after its return."""
    if not buffer.startswith(request):
        return 0
    return len(request) + (request.endswith(b"\r") and buffer[len(request) :].startswith(b"\n"))


class AsciiDevice(Polled):
    """A generic device that answers, or sends, lines of text.

    `serial_number`: of the bench file; empty when any will do.
    `echo`: as of `ask_text`.
    """

    checked = False

    def __init__(self, device: str, settings: Settings, serial_number: str, echo: bool = False) -> None:
        super().__init__(device, settings.channels, settings)
        self.settings, self._echo = settings, echo
        self._serial_number = serial_number
        self._end = settings.terminator.encode("ascii")
        self._pattern = re.compile(settings.pattern)
        self._stream = Stream(cut_lines(self._end, settings.most_bytes))
        self._first = True

    def open(self, line: Line) -> None:
        """Forget what was known; the first line that comes unasked may have lost its head, and will be dropped."""
        super().open(line)
        self._stream.forget()
        self._first = True

    def ask(self, line: Line) -> Answer:
        """Ask for a line, or wait for one, and decode it."""
        reply = self._question(line, self.settings.query) if self.settings.query else self._unasked(line)
        text = reply.data.removesuffix(self._end)
        if text.decode("ascii", errors="replace").strip(" \t\r\n\0") in self.settings.refusals:
            raise BadReplyError(
                f"{self.device} refuses: '{printable(text.decode('ascii', 'replace'))}'", Quality.EXCEPTION
            )
        found = decode(text, self._pattern, self.settings.channels, self.settings.decimal)
        return Answer(found, text, reply.request_ns, reply.reply_ns)

    def identify(self, line: Line) -> str:
        """Ask who it is, where the file says how; otherwise see that a reply has the pattern."""
        if self.settings.identity_pattern is None:
            repeated(lambda: self.ask(line), 1)
            return f"{self.settings.title} (its reply has the pattern; it does not tell who it is)"
        reply = repeated(lambda: self._question(line, self.settings.identity_query), 1)
        text = reply.data.removesuffix(self._end).decode("ascii", errors="replace")
        match = _match(re.compile(self.settings.identity_pattern), text)
        if match is None:
            raise IdentityError(f"{self.device}: '{printable(text)}' answers, which is not a {self.settings.title}")
        serial = match.groupdict().get(SERIAL_GROUP, self._serial_number) or ""
        if self._serial_number and serial != self._serial_number:
            raise IdentityError(
                f"{self.device}: number '{printable(serial)}' answers, the bench file says '{self._serial_number}'"
            )
        return printable(text)

    def _question(self, line: Line, query: str) -> Reply:
        complete, timing = ends_with(self._end, self.settings.most_bytes), timing_of(self.settings, line)
        try:
            reply = ask_text(line, query.encode("ascii"), complete, timing, self._echo, _ends_otherwise)
            if not reply.data.endswith(self._end):
                raise _other_end(reply.data, self.settings.terminator)
            return reply
        except BadReplyError:
            line.drop()
            raise

    def _unasked(self, line: Line) -> Reply:
        timing = timing_of(self.settings, line)
        time_ns, lines = self._stream.frames(line, timing.timeout_s)
        if self._first:
            self._first = False
            lines = lines[1:]
            if not lines:
                time_ns, lines = self._stream.frames(line, timing.timeout_s)
        return Reply(lines[-1], time_ns, time_ns)


def build(device: str, settings: InstrumentFile, place: Place) -> AsciiDevice:
    """The driver of a generic ASCII device."""
    chosen = cast(Settings, settings)
    refuse_keyboard(device, place)
    return AsciiDevice(device, chosen, place.table.serial_number, place.line.echo)


def groups_of(pattern: str, key: str) -> set[str]:
    """The named groups of a pattern that cannot take long.

    Raises ValueError when it is no regular expression, or could take forever on some text.
    """
    try:
        compiled = re.compile(pattern)
        opened, nested = _repeats(_PARSER.parse(pattern), inside=False)
    except (re.error, OverflowError, RecursionError) as error:
        raise ValueError(f"{key}: not a regular expression: {error}") from None
    if nested or opened > MOST_OPEN_REPEATS:
        raise ValueError(
            f"{key}: could take forever on some text; repeat nothing that repeats itself, refer to no group, and make "
            f"all open-ended repeats but {MOST_OPEN_REPEATS} possessive (\\d++ in place of \\d+)"
        )
    return set(compiled.groupindex)


def _repeats(parsed: Any, inside: bool) -> tuple[int, bool]:
    """Open-ended repeats that may give back what they took, and whether one stands in another."""
    opened, nested = 0, False
    for operation, argument in parsed:
        name, within = str(operation), inside
        if name.endswith("_REPEAT"):
            least, most, _ = argument
            variable = most - least > 1
            nested |= inside and variable
            opened += most - least > OPEN_SPAN and name != "POSSESSIVE_REPEAT"
            within |= most > 1
        nested |= name.startswith("GROUPREF")
        for inner in _inner(argument):
            more, deeper = _repeats(inner, within)
            opened, nested = opened + more, nested or deeper
    return opened, nested


def _inner(argument: Any) -> Iterator[Any]:
    """The patterns within a part of a pattern."""
    if isinstance(argument, _PARSER.SubPattern):
        yield argument
    elif isinstance(argument, (tuple, list)):
        for part in argument:
            yield from _inner(part)
