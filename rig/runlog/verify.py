"""Whether a sealed run is as it was sealed, and the repair of one that was killed."""

from __future__ import annotations

import hashlib
import os
from collections import Counter, deque
from pathlib import Path

from rig.readings import NS
from rig.recording.files import alone_in
from rig.runlog import rows
from rig.runlog.folder import (
    APPENDED,
    END,
    HASHED,
    LOCK,
    PAGE,
    SAMPLES,
    START,
    WIRE,
    Lock,
    RunError,
    sha256_of,
    write_whole,
)
from rig.runlog.lines import whole_lines
from rig.runlog.reader import BEING_WRITTEN, KILLED, Run, read_end, read_run, read_start
from rig.runlog.schema import EndRecord, dump

REPAIRED = "killed; repaired"


def verify(folder: Path) -> list[str]:
    """What is not as it should be in a run, in words; empty when everything is.

    Hashes are held against the end record, counts against the rows, and the rows of each exchange against its line of
    the wire. Raises RunError when the folder holds no run.
    """
    folder = Path(folder)
    if not (folder / START).exists():
        read_start(folder)  # says what is missing
    findings = _strangers(folder)
    try:
        end = read_end(folder)
        findings += _changed(folder, end) if end is not None else []
        run = read_run(folder)
        counts, unfit = _counted(run)
    except RunError as error:
        return [*findings, *str(error).splitlines()]
    if run.state == BEING_WRITTEN:
        findings.append("no end record: a program writes this run now")
    elif run.state == KILLED:
        findings.append("no end record: the run was killed; `spinbench runs repair` seals what there is")
    findings += [f"{name}: its last line is torn, {dropped} bytes are left out" for name, dropped in run.torn.items()]
    findings += unfit
    if run.end is not None:
        findings += [
            f"the end record counts {said} {what}, the files hold {counts[what]}"
            for what, said in run.end.counts.items()
            if what in counts and counts[what] != said
        ]
    for name, source in run.start.sources.items():
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


def _changed(folder: Path, end: EndRecord) -> list[str]:
    """What the hashes tell."""
    findings = []
    for name in HASHED:
        path, said = folder / name, end.sha256.get(name)
        there = path.exists() or path.is_symlink()
        if said is not None and not there:
            findings.append(f"{name}: missing; the end record has its hash")
        elif said is None and there:
            findings.append(f"{name}: the end record has no hash of it")
        elif said is not None and sha256_of(path) != said:
            findings.append(f"{name}: changed since the run was sealed (its SHA-256 differs)")
    return findings


def _counted(run: Run) -> tuple[dict[str, int], list[str]]:
    """How many lines there are of each sort, and where the samples do not fit the wire."""
    samples = run.samples
    last = int(samples["exchange"].iloc[-1]) if len(samples) else 0
    counts = {"samples": len(samples), "events": len(run.events), "plateaus": len(run.plateau_rows)}
    if not run.has_wire:
        return counts, []
    findings = []
    held = Counter(samples["exchange"].tolist())
    number = 0
    for line in run.wire_lines():
        number = line.n
        if held[number] != line.readings:
            findings.append(
                f"{SAMPLES}: exchange {number} has {held[number]} rows; {WIRE} says {line.readings} readings"
            )
    if last > number:
        findings.append(f"{SAMPLES}: rows of exchange {last}, but {WIRE} ends with {number}")
    counts["exchanges"] = number
    if len(findings) > 20:
        findings = [*findings[:20], f"and {len(findings) - 20} more"]
    return counts, findings


def repair(folder: Path) -> list[str]:
    """Seal a killed run: drop what is torn at the end of each file, and an exchange whose rows are not all there.

    The end record keeps what was dropped. Nothing else changes. Returns what was done, in words. A run that has an end
    record is left as it is. Raises RunError when a program writes the run now, or when it is damaged beyond torn last
    lines; nothing is changed then.
    """
    folder = Path(folder)
    if read_run(folder).sealed:
        return ["the run has an end record; nothing to repair"]
    lock = Lock(folder)
    try:
        run = read_run(folder)
        if run.sealed:
            return ["the run has an end record; nothing to repair"]
        _counted(run)  # refuses what is damaged before anything is changed
        done, dropped = _drop(run)
        run = read_run(folder)
        counts, findings = _counted(run)
        last_ns = max(
            int(run.samples["reply_ns"].max()) if len(run.samples) else 0,
            round(run.events[-1].time_s * NS) if run.events else 0,
        )
        with alone_in(folder):  # a watchdog may be writing its line
            present = [name for name in HASHED if (folder / name).exists()]
            record = EndRecord(
                outcome="failed",
                reason=REPAIRED,
                utc_end=rows.utc_text(run.start.clock.utc_start_ns + last_ns),
                counts={"exchanges": int(run.samples["exchange"].iloc[-1]) if len(run.samples) else 0} | counts,
                sha256={name: sha256_of(folder / name) for name in present},
                vented=None,
                repair={"dropped": dropped, "findings": findings},
            )
            write_whole(folder / END, dump(record))
    finally:
        lock.release()
    return [*done, *findings, f"sealed as failed, reason '{REPAIRED}'"]


def _drop(run: Run) -> tuple[list[str], dict[str, dict[str, object]]]:
    """Cut off the torn last lines and an unfinished last exchange, and say what was in them.

    The rows go before their line of the wire: a repair that is killed in between can be done again.
    """
    done, dropped = [], {}
    unfinished, said = _unfinished(run)
    for name in APPENDED:
        torn = run.torn.get(name, 0)
        size = torn + unfinished.get(name, 0)
        if size:
            tail = _cut(run.folder / name, size)
            dropped[name] = {"bytes": size, "text": rows.harmless(tail.decode("utf-8", "backslashreplace"))}
        if torn:
            done.append(f"{name}: dropped a torn last line of {torn} bytes")
    return [*done, *said] or ["no line was torn"], dropped


def _unfinished(run: Run) -> tuple[dict[str, int], list[str]]:
    """The bytes of a last exchange whose rows are not all there, by file: it was never acknowledged."""
    last = deque(run.wire_lines() if run.has_wire else (), maxlen=1)
    held = len(run.readings_of(last[0].n)) if last else 0
    if not last or held >= last[0].readings:
        return {}, []
    sizes = {}
    for name, lines in ((SAMPLES, held), (WIRE, 1)):
        tail = deque((line for _, line in whole_lines(run.folder / name)), maxlen=lines)
        sizes[name] = sum(len(line) + 1 for line in tail)
    return sizes, [f"dropped exchange {last[0].n}: {held} of its {last[0].readings} rows had been written"]


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
