"""What a run by hand asks, and readings that are typed in the page.

The run has a named pipe in the logs folder as its standard input, and holds both ends of it: whoever else opens or
closes it, a console that is killed too, the run goes on and waits. What it says is in a file beside the pipe. So the
page types what a person at a terminal would, and the run checks it, logs it and is replayed likewise.
"""

from __future__ import annotations

import contextlib
import os
import stat
import subprocess
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rig.bench.bench import Bench
from rig.by_hand.by_hand import faces_of, is_manual
from rig.by_hand.conversation import COMMANDS, MOST_CHARACTERS, WAIT
from rig.by_hand.manual import CLOSED_QUESTION
from rig.by_hand.prompter import PRESSURE_NOW
from rig.instruments.manual import NOT_READ, EntryError, decode_entry, example, quantity, unit_on_face
from spinbench.console.access import RefusedError

SAID = ".console-sweep.txt"  # in the logs folder: what the run that was started last has said
PIPE = ".console-typed"
MOST_SAID, SHOWN_LINES = 4000, 8
READINGS, PRESSURE, VENTED, LINE = "readings", "pressure", "vented", "line"  # what may be asked for


class Entries:
    """Of a bench whose valve a person sets. Its methods may be called from several threads."""

    def __init__(self, bench: Bench, logs: Path) -> None:
        self.channels = dict(faces_of(bench)) if is_manual(bench) else {}
        self._pressure = bench.file.roles.pressure.partition(".")[2]
        self._said, self.pipe = logs / SAID, logs / PIPE
        self._lock = threading.Lock()
        self._answered: int | None = None

    def told(self) -> dict[str, Any] | None:
        """The question that is open, for the page; None where no run listens to it.

        Returns ``asks``, which question it is: an answer names it; and ``kind``, which is ``readings``, ``pressure``,
        ``vented`` or ``line``.
        """
        if (handle := self._opened()) is None:
            return None
        os.close(handle)
        size, asks, lines = self._heard()
        kind = self._kind(lines[-1])
        said, question = self._shown(lines, kind)
        named = {READINGS: list(self.channels), PRESSURE: [self._pressure]}.get(kind, [])
        return {
            "asks": asks,
            "kind": kind,
            "said": said,
            "question": question,
            "answered": size == self._answered,
            "fields": [self._field(name) for name in named],
            "commands": COMMANDS if self.channels else {},
        }

    def enter(self, asked: Mapping[str, Any]) -> None:
        """Answer the open question, as if it were typed.

        `asked`: ``asks``, and ``fields`` by channel or ``text``.
        Raises RefusedError: it cannot be read as meant, the question has changed, or nobody listens.
        """
        with self._lock:
            open_now = self.told()
            if open_now is None:
                raise RefusedError(409, "no run that was started from a console waits for an answer")
            if open_now["answered"] or asked.get("asks") != open_now["asks"]:
                raise RefusedError(409, "the question has changed since it was shown: read it, and answer again")
            fields = asked.get("fields")
            text = self._line(fields, open_now["kind"]) if isinstance(fields, dict) else str(asked.get("text", ""))
            if len(text) > MOST_CHARACTERS or not text.isprintable():
                raise RefusedError(400, f"an answer is one line of at most {MOST_CHARACTERS} characters")
            if (handle := self._opened()) is None:
                raise RefusedError(409, "the run has ended meanwhile")
            line = f"{text}\n".encode()
            try:
                with self._said.open("ab") as said:  # as a terminal shows what is typed
                    said.write(line)
                self._answered = self._heard()[0]
                os.write(handle, line)
            except OSError as error:
                raise RefusedError(409, f"the run does not listen: {error.strerror}") from None
            finally:
                os.close(handle)

    def _shown(self, lines: list[str], kind: str) -> tuple[list[str], str]:
        """What was said, and what is asked: the fields are named beside them, and are not told again."""
        prompt = example(self.channels) if self.channels else "\n"
        said = [line.replace(f"{prompt}:", "") for line in lines]
        said = [line.strip() for line in said if line.strip() and not line.strip().startswith(WAIT)]
        if kind == READINGS and lines[-1].strip().startswith(WAIT):
            return said, lines[-1].strip()
        return said[:-1][-SHOWN_LINES:], said[-1] if said else ""

    def _line(self, fields: Mapping[str, Any], kind: str) -> str:
        """What is typed for fields, checked as the run checks it."""
        typed = {name: str(fields.get(name, "")).strip() or NOT_READ for name in self.channels}
        if cut := [name for name, text in typed.items() if len(text.split()) > 1]:
            raise RefusedError(400, f"{cut[0]}: one number, without its unit")
        if kind == READINGS and set(typed.values()) == {NOT_READ}:
            raise RefusedError(400, "nothing is entered; - is for one that was not read")
        try:
            decode_entry(" ".join(typed.values()), self.channels)
        except EntryError as error:
            raise RefusedError(400, str(error)) from None
        if kind == PRESSURE:
            return "" if typed[self._pressure] == NOT_READ else typed[self._pressure]
        return " ".join(typed.values())

    def _field(self, name: str) -> dict[str, Any]:
        channel = self.channels[name]
        return {
            "name": name,
            "label": quantity(name),
            "unit": unit_on_face(name, channel),
            "low": channel.lowest,
            "high": channel.highest,
        }

    def _kind(self, question: str) -> str:
        if self.channels and (example(self.channels) in question or question.strip().startswith(WAIT)):
            return READINGS  # a countdown ends with them
        if self.channels and PRESSURE_NOW in question:
            return PRESSURE
        return VENTED if CLOSED_QUESTION in question else LINE

    def _heard(self) -> tuple[int, int, list[str]]:
        """How much the run has said [bytes], where its last line begins [bytes], and its last lines."""
        try:
            with self._said.open("rb") as stream:
                size = stream.seek(0, os.SEEK_END)
                stream.seek(max(size - MOST_SAID, 0))
                said = stream.read(MOST_SAID)
        except OSError:
            return 0, 0, [""]
        lines = said.rstrip(b"\n").decode("utf-8", "replace").split("\n")[-3 * SHOWN_LINES :]
        begins = size - len(said) + said.rstrip(b"\n").rfind(b"\n") + 1
        return size, begins, lines

    def _opened(self) -> int | None:
        """The pipe, to be written to; None where no run has it."""
        try:
            handle = os.open(self.pipe, os.O_WRONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError:  # there is none, or nobody reads it
            return None
        if stat.S_ISFIFO(os.fstat(handle).st_mode):
            return handle
        os.close(handle)
        return None


@contextlib.contextmanager
def typed_into(entries: Entries | None) -> Iterator[int]:
    """The standard input of a run that is started: a new pipe, for its user alone; nothing where no person reads."""
    if entries is None:
        yield subprocess.DEVNULL
        return
    entries.pipe.unlink(missing_ok=True)
    os.mkfifo(entries.pipe, 0o600)
    handle = os.open(entries.pipe, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)  # both ends: its reader never sees an end
    try:
        yield handle
    finally:
        os.close(handle)
