"""The project's own Python files, and which of them import which."""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

ROOT = Path(__file__).resolve().parents[1]
OURS = ("calibration", "configs", "model", "rig", "spinbench")
Node = TypeVar("Node", str, Path)
# An import statement; the parser of `ast` takes 30 times as long, which every start of a command would wait for.
IMPORT = re.compile(r"^ *(?:from +([\w.]+) +import +(\([^)]*\)|.+)|import +(.+))$", re.MULTILINE)


def is_ours(file: str) -> bool:
    """Whether a file lies in one of the project's packages."""
    path = Path(file)
    return path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in OURS


@functools.cache
def imports_of(path: Path) -> tuple[str, ...]:
    """Our own modules that a file imports by name, at its top or in a function, and the packages they lie in."""
    names = []
    for module, what, modules in IMPORT.findall(path.read_text(encoding="utf-8")):
        found = [one.split(" as ")[0].strip(" ()\n") for one in (what or modules).split(",")]
        names += [module, *(f"{module}.{name}" for name in found if name)] if module else found
    return ours_among(names)


def ours_among(names: list[str]) -> tuple[str, ...]:
    """Those of these modules that are ours, and the packages they lie in; sorted."""
    parts = [one.split(".") for one in names if one.split(".")[0] in OURS]
    packages = {".".join(one[:end]) for one in parts for end in range(1, len(one) + 1)}
    return tuple(sorted(one for one in packages if file_of(one).is_file()))


def file_of(name: str) -> Path:
    """Where a module of ours lies, or would."""
    path = ROOT.joinpath(*name.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def reached(roots: Iterable[Node], next_to: Callable[[Node], Iterable[Node]]) -> list[Node]:
    """What is reached from some, directly or not, themselves among it; sorted."""
    found: set[Node] = set()
    left = list(roots)
    while left:
        node = left.pop()
        if node not in found:
            found.add(node)
            left += next_to(node)
    return sorted(found)


@functools.cache
def made_of_sha256(file: str) -> str:
    """A hash of a file, and of ours that it imports, directly or not."""
    return sha256_of(reached([Path(file)], lambda path: map(file_of, imports_of(path))))


def sha256_of(paths: Iterable[Path]) -> str:
    """A hash of the names and contents of our files."""
    contents = [(path.relative_to(ROOT).as_posix(), hashlib.sha256(path.read_bytes()).hexdigest()) for path in paths]
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()
