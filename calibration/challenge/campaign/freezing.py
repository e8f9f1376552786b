"""What a campaign is run with, written down before its first verdict: code, thresholds, versions."""

from __future__ import annotations

import importlib
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from calibration.work.sources import DIAGNOSIS, EVERYTHING, ROOT, code_sha256, diagnosis_sha256, imported

PACKAGES = ("spinbench", "numpy", "scipy", "numba", "emcee")
SCALARS = (int, float, str)


def frozen() -> dict[str, Any]:
    """Commit, hashes, thresholds and versions, as they are now."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "dirty": _dirty(),
        "code_sha256": code_sha256(),
        "diagnosis_sha256": diagnosis_sha256(),
        "thresholds": thresholds(),
        "versions": {name: _version(name) for name in PACKAGES} | {"python": platform.python_version()},
        "machine": f"{platform.system()} {platform.machine()}",
    }


def thresholds() -> dict[str, Any]:
    """Every number, word and plain tuple that the modules of calibration set which a verdict imports."""
    found: dict[str, Any] = {}
    for name in (one for one in imported(DIAGNOSIS) if one.startswith("calibration.")):
        module = importlib.import_module(name)
        for key, value in sorted(vars(module).items()):
            constant = isinstance(value, SCALARS) or (
                isinstance(value, tuple) and all(isinstance(one, SCALARS) for one in value)
            )
            if key.isupper() and not key.startswith("_") and constant:
                found[f"{name.removeprefix('calibration.')}.{key}"] = value
    return found


def _git(*arguments: str) -> str | None:
    """What git says; None outside a checkout, or where there is no git."""
    if not (ROOT / ".git").exists():
        return None
    try:
        command = ["git", "--no-optional-locks", "-C", str(ROOT), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _dirty() -> bool | None:
    status = _git("status", "--porcelain", "--", *EVERYTHING, "spinbench")
    return None if status is None else bool(status)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
