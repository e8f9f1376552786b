"""Writing results: each beside its place first and then renamed, so that nothing is ever there by half."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

# A lock may be unknown to other machines that share the folder: a leftover is for the machine that it names.
_HIDDEN = f".spinbench-{re.sub('[^A-Za-z0-9]', '_', platform.node())}"
# Endings of files: a folder of such a name was not meant.
OF_FILES = (
    ".csv", ".tsv", ".txt", ".json", ".toml", ".zip", ".xls", ".xlsx", ".mat",
    ".mdf", ".dat", ".nc", ".html", ".png",
)  # fmt: skip


def check_places(folder: Path | None, file: Path | None = None) -> None:
    """Whether results could be written, before the work that they come of.

    Raises OSError when something else is there, or nothing can be made there.
    """
    if file is not None:
        _refuse_folder(file)
    for place in (folder, None if file is None else file.parent):
        if place is None:
            continue
        there = place.absolute()
        while not there.exists() and there != there.parent:
            there = there.parent
        code = errno.ENOTDIR if not there.is_dir() else 0 if os.access(there, os.W_OK | os.X_OK) else errno.EACCES
        if code:
            raise OSError(code, os.strerror(code), str(there))
        if file is None or place is folder or not file.exists():  # a pipe, too, is a file that is there
            _try(there)


def _refuse_folder(file: Path) -> None:
    if file.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))


def _try(folder: Path) -> None:
    """Make something in a folder, and take it away: whether that goes, nothing else tells for sure."""
    try:
        Path(tempfile.mkdtemp(prefix=f"{_HIDDEN}-", dir=folder)).rmdir()
    except OSError as error:
        why = f"cannot be written ({error.strerror}); check the place and the space"
        raise OSError(error.errno, why, str(folder)) from None


def write_files(folder: Path, files: Mapping[str, bytes], hidden_in: Path | None = None) -> None:
    """Write files into a folder, which is made if it is missing.

    All are written out in full before the first gets its name. What is there and is no plain file, as /dev/null or a
    pipe, is written into and stays what it is.

    `hidden_in`: where they are until they are whole, if not in the folder itself.
    Raises OSError when the folder or a file cannot be written, with its name; what was there before is still there.
    """
    with contextlib.ExitStack() as stack:
        if not folder.exists():
            folder.mkdir(parents=True)
            stack.callback(_remove_if_empty, folder)
        hidden = stack.enter_context(beside(hidden_in or folder))
        written = [(_write_into(hidden, folder / name, content), folder / name) for name, content in files.items()]
        for _, place in written:
            _refuse_folder(place)
        for temporary, place in written:
            if place.exists() and not place.is_file():
                place.write_bytes(files[place.name])
            else:
                temporary.replace(place)
    sync_folder(folder)


@contextlib.contextmanager
def beside(folder: Path) -> Iterator[Path]:
    """A hidden folder in `folder`, for what is moved to its place once it is whole; removed at the end.

    It is locked as long as its writer lives. What a killed writer left is removed by the next one of the same folder,
    where the file system has locks. Raises OSError when it cannot be made.
    """
    _remove_leftovers(folder)
    hidden, handle = _locked_folder(folder)
    try:
        yield hidden
    finally:
        shutil.rmtree(hidden, ignore_errors=True)
        if handle is not None:
            os.close(handle)


def write_file(path: Path, content: bytes, hidden_in: Path | None = None) -> None:
    """Write one file, as `write_files` does. Raises OSError when it cannot be written."""
    write_files(path.parent, {path.name: content}, hidden_in)


def json_bytes(data: Any) -> bytes:
    """Data as an indented JSON file, never with a NaN in it.

    Raises ValueError for a number that JSON has no word for.
    """
    return json.dumps(data, indent=1, allow_nan=False).encode() + b"\n"


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes that ask for the same out of a folder; where the file system has no locks, nothing is kept.

    Raises OSError when the folder cannot be opened.
    """
    if os.name != "posix":
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def sync_folder(folder: Path) -> None:
    """Put the folder's entries on the disk."""
    if os.name != "posix":
        return  # a folder has no handle there
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove_if_empty(folder: Path) -> None:
    with contextlib.suppress(OSError):
        folder.rmdir()


def _write_into(hidden: Path, place: Path, content: bytes) -> Path:
    """A file with the content, on the disk, that is yet to be moved to its place."""
    temporary = hidden / f"{place.name}.part"  # under its own name it would make the hidden folder look like a run
    try:
        with temporary.open("xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(place)) from None  # a full disk names no file
    return temporary


def _locked_folder(folder: Path) -> tuple[Path, int | None]:
    """A new hidden folder, and the handle that keeps it locked; no handle where there are no locks."""
    while True:
        try:
            hidden = Path(tempfile.mkdtemp(prefix=f"{_HIDDEN}-", dir=folder))
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(folder)) from None
        if os.name != "posix":
            return hidden, None
        handle = None
        with contextlib.suppress(FileNotFoundError):  # another writer took it for a leftover before it was locked
            handle = _opened(hidden)
            is_locked = _lock(handle)
            if is_locked is None or (is_locked and hidden.exists()):
                return hidden, handle
        if handle is not None:
            os.close(handle)


def _remove_leftovers(folder: Path) -> None:
    """Remove what killed writers of this machine left in a folder: what nobody holds locked."""
    if os.name != "posix":
        return
    there: list[Path] = []
    with contextlib.suppress(PermissionError):  # a folder that one may write into and not look into
        there = [path for path in folder.iterdir() if path.name.rpartition("-")[0] == _HIDDEN]
    for path in there:
        with contextlib.suppress(OSError):  # gone meanwhile, or another user's
            handle = _opened(path)
            try:
                if _lock(handle):
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(handle)


def _opened(folder: Path) -> int:
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)


def _lock(handle: int) -> bool | None:
    """Whether the lock is ours now, without waiting; None where the file system has no locks."""
    import fcntl

    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True
