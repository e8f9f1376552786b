"""What a test that a diagnosis asks for promised, against what it gave, on cases of the second rig.

Each case is diagnosed. Where more than one explanation stays open, the first test that this bench can take is simulated
as a recording of another day and given back; then once more. Where none explains the readings, there are none to tell
apart. What is drawn is the challenge's make-up, nulls included, as it comes or in a sweep alone; or dry friction alone,
in a sweep with a spin-up and a coast-down.

    python -m calibration.studies.follow_ups -o out/follow_ups     # resumable: a case that is there is not made again
    python -m calibration.studies.follow_ups -o out/sweeps --sweep-alone
    python -m calibration.studies.follow_ups -o out/dry --dry-friction 0.06 0.20 --days 0
    python -m calibration.studies.follow_ups -o out/more --first-seed 350000 --also out/follow_ups/cases.json
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from calibration.challenge.pages.tables import Grid, as_markdown
from calibration.studies.campaigns import Row, Rows, Study, StudyError, main, whole_number
from calibration.work.many import Item
from calibration.work.sources import DIAGNOSIS
from rig.recording.files import json_bytes

FAMILY = "development"
CASES = 100
SEED = 1  # of each diagnosis
DAYS = 2  # tests that are taken, at most
BY_D = (("below 3", 0.0, 3.0), ("3 to 7", 3.0, 7.0), ("7 and more", 7.0, math.inf))
DRY = "coulomb_friction"
TOLD_APART = 10.0  # nats promised, above which a promise is held against what came of it


def followed(argument: Mapping[str, Any]) -> dict[str, Any]:
    """One case: its diagnosis, and those with a test of another day in them.

    `argument`: ``seed`` of the draw; ``dry_nm``, least and most dry friction [N m] where it alone is concealed, or
        None; ``sweep``, whether the first recording is a sweep alone; ``days``, tests that are taken at most; ``D``,
        whether that is reckoned.
    Returns ``ids`` concealed; ``D`` and ``rival`` of the first recording by the scorer, None where its diagnosis names
    or lists the truth; and ``steps``: of each diagnosis its verdict, what it is worth, and the test that was given back
    before it, with nats promised, promised should the truth be right (None where it was not weighed), and delivered.
    """
    from calibration.challenge.scoring.judging import LISTED, RIGHT
    from calibration.challenge.second_rig import another_day, draw, make_recording, separable
    from calibration.data.joined import as_given
    from calibration.diagnosis.diagnose import diagnose
    from calibration.diagnosis.next_test.promised import Promise, Rival
    from calibration.diagnosis.steps.verdict import VerdictKind
    from rig.recording import read_recording

    truth = draw(FAMILY, argument["seed"], "follow-ups")
    if argument["dry_nm"]:
        truth = dry_friction_alone(truth, argument["dry_nm"])
    if argument["sweep"]:
        truth = replace(truth, with_transients=False)
    with tempfile.TemporaryDirectory() as place:
        folders = [Path(place) / "first"]
        make_recording(truth, folders[0])
        found = diagnose(read_recording(folders[0]), SEED)
        steps = [_step(truth, found)]
        is_told = steps[0]["outcome"] in (RIGHT, LISTED)  # its D would say nothing more, and takes minutes
        seen = separable(truth, folders[0]) if argument["D"] and not is_told else {"D": None, "rival": None}
        for day in range(1, argument["days"] + 1):
            test = next((one for one in found.next_tests if one.capture), None)
            if found.verdict.kind == VerdictKind.UNRESOLVED or test is None or test.capture is None:
                break
            rivals = {one.names: Rival(one.log_evidence, one.probability) for one in found.rivals}
            promise = Promise(test.test, test.information_nats, rivals)
            folders.append(Path(place) / f"day_{day}")
            another_day(truth, asdict(test.capture), day, folders[-1])
            found = diagnose(as_given([read_recording(one) for one in folders]), SEED, promises=[promise])
            if_right = {tuple(sorted(names)): nats for names, nats in test.nats_where_true.items()}
            steps.append(_step(truth, found, if_right.get(tuple(sorted(truth.ids)))))
    return {
        "ids": truth.ids,
        "category": truth.category,
        "sizes": truth.sizes,
        "sweep": not truth.with_transients,
        "D": seen["D"],
        "rival": seen["rival"],
        "steps": steps,
    }


def nothing_concealed(truth: Any) -> Any:
    """The same bench with nothing concealed, in a sweep with runs in time."""
    from calibration.challenge.second_rig.draws import NONE

    nothing = {"ids": [], "effects": [], "sizes": {}, "place": {}, "near_nuisance": False, "total_sds": {}}
    return replace(truth, category=NONE, **nothing, with_transients=True)


def dry_friction_alone(truth: Any, range_nm: tuple[float, float]) -> Any:
    """The same bench with dry friction alone, even in its logarithm, in a sweep with runs in time."""
    from calibration.challenge.second_rig.concealed import USUAL, Concealed
    from calibration.challenge.second_rig.draws import SINGLE

    values = {"torque_nm": float(np.exp(truth.rng("dry friction").uniform(*np.log(range_nm))))}
    effects = [asdict(Concealed(DRY, USUAL[DRY], values))]
    return replace(nothing_concealed(truth), category=SINGLE, ids=[DRY], effects=effects, sizes={DRY: values})


def _step(truth: Any, found: Any, nats_if_right: float | None = None) -> dict[str, Any]:
    from calibration.challenge.scoring.judging import outcome
    from calibration.diagnosis.document import as_json

    document = as_json(found)
    concealed = frozenset() if truth.category in ("none", "not_in_library") else frozenset(truth.ids)
    return {
        "verdict": document["verdict"],
        "outcome": outcome(truth.category, concealed, document),
        "sets": [[one["id"] for one in document["effects"]], *document["alternatives"]],
        "rivals": [sorted(one.names) for one in found.rivals],
        "promised": [one | {"nats_if_right": nats_if_right} for one in document["promised"]],
    }


def items_of(given: argparse.Namespace, code: str) -> list[Item]:
    """Every case of a campaign. Raises StudyError for a range that holds no torque."""
    if given.dry_friction and not 0.0 < given.dry_friction[0] <= given.dry_friction[1] < math.inf:
        raise StudyError("--dry-friction: two torques above 0 N m, the lesser first; give 0.06 0.20, for example")
    how = {"dry_nm": given.dry_friction, "sweep": given.sweep_alone, "days": given.days, "D": not given.without_D}
    mark = sha256(f"{code} {how}".encode()).hexdigest()
    return [
        Item(f"case-{seed}", {"seed": seed} | how, mark)
        for seed in range(given.first_seed, given.first_seed + given.cases)
    ]


def summary(rows: Rows, _first_seed: int, code: str) -> dict[str, Any]:
    """What the cases come to."""
    done = [one for one in rows if not one["error"]]
    open_ = [one for one in done if len(one["steps"]) > 1]
    given = [
        {"ids": one["ids"], "is_among": is_among, **promised} for one in open_ for is_among, promised in _promises(one)
    ]
    apart = [one for one in open_ if one["ids"] and _told_apart(one)]
    return {
        "code": code,
        "codes": dict(Counter(one["code"] for one in done)),
        "cases": len(done),
        "sweeps": sum(one["sweep"] for one in done),
        "failed": [f"{one['name']}: {one['error']}" for one in rows if one["error"]],
        "open": len(open_),
        "promises": given,
        "ratios_of_all": _ratios(given, "information_nats", 0.0),
        "ratios": _ratios(given, "information_nats"),
        "ratios_if_right": _ratios(given, "nats_if_right"),
        "told_apart": len(apart),
        "named_after": [sum(_is_named(one, day) for one in apart) for day in range(1, DAYS + 1)],
        "by_D": [
            {"D": label, "outcomes": dict(Counter(one["steps"][0]["outcome"] for one in there))}
            for label, low, high in BY_D
            if (there := [one for one in done if one["ids"] and one["D"] is not None and low <= one["D"] < high])
        ],
        "wrong_before": sum(one["steps"][0]["outcome"] in WRONG for one in done),
        "wrong_after": sum(one["steps"][-1]["outcome"] in WRONG for one in open_),
        "rows": [
            {
                "ids": one["ids"],
                "D": one["D"],
                "outcomes": [step["outcome"] for step in one["steps"]],
                "tests": [promised["test"] for step in one["steps"] for promised in step["promised"]],
            }
            for one in done
            if one["ids"] or len(one["steps"]) > 1
        ],
    }


WRONG = ("wrong name", "false alarm")


def _promises(one: Row) -> list[tuple[bool, dict[str, Any]]]:
    """Each promise of a case, and whether the truth was among the explanations that the test was weighed for."""
    from calibration.diagnosis.next_test.recommend import MOST_RIVALS

    pairs = zip(one["steps"][:-1], one["steps"][1:], strict=True)
    return [
        (sorted(one["ids"]) in before["rivals"][:MOST_RIVALS], promised)
        for before, after in pairs
        for promised in after["promised"]
    ]


def _ratios(given: Rows, promised: str, above: float = TOLD_APART) -> dict[str, Any]:
    """Delivered over promised of the promises above some nats: how many, median and quartiles."""
    known = [(one["delivered_nats"], one.get(promised)) for one in given]
    found = [nats / said for nats, said in known if said is not None and said > above]
    low, median, high = np.quantile(found, [0.25, 0.5, 0.75]).tolist() if found else (None, None, None)
    return {"count": len(found), "median": median, "quartiles": [low, high]}


def _told_apart(one: Row) -> bool:
    """Whether the truth was among what a test was to tell apart, and certainty was promised should it be right.

    Older cases do not say what was promised then: there it is what was promised on the whole.
    """
    return any(
        is_among and (promised.get("nats_if_right") or promised["information_nats"]) > TOLD_APART
        for is_among, promised in _promises(one)
    )


def _is_named(one: Row, day: int) -> bool:
    return any(step["outcome"] == "right" for step in one["steps"][1 : day + 1])


def page(found: Row) -> str:
    """The result in words and a table."""
    lines = [
        "# What tests promised, and what they gave",
        "",
        f"{found['cases']} cases of the second rig, {found['sweeps']} of them a sweep alone at first.",
        f"{found['open']} stayed open between explanations. Of those the first test that the bench can take was",
        "simulated as a recording of another day and given back, at most twice.",
        "",
        f"- All promises: {_in_words(found['ratios_of_all'])}",
        f"- Promises above {TOLD_APART:g} nats: {_in_words(found['ratios'])}",
        "- The same with what was promised should the truth be right, where that was one of the explanations that the",
        f"  test was weighed for: {_in_words(found['ratios_if_right'])}",
        f"- The truth among what such a test was to tell apart: {found['told_apart']} cases. Named after one test: "
        f"{found['named_after'][0]}, after two: {found['named_after'][1]}.",
        f"- Wrong names and false alarms: {found['wrong_before']} of {found['cases']} before, "
        f"{found['wrong_after']} of {found['open']} after.",
        f"- Failed: {len(found['failed'])}. {'; '.join(found['failed'])}".rstrip(),
        f"- States of the code: {len(found['codes'])}, with {' and '.join(map(str, found['codes'].values()))} cases.",
        "",
        "![promised against delivered](follow_ups.png)",
        "",
        "What a first diagnosis was worth that neither named nor listed the truth, by D: how many sds of noise the",
        "first recording shows of what is concealed, once the nuisances have taken up what they can.",
        "",
    ]
    by_d = [(one["D"], ", ".join(f"{n} {what}" for what, n in one["outcomes"].items())) for one in found["by_D"]]
    cases = [
        (
            " + ".join(one["ids"]) or "nothing",
            "" if one["D"] is None else format(one["D"], ".1f"),
            ", then ".join(one["outcomes"]),
            "; ".join(one["tests"]),
        )
        for one in found["rows"]
    ]
    header = ("concealed", "D", "what the diagnoses were worth", "tests")
    grids = (Grid("", ("D", "cases"), by_d), Grid("", header, cases))
    return "\n".join([*lines, *(as_markdown(grid) for grid in grids)])


def _in_words(ratios: Mapping[str, Any]) -> str:
    if not ratios["count"]:
        return "none."
    low, high = ratios["quartiles"]
    told = f"median {ratios['median']:.2f}, quartiles {low:.2f} and {high:.2f}"
    return f"{ratios['count']}. Delivered over promised: {told}."


def picture(found: Row) -> bytes:
    """Promised against delivered nats, as a PNG."""
    from calibration.report.style import FAINT, drawing, name_axes, png, series

    with drawing() as (figure, axes):
        axes.axline((0.0, 0.0), (1.0, 1.0), color=FAINT, linewidth=0.8, label="as promised")
        kinds = (
            ("information_nats", True, "the truth was weighed"),
            ("information_nats", False, "it was not"),
            ("nats_if_right", True, "promised should the truth be right"),
        )
        for i, (promised, is_among, label) in enumerate(kinds):
            there = [one for one in found["promises"] if one["is_among"] == is_among and one.get(promised) is not None]
            places = ([one[key] for one in there] for key in (promised, "delivered_nats"))
            axes.plot(*places, label=label, **series(i) | {"marker": "osx"[i], "linestyle": "none"})
        axes.legend(loc="best")
        axes.set_xscale("symlog", linthresh=1.0)
        axes.set_yscale("symlog", linthresh=1.0)
        name_axes(axes, ("promised", "nats"), ("delivered", "nats"))
        return png(figure)


def documents(found: Row, _rows: Rows) -> dict[str, bytes]:
    """The result as a document, a page and a picture, by file name."""
    files = {"follow_ups.json": json_bytes(found), "follow_ups.md": page(found).encode()}
    return files | {"follow_ups.png": picture(found)}


STUDY = Study(
    name="follow_ups",
    words=__doc__,
    roots=("calibration.challenge.second_rig", DIAGNOSIS),
    task=followed,
    items=items_of,
    first_seed=300_000,
    options={
        "--cases": {"type": whole_number, "default": CASES, "help": "cases that are drawn (%(default)s)"},
        "--sweep-alone": {"action": "store_true", "help": "without runs in time in the first recording"},
        "--days": {"type": whole_number, "default": DAYS, "help": "tests that are taken at most (%(default)s)"},
        "--dry-friction": {
            "type": float,
            "nargs": 2,
            "metavar": ("LEAST", "MOST"),
            "help": "conceal dry friction alone, between these [N m], with runs in time",
        },
        "--without-D": {"action": "store_true", "help": "without D, which takes minutes a case"},
    },
    summary=summary,
    documents=documents,
    told=page,
    kept="cases.json",
)

if __name__ == "__main__":
    sys.exit(main(STUDY))
