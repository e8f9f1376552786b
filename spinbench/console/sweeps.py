"""The sweep that a console starts: a process of its own, in a session of its own, that outlives the console."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rig.bench.bench import Bench
from rig.sweep.ambient import FIGURES
from spinbench.console.access import RefusedError
from spinbench.console.stopping import ask_to_stop, being_written, runs_of_benches

SAID = ".console-sweep.txt"  # in the logs folder: what the sweep that was started last has said
MOST_SAID, MOST_TEXT = 4000, 500
OPTIONS = (
    "operator",
    "motor_serial",
    "note",
    "lubrication",
    "minutes_running",
    "ambient_pressure_bar_abs",
    "ambient_temperature_c",
    "relative_humidity",
)


RANGES = {
    name: tuple(FIGURES[key].factor * end for end in (FIGURES[key].low, FIGURES[key].high))
    for name, key in {
        "minutes_running": "minutes_running",
        "ambient_pressure_bar_abs": "pressure_bar_abs",
        "ambient_temperature_c": "temperature_c",
        "relative_humidity": "relative_humidity",
    }.items()
}  # of the entries that are numbers


def sentence(said: str) -> str:
    """What a command says of why it did not begin, without the box around it and without its usage."""
    _, box, within = said.partition("─ Error ─")
    lines = within.splitlines()[1:] if box else said.splitlines()
    return " ".join(line.strip(" │╰╯─").removeprefix("spinbench: ") for line in lines).strip()


class Sweeps:
    """Starts a sweep, and knows of it until its run is there or it has ended.

    `options`: of `spinbench sweep`, given to every sweep.
    """

    def __init__(self, path: Path, bench: Bench, logs: Path, options: tuple[str, ...] = ()) -> None:
        self.path, self.bench, self.logs, self.options = path, bench, logs, options
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0
        self._before: set[Path] = set()
        self._has_run = False
        self._lock = threading.RLock()  # a start and what became of the one before are asked for by several threads

    @property
    def running(self) -> bool:
        """Whether the sweep that was started last goes on."""
        return self._process is not None and self._process.poll() is None

    @property
    def starting(self) -> bool:
        """Whether the sweep that was started last goes on and has no run yet."""
        with self._lock:
            if self.running and not self._has_run:
                self._has_run = not self._before.issuperset(runs_of_benches(self.logs))
            return self.running and not self._has_run

    def start(self, answers: Mapping[str, str]) -> None:
        """Start a sweep.

        `answers`: by `OPTIONS`; an empty one is left out.
        Raises RefusedError where it cannot be.
        """
        if self.bench.file.roles.regulator is None:
            raise RefusedError(
                409, "a person sets this bench's valve: start spinbench sweep in a terminal, this page follows it"
            )
        unknown = sorted(set(answers) - set(OPTIONS))
        if unknown or any(len(str(text)) > MOST_TEXT for text in answers.values()):
            raise RefusedError(400, f"not an entry of a sweep, or too long: {', '.join(unknown)}")
        words = [f"--{name.replace('_', '-')}={text}" for name, text in answers.items() if str(text).strip()]
        command = [sys.executable, "-m", "spinbench", "sweep", str(self.path), f"--logs={self.logs}"]
        with self._lock:
            if self.running or being_written(self.logs):
                raise RefusedError(409, "a run is going on in this logs folder; wait for its end, or stop it")
            self._process = None  # what the start before said is no longer true of anything
            self._starts += 1
            self._before, self._has_run = set(runs_of_benches(self.logs)), False
            with (self.logs / SAID).open("wb") as said:
                self._process = subprocess.Popen(
                    [*command, *self.options, *words],
                    stdin=subprocess.DEVNULL,
                    stdout=said,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )

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
