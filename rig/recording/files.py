"""Writing results: each file beside its place first and then renamed, so that nothing is ever there by half."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any


def check_places(folder: Path | None, file: Path | None = None) -> None:
    """Whether results could be written, before the work that they come of.

    Raises OSError when something else is there, or the place is not open to this user.
    """
    if file is not None and file.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    for place in (folder, None if file is None else file.parent):
        if place is None:
            continue
        there = place.absolute()
        while not there.exists() and there != there.parent:
            there = there.parent
        code = errno.ENOTDIR if not there.is_dir() else 0 if os.access(there, os.W_OK | os.X_OK) else errno.EACCES
        if code:
            raise OSError(code, os.strerror(code), str(there))


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, which is made if it is missing.

    All are written out in full before the first gets its name. What is there and is no plain file, as /dev/null or a
    pipe, is written into and stays what it is. Raises OSError when the folder or a file cannot be written, with its
    name; what was there before is still there.
    """
    with contextlib.ExitStack() as stack:
        if not folder.exists():
            folder.mkdir(parents=True)
            stack.callback(_remove_if_empty, folder)
        beside = [(_write_beside(folder / name, content, stack), folder / name) for name, content in files.items()]
        for _, place in beside:
            check_places(None, place)
        for temporary, place in beside:
            if place.exists() and not place.is_file():
                place.write_bytes(files[place.name])
            else:
                temporary.replace(place)
    sync_folder(folder)


def write_file(path: Path, content: bytes) -> None:
    """Write one file, as `write_files` does. Raises OSError when it cannot be written."""
    write_files(path.parent, {path.name: content})


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


def _write_beside(place: Path, content: bytes, stack: contextlib.ExitStack) -> Path:
    """A temporary file with the content, removed by the stack unless it has been renamed by then."""
    handle, name = tempfile.mkstemp(prefix=".spinbench-", dir=place.parent)
    temporary = Path(name)
    stack.callback(temporary.unlink, missing_ok=True)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(place)) from None  # a full disk names no file
    umask = os.umask(0)
    os.umask(umask)
    temporary.chmod(0o666 & ~umask)
    return temporary
