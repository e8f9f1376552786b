"""Talking with a person at a terminal: prompts, typed lines with their times, and the commands among them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from rig.acquisition.opening import port_of
from rig.bench.bench import LineTable
from rig.clock import Clock
from rig.lines import LostError, Port
from rig.lines.keyboard import KeyboardPort
from rig.readings import NS
from rig.sweep.ambient import Ambient

MOST_CHARACTERS = 200
MOST_BUFFER = 65_536
WAIT = "wait:"
MOST_MARKS = 10  # of a countdown
LOOK_REAL_S = 0.2  # how often a wait looks whether the operator has asked to stop, and after the bench


class StoppedError(Exception):
    """The operator has asked to stop while a prompt was open."""


class EndedError(Exception):
    """Nobody can type any more."""


@dataclass(frozen=True)
class Typed:
    """One line. `asked_ns`, `typed_ns`: when the prompt was shown and when the line was there [ns]."""

    text: str
    asked_ns: int
    typed_ns: int


class Conversation:
    """Prompts and answers over a keyboard port.

    `stops`: how often the operator has asked to stop by other means than typing, such as Ctrl-C.
    `room`: what the person has said of the room, as far as it is known here.
    `look`: called several times a second while a prompt is open or time is counted down; what it raises ends the wait.
    """

    def __init__(self, port: KeyboardPort, clock: Clock, stops: Callable[[], int] = lambda: 0) -> None:
        self.port, self.clock = port, clock
        self.stops = stops
        self.room: Ambient | None = None
        self.log: Callable[..., None] = _unlogged
        self.look: Callable[[], None] = _unwatched
        self._seen_stops = 0
        self._buffer = b""
        port.open()

    def ports(self, name: str, table: LineTable, clock: Clock) -> Port:
        """The ports of a bench, with this one for its keyboard: what `Acquisition` is given."""
        return self.port if table.kind == "keyboard" else port_of(name, table, clock)

    def resume(self) -> None:
        """Go on after the port was closed and the log ended. Raises LostError when there is no terminal any more."""
        self.log = _unlogged
        self.port.open()

    def say(self, text: str) -> None:
        """Show a line."""
        self.port.write(f"{text}\n".encode("utf-8", "replace"))

    def show(self, text: str) -> None:
        """Show text without an end of line."""
        self.port.write(text.encode("utf-8", "replace"))

    def ask(self, prompt: str) -> Typed:
        """Show a prompt and wait for a line.

        Raises StoppedError when the operator has asked to stop meanwhile, EndedError when the input has ended.
        """
        try:
            asked_ns = self.port.write(prompt.encode("utf-8", "replace"))
            while b"\n" not in self._buffer:
                self._look()
                _, data = self.port.read(self.clock.now_ns() + int(LOOK_REAL_S * self.clock.rate * NS))
                self._buffer = (self._buffer + data.replace(b"\r", b"\n"))[-MOST_BUFFER:]
        except LostError as error:
            raise EndedError(str(error)) from None
        line, _, self._buffer = self._buffer.partition(b"\n")
        typed = Typed(_printable(line), asked_ns, self.clock.now_ns())
        self.log("typed", prompt=prompt.strip()[-MOST_CHARACTERS:], text=typed.text)
        return typed

    def ask_text(self, prompt: str) -> str:
        """The same for `rig.sweep.ambient`: only the text, and EOFError when nobody can type."""
        try:
            return self.ask(prompt).text
        except EndedError as error:
            raise EOFError(str(error)) from None

    def line_there(self) -> str | None:
        """A line that was typed meanwhile, without waiting; None when there is none, or nobody can type any more."""
        try:
            if b"\n" not in self._buffer:
                _, data = self.port.read(self.clock.now_ns())
                self._buffer = (self._buffer + data.replace(b"\r", b"\n"))[-MOST_BUFFER:]
        except LostError:
            return None
        if b"\n" not in self._buffer:
            return None
        line, _, self._buffer = self._buffer.partition(b"\n")
        return _printable(line)

    def wait(self, seconds: float) -> None:
        """Count down bench time, with marks behind each other so that nothing is written over; a typed line ends it."""
        end_ns = self.clock.now_ns() + int(seconds * NS)
        mark_ns = max(1, math.ceil(seconds / MOST_MARKS)) * NS
        next_ns = int(seconds * NS)
        self.show(f"  {WAIT}")
        while (left_ns := end_ns - self.clock.now_ns()) > 0 and not self._is_typed():
            self._look()
            if left_ns <= next_ns:
                next_ns -= mark_ns
                self.show(f" {math.ceil(left_ns / NS)} s")
            self.clock.sleep(min(left_ns / NS, LOOK_REAL_S * self.clock.rate))
        self.say(" over")

    def _is_typed(self) -> bool:
        """Whether a line with something in it is there already; it is kept for the next prompt."""
        try:
            _, data = self.port.read(self.clock.now_ns())
        except LostError:
            return True  # the next prompt tells
        self._buffer = (self._buffer + data.replace(b"\r", b"\n"))[-MOST_BUFFER:].lstrip(b"\n")
        return b"\n" in self._buffer

    def _look(self) -> None:
        if self.stops() > self._seen_stops:
            self._seen_stops = self.stops()
            raise StoppedError
        self.look()


def _unlogged(kind: str, **details: object) -> None:
    """Where no run is being written."""


def _unwatched() -> None:
    """Where there is nothing to look after."""


class ValveHand:
    """The person at the valve of a bench whose instruments read themselves: `rig.sweep.hooks.Person`."""

    def __init__(self, conversation: Conversation) -> None:
        self._conversation = conversation
        self._answer: str | None = None

    def ask(self, text: str) -> None:
        """Put a question, and do not wait."""
        while self._conversation.line_there() is not None:
            pass  # what was typed before is no answer to this
        self._answer = None
        self._conversation.say(text)

    def answer(self) -> str | None:
        """What was typed since the last question; None until then."""
        if self._answer is None:
            self._answer = self._conversation.line_there()
        return self._answer


def _printable(line: bytes) -> str:
    text = line.decode("utf-8", "replace").strip()
    return "".join(c if c.isprintable() else " " for c in text)[: MOST_CHARACTERS + 1]


@dataclass(frozen=True)
class Command:
    """A word that is not an entry, and what follows it."""

    word: str
    rest: str = ""


COMMANDS = {
    "repeat": "take this level again (at a new level: the one before, once more)",
    "undo": "take the last plateau back, and do it again",
    "skip": "leave this level out",
    "note": "note TEXT: keep a remark with this plateau",
    "room": "put right what was said of the room",
    "stop": "end the run; the valve is closed first",
    "help": "this",
}


def command_of(text: str) -> Command | None:
    """The command that a line is; None for an entry."""
    word, _, rest = text.partition(" ")
    return Command(word.lower(), rest.strip()) if word.lower() in COMMANDS else None


def help_text() -> str:
    """What can be typed, a line each."""
    lines = [f"  {word:<7} {text}" for word, text in COMMANDS.items()]
    lines += ["  <10 or >100: off the scale; -: not read; Enter alone: it is set, count down"]
    return "\n".join(lines)
