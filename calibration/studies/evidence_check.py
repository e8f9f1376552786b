"""Whether the evidence that a diagnosis weighs by, Laplace's, is right: against nested sampling of the same posterior.

A case is a sweep drawn by `nulls_draw`, with nothing concealed or with one effect. It is searched as a
diagnosis does it; then the Bayes factor of one effect against the base model is taken three ways: as the diagnosis has
it, by nested sampling, and by importance sampling. The effect is the one concealed; where nothing is, the one that the
diagnosis finds most probable. Runs in time are left aside: a call of the model takes fifteen times as long there.

    python -m calibration.studies.evidence_check -o out/evidence     # resumable: a case that is there is not made again
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from calibration.studies import evidence_page
from calibration.studies.campaigns import code_of_a_case, command_line, go, refuse, results_of, whole_number
from calibration.studies.evidence_cases import FIRST_SEED, check_case, items_of
from calibration.work import many_table
from calibration.work.many import Item, Result, Tell
from rig.recording.files import json_bytes, write_files

CASES = 50  # every other one with an effect concealed
COLUMNS = {
    "name": many_table.TEXT,
    "seed": many_table.WHOLE,
    "noise": many_table.TEXT,
    "concealed": many_table.TEXT,
    "size": many_table.NUMBER,
    "effect": many_table.TEXT,
    **dict.fromkeys(evidence_page.NUMBERS, many_table.NUMBER),
    "seconds": many_table.NUMBER,
    "error": many_table.TEXT,
}


def run_campaign(
    cases: int,
    out: Path,
    workers: int,
    scheduler: str | None = None,
    first_seed: int = FIRST_SEED,
    nested_every: int = 1,
    tell: Tell = lambda done, total, name: None,
) -> dict[str, Any]:
    """Make the cases that are not there yet, and write what all of them say.

    `out`: gets a result a case in ``results/``, ``evidence.parquet``, ``evidence.json``, ``evidence.md`` and
        ``evidence.png``.
    `workers`: processes; 0 works in this one [-].
    Returns what `evidence_page.summary` gives. Raises OtherCodeError when the sources changed on the way; ClusterError
    when no scheduler answers, or it is lost on the way.
    """
    items = items_of(cases, first_seed, nested_every)
    results = results_of(check_case, items, out, workers, scheduler, tell)
    rows = [row_of(item, result) for item, result in zip(items, results, strict=True)]
    found = evidence_page.summary(rows, first_seed, code_of_a_case())
    documents = {
        "evidence.json": json_bytes(found | {"cases": rows}),
        "evidence.md": evidence_page.page(found, rows).encode(),
        "evidence.png": evidence_page.picture(rows),
        "evidence.parquet": many_table.as_parquet(rows, COLUMNS),
    }
    write_files(out, documents)
    return found


def row_of(item: Item, result: Result) -> dict[str, Any]:
    """A case as a row of the table; a failed one has its error."""
    given = item.argument
    row = {
        "name": item.name,
        "seed": given["seed"],
        "noise": given["noise"],
        "concealed": next(iter(given["concealed"]), ""),
        "size": given["size"],
        "effect": (result.value or {}).get("effect", ""),
    }
    numbers = evidence_page.numbers(result.value) if result.value else dict.fromkeys(evidence_page.NUMBERS)
    return row | numbers | {"seconds": result.seconds, "error": result.error}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign of a command line, print what it comes to, and return the exit code."""
    given = _parser().parse_args(arguments)
    if not given.cases:
        return refuse("evidence", "nothing to do: --cases is 0")
    try:
        import dynesty  # noqa: F401
    except ImportError:
        words = "nested sampling needs dynesty, of the development extra: pip install 'spinbench[dev]'"
        return refuse("evidence", words)
    run = partial(run_campaign, given.cases, nested_every=given.nested_every)
    return go("evidence", given, evidence_page.PAGE, run, evidence_page.verdict)


def _parser() -> argparse.ArgumentParser:
    parser = command_line("evidence_check", __doc__, FIRST_SEED, "of the first case", evidence_page.PAGE)
    parser.add_argument("--cases", type=whole_number, default=CASES, help="half with an effect concealed (%(default)s)")
    parser.add_argument(
        "--nested-every", type=whole_number, default=1, help="nested sampling of one case in so many; 0 for none"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
