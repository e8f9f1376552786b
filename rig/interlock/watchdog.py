"""A process of its own that sends the regulator to zero when the controller dies or hangs.

It is started before the regulator is first raised, and has the bench file read and the driver built by then. The
controller beats over a pipe, ten times a second, from a thread that does nothing else: a controller that is merely busy
goes on beating, one that is stopped, or whose interpreter is stuck, does not. The system closes the pipe when the
controller ends in any way, kill -9 included. Either way the watchdog opens the regulator's port (the lock of a dead
controller falls with it) and orders zero, until it is read back. A release ends it without any of that.

It leads a session of its own and ignores Ctrl-C, SIGTERM and SIGHUP, which are meant for the controller. It cannot help
when the machine stops, or when both processes are killed at once: docs/safety.md.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pydantic

from rig.bench.bench import Bench, LineTable
from rig.clock import Clock
from rig.interlock import SafetyError

BEAT_S = 0.1
SILENCE_S = 1.0  # without a beat, in real time, before the controller counts as hung
START_S = 30.0  # for the process to read its files; a cold disk is slow
END_S = 5.0
HAND_OVER_S = 15.0  # longer than the watchdog tries
BEAT, RELEASE = b".", b"R"
READY = b"ready\n"
FOLDER = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Plan:
    """How to reach the regulator.

    `bench_file`: the bench file; it and the instruments' files are read when the watchdog starts.
    `line`: its line, with the port where it really is (on a virtual bench the pty or the TCP port in use).
    `log`: where a line of JSON says what was done; usually ``watchdog.jsonl`` of the run.
    `seal`: a file in the log's folder; once it is there, nothing is written into the log any more.
    """

    bench_file: Path
    device: str
    line: LineTable
    rate: float = 1.0
    log: Path | None = None
    seal: Path | None = None

    @classmethod
    def of(
        cls,
        bench: Bench,
        bench_file: Path,
        clock: Clock,
        log: Path | None = None,
        where: Mapping[str, str | int] | None = None,
        seal: Path | None = None,
    ) -> Plan:
        """The plan for a bench's regulator.

        `where`: ``port``, or ``host`` and ``tcp_port``, in place of what the bench file says.
        Raises SafetyError when the bench has no regulator.
        """
        device = bench.file.roles.regulator
        if device is None:
            raise SafetyError("the bench has no regulator, so a watchdog has nothing to set to zero")
        table = bench.file.lines[bench.file.devices[device].line]
        return cls(bench_file, device, table.model_copy(update=dict(where or {})), clock.rate, log, seal)

    def to_json(self) -> bytes:
        """The plan as one line."""
        places: Any = {name: place.resolve() for name, place in vars(self).items() if isinstance(place, Path)}
        return pydantic.TypeAdapter(Plan).dump_json(replace(self, **places)) + b"\n"

    @classmethod
    def from_json(cls, text: bytes) -> Plan:
        """A plan from `to_json`."""
        return pydantic.TypeAdapter(cls).validate_json(text)


class Beat(threading.Thread):
    """Writes a beat into the pipe, and does nothing else, so that nothing else delays it.

    `attended_s`: it falls silent when nobody has called `attend` for so long, in real time [s]; never, when left out.
    """

    def __init__(self, pipe: int, attended_s: float | None = None) -> None:
        super().__init__(name="watchdog beat", daemon=True)
        self._pipe, self._attended_s = pipe, attended_s
        self._ending = threading.Event()
        self._seen_s = time.monotonic()

    def attend(self) -> None:
        """Say that whoever runs the bench is at work."""
        self._seen_s = time.monotonic()

    def run(self) -> None:
        """Beat until `end`, or until nobody listens."""
        while not self._ending.is_set():
            alone_s = time.monotonic() - self._seen_s
            try:
                if self._attended_s is None or alone_s < self._attended_s:
                    os.write(self._pipe, BEAT)
            except BlockingIOError:
                pass  # the pipe is full of beats that a stopped watchdog has not read
            except OSError:
                return
            self._ending.wait(BEAT_S)

    def end(self) -> None:
        """Stop beating, and wait until it has stopped."""
        self._ending.set()
        self.join()


class Watchdog:
    """The controller's end. Use `start`, and `release` once the regulator is at zero."""

    def __init__(self, process: subprocess.Popen[bytes], attended_s: float | None = None) -> None:
        if process.stdin is None or process.stdout is None:
            raise ValueError("the watchdog needs both its pipes")
        self._process, self._pipe, self._said = process, process.stdin, process.stdout
        os.set_blocking(self._pipe.fileno(), False)
        self._beat = Beat(self._pipe.fileno(), attended_s)
        self._beat.start()

    @classmethod
    def start(cls, plan: Plan, attended_s: float | None = None) -> Watchdog:
        """Start the process, and wait until it watches.

        `attended_s`: how long the sweep may go without asking for `fault`, in real time [s]: a sweep that hangs while
            its threads live, on a terminal stopped with Ctrl-S for example, counts as hung then. Never, when left out.
        Raises SafetyError when it does not get ready; the regulator must not be raised then.
        """
        places = [str(FOLDER), os.environ.get("PYTHONPATH", "")]
        process = subprocess.Popen(
            [sys.executable, "-m", "rig.interlock.watching"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # it outlives the terminal
            bufsize=0,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(place for place in places if place)},
        )
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.write(plan.to_json())
        watchdog = cls(process, attended_s)
        watchdog._wait_until_ready()
        return watchdog

    @property
    def pid(self) -> int:
        """Of the process [-]."""
        return self._process.pid

    def fault(self) -> str | None:
        """Why nobody watches any more; None while somebody does. A run without its watchdog is ended.

        Asking is the sign of life that ``attended_s`` of `start` waits for.
        """
        self._beat.attend()
        code = self._process.poll()
        if code is None:
            return None
        return f"the watchdog process has ended (exit code {code}); its log says why"

    def release(self) -> None:
        """End it without action; harmless when it has ended."""
        self._beat.end()
        with contextlib.suppress(OSError):
            os.write(self._pipe.fileno(), RELEASE)
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._pipe.close()
        self._said.close()

    def hand_over(self) -> bool:
        """Have it set the regulator to zero now, where the controller could not; its line must be closed before.

        Returns whether the regulator read back zero.
        """
        self._beat.end()
        self._pipe.close()
        self._said.close()
        try:
            return self._process.wait(HAND_OVER_S) == 0
        except subprocess.TimeoutExpired:
            return False

    def _wait_until_ready(self) -> None:
        said = b""
        if select.select([self._said], [], [], START_S)[0]:
            said = os.read(self._said.fileno(), 4096)
        if said != READY:
            self.release()
            why = said.decode(errors="replace").strip()[:500] or "it said nothing"
            raise SafetyError(f"the watchdog of the regulator did not start: {why}")
