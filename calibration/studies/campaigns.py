"""What the campaigns that look at the diagnosis itself share: their command line, their bar, one code throughout."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from calibration.work.many import Item, Result, Tell, run_many
from calibration.work.sources import DIAGNOSIS, imported_sha256
from rig.progress import Bar, Count, Elapsed, Left, bar_of
from rig.recording.files import write_files

RESULTS = "results"  # the folder with a result an item


class OtherCodeError(RuntimeError):
    """A worker has other sources than the campaign began with."""


def code_of_a_case() -> str:
    """The hash of what a case hangs on: how its recording is drawn, and the diagnosis."""
    return imported_sha256("calibration.studies.nulls_draw", DIAGNOSIS)


def same_code(code: str) -> None:
    """See that this process has the sources that a campaign began with. Raises OtherCodeError when it has others."""
    if code_of_a_case() != code:
        raise OtherCodeError("this worker has other code than the campaign")


def results_of(
    task: Callable[[Any], dict[str, Any]],
    items: Sequence[Item],
    out: Path,
    workers: int,
    scheduler: str | None,
    tell: Tell,
) -> list[Result]:
    """Do what is not done yet of a campaign.

    `task`: of one item's argument; it calls `same_code`.
    `workers`: processes; 0 works in this one [-].
    Raises OtherCodeError when the sources changed on the way; ClusterError when no scheduler answers, or it is lost on
    the way.
    """
    results = run_many(task, items, out / RESULTS, workers, scheduler, tell)
    elsewhere = [one for one in results if one.error.startswith(OtherCodeError.__name__)]
    if elsewhere:
        raise OtherCodeError(
            f"the code was changed while {elsewhere[0].name} and {len(elsewhere) - 1} more of {len(items)} were made, "
            "so they say nothing of either; leave it alone and give the same command again"
        )
    return results


def command_line(
    study: str, words: str | None, first_seed: int, seeds_of: str, page: Iterable[str]
) -> argparse.ArgumentParser:
    """The command line of a study, with the options that each campaign has. `words`: its docstring."""
    about = words.splitlines()[0] if words else ""
    parser = argparse.ArgumentParser(prog=f"python -m calibration.studies.{study}", description=about)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--first-seed", type=whole_number, default=first_seed, help=f"{seeds_of} (%(default)s)")
    parser.add_argument(
        "--workers", type=whole_number, default=os.cpu_count() or 1, help="processes; 0 for none but this"
    )
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask scheduler instead")
    parser.add_argument("--page", type=Path, help=f"a folder of the docs, which gets {', '.join(page)}")
    return parser


def go(
    name: str,
    given: argparse.Namespace,
    page: Iterable[str],
    run: Callable[..., dict[str, Any]],
    told: Callable[[dict[str, Any]], str],
) -> int:
    """Run a campaign beneath its bar, copy its page, and print what it comes to; the exit code.

    `run`: takes the folder, the processes, the scheduler, the first seed and ``tell``.
    `told`: what it comes to, as text.
    """
    try:
        with progress_bar(name) as tell:
            found = run(given.out, given.workers, given.scheduler, given.first_seed, tell=tell)
        if given.page:
            write_files(given.page, {file: (given.out / file).read_bytes() for file in page})
    except KeyboardInterrupt:
        print(f"stopped; what is done is kept in {given.out}, and the same command goes on", file=sys.stderr)
        return 130
    except (OSError, OtherCodeError) as problem:  # an OSError may be a cluster's
        return refuse(name, str(problem))
    print(told(found))
    return 0


def refuse(name: str, why: str) -> int:
    """Say why a campaign cannot be; the exit code."""
    print(f"{name}: {why}", file=sys.stderr)
    return 2


@contextlib.contextmanager
def progress_bar(name: str) -> Iterator[Tell]:
    """A bar on the error stream with the time gone and the time left; its value is what `run_many` tells."""
    with bar_of(name, Bar, Count, Elapsed, Left, pace_s=3600.0) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total, item: bar.update(task, completed=done, total=total)


def whole_number(text: str) -> int:
    """A number of 0 or more of a command line [-]. Raises argparse.ArgumentTypeError when it is none."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of 0 or more")
    return int(text)
