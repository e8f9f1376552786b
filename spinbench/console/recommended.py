"""The tests that a run's diagnoses recommend, as their documents in its folder of reports hold them."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

from rig.bench.bench import Bench
from spinbench.console.access import REPORTS, RefusedError, is_plain
from spinbench.console.planned import of_command

DIAGNOSIS = "diagnosis.json"
FORMAT = "diagnosis/1"
MOST_BYTES, MOST_TESTS, MOST_DIAGNOSES, MOST_TEXT = 5_000_000, 10, 10, 300
BY_HAND = "the bench cannot take it by itself"


def recommended(logs: Path, run: str, bench: Bench) -> list[dict[str, Any]]:
    """Tests that diagnoses of a run recommend, the most telling first.

    Each with `report`: its folder from the logs folder; `planned`: what can be started, or None, and `why_not`.
    """
    folder = logs / REPORTS / run
    if not is_plain(run) or not folder.is_dir():
        return []
    found = sorted([*folder.glob(DIAGNOSIS), *folder.glob(f"*/{DIAGNOSIS}")])[:MOST_DIAGNOSES]
    return [one for path in found for one in _tests(path, logs, run, bench)]


def _tests(path: Path, logs: Path, run: str, bench: Bench) -> list[dict[str, Any]]:
    if path.is_symlink() or not path.resolve().is_relative_to(logs.resolve()):
        return []
    stat = path.stat()
    document = _document(path, stat.st_mtime_ns, stat.st_size)
    return [
        {"report": str(path.parent.relative_to(logs)), **_told(test, run, bench)}
        for test in document[:MOST_TESTS]
        if isinstance(test, dict)
    ]


@lru_cache(maxsize=400)
def _document(path: Path, modified_ns: int, size: int) -> list[Any]:
    """The tests of a document as it stood then; none of what is no diagnosis."""
    if size > MOST_BYTES:
        return []
    try:
        read = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return []
    tests = read.get("next_tests") if isinstance(read, dict) and read.get("format") == FORMAT else None
    return tests if isinstance(tests, list) else []


def _told(test: dict[str, Any], run: str, bench: Bench) -> dict[str, Any]:
    separates, nats, command = test.get("separates"), test.get("information_nats"), test.get("command")
    told: dict[str, Any] = {
        "test": str(test.get("test", ""))[:MOST_TEXT],
        "separates": [str(one)[:MOST_TEXT] for one in separates[:10]] if isinstance(separates, list) else [],
        "nats": nats if isinstance(nats, int | float) and abs(nats) < 1e9 else None,
        "planned": None,
        "why_not": "",
    }
    if not isinstance(command, str) or not command:
        needs = str(test.get("needs") or "")[:MOST_TEXT]
        return told | {"why_not": f"it needs {needs}" if needs else BY_HAND}
    try:
        return told | {"planned": of_command(command, run, bench).told(bench)}
    except RefusedError as error:
        return told | {"why_not": str(error)}
