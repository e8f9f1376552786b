"""What each allowance of a diagnosis costs, and how far recordings make use of it.

An allowance is an unknown with a prior: the moment at which a valve moves, how a line fills, the roller friction. Each
takes up a part of what an effect does to the readings. How much is told by D, the size of an effect's change in units
of noise once all unknowns have taken up what they can, and by D with some of the unknowns known. Both are of the linear
model at the most probable point of recordings of the second rig that conceal nothing: a sweep, a spin-up and a
coast-down behind a supply of its own.

    python -m calibration.studies.allowances -o out/allowances     # resumable
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.challenge.pages.tables import Grid, as_markdown
from calibration.studies.campaigns import Row, Rows, Study, main, whole_number
from calibration.studies.follow_ups import FAMILY, nothing_concealed
from calibration.unknowns.priors import OfRun, Unknown
from calibration.work.many import Item
from calibration.work.sources import DIAGNOSIS
from rig.recording.files import json_bytes

RECORDINGS = 24
LINE = "line"
OF_A_LINE = {  # by what the name of a run's own unknown holds
    "_late": ("moved", "when a valve moves, and when a gauge shows"),
    "_time": ("filling", "how fast the line fills and empties"),
    "_valve": ("valve", "how fast the valve opens"),
    "_bend": ("bend", "what empties the line, an orifice or the motor"),
    "_lead": ("lead", "what passes ahead of the slower lag while a line fills"),
    "_droop": ("droop", "what a regulator gives less while the motor takes air"),
    "_form": ("form", "free deviations from that course"),
    "wander": ("wander", "how an open line goes up and down"),
    "begun": ("begun", "the speed from which a spin-up is compared"),
    "supply": ("settled", "the settled pressure"),
    "floor": ("floor", "what a vented line keeps"),
}
OF_THE_MOTOR = {
    "port_lap": ("lap", "the ports' lap"),
    "roller_friction": ("roller", "the roller friction"),
    "f_overall": ("f_overall", "the overall friction coefficient"),
    "inertia": ("inertia", "the rotor's inertia"),
}
OTHERS = ("others", "the shaft's angle, the room, errors of the instruments")
WORDS = {
    LINE: "all of the line, from *moved* to *floor*",
    **dict([*OF_A_LINE.values(), *OF_THE_MOTOR.values(), OTHERS]),
}


def allowance_of(unknown: Unknown) -> str:
    """The allowance that an unknown belongs to, a key of `WORDS`."""
    if not isinstance(unknown.of, OfRun):
        return OF_THE_MOTOR.get(unknown.own, OTHERS)[0]
    what = unknown.of.what
    return next((name for key, (name, _) in OF_A_LINE.items() if key in what), OTHERS[0])


def costs(argument: Mapping[str, Any]) -> dict[str, Any]:
    """What allowances cost in one recording.

    `argument`: ``seed`` of the draw.
    Returns ``used``: of each allowance how far its unknowns lie from their priors' middles, rms [sd]; ``D2``: of each
    effect at its ordinary size the square of D, by the allowance that is known, empty for none.
    """
    from calibration.challenge.second_rig import draw, make_recording
    from calibration.diagnosis.mismatch import fit_base
    from calibration.likelihood.signatures import signatures
    from rig.recording import read_recording

    truth = nothing_concealed(draw(FAMILY, argument["seed"], "allowances"))
    with tempfile.TemporaryDirectory() as place:
        make_recording(truth, Path(place) / "recording")
        comparison, mode = fit_base(read_recording(Path(place) / "recording"), lambda _: None)
    unknowns = comparison.problem.nuisances
    groups = [allowance_of(one) for one in unknowns]
    known = {name: [group == name for group in groups] for name in dict.fromkeys(groups)}
    used = {name: float(np.sqrt(np.mean(mode.z[which] ** 2))) for name, which in known.items()}
    of_a_line = {name for name, _ in OF_A_LINE.values()}
    known[LINE] = [group in of_a_line for group in groups]
    white = comparison.whitener(mode.prediction, mode.u)
    J = white(mode.D)
    found: dict[str, dict[str, float]] = {}
    for one in signatures(comparison, mode):
        if one.effect not in found:  # of several shapes the first
            change = white(one.column)
            of = found[one.effect] = {"": D2(J, change)}
            of |= {name: D2(J[:, ~np.array(which)], change) for name, which in known.items()}
    return {"used": used, "D2": found}


def D2(J: np.ndarray, change: np.ndarray) -> float:
    """The square of D [-].

    `J`, shape (m, k): whitened derivatives with unknowns whose priors are standard normal [-].
    `change`, shape (m,): whitened change of the readings [-].
    """
    along = J.T @ change
    return float(change @ change - along @ np.linalg.solve(J.T @ J + np.eye(J.shape[1]), along))


def items_of(given: argparse.Namespace, code: str) -> list[Item]:
    """Every recording of a campaign."""
    return [
        Item(f"recording-{seed}", {"seed": seed}, code)
        for seed in range(given.first_seed, given.first_seed + given.recordings)
    ]


def summary(rows: Rows, _first_seed: int, code: str) -> dict[str, Any]:
    """Medians over the recordings; what an allowance costs as the factor on D squared if it were known."""
    done = [one for one in rows if not one["error"]]
    effects = sorted({effect for one in done for effect in one["D2"]})
    there = [name for name in WORDS if name == LINE or any(name in one["used"] for one in done)]
    of = {effect: [one["D2"][effect] for one in done if effect in one["D2"]] for effect in effects}
    return {
        "code": code,
        "recordings": len(done),
        "failed": [f"{one['name']}: {one['error']}" for one in rows if one["error"]],
        "used": {name: _rms([one["used"][name] for one in done if name in one["used"]]) for name in there},
        "D": {effect: math.sqrt(float(np.median([one[""] for one in of[effect]]))) for effect in effects},
        "factor": {
            effect: {
                name: float(np.median([one[name] / one[""] for one in of[effect] if name in one and one[""] > 0.0]))
                for name in there
            }
            for effect in effects
        },
    }


def _rms(values: list[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values else None


def page(found: Row) -> str:
    """The result in words and a table."""
    used = found["used"]
    lines = [
        "# What allowances cost",
        "",
        f"{found['recordings']} recordings of the second rig that conceal nothing: a sweep, a spin-up, a coast-down.",
        "D tells how much of an effect of ordinary size is seen [sds of noise]. Beside it stands by how much D squared",
        "would grow if an allowance were known; 1.00 is nothing. *Used* is how far the unknowns lie from their priors'",
        "middles, rms [sd].",
        "",
        *(f"- *{name}*: {words}" for name, words in WORDS.items() if name in used),
        "",
        f"Failed: {len(found['failed'])}. {'; '.join(found['failed'])}".rstrip(),
        "",
    ]
    header = ("effect", "D", *used)
    rows = [("used", "", *("" if value is None else format(value, ".2f") for value in used.values()))]
    for effect, factors in found["factor"].items():
        rows.append((effect, format(found["D"][effect], ".1f"), *(format(value, ".2f") for value in factors.values())))
    return "\n".join([*lines, as_markdown(Grid("", header, rows))])


def documents(found: Row, _rows: Rows) -> dict[str, bytes]:
    """The result as a document and a page, by file name."""
    return {"allowances.json": json_bytes(found), "allowances.md": page(found).encode()}


STUDY = Study(
    name="allowances",
    words=__doc__,
    roots=("calibration.challenge.second_rig", DIAGNOSIS),
    task=costs,
    items=items_of,
    first_seed=790_000,
    options={
        "--recordings": {"type": whole_number, "default": RECORDINGS, "help": "that are drawn (%(default)s)"},
    },
    summary=summary,
    documents=documents,
    told=page,
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
