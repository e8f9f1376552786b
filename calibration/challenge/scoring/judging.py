"""One case: what was concealed against what was said."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

NONE, SINGLE, OTHER_FORM, PAIR, NOT_IN_LIBRARY, NEAR = (
    "none",
    "single",
    "other_form",
    "pair",
    "not_in_library",
    "near_nuisance",
)
GROUPS = (NONE, SINGLE, PAIR, OTHER_FORM, NOT_IN_LIBRARY, NEAR)
LISTED_IN_LIBRARY = (SINGLE, PAIR)  # what the goal for the right set is counted on
BEYOND_SD = 3.0  # an effect with the form of a nuisance has its name only beyond this, by diagnosis/1

RIGHT, LISTED, PART, WRONG = "right", "truth listed", "part named", "wrong name"
ASTRAY, REFUSED, MISSED, ALARM, FAILED = "confounded without the truth", "unresolved", "missed", "false alarm", "failed"
OUTCOMES = (RIGHT, LISTED, PART, REFUSED, MISSED, ALARM, ASTRAY, WRONG, FAILED)


@dataclass(frozen=True)
class Case:
    """Everything known of a case once its truth is open.

    `diagnosis`: diagnosis/1 without its times; None where it failed.
    `seconds`: of the diagnosis [s].
    `again`: the diagnosis with the recommended test added, where one was made.
    `oracle_gain`: held-out gain of the true set, where it was computed [-].
    `apart`: whether its campaign is of one category alone. It counts where that is asked for, not in the shares of all.
    """

    name: str
    truth: dict[str, Any]
    diagnosis: dict[str, Any] | None
    error: str = ""
    seconds: float = 0.0
    signatures: dict[str, Any] | None = None
    again: dict[str, Any] | None = None
    oracle_gain: float | None = None
    apart: bool = False

    @property
    def group(self) -> str:
        """The make-up's part that it is counted in; sizes about those of a nuisance are apart."""
        near = self.truth.get("near_nuisance") or self.named_by_format != self.true_set
        return NEAR if near else str(self.truth["category"])

    @property
    def true_set(self) -> frozenset[str]:
        """What is at work of the library; empty for nothing, and for what is in no library."""
        return frozenset(self.truth["ids"]) if self.truth["category"] in (SINGLE, PAIR, OTHER_FORM) else frozenset()

    @property
    def named_by_format(self) -> frozenset[str]:
        """The same without what is, nuisance included, within three declared sds: that is the nuisance at work."""
        sds = self.truth.get("total_sds") or {}
        return frozenset(one for one in self.true_set if abs(sds.get(one, BEYOND_SD)) >= BEYOND_SD)

    @property
    def verdict(self) -> str:
        """In a word of diagnosis/1, or failed."""
        return FAILED if self.diagnosis is None else str(self.diagnosis["verdict"])

    @property
    def named(self) -> frozenset[str]:
        """The set named alone; empty without one."""
        return said_set(self.diagnosis) if self.verdict == "named" and self.diagnosis else frozenset()

    @property
    def outcome(self) -> str:
        """One of OUTCOMES."""
        return self.outcome_of(self.diagnosis)

    def outcome_of(self, diagnosis: Mapping[str, Any] | None) -> str:
        """What any diagnosis of this case is worth: right by diagnosis/1, or by what is at work."""
        full = outcome(self.truth["category"], self.true_set, diagnosis)
        if self.named_by_format == self.true_set or full in (RIGHT, WRONG, FAILED):
            return full
        category = self.truth["category"] if self.named_by_format else NONE
        by_format = outcome(category, self.named_by_format, diagnosis)
        return by_format if by_format in (RIGHT, LISTED) else full

    @property
    def size(self) -> float | None:
        """Projected signal-to-noise ratio D of what was concealed [-]."""
        D = (self.signatures or {}).get("D")
        return float(D) if D is not None and math.isfinite(D) else None

    @property
    def separable(self) -> bool:
        """Whether the recording can tell it from every rival, by the scorer's account."""
        return bool(self.signatures and self.signatures.get("separable"))


def mixed(cases: Sequence[Case]) -> list[Case]:
    """Cases of campaigns with the whole make-up, for the shares of all; all of them where there are no such."""
    return [case for case in cases if not case.apart] or list(cases)


def said_set(diagnosis: Mapping[str, Any]) -> frozenset[str]:
    """The set that a verdict rests on."""
    return frozenset(effect["id"] for effect in diagnosis["effects"])


def listed_sets(diagnosis: Mapping[str, Any]) -> list[frozenset[str]]:
    """All sets that a confounded verdict lists."""
    return [said_set(diagnosis), *(frozenset(names) for names in diagnosis["alternatives"])]


def tests_of_this_bench(diagnosis: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """The tests recommended that need no other instrument: the rig has only its own."""
    return [test for test in (diagnosis or {}).get("next_tests", []) if not test.get("needs")]


def outcome(category: str, true_set: frozenset[str], diagnosis: Mapping[str, Any] | None) -> str:
    """What a verdict is worth."""
    if diagnosis is None:
        return FAILED
    verdict = diagnosis["verdict"]
    if category == NONE:
        return {"consistent": RIGHT, "named": WRONG}.get(verdict, ALARM)
    if category == NOT_IN_LIBRARY:
        return {"unresolved": RIGHT, "named": WRONG, "confounded": ASTRAY}.get(verdict, MISSED)
    if verdict == "named":
        said = said_set(diagnosis)
        return RIGHT if said == true_set else PART if said and said < true_set else WRONG
    if verdict == "confounded":
        return LISTED if true_set in listed_sets(diagnosis) else ASTRAY
    return REFUSED if verdict == "unresolved" else MISSED
