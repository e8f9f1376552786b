"""The program that takes the data: every row is in the file before it is acknowledged, and nothing is written twice.

A row handed to the system survives the program, killed or not; once a second it is put on the disk, where it survives a
power cut. A half-written row is taken back when the disk is full, so that the files hold whole lines as long as the
program lives.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from rig.readings import NS, Exchange
from rig.recording.files import alone_in, sync_folder
from rig.runlog import plateaus, rows
from rig.runlog.folder import (
    APPENDED,
    END,
    EVENTS,
    HASHED,
    PLATEAUS,
    SAMPLES,
    START,
    WIRE,
    Lock,
    RunError,
    make_folder,
    run_name,
    sha256_of,
    write_whole,
)
from rig.runlog.schema import AmbientRecord, EndRecord, Outcome, StartRecord, dump

SYNC_S = 1.0
GONE = "was deleted or moved while it was written; what was measured is lost with it, and the run ends here"


class RunWriter:
    """One run, open for writing. `create` makes it; `end` seals it; without `end` the run counts as killed.

    Its methods may be called from several threads.
    """

    def __init__(self, folder: Path, start: StartRecord, wire: bool, sync_s: float) -> None:
        self.folder = folder
        self.start = start
        self.wire = wire
        self.counts = {"exchanges": 0, "samples": 0, "events": 0, "plateaus": 0}
        self._utc_start_ns, self._begun_ns = start.clock.utc_start_ns, time.monotonic_ns()
        self._guard = threading.Lock()
        self._lock = Lock(folder)
        self._files: dict[str, int] = {}
        self._sizes: dict[str, int] = {}
        self._unsynced: set[str] = set()
        self._failure: str = ""
        self._closing = threading.Event()
        self._syncer = threading.Thread(target=self._sync_often, args=(sync_s,), name="run log", daemon=True)

    @classmethod
    def create(cls, root: Path, start: StartRecord, wire: bool = True, sync_s: float = SYNC_S) -> RunWriter:
        """Make a run's folder, its start record last.

        `start`: what is known at the start; it names the folder.
        `wire`: whether the bytes on the wire are kept; without them the run cannot be replayed.
        `sync_s`: how often what was written is put on the disk [s].
        Raises RunError when the folder cannot be made.
        """
        try:
            begun_ns = rows.utc_ns(start.utc_start)
        except ValueError:
            raise RunError(f"utc_start '{start.utc_start}' is no time in ISO 8601") from None
        folder = make_folder(Path(root), run_name(begun_ns, start.bench, start.kind))
        writer = cls(folder, start, wire, sync_s)
        try:
            writer._open(SAMPLES, rows.HEADER)
            writer._open(EVENTS, b"")
            if wire:
                writer._open(WIRE, b"")
            # Hidden where the next run is made: nothing is ever written again into a run that never began.
            write_whole(folder / START, dump(start), folder.parent)
            sync_folder(folder.parent)
        except BaseException:
            writer.close()
            raise
        writer._syncer.start()
        return writer

    @property
    def name(self) -> str:
        """The run's name: that of its folder."""
        return self.folder.name

    def exchange(self, exchange: Exchange) -> None:
        """Write an exchange: its line of the wire, then a row for each reading. They are in the file on return.

        Raises RunError when it could not be written; the files then end before it.
        """
        with self._guard:
            self._check()
            number = self.counts["exchanges"] + 1
            lines = [
                rows.sample_line(n, number, reading, self._utc_start_ns)
                for n, reading in enumerate(exchange.readings, start=self.counts["samples"] + 1)
            ]
            before = self._sizes.get(WIRE, 0)
            if self.wire:
                self._append(WIRE, rows.wire_line(number, exchange))
            try:
                self._append(SAMPLES, b"".join(lines))
            except RunError:
                if self.wire:
                    self._sizes[WIRE] = before
                    self._take_back(WIRE)
                raise
            self.counts["exchanges"] = number
            self.counts["samples"] += len(lines)

    def event(self, kind: str, time_ns: int, **details: Any) -> None:
        """Write an event.

        `kind`: what happened; docs/runs.md lists those that an export looks for.
        `**details`: what else is to be said, as far as JSON can hold it.
        Raises RunError when it could not be written.
        """
        with self._guard:
            self._check()
            self._append(EVENTS, rows.event_line(self.counts["events"] + 1, kind, time_ns, self._utc_start_ns, details))
            self.counts["events"] += 1

    def plateau(self, row: Mapping[str, Any]) -> None:
        """Write a plateau.

        `row`: columns of plateaus.csv, see `rig.runlog.plateaus.line`. A number that stood before replaces that
            plateau.
        Raises RunError when it could not be written, or is no plateau.
        """
        line = plateaus.line(row)
        with self._guard:
            self._check()
            if PLATEAUS not in self._files:
                self._open(PLATEAUS, plateaus.HEADER)
                sync_folder(self.folder)
            self._append(PLATEAUS, line)
            self.counts["plateaus"] += 1

    def end(
        self,
        outcome: Outcome,
        reason: str = "",
        ambient_end: AmbientRecord | None = None,
        statistics: Mapping[str, Any] | None = None,
        vented: bool | None = None,
        stopped_by: Literal["operator", "interlock"] | None = None,
    ) -> EndRecord:
        """Seal the run: everything on the disk, every file hashed, the end record last, the lock released.

        Raises RunError when the record could not be written; the run is readable, and counts as killed.
        """
        with self._guard:
            if self._closing.is_set():
                raise RunError(f"{self.folder}: the run is closed already")
            self._closing.set()
        if self._syncer.is_alive():  # what it puts on the disk may fail yet
            self._syncer.join()
        self._refuse_if_gone()
        with self._guard, alone_in(self.folder):  # a watchdog may be writing its line
            self._sync()
            if self._failure and self._failure not in reason:
                reason = f"{reason}; {self._failure}".removeprefix("; ")
                outcome = "failed"
            files = [name for name in HASHED if name in (START, *self._files) or (self.folder / name).is_file()]
            record = EndRecord(
                outcome=outcome,
                reason=rows.clean(reason)[:4000],
                utc_end=rows.utc_text(time.time_ns()),
                counts=dict(self.counts),
                sha256={name: sha256_of(self.folder / name) for name in files},
                ambient_end=ambient_end,
                statistics=rows.plain(statistics or {}),
                vented=vented,
                stopped_by=stopped_by if outcome == "aborted" else None,
                wall_s=(time.monotonic_ns() - self._begun_ns) / NS,
            )
            try:
                write_whole(self.folder / END, dump(record))
            finally:
                self._close_files()
        return record

    def close(self) -> None:
        """Let go of the files without an end record, as a killed program does."""
        with self._guard:
            self._close_files()

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, name: str, header: bytes) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            self._files[name] = os.open(self.folder / name, flags, 0o644)
        except OSError as error:
            raise RunError(f"{self.folder / name}: cannot be made ({error.strerror})") from None
        self._sizes[name] = 0
        if header:
            self._append(name, header)

    def _check(self) -> None:
        if self._closing.is_set():
            raise RunError(f"{self.folder}: the run is closed; nothing more can be written to it")
        if self._failure:
            raise RunError(self._failure)

    def _append(self, name: str, data: bytes) -> None:
        """All of the data, or none of it."""
        handle, left = self._files[name], memoryview(data)
        try:
            while left:  # nothing at all for an exchange without readings
                left = left[os.write(handle, left) :]
        except OSError as error:
            self._failure = f"{self.folder / name}: cannot be written ({error.strerror}); the run ends here"
            self._take_back(name)
            raise RunError(self._failure) from None
        self._sizes[name] += len(data)
        self._unsynced.add(name)

    def _refuse_if_gone(self) -> None:
        if not self.folder.is_dir():
            self.close()
            raise RunError(f"{self.folder}: {GONE}")

    def _take_back(self, name: str) -> None:
        """Cut off a line that was written in part; where even that fails, a reader leaves the torn line out."""
        try:
            os.ftruncate(self._files[name], self._sizes[name])
        except OSError as error:
            self._failure += f"; its last line is torn ({error.strerror})"

    def _sync(self) -> None:
        for name, handle in self._files.items():
            try:
                os.fsync(handle)
            except OSError as error:
                self._failure = f"{self.folder / name}: the disk does not keep it ({error.strerror})"

    def _sync_often(self, sync_s: float) -> None:
        """In a thread of its own, so that a slow disk holds no row up."""
        while not self._closing.wait(sync_s):
            with self._guard:
                waiting = {name: os.dup(self._files[name]) for name in self._unsynced if name in self._files}
                self._unsynced.clear()
            for name, handle in waiting.items():
                try:
                    os.fsync(handle)
                    if os.fstat(handle).st_nlink == 0:
                        self._failure = f"{self.folder / name}: {GONE}"
                except OSError as error:
                    self._failure = f"{self.folder / name}: the disk does not keep it ({error.strerror})"
                finally:
                    os.close(handle)

    def _close_files(self) -> None:
        self._closing.set()
        for name in APPENDED:
            if name in self._files:
                os.close(self._files.pop(name))
        self._lock.release()
