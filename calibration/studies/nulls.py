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
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.studies import nulls_table
from calibration.studies.campaigns import Study, main, whole_number
from calibration.studies.nulls_draw import NOISES, null_recording
from calibration.work import many_table
from calibration.work.many import Item, Result
from calibration.work.sources import DIAGNOSIS

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


def p_of_null(argument: Mapping[str, Any]) -> dict[str, Any]:
    """One null's p-value.

    `argument`: ``noise``, ``with_runs``, ``seed``; perhaps ``concealed``, effects and their parameters [SI], by which
        it is no null.
    Returns ``p_value``, ``extrapolated``, ``statistic``, the logarithms ``u`` of the noise scales found, and the
    ``truth``.
    """
    from calibration.diagnosis.mismatch import detect_mismatch

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


def items_of(given: argparse.Namespace, code: str) -> list[Item]:
    """Every null of a campaign: of each class the seeds that begin with the first."""
    counts = {False: given.sweeps, True: given.with_runs}
    return [
        Item(
            f"{noise}{nulls_table.RUNS if with_runs else ''}-{seed}",
            {"noise": noise, "with_runs": with_runs, "seed": seed},
            code,
        )
        for with_runs, count in counts.items()
        for noise in dict.fromkeys(given.noise)
        for seed in range(given.first_seed, given.first_seed + count)
    ]


def row_of(item: Item, result: Result) -> dict[str, Any]:
    """A null as a row of the table; a failed one has its error."""
    value = result.value or {}
    return {
        "name": item.name,
        "class": item.name.rpartition("-")[0],
        "seed": item.argument["seed"],
        "p_value": value.get("p_value"),
        "statistic": value.get("statistic"),
        "f_overall": value.get("truth", {}).get("f_overall"),
        "seconds": result.seconds,
        "error": result.error,
    }


STUDY = Study(
    name="nulls",
    words=__doc__,
    roots=("calibration.studies.nulls_draw", DIAGNOSIS),
    task=p_of_null,
    items=items_of,
    first_seed=200_000,
    options={
        "--sweeps": {"type": whole_number, "default": SWEEPS, "help": "sweeps of each class of noise (%(default)s)"},
        "--with-runs": {
            "type": whole_number,
            "default": WITH_RUNS,
            "help": "the same with two runs each (%(default)s)",
        },
        "--noise": {"nargs": "+", "choices": NOISES, "default": NOISES, "help": "classes of noise; all if left out"},
    },
    row=row_of,
    columns=COLUMNS,
    summary=nulls_table.summary,
    documents=nulls_table.documents,
    told=nulls_table.table,
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
