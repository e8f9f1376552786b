"""How often the diagnosis sees a mismatch where there is none: p-values of many recordings with nothing concealed.

Each null is drawn by `calibration.nulls_draw` and goes through the first steps of a diagnosis alone: the base model and
the test of it. A class is a kind of noise, in a sweep alone or in a sweep with two runs in time. The test was built for
Gaussian noise of about the declared size; what correlated or heavy-tailed noise does to it is measured and shown like
the rest.

    python -m calibration.nulls -o out/nulls     # resumable: a null that is there is not made again
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration import many_table, nulls_table
from calibration.many import Item, Result, Tell, run_many
from calibration.many_bar import progress_bar, whole_number
from calibration.nulls_draw import NOISES, null_recording
from calibration.report.files import write_files
from calibration.sources import diagnosis_sha256

FIRST_SEED = 200_000
SWEEPS, WITH_RUNS = 1000, 200  # nulls of each class; a sweep with runs takes fifteen times as long
RESULTS = "results"
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


class OtherCodeError(RuntimeError):
    """A worker has other sources than the campaign began with."""


@dataclass(frozen=True)
class Kind:
    """A class of nulls.

    Attributes
    ----------
    noise : str
        One of `nulls_draw.NOISES`.
    with_runs : bool
        Whether a spin-up and a coast-down follow the sweep.
    """

    noise: str
    with_runs: bool = False

    @property
    def name(self) -> str:
        """In tables and file names."""
        return f"{self.noise}_with_runs" if self.with_runs else self.noise


def p_of_null(argument: Mapping[str, Any]) -> dict[str, Any]:
    """One null's p-value.

    Parameters
    ----------
    argument : mapping
        ``noise``, ``with_runs``, ``seed``, and ``code``, the hash of the sources that the campaign began with; perhaps
        ``concealed``, effects and their parameters [SI], by which it is no null.

    Returns
    -------
    dict
        ``p_value``, ``extrapolated``, ``statistic``, the logarithms ``u`` of the noise scales found, and the ``truth``.

    Raises
    ------
    OtherCodeError
        When this process has other sources.
    """
    from calibration.diagnosis.diagnose import detect_mismatch

    if diagnosis_sha256() != argument["code"]:
        raise OtherCodeError("this worker has other code than the campaign")
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
    """Every null of a campaign.

    Parameters
    ----------
    kinds : mapping of Kind to int
        How many of each [-].
    first_seed : int
        Of each class; the others follow it [-].
    """
    code = diagnosis_sha256()
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

    Parameters
    ----------
    kinds : mapping of Kind to int
        How many of each class [-].
    out : Path
        Gets a result a null in ``results/``, ``nulls.parquet``, ``nulls.json``, ``nulls.md`` and ``nulls.png``.
    workers : int
        Processes; 0 works in this one [-].
    scheduler : str or None
        A Dask scheduler instead.
    first_seed : int
        Of each class [-].
    tell : callable
        Told of the progress.

    Returns
    -------
    dict
        Of `nulls_table.summary`.

    Raises
    ------
    OtherCodeError
        When the sources changed on the way.
    ClusterError
        When no scheduler answers, or it is lost on the way.
    """
    items = items_of(kinds, first_seed)
    results = run_many(p_of_null, items, out / RESULTS, workers, scheduler, tell)
    elsewhere = [one for one in results if one.error.startswith(OtherCodeError.__name__)]
    if elsewhere:
        raise OtherCodeError(
            f"the code was changed while {elsewhere[0].name} and {len(elsewhere) - 1} more of {len(items)} nulls were "
            "made, so they say nothing of either; leave it alone and give the same command again"
        )
    rows = [row_of(item, result) for item, result in zip(items, results, strict=True)]
    found = nulls_table.summary(rows, first_seed, diagnosis_sha256())
    files = documents(rows, found) | {"nulls.parquet": many_table.as_parquet(rows, COLUMNS)}
    write_files(out, files)
    return found


def row_of(item: Item, result: Result) -> dict[str, Any]:
    """A null as a row of the table; a failed one has its error.

    Parameters
    ----------
    item : Item
        The null.
    result : Result
        What became of it.
    """
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
    """The result as a document, a page and a picture, by file name.

    Parameters
    ----------
    rows : sequence of mapping
        Of `row_of`.
    found : mapping
        Of `nulls_table.summary`.
    """
    return {
        "nulls.json": (json.dumps(found, indent=1) + "\n").encode(),
        "nulls.md": nulls_table.page(found).encode(),
        "nulls.png": nulls_table.picture(rows),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the campaign of a command line, print its table, and return the exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        The process's own when left out.
    """
    given = _parser().parse_args(arguments)
    kinds = {Kind(noise): given.sweeps for noise in given.noise if given.sweeps}
    kinds |= {Kind(noise, True): given.with_runs for noise in given.noise if given.with_runs}
    if not kinds:
        return _refuse("nothing to do: --sweeps and --with-runs are both 0; give one of them a number")
    try:
        with progress_bar("nulls") as tell:
            found = run_campaign(kinds, given.out, given.workers, given.scheduler, given.first_seed, tell)
        if given.page:
            write_files(given.page, {name: (given.out / name).read_bytes() for name in nulls_table.PAGE})
    except KeyboardInterrupt:
        print(f"stopped; what is done is kept in {given.out}, and the same command goes on", file=sys.stderr)
        return 130
    except (OSError, OtherCodeError) as problem:  # an OSError may be a cluster's
        return _refuse(str(problem))
    print(nulls_table.table(found))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m calibration.nulls", description=__doc__.splitlines()[0] if __doc__ else ""
    )
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the results")
    parser.add_argument(
        "--sweeps", type=whole_number, default=SWEEPS, help="sweeps of each class of noise (%(default)s)"
    )
    parser.add_argument(
        "--with-runs", type=whole_number, default=WITH_RUNS, help="the same with two runs each (%(default)s)"
    )
    parser.add_argument("--noise", nargs="+", choices=NOISES, default=NOISES, help="classes of noise; all if left out")
    parser.add_argument("--first-seed", type=whole_number, default=FIRST_SEED, help="of each class (%(default)s)")
    parser.add_argument(
        "--workers", type=whole_number, default=os.cpu_count() or 1, help="processes; 0 for none but this"
    )
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask scheduler instead")
    parser.add_argument("--page", type=Path, help="a folder of the docs, which gets nulls.json, nulls.md, nulls.png")
    return parser


def _refuse(why: str) -> int:
    print(f"nulls: {why}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
