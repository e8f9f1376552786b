"""The files of a run, the name that its folder gets, and the lock that says a program writes it now."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import stat
import time
from pathlib import Path
from typing import BinaryIO

from rig.recording.files import write_file

START, SAMPLES, EVENTS = "start.json", "samples.csv", "events.jsonl"
WIRE, PLATEAUS, END, LOCK = "wire.jsonl", "plateaus.csv", "end.json", ".lock"
APPENDED = (SAMPLES, EVENTS, WIRE, PLATEAUS)
WATCHDOG = "watchdog.jsonl"  # what the watchdog did, by itself; not there in every run
PAGE = "report.html"  # of a run that has ended, by whoever took it; no part of what is sealed
HASHED = (START, *APPENDED, WATCHDOG)
MAX_RECORD_BYTES = 32_000_000  # of start.json and end.json
MAX_FILE_BYTES = 4_000_000_000
MAX_SAME_NAME = 1000
A_FILE = "a file, where the folder of runs is to be; name another with --logs"
_WORD = re.compile(r"[^A-Za-z0-9.-]+")


class RunError(ValueError):
    """A run cannot be written, read, exported or imported. The text names the file, the line and what to do."""


class EmptyRunError(RunError):
    """A run holds nothing that a recording could."""


def run_name(utc_ns: int, bench: str, kind: str) -> str:
    """The folder's name, ``YYYYMMDD-HHMMSS_<bench>_<kind>``, UTC.

    `bench`: the bench's name; what a file name should not hold becomes a dash.
    """
    when = time.strftime("%Y%m%d-%H%M%S", time.gmtime(utc_ns // 1_000_000_000))
    plain = _WORD.sub("-", bench).strip("-.")[:60] or "bench"
    return f"{when}_{plain}_{kind}"


def make_folder(root: Path, name: str) -> Path:
    """Make a run's folder; ``-2``, ``-3`` is added when the name is taken. Making it is what decides between programs.

    `root`: where runs are kept; made when it is missing.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
        for number in range(1, MAX_SAME_NAME):
            folder = root / (name if number == 1 else f"{name}-{number}")
            with contextlib.suppress(FileExistsError):
                folder.mkdir()
                return folder
    except (FileExistsError, NotADirectoryError):
        raise RunError(f"{root}: {A_FILE}") from None
    except OSError as error:
        raise RunError(f"{root}: the run's folder cannot be made ({error.strerror}); check the place") from None
    raise RunError(f"{root}: {MAX_SAME_NAME} runs are called {name}; move them away")


class Lock:
    """An exclusive lock on a run, gone with the process that holds it; the file names that process."""

    def __init__(self, folder: Path) -> None:
        path = folder / LOCK
        try:
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise RunError(f"{path}: cannot be opened ({error.strerror})") from None
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._handle)
            raise RunError(f"{folder}: another program writes this run; wait for its end, or stop it") from None
        os.ftruncate(self._handle, 0)
        os.write(self._handle, f"{os.getpid()}\n".encode())

    def release(self) -> None:
        """Let go of the run; nothing happens when that was done before."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def is_locked(folder: Path) -> bool:
    """Whether a program writes this run now."""
    try:
        handle = os.open(folder / LOCK, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def writer_of(folder: Path) -> int | None:
    """The process that writes a run now; None when nobody does, or the lock does not name it."""
    if not is_locked(folder):
        return None
    with contextlib.suppress(OSError, ValueError, RunError):
        return int(read_bytes(folder / LOCK, 32))
    return None


def write_whole(path: Path, data: bytes, hidden_in: Path | None = None) -> None:
    """Write a small file so that it is there whole or not at all, on the disk when this returns.

    `path`: the file; it must not exist.
    `hidden_in`: where it is until it is whole, if not in its own folder.
    """
    if os.path.lexists(path):
        raise RunError(f"{path}: exists already; nothing is overwritten")
    try:
        write_file(path, data, hidden_in)
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror}); check the place and the space") from None


def read_bytes(path: Path, limit: int) -> bytes:
    """The content of a plain file of a run; a link, a pipe or a file above `limit` bytes is refused."""
    with open_plain(path, limit) as stream:
        return stream.read()


def open_plain(path: Path, limit: int) -> BinaryIO:
    """Open a plain file of a run for reading.

    Raises RunError when it is missing, a link, no plain file, or too large.
    """
    try:
        # Not blocking, so that a pipe put there in its place is refused and does not hang the reader.
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        is_link = error.errno == errno.ELOOP
        why = (
            "a symbolic link, which is refused; give the file itself"
            if is_link
            else f"cannot be read ({error.strerror})"
        )
        raise RunError(f"{path}: {why}") from None
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode) or status.st_size > limit:
        os.close(handle)
        if stat.S_ISREG(status.st_mode):
            raise RunError(f"{path}: larger than {limit} bytes")
        what = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe or a device"
        raise RunError(f"{path}: is not a plain file, but {what}; give a file")
    return os.fdopen(handle, "rb")


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    digest = hashlib.sha256()
    with open_plain(path, MAX_FILE_BYTES) as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
