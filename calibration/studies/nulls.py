"""How often the diagnosis sees a mismatch where there is none: p-values of many recordings with nothing concealed.

Each null is drawn by `nulls_draw` and goes through the first steps of a diagnosis alone: the base model and
the test of it. A class is a kind of noise, in a sweep alone or in a sweep with two runs in time. The test was built for
Gaussian noise of about the declared size, correlated or not; what heavy tails do to it is measured and shown like the
rest.

    python -m calibration.studies.nulls -o out/nulls     # resumable: a null that is there is not made again
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calibration.studies import nulls_table
from calibration.studies.campaigns import code_of_a_case, command_line, go, refuse, results_of, same_code, whole_number
from calibration.studies.nulls_draw import NOISES, null_recording
from calibration.work import many_table
from calibration.work.many import Item, Result, Tell
from rig.recording.files import json_bytes, write_files

FIRST_SEED = 200_000
SWEEPS, WITH_RUNS = 1000, 200  # nulls of each class; a sweep with runs takes fifteen times as long
COLUMNS = {
    "name": many_table.TEXT,
    "class": many_table.TEXT,
    "seed": many_table.WHOLE,
    "p_value": many_table.NUMBER,
    "statistic": many_table.NUMBER,
    "f_overall": many_table.NUMBER,
    "seconds": many_table.NUMBER,
    "error": many_table.TEXT,
}


@dataclass(frozen=True)
class Kind:
    """A class of nulls."""

    noise: str
    with_runs: bool = False

    @property
    def name(self) -> str:
        """In tables and file names."""
        return f"{self.noise}_with_runs" if self.with_runs else self.noise


def p_of_null(argument: Mapping[str, Any]) -> dict[str, Any]:
    """One null's p-value.

    `argument`: ``noise``, ``with_runs``, ``seed``, and ``code``, the hash of the sources that the campaign began with;
        perhaps ``concealed``, effects and their parameters [SI], by which it is no null.
    Returns ``p_value``, ``extrapolated``, ``statistic``, the logarithms ``u`` of the noise scales found, and the
    ``truth``. Raises OtherCodeError when this process has other sources.
    """
    from calibration.diagnosis.mismatch import detect_mismatch

    same_code(argument["code"])
    key = (argument["seed"], NOISES.index(argument["noise"]), int(argument["with_runs"]))
    draw, test = (np.random.default_rng(one) for one in np.random.SeedSequence(key).spawn(2))
    recording, truth = null_recording(argument["noise"], argument["with_runs"], draw, argument.get("concealed"))
    found = detect_mismatch(recording, test).detection
    return {
        "p_value": found.p_value,
        "extrapolated": bool(found.extrapolated),
        "statistic": found.statistic,
        "u": found.u.tolist(),
        "truth": truth,
    }


def items_of(kinds: Mapping[Kind, int], first_seed: int = FIRST_SEED) -> list[Item]:
    """Every null of a campaign. `first_seed`: of each class; the others follow it [-]."""
    code = code_of_a_case()
    return [
        Item(
            f"{kind.name}-{seed}",
            {"noise": kind.noise, "with_runs": kind.with_runs, "seed": seed, "code": code},
            code,
        )
        for kind, count in kinds.items()
        for seed in range(first_seed, first_seed + count)
    ]


def run_campaign(
    kinds: Mapping[Kind, int],
    out: Path,
    workers: int,
    scheduler: str | None = None,
    first_seed: int = FIRST_SEED,
    tell: Tell = lambda done, total, name: None,
) -> dict[str, Any]:
    """Make the nulls that are not there yet, and write what all of them say.

    `out`: gets a result a null in ``results/``, ``nulls.parquet``, ``nulls.json``, ``nulls.md`` and ``nulls.png``.
    `workers`: processes; 0 works in this one [-].
    Returns what `nulls_table.summary` gives. Raises OtherCodeError when the sources changed on the way; ClusterError
    when no scheduler answers, or it is lost on the way.
    """
    items = items_of(kinds, first_seed)
    results = results_of(p_of_null, items, out, workers, scheduler, tell)
    rows = [row_of(item, result) for item, result in zip(items, results, strict=True)]
    found = nulls_table.summary(rows, first_seed, code_of_a_case())
    files = documents(rows, found) | {"nulls.parquet": many_table.as_parquet(rows, COLUMNS)}
    write_files(out, files)
    return found


def row_of(item: Item, result: Result) -> dict[str, Any]:
    """A null as a row of the table; a failed one has its error."""
    value = result.value or {}
    kind = Kind(item.argument["noise"], item.argument["with_runs"])
    return {
        "name": item.name,
        "class": kind.name,
        "seed": item.argument["seed"],
        "p_value": value.get("p_value"),
        "statistic": value.get("statistic"),
        "f_overall": value.get("truth", {}).get("f_overall"),
        "seconds": result.seconds,
        "error": result.error,
    }


def documents(rows: Sequence[Mapping[str, Any]], found: Mapping[str, Any]) -> dict[str, bytes]:
    """The result as a document, a page and a picture, by file name."""
    return {
        "nulls.json": json_bytes(found),
        "nulls.md": nulls_table.page(found).encode(),
        "nulls.png": nulls_table.picture(rows),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign of a command line, print its table, and return the exit code."""
    given = _parser().parse_args(arguments)
    kinds = {Kind(noise): given.sweeps for noise in given.noise if given.sweeps}
    kinds |= {Kind(noise, True): given.with_runs for noise in given.noise if given.with_runs}
    if not kinds:
        return refuse("nulls", "nothing to do: --sweeps and --with-runs are both 0; give one of them a number")
    return go("nulls", given, nulls_table.PAGE, partial(run_campaign, kinds), nulls_table.table)


def _parser() -> argparse.ArgumentParser:
    parser = command_line("nulls", __doc__, FIRST_SEED, "of each class", nulls_table.PAGE)
    parser.add_argument(
        "--sweeps", type=whole_number, default=SWEEPS, help="sweeps of each class of noise (%(default)s)"
    )
    parser.add_argument(
        "--with-runs", type=whole_number, default=WITH_RUNS, help="the same with two runs each (%(default)s)"
    )
    parser.add_argument("--noise", nargs="+", choices=NOISES, default=NOISES, help="classes of noise; all if left out")
    return parser


if __name__ == "__main__":
    sys.exit(main())
