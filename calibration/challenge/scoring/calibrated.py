"""Whether what is said with a number keeps what the number promises: intervals, held-out gains, probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.challenge.intervals import half_width_50, reliability, share
from calibration.challenge.scoring.judging import LISTED, LISTED_IN_LIBRARY, NONE, RIGHT, SINGLE, Case, mixed, said_set

LEAST_ORACLE_GAIN = 4.0  # below it a ratio of gains says nothing


def coverage(cases: Sequence[Case]) -> dict[str, Any]:
    """How often the 50 and 90 % intervals of f_overall and of the effects' sizes hold the truth.

    Sizes are counted where the right set was named and its form is the library's. The 90 % interval is q05 to q95 as
    stated; the 50 % one is q25 to q75 where the diagnosis states them, else that of a normal with its mean and sd.
    """
    after, of_all = (
        [(c, c.diagnosis["f_overall_after"]) for c in some if c.diagnosis and _of(c, "after")]
        for some in (cases, mixed(cases))
    )
    parts: dict[str, list[tuple[Case, Mapping[str, float]]]] = {
        "all": of_all,
        "nothing concealed": [one for one in after if one[0].group == NONE],
        "verdict right": [one for one in after if one[0].outcome == RIGHT and one[0].group != NONE],
        "truth listed": [one for one in after if one[0].outcome == LISTED],
        "verdict not right": [one for one in after if one[0].outcome not in (RIGHT, LISTED) and one[0].group != NONE],
        "one effect": [one for one in after if one[0].group == SINGLE],
    }
    before = [(c, c.diagnosis["f_overall_before"]) for c in cases if c.diagnosis and _of(c, "before")]
    if len(of_all) < len(after):
        parts["with those of campaigns of one category"] = after
    parts["before: the base model alone"] = [one for one in before if one[0].group != NONE]
    sizes = [pair for case in cases for pair in _sizes(case)]
    return {
        "f_overall": {name: _covered([(c.truth["f_overall"], f) for c, f in mine]) for name, mine in parts.items()},
        "effect_size": _covered(sizes),
    }


def held_out(cases: Sequence[Case]) -> dict[str, Any]:
    """The gain on held-out readings against that of the true set; a case with no set named or listed gained nothing."""
    known = [(_gain(c), c.oracle_gain) for c in cases if c.group in LISTED_IN_LIBRARY and c.oracle_gain is not None]
    worth = [(gain, oracle) for gain, oracle in known if oracle >= LEAST_ORACLE_GAIN]
    return {
        "cases": len(known),
        "gain": sum(gain for gain, _ in known),
        "oracle_gain": sum(oracle for _, oracle in known),
        "ratio": sum(g for g, _ in known) / sum(o for _, o in known) if sum(o for _, o in known) > 0.0 else None,
        "median_ratio": float(np.median([gain / oracle for gain, oracle in worth])) if worth else None,
    }


def stated(cases: Sequence[Case]) -> dict[str, Any]:
    """Stated probabilities against what was true: of whole sets, and of single effects in them.

    `cases`: all; named and confounded verdicts state probabilities.
    """
    said = [c for c in cases if c.diagnosis and c.verdict in ("named", "confounded")]
    sets, effects = [], []
    for case in said:
        found: Mapping[str, Any] = case.diagnosis or {}
        said_of = said_set(found)
        right = bool(said_of) and said_of in (case.true_set, case.named_by_format)
        sets.append((found["set_probability"], right))
        effects += [(effect["probability"], effect["id"] in case.true_set) for effect in found["effects"]]
    named = [one for one, case in zip(sets, said, strict=True) if case.verdict == "named"]
    return {
        "sets": reliability(*_columns(sets)),
        "sets_named": reliability(*_columns(named)),
        "effects": reliability(*_columns(effects)),
    }


def _columns(pairs: Sequence[tuple[float, bool]]) -> tuple[list[float], list[bool]]:
    return [p for p, _ in pairs], [hit for _, hit in pairs]


def _of(case: Case, when: str) -> Mapping[str, float] | None:
    found = (case.diagnosis or {}).get(f"f_overall_{when}")
    return found if case.truth.get("f_overall") is not None else None


def _gain(case: Case) -> float:
    if case.diagnosis is None or case.verdict not in ("named", "confounded"):
        return 0.0
    found = (case.diagnosis.get("improvement") or {}).get("held_out") or {}
    return float(found.get("elpd_gain") or 0.0)


def _sizes(case: Case) -> list[tuple[float, Mapping[str, float]]]:
    """True and found parameters of effects whose form is the library's."""
    if case.group not in LISTED_IN_LIBRARY or case.outcome != RIGHT or case.diagnosis is None:
        return []
    made = []
    for effect in case.diagnosis["effects"]:
        true = case.truth["sizes"].get(effect["id"])
        for name, found in effect["parameters"].items():
            value = true.get(name) if isinstance(true, Mapping) else true if len(effect["parameters"]) == 1 else None
            if value is not None:
                made.append((float(value), found))
    return made


def _covered(pairs: Sequence[tuple[float, Mapping[str, float]]]) -> dict[str, Any]:
    inside = {"50": [], "90": []}  # type: dict[str, list[bool]]
    for true, found in pairs:
        half = half_width_50(found["sd"])
        low, high = found.get("q25", found["mean"] - half), found.get("q75", found["mean"] + half)
        inside["50"].append(low <= true <= high)
        inside["90"].append(found["q05"] <= true <= found["q95"])
    return {level: share(hits) for level, hits in inside.items()}
