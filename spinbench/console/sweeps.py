"""The sweep or capture that a console starts: a process of its own, in a session of its own, that outlives it."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.bench.bench import Bench
from rig.runlog import RunError
from rig.runlog.folder import END
from rig.runlog.reader import read_end, read_start
from rig.sweep.ambient import ROOM_FIGURES
from spinbench.console.access import RefusedError
from spinbench.console.entries import SAID, Entries, typed_into
from spinbench.console.planned import Planned, bench_words
from spinbench.console.stopping import ask_to_stop, being_written, newest_first, runs_of_benches

MOST_SAID, MOST_TEXT = 4000, 500
OPTIONS = (
    "operator",
    "motor_serial",
    "lubrication",
    "minutes_running",
    "ambient_pressure_bar_abs",
    "ambient_temperature_c",
    "relative_humidity",
)


RANGES = {
    name: tuple(ROOM_FIGURES[key].factor * end for end in (ROOM_FIGURES[key].low, ROOM_FIGURES[key].high))
    for name, key in {
        "minutes_running": "minutes_running",
        "ambient_pressure_bar_abs": "pressure_bar_abs",
        "ambient_temperature_c": "temperature_c",
        "relative_humidity": "relative_humidity",
    }.items()
}  # of the entries that are numbers


def sentence(said: str) -> str:
    """What a command says of why it did not begin, without its usage."""
    _, usage, told = f"\n{said}".partition("\nError: ")
    lines = (told if usage else said).splitlines()
    return " ".join(line.strip().removeprefix("spinbench: ") for line in lines).strip()


class Sweeps:
    """Starts a sweep or a capture, and knows of it until its run is there or it has ended.

    `options`: of `spinbench sweep` and `capture`, given to each.
    """

    def __init__(self, path: Path, bench: Bench, logs: Path, options: tuple[str, ...] = ()) -> None:
        self.path, self.bench, self.logs, self.options = path, bench, logs, options
        self.entries = Entries(bench, logs) if bench.file.roles.regulator is None else None
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0
        self._before: set[Path] = set()
        self._run: Path | None = None  # of the last start, once it is there
        self._lock = threading.RLock()  # a start and what became of the one before are asked for by several threads

    @property
    def running(self) -> bool:
        """Whether the sweep that was started last goes on. Once its run is sealed its program makes the page alone."""
        with self._lock:
            is_alive = self._process is not None and self._process.poll() is None
            return is_alive and ((new := self._new()) is None or not (new / END).exists())

    @property
    def starting(self) -> bool:
        """Whether the sweep that was started last goes on and has no run yet."""
        with self._lock:
            return self.running and self._run is None

    def start(self, planned: Planned, answers: Mapping[str, str]) -> None:
        """Start it.

        `answers`: by `OPTIONS`; an empty one is left out.
        Raises RefusedError where it cannot be.
        """
        unknown = sorted(set(answers) - set(OPTIONS))
        if unknown or any(len(str(text)) > MOST_TEXT for text in answers.values()):
            raise RefusedError(400, f"not an entry of a run, or too long: {', '.join(unknown)}")
        given = {**answers, "note": planned.note}
        words = [f"--{name.replace('_', '-')}={text}" for name, text in given.items() if str(text).strip()]
        command = [sys.executable, "-m", "spinbench", *bench_words(self.path, planned, self.logs)]
        with self._lock:
            if self.running or being_written(self.logs):
                raise RefusedError(409, "a run is going on in this logs folder; wait for its end, or stop it")
            if self.asked() is not None:
                raise RefusedError(409, "a run by hand waits for its next answer: answer it, or stop it")
            self._process = None  # what the start before said is no longer true of anything
            self._starts += 1
            self._before, self._run = set(newest_first(self.logs)), None
            (self.logs / SAID).unlink(missing_ok=True)  # the one before may still write into its own
            with (self.logs / SAID).open("ab") as said, typed_into(self.entries) as typed:
                self._process = subprocess.Popen(
                    [*command, *self.options, *words],
                    stdin=typed,
                    stdout=said,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )

    def asked(self) -> dict[str, Any] | None:
        """What a run by hand asks now; None where none does, and where it was sealed after the last answer."""
        told = None if self.entries is None else self.entries.told()
        run = self._run or next(runs_of_benches(self.logs), None)
        if told is not None and self.entries is not None and run is not None:
            with contextlib.suppress(OSError):  # it has no end yet
                sealed_s = (run / END).stat().st_mtime
                return None if sealed_s > self.entries.pipe.stat().st_mtime else told
        return told

    def stop(self) -> str:
        """Tell the sweep that was started to stop, also before its run is there; why not, empty when it was told."""
        return ask_to_stop(self._process.pid if self._process is not None and self.running else None)

    def forget_refusal(self) -> None:
        """A run is being written: that an earlier start was refused is no longer of interest."""
        with self._lock:
            if not self.running:
                self._process = None

    def failed(self) -> dict[str, Any] | None:
        """The number of the last start and what its sweep said when it could not begin; None where it began."""
        with self._lock:
            if self._process is None or self._process.poll() in (None, 0, 4):
                return None
            said = (self.logs / SAID).read_bytes()[-MOST_SAID:].decode("utf-8", "replace").strip()
            said = sentence(said) or f"the sweep ended with exit code {self._process.returncode} and said nothing"
            return {"start": self._starts, "text": said}

    def why_not_well(self) -> str:
        """Why the run that was started last has not ended well; empty where it finished and its line is vented."""
        with self._lock:
            if failed := self.failed():
                return f"The run before did not begin, or failed: {failed['text']}."
            try:
                new = self._new()
                end = None if new is None else read_end(new)
            except RunError as error:
                return f"The run before cannot be read: {error}."
            if new is None or end is None:
                return f"{'The run before' if new is None else new.name} was not sealed."
            if end.outcome != "finished":
                return f"{new.name} did not finish: {end.reason}."
            return "" if end.vented else f"After {new.name} the line is NOT known to be without pressure."

    def minutes_running(self) -> float:
        """How long the motor has run today at the end of the run that was started last [min]."""
        new = self._new()
        start, end = (None, None) if new is None else (read_start(new), read_end(new))
        if start is None or end is None or start.minutes_running is None:
            return 0.0
        return start.minutes_running + (end.wall_s or 0.0) * start.clock.rate / 60.0

    def _new(self) -> Path | None:
        if self._run is None:
            self._run = next((run for run in runs_of_benches(self.logs) if run not in self._before), None)
        return self._run
