"""The benchmark: `make bench`. Ratios of one run on one machine; docs/benchmarks.md says how to read them."""

from __future__ import annotations

import argparse
import itertools
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cold_start
import draws
import operating_point
import polling
import spin_up
from results import Row, as_json, machine, page_block, table, with_block
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from calibration.fit.sampling import Settings
from model.motor import read_motor
from rig.recording import read_recording
from rig.recording.files import write_file
from spinbench.published import published_sweep

STAGES, OF_WHOLE = 19, 6  # what is told in all, and what of it only a whole run has


@dataclass(frozen=True)
class Size:
    """How much is measured.

    Attributes
    ----------
    sets, rounds : int
        Parameter sets of a batch, and rounds of a timing [-].
    spin_up_s : float
        Length of the spin-up [s].
    effort : Effort
        Of the samplers.
    polling_s : float
        Of each measurement of polling [s].
    whole : bool
        The published sweep's posterior and not a toy, the whole fit, and the compiling.
    """

    sets: int
    rounds: int
    spin_up_s: float
    effort: draws.Effort
    polling_s: float
    whole: bool


FULL = Size(512, 7, 0.675, draws.Effort(Settings(seed=1, effective_samples=draws.WANTED), 1000, 6000, 60.0), 5.0, True)
QUICK = Size(
    4,
    1,
    0.02,
    draws.Effort(Settings(seed=1, effective_samples=200, most_steps=25, walkers=16), 20, 400, 2.0),
    0.1,
    False,
)


def measure(size: Size, tell: Callable[[str], None]) -> Iterator[list[Row]]:
    """Everything, a topic at a time, in the order of the table.

    Parameters
    ----------
    size : Size
        How much.
    tell : callable
        Told what comes next.
    """
    motor = read_motor("ptm3600")
    yield operating_point.rows(motor, size.sets, size.rounds, tell)
    yield spin_up.rows(motor, size.spin_up_s, size.rounds, tell)
    target = draws.of_recording(read_recording(published_sweep())) if size.whole else draws.gaussian(3)
    yield draws.rows(target, size.effort, tell)
    if size.whole:
        yield draws.larger(size.effort.settings, tell)
    yield polling.rows(size.polling_s, tell)
    yield cold_start.rows(size.rounds, size.whole, tell)


def main(arguments: list[str] | None = None) -> None:
    """The command line.

    Parameters
    ----------
    arguments : list of str, optional
        In place of the process's own.
    """
    parser = argparse.ArgumentParser(description="spinbench's speed, as ratios against stated peers")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep the figures there, as they come")
    parser.add_argument("--page", type=Path, metavar="FILE", help="renew the generated block of this page")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: does it work? The figures mean nothing")
    chosen = parser.parse_args(arguments)
    page = chosen.page.read_text(encoding="utf-8") if chosen.page else None
    if page is not None:
        with_block(page, "")  # a page without the marks is told before the minutes are spent

    rows: list[Row] = []
    conditions = machine()
    for found in _with_bar(QUICK if chosen.quick else FULL):
        rows += found
        if chosen.json:
            text = json.dumps({"machine": conditions, "quick": chosen.quick, "rows": as_json(rows)}, indent=1)
            write_file(chosen.json, (text + "\n").encode())
    if page is not None:
        write_file(chosen.page, with_block(page, page_block(rows, conditions)).encode())
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(table(rows))
    for row in rows:
        console.print(f"[dim]{row.what}: {row.note}[/dim]", highlight=False)


def _with_bar(size: Size) -> Iterator[list[Row]]:
    """`measure` under a bar on standard error."""
    columns = (SpinnerColumn(), BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=STAGES if size.whole else STAGES - OF_WHOLE)
        begun = itertools.count()

        def tell(words: str) -> None:
            bar.update(task, description=words, completed=next(begun))

        yield from measure(size, tell)
        bar.update(task, description="done", completed=bar.tasks[task].total)


if __name__ == "__main__":
    main()
