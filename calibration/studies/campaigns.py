"""The one runner of the studies: a command line, items that workers do, and what all of them say, in files."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from calibration.work import many_table
from calibration.work.many import Item, Result, Tell, run_many
from calibration.work.sources import imported_sha256
from rig.progress import Bar, Count, Elapsed, Left, bar_of
from rig.recording.files import json_bytes, write_files

RESULTS = "results"  # the folder with a result an item

Row = Mapping[str, Any]
Rows = Sequence[Row]


class StudyError(RuntimeError):
    """A campaign says nothing."""


class OtherCodeError(StudyError):
    """A worker has other sources than the campaign began with."""


def plain_row(item: Item, result: Result) -> dict[str, Any]:
    """What an item gave, with its ``name``, its ``seconds`` and its ``error``, empty where it gave something."""
    return (result.value or {}) | {"name": item.name, "seconds": result.seconds, "error": result.error}


@dataclass(frozen=True, kw_only=True)
class Study:
    """A campaign.

    `name`: of its module.
    `words`: its docstring.
    `roots`: modules that a result hangs on, with all that they import.
    `task`: gives what is kept of an item, of its argument.
    `items`: of the command line, and the hash of the code, which goes into each one's mark.
    `options`: of the command line, besides those that all have, as argparse takes them.
    `row`: an item with its result.
    `summary`: of all rows, the first seed and the hash of the code.
    `documents`: of the summary and the rows, by file name.
    `told`: the summary as text.
    `columns`: of a table of the rows; no table without them.
    `kept`: the file among the documents that holds the rows, each with its ``code``, so that ``--also`` takes them in.
    `needs`: a package of the development extra.
    """

    name: str
    words: str | None
    roots: tuple[str, ...]
    task: Callable[[Any], dict[str, Any]]
    items: Callable[[argparse.Namespace, str], list[Item]]
    first_seed: int
    options: Mapping[str, Mapping[str, Any]]
    summary: Callable[[Rows, int, str], dict[str, Any]]
    documents: Callable[[Row, Rows], dict[str, bytes]]
    told: Callable[[Row], str]
    row: Callable[[Item, Result], dict[str, Any]] = plain_row
    columns: Mapping[str, str] = field(default_factory=dict)
    needs: str = ""
    kept: str = ""

    def code(self) -> str:
        """The hash of what a result hangs on."""
        return imported_sha256(*self.roots)


def main(study: Study, arguments: Sequence[str] | None = None) -> int:
    """Run the campaign of a command line beneath a bar, print what it comes to, and return the exit code."""
    given = _parser(study).parse_args(arguments)
    try:
        items = study.items(given, study.code())
        if study.needs and not importlib.util.find_spec(study.needs):
            raise StudyError(f"needs {study.needs}, of the development extra: pip install 'spinbench[dev]'")
        if not items:
            raise StudyError("nothing to do: this asks for 0 items; give a number above 0 (--help says of what)")
        with _progress_bar(study.name) as tell:
            found, documents = run(study, items, given, tell)
        if given.page:
            write_files(given.page, documents)
    except KeyboardInterrupt:
        print(f"stopped; what is done is kept in {given.out}, and the same command goes on", file=sys.stderr)
        return 130
    except (OSError, StudyError) as problem:  # an OSError may be a cluster's
        print(f"{study.name}: {problem}", file=sys.stderr)
        return 2
    print(study.told(found).rstrip())
    return 0


def run(
    study: Study, items: Sequence[Item], given: argparse.Namespace, tell: Tell
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Do what is not done yet, and write what all of it says.

    `given`: ``out``, which gets the documents, perhaps a table, and a result an item in ``results/``; ``workers``, 0
        for this process alone; ``scheduler``; ``first_seed``.
    Returns the summary, and the documents by file name. Raises OtherCodeError when the sources changed on the way;
    ClusterError when no scheduler answers, or it is lost on the way.
    """
    task = partial(with_same_code, study.roots, study.code(), study.task)
    results = run_many(task, items, given.out / RESULTS, given.workers, given.scheduler, tell)
    elsewhere = [one for one in results if one.failed_by(OtherCodeError)]
    if elsewhere:
        raise OtherCodeError(
            f"the code was changed while {elsewhere[0].name} and {len(elsewhere) - 1} more of {len(items)} were made, "
            "so they say nothing of either; leave it alone and give the same command again"
        )
    rows = [study.row(item, result) for item, result in zip(items, results, strict=True)]
    if study.kept:
        rows = _with_earlier([one | {"code": study.code()} for one in rows], given.also)
    found = study.summary(rows, given.first_seed, study.code())
    documents = study.documents(found, rows)
    documents |= {study.kept: json_bytes(rows)} if study.kept else {}
    table = {f"{study.name}.parquet": many_table.as_parquet(rows, study.columns)} if study.columns else {}
    write_files(given.out, documents | table)
    return found, documents


def _with_earlier(rows: list[dict[str, Any]], files: Sequence[Path]) -> list[dict[str, Any]]:
    """The rows, with those of earlier campaigns that are not among them. Raises StudyError for a file without."""
    kept: dict[str, dict[str, Any]] = {}
    for file in files:
        try:
            kept |= {one["name"]: one | {"code": one["code"]} for one in json.loads(file.read_bytes())}
        except (ValueError, TypeError, KeyError) as problem:
            raise StudyError(f"{file}: no rows of an earlier campaign; give the file that one has kept") from problem
    return list((kept | {one["name"]: one for one in rows}).values())


def with_same_code(
    roots: tuple[str, ...], code: str, task: Callable[[Any], dict[str, Any]], argument: Any
) -> dict[str, Any]:
    """What a task gives, in a process with the sources that a campaign began with. Raises OtherCodeError in another."""
    if imported_sha256(*roots) != code:
        raise OtherCodeError("this worker has other code than the campaign")
    return task(argument)


def whole_number(text: str) -> int:
    """A number of 0 or more of a command line [-]. Raises argparse.ArgumentTypeError when it is none."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of 0 or more")
    return int(text)


def _parser(study: Study) -> argparse.ArgumentParser:
    about = study.words.splitlines()[0] if study.words else ""
    parser = argparse.ArgumentParser(prog=f"python -m calibration.studies.{study.name}", description=about)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument(
        "--first-seed", type=whole_number, default=study.first_seed, help="first seed; others follow (%(default)s)"
    )
    parser.add_argument(
        "--workers", type=whole_number, default=os.cpu_count() or 1, help="processes; 0 for none but this"
    )
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask scheduler instead")
    parser.add_argument("--page", type=Path, help="a folder of the docs, which gets what the campaign says")
    if study.kept:
        about = f"{study.kept} of earlier campaigns, perhaps of other code, whose rows count too"
        parser.add_argument("--also", type=Path, nargs="+", default=[], metavar="FILE", help=about)
    for name, how in study.options.items():
        parser.add_argument(name, **how)
    return parser


@contextlib.contextmanager
def _progress_bar(name: str) -> Iterator[Tell]:
    """A bar on the error stream with the time gone and the time left; its value is what `run_many` tells."""
    with bar_of(name, Bar, Count, Elapsed, Left, pace_s=3600.0) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, total, item: bar.update(task, completed=done, total=total)
