"""Which code a result came from: hashes of the sources, as this process found them."""

from __future__ import annotations

import functools
from pathlib import Path

from configs.sources import ROOT, file_of, imports_of, ours_among, reached, sha256_of

EVERYTHING = ("calibration", "model", "configs", "rig/recording")
DIAGNOSIS = "calibration.diagnosis"
# What imports the modules of a package by looking into it, and the package.
FOUND_BY_LOOKING = {
    "calibration.systems.machines.system": "calibration.systems.machines",
    "model.effects.library": "model.effects.definitions",
}
SCORER = ("calibration/challenge/", "rig/recording/")


@functools.cache
def code_sha256() -> str:
    """Of all sources of calibration, model, configs and rig.recording."""
    return sha256_of(_sources())


def diagnosis_sha256() -> str:
    """Of the modules that a verdict imports, and of the configs."""
    return imported_sha256(DIAGNOSIS)


@functools.cache
def imported_sha256(*roots: str) -> str:
    """Of these modules, of our own ones that they import, directly or not, and of the configs."""
    configs = [path for path in _sources() if path.suffix == ".toml"]
    return sha256_of(sorted([*configs, *(file_of(name) for name in imported(*roots))]))


@functools.cache
def scorer_sha256() -> str:
    """Of those that make and score a challenge."""
    return sha256_of([path for path in _sources() if path.relative_to(ROOT).as_posix().startswith(SCORER)])


@functools.cache
def imported(*roots: str) -> tuple[str, ...]:
    """Names of our own modules that these import, directly or not, themselves among them; sorted."""
    return tuple(reached(roots, _imported_by))


def _imported_by(name: str) -> tuple[str, ...]:
    """Our own modules that a module imports by name, at its top or in a function, and the packages they lie in."""
    found = imports_of(file_of(name))
    if name in FOUND_BY_LOOKING:
        folder = file_of(FOUND_BY_LOOKING[name]).parent
        below = [path.relative_to(ROOT).with_suffix("").parts for path in folder.rglob("*.py")]
        found += ours_among([".".join(parts) for parts in below if parts[-1] != "__init__"])
    return found


def _sources() -> list[Path]:
    found = [path for room in EVERYTHING for path in (ROOT / room).rglob("*") if path.suffix in (".py", ".toml")]
    return sorted(path for path in found if "__pycache__" not in path.parts)
