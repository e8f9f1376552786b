"""Which files of a recording may be opened: plain files inside the folder, reached without any symbolic link."""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from rig.recording.mistakes import shown


class RefusedError(Exception):
    """A file may not be opened. The text says why and what to do."""


def inside(folder: Path, name: str) -> Path:
    """Where a file named in recording.toml stands: inside the folder, every part of it checked.

    Raises RefusedError when the name leads outside, through a symbolic link, or to something that is no plain file.
    """
    path = folder
    for part in parts(name):
        path = path / part
        if path.is_symlink():
            raise RefusedError(f"'{shown(name)}' leads through a symbolic link; put the file itself into the folder")
    check_plain(path, shown(name))
    return path


def parts(name: str) -> tuple[str, ...]:
    """The parts of a file's name, if it cannot lead outside the folder; RefusedError otherwise."""
    path = PurePosixPath(name)
    if "\\" in name or ":" in name or not name.isprintable():
        raise RefusedError(f"'{shown(name)}' holds a backslash, a colon or a control character; use plain names and /")
    if path.is_absolute() or ".." in path.parts:
        raise RefusedError(f"'{shown(name)}' points outside the folder; put the file into it and give its name alone")
    if not path.parts:
        raise RefusedError(f"'{shown(name)}' names no file")
    return path.parts


def check_plain(path: Path, name: str) -> None:
    """Refuse what is missing, a link, a folder, a pipe or a device."""
    try:
        mode = path.lstat().st_mode
    except OSError as error:
        beside = sorted(entry.name for entry in path.parent.glob("*.csv"))[:10] if path.parent.is_dir() else []
        there = f" (CSV files there: {', '.join(shown(entry) for entry in beside)})" if beside else ""
        raise RefusedError(f"'{name}' cannot be read: {error.strerror}; check the name{there}") from None
    if stat.S_ISLNK(mode):
        raise RefusedError(f"'{name}' is a symbolic link, which is refused; put the file itself there")
    if not stat.S_ISREG(mode):
        raise RefusedError(f"'{name}' is not a plain file")


def open_plain(path: Path) -> BinaryIO:
    """Open a checked file for reading; a link put there since is not followed. RefusedError when it cannot be read."""
    try:
        return os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)), "rb")
    except OSError as error:
        raise RefusedError(f"'{shown(path.name)}' cannot be read: {error.strerror}") from None
