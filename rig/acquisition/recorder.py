"""The bounded queue between the lines and the run log, and the thread that empties it.

When the disk is slow the lines wait, and poll less often: readings are never dropped. What that costs is counted.
"""

from __future__ import annotations

import queue
import threading
import time
from typing import Any, Protocol

from rig.acquisition.channels import Channels
from rig.acquisition.stage import Stage
from rig.readings import Exchange

LENGTH = 4096  # exchanges
QUESTION_FIRST_S = 0.0003  # before it writes, so that the line has the processor until its next question is out
PATIENCE_S = 10.0  # real time that a line waits for the recorder before the run is given up


class RecorderError(Exception):
    """The run log cannot be written. The text says why; the run ends there."""


class Sink(Protocol):
    """Where a run is written: `rig.runlog.RunWriter`, or a list in a test."""

    def exchange(self, exchange: Exchange) -> None:
        """Write an exchange and its readings."""

    def event(self, kind: str, time_ns: int, **details: Any) -> None:
        """Write an event."""


class Recorder(threading.Thread):
    """Takes exchanges from the lines and writes them. `sink`: the run log; set before the thread starts."""

    def __init__(self, sink: Sink | None, stage: Stage, channels: Channels) -> None:
        super().__init__(name="recorder", daemon=True)
        self.sink, self.stage, self.channels = sink, stage, channels
        self.failure: Exception | None = None
        self.high_water = 0
        self.waits = 0  # times that a line found the queue full
        self.written = 0
        self._queue: queue.Queue[Exchange | tuple[str, int, dict[str, Any]] | None] = queue.Queue(LENGTH)

    def put(self, exchange: Exchange) -> None:
        """Hand over an exchange; waits when the queue is full.

        Once the log cannot be written the exchange is dropped: the run is over, `check` says so to whoever runs it,
        and the lines go on, so that the regulator can still be sent to zero.
        """
        self._put(exchange)

    def note(self, kind: str, time_ns: int, **details: Any) -> None:
        """Hand over an event, to be written in its place among the exchanges."""
        self._put((kind, time_ns, details))

    def run(self) -> None:
        """Write until `finish`."""
        while True:
            item = self._queue.get()
            if self._queue.empty():
                time.sleep(QUESTION_FIRST_S)
            try:
                if item is None:
                    return
                if self.failure is None:
                    self._write(item)
            except Exception as error:
                self.failure = error
            finally:
                self._queue.task_done()

    def finish(self) -> None:
        """Write what is in the queue and end the thread. Raises RecorderError when the log could not be written."""
        if self.is_alive():
            self._queue.put(None)
            self.join()
        if self.ident is not None:
            self.check()

    def check(self) -> None:
        """Raise `RecorderError` when writing has failed."""
        if self.failure is not None:
            raise RecorderError(f"the run log cannot be written: {self.failure}") from self.failure

    def _put(self, item: Exchange | tuple[str, int, dict[str, Any]]) -> None:
        if self.failure is not None:
            return
        self.high_water = max(self.high_water, self._queue.qsize() + 1)
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            self.waits += 1
            try:
                self._queue.put(item, timeout=PATIENCE_S)
            except queue.Full:
                self.failure = TimeoutError(f"the disk has taken nothing for {PATIENCE_S:g} s")

    def _write(self, item: Exchange | tuple[str, int, dict[str, Any]]) -> None:
        if self.sink is None:
            raise RuntimeError("the recorder was started without a run log")
        if not isinstance(item, Exchange):
            kind, time_ns, details = item
            self.stage.hear(kind, details)
            self.sink.event(kind, time_ns, **details)
            return
        exchange = self.stage(item)
        self.sink.exchange(exchange)
        self.written += 1
        self.channels.add(exchange.readings)
