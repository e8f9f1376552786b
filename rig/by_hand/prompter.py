"""Readings that a person types: the prompts, the commands, and the entries on their way into the log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from rig.acquisition import Acquisition
from rig.acquisition.stage import ROOM
from rig.bench.bench import Bench
from rig.by_hand.by_hand import manual_device
from rig.by_hand.conversation import Command, Conversation, StoppedError, Typed, command_of, help_text
from rig.instruments.codecs.values import Value
from rig.instruments.manual import EntryError, ManualEntry, decode_entry, example, unit_on_face
from rig.readings import Reading
from rig.sweep import ambient as room
from rig.sweep.course import Course
from rig.sweep.orders import Trip
from rig.sweep.runner import COMMAND_REAL_S, BenchView

PRESSURE_NOW = "pressure now?"
RECORDED_REAL_S = 2.0  # in which a reading is in the log


Doubt = Callable[[Mapping[str, Value]], str]


def believed(values: Mapping[str, Value]) -> str:
    """No doubt."""
    return ""


class JumpedError(Exception):
    """A command that leaves the level: repeat, undo or skip."""

    def __init__(self, command: Command) -> None:
        super().__init__(command.word)
        self.command = command


class TrippedError(Exception):
    """A reading is beyond a limit of the bench."""


class Prompter:
    """Asks for readings and lays them into the log."""

    def __init__(
        self, acquisition: Acquisition, bench: Bench, course: Course, conversation: Conversation, trip: Trip
    ) -> None:
        self.acquisition, self.bench, self.person, self.trip = acquisition, bench, conversation, trip
        self.clock = acquisition.clock
        self.roles, self.wait_s = course.roles, course.table.dwell_s
        self.device = manual_device(bench)
        driver = bench.build(self.device)
        self.typed, self.faces = (driver.channels, driver.faces) if isinstance(driver, ManualEntry) else ({}, {})
        device, _, self.pressure = bench.file.roles.pressure.partition(".")
        self.pressure_is_typed = device == self.device
        named = {role: getattr(bench.file.roles, role) or "" for role in self.roles}
        self.typed_roles = {
            role: name.partition(".")[2] for role, name in named.items() if name.partition(".")[0] == self.device
        }
        self.note = ""
        self._view = BenchView(acquisition)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """While entered, a reading beyond a limit ends an open prompt too: instruments may be polled beside the person.

        What the conversation raises then is TrippedError.
        """
        before, self.person.look = self.person.look, self._look
        try:
            yield
        finally:
            self.person.look = before

    def entry(self, lead: str = "", doubt: Doubt = believed) -> dict[str, Reading]:
        """Ask for one line of readings, and obey commands until there is one; by channel, and by role.

        What is doubted is asked for again, and is no reading before the same has been typed twice.

        `doubt`: says why typed values, by role, may be a slip; empty when they are plausible.
        Raises JumpedError when a command leaves the level; StoppedError, EndedError, TrippedError when the run ends
        here.
        """
        prompt = f"  {lead}{example(self.faces)}: "
        doubted: list[str] = []
        while True:
            typed = self._asked(prompt)
            if not typed.text:
                self.person.wait(self.wait_s)
                continue
            try:
                values = decode_entry(typed.text, self.faces)
            except EntryError as error:
                self.person.say(f"  {error}")
                continue
            if typed.text.split() != doubted and self._doubts(values, doubt):
                doubted = typed.text.split()
                continue
            return self._read(typed.text, typed)

    def _doubts(self, values: Mapping[str, Value], doubt: Doubt) -> bool:
        """Whether values are doubted; then it is said why."""
        why = doubt({role: values[name] for role, name in self.typed_roles.items()})
        if why:
            self.acquisition.event("doubted", None, text=why)
            self.person.say(f"  ? {why}. Type the right figures, or the same again if they are right.")
        return bool(why)

    def pressure_now(self, doubt: Doubt = believed) -> Reading | None:
        """The pressure read again, to see whether it has drifted."""
        doubted = ""
        while True:
            unit = unit_on_face(self.pressure, self.faces[self.pressure])
            typed = self._asked(f"  {PRESSURE_NOW} [{unit}] (Enter when it was not read) ")
            if not typed.text:
                return None
            words = [typed.text if name == self.pressure else "-" for name in self.typed]
            text = " ".join(words)
            try:
                values = decode_entry(text, self.faces)
            except EntryError as error:
                self.person.say(f"  {error}")
                continue
            if typed.text != doubted and self._doubts(values, doubt):
                doubted = typed.text
                continue
            return self._read(text, typed)["pressure"]

    def _asked(self, prompt: str) -> Typed:
        """A line that is no command; notes and help are dealt with here, others leave the level."""
        while True:
            typed = self.person.ask(prompt)
            command = command_of(typed.text)
            if command is None:
                return typed
            if command.word == "stop":
                raise StoppedError
            if command.word == "help":
                self.person.say(help_text())
            elif command.word == "room":
                self._correct_room()
            elif command.word == "note":
                self.note = f"{self.note}; {command.rest}".removeprefix("; ")
                self.acquisition.event("note", None, text=command.rest)
            else:
                raise JumpedError(command)

    def _correct_room(self) -> None:
        """Ask for the room once more; what is put right goes into the log, and stands for the start too."""
        if self.person.room is None:
            self.person.say("  the room's figures are not at hand here")
            return
        try:
            now = room.again(self.person.room, self.person.ask_text)
        except room.AmbientError as error:
            self.person.say(f"  {error}")
            return
        self.person.room = now
        self.acquisition.event(ROOM, None, **now.told())
        self.person.say(f"  the room: {now.words()}")

    def _read(self, text: str, typed: Typed) -> dict[str, Reading]:
        """Have the entry decoded and logged as any instrument's; by role, and by channel."""
        self.person.port.feed(f"{text}\n".encode(), typed.asked_ns, typed.typed_ns)
        exchange = self.acquisition.command(self.device, "poll", None, COMMAND_REAL_S)
        found = {reading.channel: reading for reading in exchange.readings}
        for role in self.roles:
            reading = self._logged(role, typed.typed_ns)
            if reading is not None:
                found[role] = reading
        self._look()
        return found

    def _look(self) -> None:
        reason = self.trip(self._view, self.clock.now_ns(), False)
        if reason is not None:
            raise TrippedError(reason)

    def _logged(self, role: str, typed_ns: int) -> Reading | None:
        """The reading that a typed channel, or one derived from it, got for a role; None when it is not typed."""
        name = getattr(self.bench.file.roles, role)
        if name is None or name.partition(".")[0] != self.device:
            return None
        wait_s = RECORDED_REAL_S
        while wait_s > 0.0:  # the recorder has a thread of its own
            last = self.acquisition.last(role)
            if last is not None and last.time_ns >= typed_ns:
                return last
            self.clock.sleep(0.002 * self.clock.rate)
            wait_s -= 0.002
        return None
