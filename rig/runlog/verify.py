"""Whether a sealed run is as it was sealed, and the repair of one that was killed."""

from __future__ import annotations

import hashlib
import itertools
import os
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path

from rig.readings import NS
from rig.recording.files import alone_in
from rig.runlog import plateaus, rows
from rig.runlog.folder import (
    APPENDED,
    END,
    EVENTS,
    HASHED,
    LOCK,
    PAGE,
    PLATEAUS,
    SAMPLES,
    START,
    WIRE,
    Lock,
    RunError,
    is_locked,
    sha256_of,
    write_whole,
)
from rig.runlog.lines import whole_lines
from rig.runlog.reader import KILLED, read_end, read_events, read_head, read_start, wire_lines
from rig.runlog.samples import blocks_of
from rig.runlog.schema import EndRecord, WireLine, dump

REPAIRED = "killed; repaired"
MOST_SHOWN = 20


def verify(folder: Path) -> list[str]:
    """What is not as it should be in a run, in words; empty when everything is.

    Hashes are held against the end record, counts against the rows, and the rows of each exchange against its line of
    the wire. Raises RunError when the folder holds no run, or one that is being written: its files do not agree yet.
    """
    folder = Path(folder)
    if not (folder / START).exists():
        read_start(folder)  # says what is missing
    if is_locked(folder) and not (folder / END).exists():
        raise RunError(f"{folder}: a program writes this run now; wait for its end, or stop it")
    findings = _strangers(folder)
    try:
        end = read_end(folder)
        findings += changed(folder, end) if end is not None else []
        run = _Look(folder)
    except RunError as error:
        return [*findings, *str(error).splitlines()]
    if run.head.state == KILLED:
        findings.append("no end record: the run was killed; `spinbench runs repair` seals what there is")
    torn = run.head.torn.items()
    findings += [f"{name}: its last line is torn, {dropped} bytes are left out" for name, dropped in torn]
    findings += run.findings
    if run.head.end is not None:
        findings += [
            f"the end record counts {said} {what}, the files hold {run.counts[what]}"
            for what, said in run.head.end.counts.items()
            if what in run.counts and run.counts[what] != said
        ]
    for name, source in run.head.start.sources.items():
        if _differs(source.text, source.sha256):
            findings.append(f"{START}: the text of the source {name} has another SHA-256 than it says")
    return findings


def _differs(text: str, sha256: str) -> bool:
    """Whether a kept file's text has another hash than was noted; of bytes that were no text that cannot be told."""
    return "\\x" not in text and hashlib.sha256(text.encode("utf-8")).hexdigest() != sha256


def _strangers(folder: Path) -> list[str]:
    """Files that no run holds."""
    known = {*HASHED, END, LOCK, PAGE}
    return [
        f"{entry.name}: this file is no part of a run"
        for entry in sorted(folder.iterdir() if folder.is_dir() else ())
        if entry.name not in known
    ]


def changed(folder: Path, end: EndRecord, names: Sequence[str] = HASHED) -> list[str]:
    """Which of a sealed run's files are not as the hashes of its end record say, in words."""
    findings = []
    for name in names:
        path, said = folder / name, end.sha256.get(name)
        there = path.exists() or path.is_symlink()
        if said is not None and not there:
            findings.append(f"{name}: missing; the end record has its hash")
        elif said is None and there:
            findings.append(f"{name}: the end record has no hash of it")
        elif said is not None and sha256_of(path) != said:
            findings.append(f"{name}: changed since the run was sealed (its SHA-256 differs)")
    return findings


class _Look:
    """A look at every line of a run, in memory that does not grow with its samples.

    `counts`: lines of each sort [-]; no exchanges where the bytes on the wire were not kept.
    `findings`: where the samples do not fit the wire.
    `exchange`: the last one of the samples [-].
    `wire_end`: the last exchange of the wire, the rows that it has, and the readings that the wire says [-].
    `last_ns`: the last reply, or the last event where that is later [ns].
    Raises RunError as `read_run` does, or for a line of the wire.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.head = read_head(folder)
        self.counts = {"samples": 0, "events": 0, "plateaus": 0}
        self.exchange = self.last_ns = 0
        self.wire_end = (0, 0, 0)
        self._damage: RunError | None = None
        misfits = self._misfits((folder / WIRE).exists())
        self.findings = list(itertools.islice(misfits, MOST_SHOWN))
        if more := sum(1 for _ in misfits):
            self.findings.append(f"and {more} more")

    def _misfits(self, has_wire: bool) -> Iterator[str]:
        """Where the samples do not fit the wire. Damage of the wire is told after that of any other file."""
        held = ((number, sum(1 for _ in rows)) for number, rows in itertools.groupby(self._exchanges()))
        following = next(held, None)
        for line in self._wire() if has_wire else ():
            rows = 0
            if following is not None and following[0] == line.n:
                rows, following = following[1], next(held, None)
            if rows != line.readings:
                yield f"{SAMPLES}: exchange {line.n} has {rows} rows; {WIRE} says {line.readings} readings"
            self.wire_end = (line.n, rows, line.readings)
        deque(held, maxlen=0)  # what is beyond the wire is looked at too
        self._look_at_the_rest()
        if self._damage is not None:
            raise self._damage
        if has_wire:
            self.counts["exchanges"] = self.wire_end[0]
            if self.exchange > self.wire_end[0]:
                yield f"{SAMPLES}: rows of exchange {self.exchange}, but {WIRE} ends with {self.wire_end[0]}"

    def _exchanges(self) -> Iterator[int]:
        """The exchange of each row of the samples."""
        for block in blocks_of(self.folder / SAMPLES):
            if exchanges := block["exchange"].tolist():
                self.counts["samples"] += len(exchanges)
                self.exchange = exchanges[-1]
                self.last_ns = max(self.last_ns, int(block["reply_ns"].max()))
                yield from exchanges

    def _wire(self) -> Iterator[WireLine]:
        """The lines of the wire up to a damaged one."""
        try:
            yield from wire_lines(self.folder / WIRE)
        except RunError as damage:
            self._damage = damage

    def _look_at_the_rest(self) -> None:
        event_s = 0.0
        for event in read_events(self.folder / EVENTS):
            self.counts["events"] += 1
            event_s = event.time_s
        self.last_ns = max(self.last_ns, round(event_s * NS))
        self.counts["plateaus"] = len(plateaus.read(self.folder / PLATEAUS))


def repair(folder: Path) -> list[str]:
    """Seal a killed run: drop what is torn at the end of each file, and an exchange whose rows are not all there.

    The end record keeps what was dropped. Nothing else changes. Returns what was done, in words. A run that has an end
    record is left as it is. Raises RunError when a program writes the run now, or when it is damaged beyond torn last
    lines; nothing is changed then.
    """
    folder = Path(folder)
    if read_head(folder).end is not None:
        _Look(folder)  # refuses what is damaged
        return ["the run has an end record; nothing to repair"]
    lock = Lock(folder)
    try:
        run = _Look(folder)  # refuses what is damaged before anything is changed
        if run.head.end is not None:
            return ["the run has an end record; nothing to repair"]
        done, dropped = _drop(run)
        run = _Look(folder)
        with alone_in(folder):  # a watchdog may be writing its line
            present = [name for name in HASHED if (folder / name).exists()]
            record = EndRecord(
                outcome="failed",
                reason=REPAIRED,
                utc_end=rows.utc_text(run.head.start.clock.utc_start_ns + run.last_ns),
                counts={"exchanges": run.exchange} | run.counts,
                sha256={name: sha256_of(folder / name) for name in present},
                vented=None,
                repair={"dropped": dropped, "findings": run.findings},
            )
            write_whole(folder / END, dump(record))
    finally:
        lock.release()
    return [*done, *run.findings, f"sealed as failed, reason '{REPAIRED}'"]


def _drop(run: _Look) -> tuple[list[str], dict[str, dict[str, object]]]:
    """Cut off the torn last lines and an unfinished last exchange, and say what was in them.

    The rows go before their line of the wire: a repair that is killed in between can be done again.
    """
    done, dropped = [], {}
    unfinished, said = _unfinished(run)
    for name in APPENDED:
        torn = run.head.torn.get(name, 0)
        size = torn + unfinished.get(name, 0)
        if size:
            tail = _cut(run.folder / name, size)
            dropped[name] = {"bytes": size, "text": rows.harmless(tail.decode("utf-8", "backslashreplace"))}
        if torn:
            done.append(f"{name}: dropped a torn last line of {torn} bytes")
    return [*done, *said] or ["no line was torn"], dropped


def _unfinished(run: _Look) -> tuple[dict[str, int], list[str]]:
    """The bytes of a last exchange whose rows are not all there, by file: it was never acknowledged."""
    number, held, said = run.wire_end
    if held >= said:
        return {}, []
    sizes = {}
    for name, lines in ((SAMPLES, held), (WIRE, 1)):
        tail = deque((line for _, line in whole_lines(run.folder / name)), maxlen=lines)
        sizes[name] = sum(len(line) + 1 for line in tail)
    return sizes, [f"dropped exchange {number}: {held} of its {said} rows had been written"]


def _cut(path: Path, torn: int) -> bytes:
    """Take the last `torn` bytes off a file; returned is how they begin."""
    handle = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        size = os.fstat(handle).st_size - torn
        tail = os.pread(handle, min(torn, 2000), size)
        os.ftruncate(handle, size)
        os.fsync(handle)
    except OSError as error:
        raise RunError(f"{path}: cannot be mended ({error.strerror}); check the place and its permissions") from None
    finally:
        os.close(handle)
    return tail
