"""Which code a result came from: hashes of the sources, as this process found them."""

from __future__ import annotations

import functools
import hashlib
import json
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EVERYTHING = ("calibration", "model", "configs", "rig/recording")
CHALLENGE = "calibration/challenge/"
NOT_THE_VERDICT = (CHALLENGE, "calibration/report/")  # what no fit and no verdict hangs on
SCORER = (CHALLENGE, "rig/recording/")


@functools.cache
def code_sha256() -> str:
    """Of all sources of calibration, model, configs and rig.recording."""
    return _hash(_sources())


@functools.cache
def diagnosis_sha256() -> str:
    """Of those that a fit or a verdict hangs on: neither the challenge nor the reports."""
    return _hash([path for path in _sources() if not path.relative_to(ROOT).as_posix().startswith(NOT_THE_VERDICT)])


@functools.cache
def scorer_sha256() -> str:
    """Of those that make and score a challenge."""
    return _hash([path for path in _sources() if path.relative_to(ROOT).as_posix().startswith(SCORER)])


def _sources() -> list[Path]:
    found = [path for room in EVERYTHING for path in (ROOT / room).rglob("*") if path.suffix in (".py", ".toml")]
    return sorted(path for path in found if "__pycache__" not in path.parts)


def _hash(paths: list[Path]) -> str:
    contents = [(path.relative_to(ROOT).as_posix(), hashlib.sha256(path.read_bytes()).hexdigest()) for path in paths]
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()
