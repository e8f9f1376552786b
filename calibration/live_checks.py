"""Checks of a sweep while it runs, in a process of their own, so that no instrument is ever read later for it.

The process reads the run's folder, as anyone may, and answers with what `diagnosis.live_check` found. It runs at
a lower priority and on one core. Plateaus that are taken while it is at work are looked at together, afterwards.
Whatever fails here becomes an event of the run, and nothing more.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from calibration.work.processes import begin_worker
from rig.recording import Recording

BEGINS_AT = 3  # settled plateaus: the process then has some plateaus' time to load, and a short run is spared of it
IN_A_ROW = 2  # checks that have to find a difference before the person is told
PATIENCE_S = 60.0  # real time that the end of a sweep waits for its last check; the regulator is at zero then
TELL_AFTER_S = 2.0  # of it, before the person is told what is waited for
NICE = 15
CHECK, FAILED, WARNING = "model check", "model check failed", "warning"  # events


class Taken(Protocol):
    """A plateau: `rig.plateaus.plateau.Plateau`."""

    @property
    def settled(self) -> bool:
        """Whether it had settled."""


Read = Callable[[Path], Recording]


class Beside:
    """A context manager around a sweep; its value is called with each plateau.

    `read`: from the folder to the recording so far; a function of a module, as it is called in the other process.
    """

    def __init__(
        self, folder: Path, read: Read, note: Callable[..., None], say: Callable[[str], None], seed: int = 0
    ) -> None:
        self.folder, self.read, self.note, self.say, self.seed = folder, read, note, say, seed
        self._settled = 0
        self._in_a_row = 0  # checks that have found a difference, up to the last one
        self._asked = False
        self._ending = False
        self._changed = threading.Condition()
        self._process: BaseProcess | None = None
        self._thread = threading.Thread(target=self._run, name="model check", daemon=True)

    def __enter__(self) -> Callable[[Taken], None]:
        return self.plateau

    def plateau(self, taken: Taken) -> None:
        """Have the sweep looked at, once there is something to see; returns at once.

        `taken`: the newest plateau; one that has not settled is no occasion.
        """
        self._settled += taken.settled
        if not taken.settled or self._settled < BEGINS_AT:
            return
        with self._changed:
            self._asked = True
            self._changed.notify()
        if self._thread.ident is None:
            with contextlib.suppress(RuntimeError):  # no more threads: then there is no check
                self._thread.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._ending = True
            self._changed.notify()
        if self._thread.ident is None:
            return
        if kind is None:
            self._thread.join(min(TELL_AFTER_S, PATIENCE_S))
            if self._thread.is_alive() and PATIENCE_S > TELL_AFTER_S:
                self.say(f"the last plateaus are held against the model: at most {PATIENCE_S:g} s")
                self._thread.join(PATIENCE_S - TELL_AFTER_S)
        if self._thread.is_alive():
            self._end_process()
            self._thread.join(1.0)

    def _run(self) -> None:
        """In a thread of its own: one check after another, until the sweep has ended and all was looked at."""
        try:
            with self._started() as pipe:
                while self._wait():
                    began_s = time.monotonic()
                    pipe.send(self.folder)
                    self._answered(pipe.recv(), time.monotonic() - began_s)
        except EOFError:
            why = "the run ended first" if self._ending else "its process has ended; there are no more checks"
            self.note(FAILED, error=why)
        except Exception as error:  # such as a process that could not be started
            self.note(FAILED, error=f"{type(error).__name__}: {error}; there are no more checks")

    @contextlib.contextmanager
    def _started(self) -> Iterator[Connection]:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self._process = context.Process(target=_look, args=(theirs, self.read, self.seed), daemon=True)
        try:
            self._process.start()
            theirs.close()  # or its end would never show as one
            yield ours
        finally:
            ours.close()
            self._end_process()

    def _end_process(self) -> None:
        process = self._process
        if process is not None and process.pid is not None:
            process.kill()
            process.join(1.0)

    def _wait(self) -> bool:
        """Whether there is something to look at; False once there never will be."""
        with self._changed:
            self._changed.wait_for(lambda: self._asked or self._ending)
            asked, self._asked = self._asked, False
            return asked

    def _answered(self, answer: dict[str, Any], seconds: float) -> None:
        if "error" in answer:
            self.note(FAILED, **answer)
            return
        self.note(CHECK, **answer, seconds=round(seconds, 3))
        if answer["p_value"] is None:
            return
        self._in_a_row = self._in_a_row + 1 if answer["differs"] else 0
        if self._in_a_row == IN_A_ROW:
            text = f"model check, {IN_A_ROW} times in a row: {answer['text']} Diagnose the run once it has ended."
            self.note(WARNING, text=text)
            self.say(text)


def _look(pipe: Connection, read: Read, seed: int) -> None:
    """The process: a folder comes in, what was found of it goes out."""
    begin_worker()  # Ctrl-C is for the sweep
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (1, 2):  # the terminal is the sweep's
        os.dup2(nothing, stream)
    with contextlib.suppress(OSError):
        os.nice(NICE)
    from calibration.diagnosis.live_check import check
    from calibration.report.diagnosis.words import place_in_words

    while True:
        try:
            folder = pipe.recv()
        except EOFError:
            return
        try:
            found = check(read(folder), seed)
            places = [
                asdict(place) | {"where": list(place.where), "same_as": list(place.same_as)} for place in found.places
            ]
            answer = {
                "plateaus": found.plateaus,
                "p_value": found.p_value,
                "extrapolated": found.extrapolated,
                "differs": found.differs,
                "places": places,
                "text": " ".join([found.sentence, *map(place_in_words, places[:1])]),
            }
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"[:2000]}
        pipe.send(answer)
