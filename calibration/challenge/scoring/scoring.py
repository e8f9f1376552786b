"""All cases of a campaign, counted: plain data that JSON can hold. Nothing here reads a file."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calibration.challenge.intervals import share
from calibration.challenge.scoring import judging
from calibration.challenge.scoring.calibrated import coverage, held_out, stated
from calibration.challenge.scoring.goals import goals
from calibration.challenge.scoring.judging import (
    ASTRAY,
    FAILED,
    GROUPS,
    LISTED,
    LISTED_IN_LIBRARY,
    MISSED,
    NEAR,
    NONE,
    NOT_IN_LIBRARY,
    OTHER_FORM,
    RIGHT,
    WRONG,
    Case,
)
from calibration.challenge.scoring.places import Located, any_place, first_place

SIGNAL_EDGES = (0.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0, 50.0, float("inf"))
SEEN = 7.0  # D from which what is not separable is hidden by a rival, not by noise
PAIR_ROW, PAIR_COLUMN = "two effects", "two effects named"


def summary(cases: Sequence[Case]) -> dict[str, Any]:
    """Everything that is published of a campaign. `cases`: all of them; none is dropped."""
    by_group = {group: [case for case in cases if case.group == group] for group in GROUPS}
    found: dict[str, Any] = {
        "cases": len(cases),
        "make_up": {group: len(mine) for group, mine in by_group.items()},
        "outcomes": {group: dict(Counter(case.outcome for case in mine)) for group, mine in by_group.items() if mine},
        "confusion": {
            "main": confusion([c for c in cases if c.group not in (OTHER_FORM, NEAR)]),
            OTHER_FORM: confusion(by_group[OTHER_FORM]),
            NEAR: confusion(by_group[NEAR]),
        },
        "accuracy": {group: accuracy(mine) for group, mine in by_group.items() if mine and group != NONE},
        "separable": separable(by_group),
        "by_signal": by_signal([c for group in LISTED_IN_LIBRARY for c in by_group[group]]),
        "nulls": nulls(by_group[NONE]),
        "near": near(by_group[NEAR]),
        "wrong_names": {"all": share(c.outcome == WRONG for c in judging.mixed(cases))}
        | {group: share(c.outcome == WRONG for c in mine) for group, mine in by_group.items() if mine},
        "not_in_library": not_in_library(by_group[NOT_IN_LIBRARY]),
        "located": {group: located(mine) for group, mine in by_group.items() if mine and group != NONE},
        "confounded": confounded(cases),
        "coverage": coverage(cases),
        "held_out": held_out(cases),
        "reliability": stated(cases),
        "core_hours": sum(case.seconds for case in cases) / 3600.0,
        "seconds": _quantiles([case.seconds for case in cases]),
    }
    return found | {"goals": goals(found)}


def confusion(cases: Sequence[Case]) -> dict[str, Any]:
    """Rows: what was concealed; columns: what was said, refusals included."""
    counts = Counter((_row(case), _column(case)) for case in cases)
    rows = _ordered({row for row, _ in counts}, (NONE,), (PAIR_ROW, NOT_IN_LIBRARY))
    last = (PAIR_COLUMN, "truth listed", "confounded without the truth", "unresolved", "failed")
    columns = _ordered({column for _, column in counts}, ("consistent",), last)
    return {"rows": rows, "columns": columns, "counts": [[counts[row, column] for column in columns] for row in rows]}


def accuracy(cases: Sequence[Case]) -> dict[str, Any]:
    """Right verdicts of all cases, and of those in which something was named: refusing helps the second alone."""
    return {
        "unconditional": share(c.outcome == RIGHT for c in cases),
        "with_truth_listed": share(c.outcome in (RIGHT, LISTED) for c in cases),
        "given_a_name": share(c.outcome == RIGHT for c in cases if c.verdict == "named"),
    }


def separable(by_group: dict[str, list[Case]]) -> dict[str, Any]:
    """How many the recordings can tell apart by the scorer's account, and the right sets among these."""
    own = [case for group in LISTED_IN_LIBRARY for case in by_group[group]]
    known = [case for case in own if case.signatures]
    found = {
        "share": share(case.separable for case in known),
        "not_computed": len(own) - len(known),
        "right_set": share(case.outcome == RIGHT for case in known if case.separable),
    }
    for group in (*LISTED_IN_LIBRARY, OTHER_FORM):
        found[f"right_set_{group}"] = share(case.outcome == RIGHT for case in by_group[group] if case.separable)
    found["right_or_listed_other_form"] = share(
        case.outcome in (RIGHT, LISTED) for case in by_group[OTHER_FORM] if case.separable
    )
    return found


def by_signal(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Rates in bins of D, the projected signal-to-noise ratio."""
    made = []
    for low, high in itertools.pairwise(SIGNAL_EDGES):
        mine = [case for case in cases if case.size is not None and low <= case.size < high]
        rates: dict[str, Callable[[Case], bool]] = {
            "right": lambda c: c.outcome == RIGHT,
            "right_or_listed": lambda c: c.outcome in (RIGHT, LISTED),
            "detected": lambda c: c.verdict not in ("consistent", "failed"),
            "wrong": lambda c: c.outcome == WRONG,
        }
        bin_ = {"from": low, "to": None if high == float("inf") else high, "n": len(mine)}
        made.append(bin_ | {name: share(is_it(case) for case in mine) for name, is_it in rates.items()})
    return made


def nulls(cases: Sequence[Case]) -> dict[str, Any]:
    """False alarms and false names where nothing was concealed, with honest and with misdeclared noise."""
    parts = {
        "all": list(cases),
        "noise as declared": [c for c in cases if not c.truth.get("misdeclared")],
        "noise misdeclared": [c for c in cases if c.truth.get("misdeclared")],
    }
    return {
        name: {
            "false_alarms": share(c.verdict not in ("consistent", "failed") for c in mine),
            "false_names": share(c.verdict == "named" for c in mine),
        }
        for name, mine in parts.items()
    }


def near(cases: Sequence[Case]) -> dict[str, Any]:
    """Effects of about a nuisance's size: by whether all of the case is beyond three declared standard deviations."""
    parts = {
        "beyond three sds": [c for c in cases if c.named_by_format == c.true_set],
        "something within three sds": [c for c in cases if c.named_by_format != c.true_set],
    }
    return {
        name: {
            "right": share(c.outcome == RIGHT for c in mine),
            "named_what_is_at_work": share(c.named == c.true_set for c in mine),
            "consistent": share(c.verdict == "consistent" for c in mine),
            "wrong": share(c.outcome == WRONG for c in mine),
        }
        for name, mine in parts.items()
    }


def not_in_library(cases: Sequence[Case]) -> dict[str, Any]:
    """What became of effects that resemble no entry."""
    return {
        "unresolved": share(c.outcome == RIGHT for c in cases),
        "wrongly_named": share(c.outcome == WRONG for c in cases),
        "confounded": share(c.outcome == ASTRAY for c in cases),
        "missed": share(c.outcome == MISSED for c in cases),
        "located": share(_first(c).right for c in cases),
        "located_where_noticed": share(_first(c).right for c in cases if c.verdict not in ("consistent", "failed")),
    }


def located(cases: Sequence[Case]) -> dict[str, Any]:
    """Places, by what is right of them and by the size of the group that held the coordinate."""
    placed = [case for case in cases if case.truth.get("place")]
    first = [_first(case) for case in placed]
    anywhere = [any_place(c.truth["place"], c.diagnosis["located"] if c.diagnosis else []) for c in placed]
    return {
        "right": share(one.right for one in first),
        "any_of_those_listed": share(one.right for one in anywhere),
        "where_noticed": share(
            one.right for one, c in zip(first, placed, strict=True) if c.verdict not in ("consistent", "failed")
        ),
        "balance": share(one.balance for one in first),
        "channel": share(one.channel for one in first),
        "coordinate": share(one.coordinate for one in first),
        "range": share(bool(one.overlaps) for one in first if one.overlaps is not None),
        "by_group_size": dict(sorted(Counter(str(one.group) for one in first if one.right).items())),
    }


def confounded(cases: Sequence[Case]) -> dict[str, Any]:
    """Pairs that the recording cannot tell apart: said so or not, and what a further test made of them."""
    alike = [
        c
        for c in cases
        if c.group in LISTED_IN_LIBRARY and c.signatures and not c.separable and (c.size or 0.0) >= SEEN
    ]
    said = [c for c in cases if c.outcome == LISTED]
    followed = [c for c in said if judging.tests_of_this_bench(c.diagnosis)] if any(c.again for c in said) else []
    again = [FAILED if c.again is None else c.outcome_of(c.again) for c in followed]
    return {
        "not_separable_above_7": len(alike),
        "flagged": share(c.outcome == LISTED for c in alike),
        "flagged_with_the_rival": share(c.outcome == LISTED and _rival_listed(c) for c in alike),
        "named_all_the_same": share(c.outcome == RIGHT for c in alike),
        "truth_listed": len(said),
        "followed_up": len(again),
        "resolved": share(one == RIGHT for one in again),
        "resolved_wrongly": share(one == WRONG for one in again),
        "still_confounded": share(one == LISTED for one in again),
        "neither": share(one not in (RIGHT, WRONG, LISTED, FAILED) for one in again),
        "ended_in_an_error": share(one == FAILED for one in again),
    }


def _first(case: Case) -> Located:
    return first_place(case.truth.get("place") or {}, case.diagnosis["located"] if case.diagnosis else [])


def _rival_listed(case: Case) -> bool:
    rival = (case.signatures or {}).get("rival")
    if not rival or case.diagnosis is None:
        return False
    wanted = frozenset([rival] if isinstance(rival, str) else rival)
    return any(wanted <= one != case.true_set for one in judging.listed_sets(case.diagnosis))


def _row(case: Case) -> str:
    if case.group == NOT_IN_LIBRARY or case.truth["category"] == NONE:
        return NONE if case.truth["category"] == NONE else NOT_IN_LIBRARY
    return PAIR_ROW if len(case.true_set) > 1 else next(iter(case.true_set))


def _column(case: Case) -> str:
    if case.verdict == "named":
        return next(iter(case.named)) if len(case.named) == 1 else PAIR_COLUMN
    if case.verdict == "confounded":
        return LISTED if case.outcome == LISTED else ASTRAY
    return case.verdict


def _ordered(present: set[str], first: tuple[str, ...], last: tuple[str, ...]) -> list[str]:
    middle = sorted(present - set(first) - set(last))
    return [*(one for one in first if one in present), *middle, *(one for one in last if one in present)]


def _quantiles(seconds: Sequence[float]) -> dict[str, float] | None:
    if not seconds:
        return None
    median, most = np.quantile(seconds, [0.5, 0.95])
    return {"median": float(median), "q95": float(most), "longest": float(max(seconds))}
