"""What was set as a goal beforehand, beside what was got."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

FALSE_NAMES, RIGHT_SETS, WRONG_NAMES, STRANGERS_NAMED, STRANGERS_LOCATED = 0.01, 0.95, 0.03, 0.05, 0.90
COVERED = (0.87, 0.93)
ORACLE = 0.90
SEPARABLE = 0.40
MET, MISSED, NO_CASES = "met", "missed", "no cases"


def goals(found: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The goals in a table: each with its bounds, the share, its interval, and whether it was met.

    A goal is met where the share itself is inside the bounds; ``certain`` says that the whole 95 % interval is.
    """
    strangers, covered = found["not_in_library"], found["coverage"]
    made = [
        _goal("false names where nothing is concealed", found["nulls"]["all"]["false_names"], high=FALSE_NAMES),
        _goal("right set of effects where separable", found["separable"]["right_set"], low=RIGHT_SETS),
        _goal("wrong names in all", found["wrong_names"]["all"], high=WRONG_NAMES),
        _goal("effects in no library wrongly named", strangers["wrongly_named"], high=STRANGERS_NAMED),
        _goal("effects in no library located", strangers["located"], low=STRANGERS_LOCATED),
        _goal("90 % intervals of f_overall that hold it", covered["f_overall"]["all"]["90"], *COVERED),
        _goal("90 % intervals of an effect's size that hold it", covered["effect_size"]["90"], *COVERED),
        _goal("separable cases of those with effects of the library", found["separable"]["share"], low=SEPARABLE),
    ]
    ratio = found["held_out"]["ratio"]
    verdict = NO_CASES if ratio is None else MET if ratio >= ORACLE else MISSED
    gain = {"goal": "held-out gain against the oracle's", "low": ORACLE, "high": None, "got": None, "ratio": ratio}
    return [*made, gain | {"met": verdict, "certain": None}]


def _goal(words: str, got: Mapping[str, Any], low: float | None = None, high: float | None = None) -> dict[str, Any]:
    def inside(least: float, most: float) -> bool:
        return (low is None or least >= low) and (high is None or most <= high)

    made = {"goal": words, "low": low, "high": high, "got": dict(got)}
    if not got["n"]:
        return made | {"met": NO_CASES, "certain": None}
    met = MET if inside(got["share"], got["share"]) else MISSED
    return made | {"met": met, "certain": inside(got["low"], got["high"])}
