"""What a user waits for: the command's help, a whole fit, and the first call after an installation, which compiles."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from results import Row
from timing import once

from spinbench.published import published_sweep

FIRST_CALLS = Path(__file__).with_name("first_calls.py")
TOPIC = "Cold start"
COMPILE = "Compile time, once after installation"


def help_row(repeats: int) -> Row:
    """Wall time of `spinbench --help`, in turn with an empty Python.

    Parameters
    ----------
    repeats : int
        Number of runs, of which the median is taken [-].
    """
    taken = [(once(lambda: _run(["-c", "pass"])), once(lambda: _run(_command("--help")))) for _ in range(repeats)]
    empty, ours = (statistics.median(times) for times in zip(*taken, strict=True))
    note = f"median of {repeats}; an empty Python takes {empty:.3f} s"
    return Row(TOPIC, "spinbench --help", ours, None, "s", most=0.3, note=note)


def fit_row() -> Row:
    """Wall time of `spinbench fit logs/published_sweep`, compiled before."""
    seconds = once(lambda: _run(_command("fit", str(published_sweep()))))
    note = "the command in all, default of 10 000 effective samples, no report"
    return Row(TOPIC, "spinbench fit logs/published_sweep", seconds, None, "s", most=8.0, note=note)


def compile_rows() -> list[Row]:
    """Wall time of the first calls with nothing compiled, and with everything compiled by the run before."""
    with tempfile.TemporaryDirectory(prefix="spinbench-bench-") as folder:
        cold, warm = (first_calls(Path(folder)) for _ in range(2))
    parts = [
        Row(COMPILE, f"first call: {name}", warm[name], cold[name], "s", note="ours: from the cache; peer: compiling")
        for name in cold
        if name != "imports"
    ]
    total = Row(COMPILE, "imports and all first calls", sum(warm.values()), sum(cold.values()), "s", note="as above")
    return [*parts, total]


def first_calls(cache: Path) -> dict[str, float]:
    """Wall time of imports and of each first call in a process of its own [s].

    Parameters
    ----------
    cache : Path
        Where numba keeps what it compiles.
    """
    answer = _run([str(FIRST_CALLS)], {"NUMBA_CACHE_DIR": str(cache)})
    found: dict[str, float] = json.loads(answer)
    return found


def rows(repeats: int, with_fit: bool, tell: Callable[[str], None]) -> list[Row]:
    """All of it.

    Parameters
    ----------
    repeats : int
        Of the help [-].
    with_fit : bool
        The fit and the compiling too, which take a minute.
    tell : callable
        Told what comes next.
    """
    tell("cold start: help")
    found = [help_row(repeats)]
    if with_fit:
        tell("cold start: a whole fit")
        found.append(fit_row())
        tell("cold start: compiling everything anew")
        found += compile_rows()
    return found


def _command(*words: str) -> list[str]:
    return ["-c", "import sys, spinbench; sys.argv[0] = 'spinbench'; spinbench.main()", *words]


def _run(arguments: Sequence[str], environment: dict[str, str] | None = None) -> str:
    """Standard output of this Python, run with the arguments.

    Raises
    ------
    RuntimeError
        When it fails, with what it said.
    """
    done = subprocess.run(
        [sys.executable, *arguments], capture_output=True, text=True, env=os.environ | (environment or {}), check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(arguments)} ended with {done.returncode}: {done.stderr.strip()[-2000:]}")
    return done.stdout
